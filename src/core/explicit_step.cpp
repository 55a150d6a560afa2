#include <algorithm>
#include <cmath>

#include "bezier_fem/green_strain.h"
#include "bezier_fem/stable_step.h"
#include "bezier_fem/step.h"
#include "forces.h"
#include "stopwatch.h"

namespace bezier_fem
{
namespace
{
/** Green's strain stiffens as it is stretched; so many sub-steps use one bound. */
constexpr int SUBSTEPS_A_BOUND = 16;
/** Of the longest stable step, for what the body stretches in between two bounds. */
constexpr double SAFETY = 0.9;

/** One body's explicit step: what its parts share. */
class ExplicitStep
{
public:
  ExplicitStep(const Model& model, const StepSettings& settings, const Supports& supports,
               const std::vector<AppliedLoad>& loads, const NodalField& external, State& state, Workspace& workspace,
               StepReport& report)
      : model_(model),
        settings_(settings),
        supports_(supports),
        loads_(loads),
        external_(external),
        state_(state),
        w_(workspace),
        report_(report),
        mass_(model, workspace.partition, state.rotations, 1, 0)
  {
    w_.prepared.reset();
    w_.solver.prepare(mass_, model_, w_.partition, supports_.held, 1e-3 * settings_.time_step);
    watch_.lap(report_.ms.assembly);
  }

  double stableStep()
  {
    const double h = SAFETY * bezier_fem::stableStep(model_, settings_, state_, w_);
    watch_.lap(report_.ms.assembly);
    return h;
  }

  /** Half the acceleration's change of v before x moves and half after it (velocity Verlet). */
  void substep(double step_begin, double h)
  {
    // Led components get the one velocity that takes them to where they have to be.
    w_.led.matrix() = state_.x.matrix();
    applySupports(supports_, state_.time + h, (state_.time + h - step_begin) / settings_.time_step, w_.led);
    w_.led.matrix() = (w_.led.matrix() - state_.x.matrix()) / h;
    for (int i = 0; i < model_.num_nodes; ++i)
    {
      for (int axis = 0; axis < 3; ++axis)
      {
        w_.led[i][axis] = supports_.held[i] >> axis & 1 ? w_.led[i][axis] - state_.v[i][axis] : 0;
      }
    }
    kick(h / 2, state_.time);
    state_.x.matrix() += h * state_.v.matrix();
    watch_.lap(report_.ms.force);
    if (settings_.elasticity == Elasticity::COROTATED)
    {
      const Turn turn = updateRotations(model_, w_.partition, state_.x, state_.rotations, w_.candidate, w_.turned);
      std::swap(state_.rotations, w_.candidate);
      report_.turn = std::max(report_.turn, turn.angle);
      report_.inverted = turn.inverted;
      watch_.lap(report_.ms.rotation);
    }
    w_.led.setZero();
    kick(h / 2, state_.time + h);
    // Squares overflow before positions do.
    report_.finite = state_.x.matrix().allFinite() && state_.v.matrix().allFinite() && std::isfinite(report_.residual);
  }

private:
  /** v += k M^-1 f(x, v) where free and v += led elsewhere. */
  void kick(double k, double time)
  {
    const double damp_m = settings_.damping.mass, damp_k = settings_.damping.stiffness;
    externalForce(model_, w_.partition, settings_, loads_, external_, time, state_.x, w_.load);
    const bool green = settings_.elasticity == Elasticity::GREEN;
    // With the rotations held f_el is affine: f_el(x) + b K' v = f_el(x + b v).
    w_.x_before.matrix() = state_.x.matrix();
    if (!green && damp_k > 0) w_.x_before.matrix() += damp_k * state_.v.matrix();
    internalForce(model_, w_.partition, settings_.elasticity, state_.rotations, w_.x_before, w_.force);
    w_.rhs.matrix() = k * (w_.load.matrix() - w_.force.matrix());
    if (green && damp_k > 0)
    {
      if (!w_.green) w_.green = std::make_unique<GreenTangent>(model_);
      linearise(model_, w_.partition, state_.x, Projection::POSITIVE_STRESS, *w_.green);
      systemProduct(model_, w_.partition, *w_.green, 0, damp_k, state_.v, w_.force);
      w_.rhs.matrix() -= k * w_.force.matrix();
    }
    w_.x_before.matrix() = k * damp_m * state_.v.matrix() + w_.led.matrix();
    if (!(w_.x_before.matrix().array() == 0).all())
    {
      mass_.product(w_.x_before, w_.force);
      w_.rhs.matrix() -= w_.force.matrix();
    }
    watch_.lap(report_.ms.force);
    // `change` still has the last acceleration to start from.
    const SolveReport solved = w_.solver.solve(mass_, w_.partition, w_.rhs, w_.change, settings_.solver.tolerance,
                                               settings_.solver.max_iterations);
    report_.iterations += solved.iterations;
    report_.residual = std::max(report_.residual, solved.residual);
    report_.converged = report_.converged && solved.converged;
    w_.balance.matrix() = w_.solver.residual().matrix() / -k;
    state_.v.matrix() += w_.change.matrix() + w_.led.matrix();
    watch_.lap(report_.ms.solve);
  }

  const Model& model_;
  const StepSettings& settings_;
  const Supports& supports_;
  const std::vector<AppliedLoad>& loads_;
  const NodalField& external_;
  State& state_;
  Workspace& w_;
  StepReport& report_;
  MatrixFreeSystem<Rotations> mass_;
  Stopwatch watch_;
};
}  // namespace

double stableStep(const Model& model, const StepSettings& settings, const State& state, Workspace& w)
{
  if (!w.bound) w.bound = std::make_unique<SpectralBound>(model, w.partition);
  // Rotations that follow the deformation only lower the eigenvalues of K'.
  const double largest =
      settings.elasticity == Elasticity::GREEN ? w.bound->green(model, w.partition, state.x) : w.bound->corotated();
  return stableStep(largest, settings.damping);
}

StepReport explicitStep(const Model& model, const StepSettings& settings, const Supports& supports,
                        const std::vector<AppliedLoad>& loads, const NodalField& external, State& state, Workspace& w)
{
  StepReport report;
  report.substeps = 0;
  Stopwatch total;
  const double begin = state.time, end = settings.time_step * static_cast<double>(state.steps + 1);
  ExplicitStep step(model, settings, supports, loads, external, state, w, report);
  double h = 0;
  while (report.finite && end - state.time > 1e-9 * settings.time_step)
  {
    if (report.substeps % SUBSTEPS_A_BOUND == 0)
    {
      const double shortest = settings.time_step / MAX_EXPLICIT_SUBSTEPS;
      const double left = end - state.time;
      h = left / std::ceil(left / std::max(step.stableStep(), shortest) * (1 - 1e-12));
    }
    step.substep(begin, h);
    ++report.substeps;
    state.time += h;
  }
  ++state.steps;
  state.time = settings.time_step * static_cast<double>(state.steps);
  total.lap(report.ms.total);
  return report;
}

}  // namespace bezier_fem
