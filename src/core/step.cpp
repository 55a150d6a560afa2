#include "bezier_fem/step.h"

#include <algorithm>
#include <cmath>

#include "bezier_fem/element_operator.h"
#include "bezier_fem/green_strain.h"
#include "bezier_fem/p_multigrid.h"
#include "bezier_fem/stable_step.h"
#include "forces.h"
#include "linear_solve.h"
#include "newton.h"
#include "stopwatch.h"

namespace bezier_fem
{
namespace
{
/** One lagged step of length h; updates x and v, not the rotations. */
void laggedStep(const Model& model, const StepSettings& settings, const Supports& supports,
                const std::vector<AppliedLoad>& loads, const NodalField& external, double step_begin, double h,
                State& state, Workspace& w, StepReport& report)
{
  Stopwatch watch;
  const double damp_m = settings.damping.mass, damp_k = settings.damping.stiffness;

  // f_el(x) + (h + b) K' v = f_el(x + (h + b) v), because f_el is affine while the rotations are held.
  externalForce(model, settings, loads, external, state.time + h / 2, state.x, w.load);
  w.change.matrix() = state.x.matrix() + (h + damp_k) * state.v.matrix();
  elasticForce(model, w.partition, state.rotations, w.change, w.force);
  w.rhs.matrix() = h * (w.load.matrix() - nodes(w.force, model));
  if (damp_m > 0)
  {
    systemProduct(model, w.partition, state.rotations, h * damp_m, 0, state.v, w.force);
    w.rhs.matrix() -= nodes(w.force, model);
  }
  watch.lap(report.ms.force);

  const double alpha = 1 + h * damp_m, beta = h * (h + damp_k);
  const MatrixFreeSystem<Rotations> matrix_free(model, w.partition, state.rotations, alpha, beta);
  const SystemOperator& system = systemOf(matrix_free, state.rotations, alpha, beta, w);
  w.solver.prepare(system, model, w.partition, supports.held, 1e-3 * h);
  watch.lap(report.ms.assembly);

  // Led components: the dv that takes them to where they have to be.
  w.led.matrix() = state.x.matrix() + h * state.v.matrix();
  w.change.matrix() = w.led.matrix();
  applySupports(supports, state.time + h, (state.time + h - step_begin) / settings.time_step, w.led);
  w.led.matrix() -= w.change.matrix();
  w.led.matrix() /= h;
  const bool led = !(w.led.matrix().array() == 0).all();
  if (led)
  {
    system.product(w.led, w.force);
    w.rhs.matrix() -= nodes(w.force, model);
  }

  if (w.history == 2 && h == settings.time_step)
  {
    w.change.matrix() = 2 * w.last_change.matrix() - w.last_but_one_change.matrix();
  }
  else
  {
    w.change.setZero();
  }
  solveLinear(model, settings, supports, state.rotations, system, alpha, beta, settings.solver.tolerance,
              std::max(1, settings.solver.max_iterations), h == settings.time_step, w, report);
  w.balance.matrix() = nodes(w.solver.residual(), model) / -h;

  state.v.matrix() += w.change.matrix();
  if (led) state.v.matrix() += w.led.matrix();
  state.x.matrix() += h * state.v.matrix();
  report.finite = state.x.matrix().allFinite();
  watch.lap(report.ms.solve);
}

Rotations startRotations(const Model& model, const StepSettings& settings)
{
  return restRotations(model,
                       settings.elasticity == Elasticity::COROTATED ? settings.rotation : RotationRule::FROM_CORNERS);
}
}  // namespace

Workspace::Workspace(const Model& model, const StepSettings& settings, int threads)
    : partition(model, threads),
      solver(model, partition),
      balance(model.num_nodes),
      load(model.num_nodes),
      force(partition.rows()),
      rhs(model.num_nodes),
      led(model.num_nodes),
      change(model.num_nodes),
      last_change(model.num_nodes),
      last_but_one_change(model.num_nodes),
      x_before(model.num_nodes),
      v_before(model.num_nodes),
      candidate(startRotations(model, settings)),
      turned(candidate.flags.size())
{
  if (settings.solver.system_operator == Scene::Solver::Operator::ASSEMBLED)
  {
    assembled = std::make_unique<AssembledSystem>(model, partition);
  }
}

StepReport implicitEulerStep(const Model& model, const StepSettings& settings, const Supports& supports,
                             const std::vector<AppliedLoad>& loads, const NodalField& external, State& state,
                             Workspace& w)
{
  if (settings.elasticity == Elasticity::GREEN)
  {
    return newtonStep(model, settings, supports, loads, external, state, w);
  }
  StepReport report;
  report.substeps = 0;
  report.inverted = state.rotations.inverted(model.num_tets);
  Stopwatch total, watch;
  const double begin = state.time, end = settings.time_step * static_cast<double>(state.steps + 1);
  const double shortest = settings.time_step / MAX_SUBSTEPS;
  double h = settings.time_step;
  while (report.finite && (report.substeps == 0 || end - state.time > 0.5 * shortest))
  {
    h = std::min(h, end - state.time);
    w.x_before.matrix() = state.x.matrix();
    w.v_before.matrix() = state.v.matrix();
    StepReport attempt = report;
    laggedStep(model, settings, supports, loads, external, begin, h, state, w, attempt);

    if (settings.elasticity == Elasticity::COROTATED && attempt.finite)
    {
      watch = Stopwatch();
      const Turn turn = updateRotations(model, w.partition, state.x, state.rotations, w.candidate, w.turned);
      watch.lap(attempt.ms.rotation);
      // Not while an element is inverted: such a body recovers best with the long step's damping, and its motion is of
      // no interest.
      const bool recovering = report.inverted > 0;
      if (turn.angle > MAX_TURN && !recovering && h > 1.001 * shortest)
      {
        // A lagged step turns an element that spins at w by atan(w h).
        const double pieces = std::ceil(std::tan(std::min(turn.angle, 1.5)) / MAX_TURN);
        h = std::max(h / std::max(pieces, 2.0), shortest);
        state.x.matrix() = w.x_before.matrix();
        state.v.matrix() = w.v_before.matrix();
        report.iterations = attempt.iterations;
        report.ms = attempt.ms;
        continue;
      }
      attempt.turn = std::max(attempt.turn, turn.angle);
      attempt.inverted = turn.inverted;
      std::swap(state.rotations, w.candidate);
    }
    report = attempt;
    ++report.substeps;
    state.time += h;
  }
  ++state.steps;
  state.time = settings.time_step * static_cast<double>(state.steps);

  std::swap(w.last_change, w.last_but_one_change);
  std::swap(w.last_change, w.change);
  w.history = report.substeps == 1 ? std::min(w.history + 1, 2) : 0;
  total.lap(report.ms.total);
  return report;
}

Workspace::~Workspace() = default;

void Workspace::forgetHistory()
{
  history = 0;
  multigrid.reset();
  multigrid_failed = false;
}

void Workspace::forgetMaterials()
{
  bound.reset();
  if (multigrid) multigrid->forget();
  multigrid_failed = false;
}

State startState(const Model& model, const StepSettings& settings, const Supports& supports, const NodalField& x,
                 const Eigen::Vector3d& velocity, Workspace& w)
{
  State state;
  state.x = x;
  applySupports(supports, 0, 0, state.x);
  state.v = NodalField(model.num_nodes);
  for (int i = 0; i < model.num_nodes; ++i)
  {
    for (int axis = 0; axis < 3; ++axis)
    {
      if (!(supports.held[i] >> axis & 1)) state.v[i][axis] = velocity[axis];
    }
  }
  state.rotations = startRotations(model, settings);
  if (settings.elasticity == Elasticity::COROTATED)
  {
    const Rotations rest = state.rotations;
    updateRotations(model, w.partition, state.x, rest, state.rotations, w.turned);
  }
  w.forgetHistory();
  return state;
}

}  // namespace bezier_fem
