#include <algorithm>
#include <cmath>

#include "bezier_fem/element_operator.h"
#include "bezier_fem/measures.h"
#include "bezier_fem/step.h"
#include "forces.h"
#include "linear_solve.h"
#include "newton.h"

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
/** The forces out of balance, f_ext - f_el, at positions x with the rotations of x; N. */
class Balance
{
public:
  Balance(const Model& model, const StepSettings& settings, const std::vector<AppliedLoad>& loads,
          const NodalField& external, double time, Workspace& workspace)
      : model_(model), settings_(settings), loads_(loads), external_(external), time_(time), w_(workspace)
  {
  }

  /** Leaves the loads in Workspace::load and the forces out of balance in Workspace::rhs. */
  void evaluate(const NodalField& x, const Rotations& rotations)
  {
    externalForce(model_, w_.partition, settings_, loads_, external_, time_, x, w_.load);
    elasticForce(model_, w_.partition, rotations, x, w_.force);
    w_.rhs.matrix() = w_.load.matrix() - w_.force.matrix();
  }

  /** The work of the forces out of balance on `direction`, which is zero where the body is held. */
  double work(const NodalField& direction) const { return w_.rhs.matrix().cwiseProduct(direction.matrix()).sum(); }

private:
  const Model& model_;
  const StepSettings& settings_;
  const std::vector<AppliedLoad>& loads_;
  const NodalField& external_;
  double time_;
  Workspace& w_;
};

/** Newton's method for Green's strain, whose force has a derivative and an energy. */
StepReport greenEquilibrium(const Model& model, const StepSettings& settings, const Supports& supports,
                            const std::vector<AppliedLoad>& loads, const NodalField& external, State& state,
                            Workspace& w, const std::function<void(int, double)>& progress)
{
  constexpr int MAX_ROUNDS = 300;
  if (!w.newton) w.newton = std::make_unique<NewtonMemory>(model);
  NewtonMemory& m = *w.newton;
  // The sum that is minimised: U(x_0 + v) - f_ext . v, with a pressure's force that of the start of each round.
  state.v.setZero();
  GreenNewton newton(model, settings, supports, state.rotations, 1, 0, 0, 0, Serves::SAME_COEFFICIENTS, state.x,
                     state.v, w);
  // Pressure turns with the faces, which takes back much of what the stress that it causes does to the stiffness. The
  // tangent that knows of the one and not of the other would have each round turn the next one's loads too far.
  const bool pressed =
      std::any_of(loads.begin(), loads.end(), [](const AppliedLoad& load) { return load.pressure > 0; });
  const Projection tangent = pressed ? Projection::POSITIVE_STRESS : Projection::NONE;
  StepReport report;
  double before = 0;
  for (int round = 0;; ++round)
  {
    externalForce(model, w.partition, settings, loads, external, state.time, state.x, w.load);
    m.quadratic.matrix() = -w.load.matrix();
    newton.start();
    const Norms out_of_balance = norms(supports, m.gradient, model.num_nodes);
    const Norms applied = norms(supports, w.load, model.num_nodes);
    const double scale = std::hypot(applied.free, applied.held) + out_of_balance.held;
    report.residual = scale > 0 ? out_of_balance.free / scale : 0;
    report.finite = std::isfinite(out_of_balance.free);
    report.converged = report.residual <= settings.solver.tolerance;
    if (progress) progress(round, report.residual);
    if (report.converged || !report.finite || round == MAX_ROUNDS) break;

    const double forcing = round == 0 ? 0.03 : 0.9 * std::pow(report.residual / before, 2);
    before = report.residual;
    newton.linearise(tangent);
    if (!newton.iterate(std::clamp(forcing, 0.1 * settings.solver.tolerance, 0.03),
                        100 * settings.solver.max_iterations, report))
    {
      break;
    }
  }
  w.balance.matrix() = m.gradient.matrix();
  report.inverted = invertedElements(model, state.x);
  return report;
}

/** Linear and co-rotated elasticity: rounds of linear systems, each with the rotations held. */
StepReport laggedEquilibrium(const Model& model, const StepSettings& settings, const Supports& supports,
                             const std::vector<AppliedLoad>& loads, const NodalField& external, State& state,
                             Workspace& w, const std::function<void(int, double)>& progress)
{
  constexpr int MAX_ROUNDS = 300, MAX_TRIALS = 10;
  // Linear: one system, so its residual has to be small enough at once. Co-rotated: K' is not the derivative of the
  // force, so a round gains two digits at best.
  const bool linear = settings.elasticity == Elasticity::LINEAR;
  const double round_tolerance = linear ? 0.01 * settings.solver.tolerance : 0.01;

  StepReport report;
  Balance balance(model, settings, loads, external, state.time, w);
  balance.evaluate(state.x, state.rotations);
  for (int round = 0;; ++round)
  {
    const Norms out_of_balance = norms(supports, w.rhs, model.num_nodes);
    const Norms applied = norms(supports, w.load, model.num_nodes);
    const double scale = std::hypot(applied.free, applied.held) + out_of_balance.held;
    report.residual = scale > 0 ? out_of_balance.free / scale : 0;
    report.finite = std::isfinite(out_of_balance.free);
    report.converged = report.residual <= settings.solver.tolerance;
    if (progress) progress(round, report.residual);
    if (report.converged || !report.finite || round == MAX_ROUNDS) break;

    const MatrixFreeSystem<Rotations> matrix_free(model, w.partition, state.rotations, 0, 1);
    const SystemOperator& system = systemOf(matrix_free, state.rotations, 0, 1, w);
    w.solver.prepare(system, model, w.partition, supports.held, 0);
    w.change.setZero();
    solveLinear(
        model, settings, supports, state.rotations, system, 0, 1, round_tolerance, 100 * settings.solver.max_iterations,
        Serves::SAME_COEFFICIENTS, [](Preconditioner*) {}, w, report);
    // A round turns the body too far for the factor to serve again.
    if (w.preconditioner && !linear) w.preconditioner->forget();

    // As far along the change as the forces out of balance go on doing work (Matthies and Strang 1979): the whole
    // change turns a soft body's elements so far that the next change would undo it.
    w.x_before.matrix() = state.x.matrix();
    const double slope = balance.work(w.change);
    double low = 0, low_work = slope, high = 0, high_work = 0, length = 1;
    for (int trial = 0; trial < MAX_TRIALS; ++trial)
    {
      state.x.matrix() = w.x_before.matrix() + length * w.change.matrix();
      if (linear)
      {
        balance.evaluate(state.x, state.rotations);
        break;
      }
      updateRotations(model, w.partition, state.x, state.rotations, w.candidate, w.turned);
      balance.evaluate(state.x, w.candidate);
      const double work = balance.work(w.change);
      if (std::abs(work) <= 0.3 * slope) break;
      if (work > 0)
      {
        low = length;
        low_work = work;
      }
      else
      {
        high = length;
        high_work = work;
      }
      const double cut = high > 0 ? std::clamp(low_work / (low_work - high_work), 0.1, 0.9) : 0;
      length = high > 0 ? low + cut * (high - low) : 2 * length;
    }
    if (!linear) std::swap(state.rotations, w.candidate);
  }
  w.balance.matrix() = -w.rhs.matrix();
  return report;
}
}  // namespace

StepReport solveStatic(const Model& model, const StepSettings& settings, const Supports& supports,
                       const std::vector<AppliedLoad>& loads, const NodalField& external, State& state, Workspace& w,
                       const std::function<void(int, double)>& progress)
{
  const auto solve = settings.elasticity == Elasticity::GREEN ? greenEquilibrium : laggedEquilibrium;
  const StepReport report = solve(model, settings, supports, loads, external, state, w, progress);
  state.v.setZero();
  w.forgetHistory();  // Newton's memory too: here, where nothing refers to it any more
  return report;
}

}  // namespace bezier_fem
