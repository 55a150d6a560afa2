#include <algorithm>
#include <cmath>

#include "bezier_fem/element_operator.h"
#include "bezier_fem/step.h"

namespace bezier_fem
{
namespace
{
struct Norms
{
  double free, held;
};

Norms norms(const Supports& supports, const NodalField& f, int num_nodes)
{
  double free = 0, held = 0;
  for (int i = 0; i < num_nodes; ++i)
  {
    for (int axis = 0; axis < 3; ++axis)
    {
      (supports.held[i] >> axis & 1 ? held : free) += f[i][axis] * f[i][axis];
    }
  }
  return {std::sqrt(free), std::sqrt(held)};
}
}  // namespace

StepReport solveStatic(const Model& model, const StepSettings& settings, const Supports& supports,
                       const std::vector<AppliedLoad>& loads, const NodalField& external, State& state, Workspace& w,
                       const std::function<void(int, double)>& progress)
{
  StepReport report;
  constexpr int MAX_ROUNDS = 200;
  for (int round = 0;; ++round)
  {
    w.load.matrix() = external.matrix();
    for (int i = 0; i < model.num_nodes; ++i) w.load[i] += model.node_mass[i] * settings.gravity;
    addLoads(model, loads, state.time, state.x, w.load);
    elasticForce(model, w.partition, state.rotations, state.x, w.force);
    w.rhs.matrix() = w.load.matrix() - w.force.matrix().leftCols(model.num_nodes);
    const Norms out_of_balance = norms(supports, w.rhs, model.num_nodes),
                applied = norms(supports, w.load, model.num_nodes);
    const double scale = std::hypot(applied.free, applied.held) + out_of_balance.held;
    report.residual = out_of_balance.free / scale;
    report.finite = std::isfinite(out_of_balance.free);
    report.converged = report.residual <= settings.solver.tolerance;
    if (progress) progress(round, report.residual);
    if (report.converged || !report.finite || round == MAX_ROUNDS) break;

    w.solver.prepare(model, w.partition, state.rotations, supports.held, 0, 1, 0);
    w.change.setZero();
    const SolveReport solved = w.solver.solve(model, w.partition, state.rotations, w.rhs, w.change,
                                              0.01 * settings.solver.tolerance, 100 * settings.solver.max_iterations);
    report.iterations += solved.iterations;
    state.x.matrix() += w.change.matrix();
    if (settings.elasticity == Elasticity::COROTATED)
    {
      updateRotations(model, w.partition, state.x, state.rotations, w.candidate, w.turned);
      std::swap(state.rotations, w.candidate);
    }
  }
  w.balance.matrix() = -w.rhs.matrix();
  state.v.setZero();
  w.forgetHistory();
  return report;
}

}  // namespace bezier_fem
