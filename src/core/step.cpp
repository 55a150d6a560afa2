#include "bezier_fem/step.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <functional>
#include <numeric>

#include "bezier_fem/element_operator.h"
#include "bezier_fem/green_strain.h"
#include "bezier_fem/measures.h"
#include "bezier_fem/stable_step.h"
#include "forces.h"
#include "linear_solve.h"
#include "newton.h"
#include "parallel.h"
#include "stopwatch.h"

namespace bezier_fem
{
namespace
{
/** 1 - sqrt(1/2), the root of Alexander 1977 with the small error. */
constexpr double GAMMA = 0.29289321881345248;

/** One body's implicit step: what its parts share. */
class ImplicitStep
{
public:
  ImplicitStep(const Model& model, const StepSettings& settings, const Supports& supports,
               const std::vector<AppliedLoad>& loads, const NodalField& external, State& state, Workspace& workspace)
      : model_(model),
        settings_(settings),
        supports_(supports),
        loads_(loads),
        external_(external),
        state_(state),
        w_(workspace),
        begin_(state.time)
  {
  }

  enum class Method
  {
    EULER,
    SDIRK2,
    AUTO
  };

  /** The whole step. */
  StepReport run(Method method)
  {
    StepReport report;
    report.substeps = 0;
    if (corotated()) report.inverted = state_.rotations.inverted(model_.num_tets);
    report.second_order = method == Method::SDIRK2 || (method == Method::AUTO && report.inverted == 0);
    Stopwatch total;
    const double end = settings_.time_step * static_cast<double>(state_.steps + 1);
    const double shortest = settings_.time_step / MAX_SUBSTEPS;
    double h = settings_.time_step;
    while (report.finite && (report.substeps == 0 || end - state_.time > 0.5 * shortest))
    {
      // A whole step is just that, whatever rounding says of its end; the last sub-step takes what is left.
      const double left = end - state_.time;
      if (h < settings_.time_step && left - h < 0.5 * shortest) h = left;
      if (w_.history_is_of_stages != report.second_order) w_.history = 0;
      w_.history_is_of_stages = report.second_order;
      forEachChunk(w_.partition, [&](int first, int count) {
        w_.x_before.columns(first, count) = state_.x.columns(first, count);
        w_.v_before.columns(first, count) = state_.v.columns(first, count);
      });
      StepReport attempt = report;
      const double lag = report.second_order ? sdirk2(h, attempt) : euler(h, attempt);
      const auto takeBack = [&] {
        state_.x.matrix() = w_.x_before.matrix();
        state_.v.matrix() = w_.v_before.matrix();
        report.iterations = attempt.iterations;
        report.ms = attempt.ms;
      };
      if (method == Method::AUTO && report.second_order &&
          !(lag <= MAX_TURN && attempt.inverted == 0 && attempt.finite && attempt.converged))
      {
        takeBack();
        report.second_order = false;
        continue;
      }
      // Not while an element is inverted: such a body recovers best with the long step's damping, and its motion is of
      // no interest.
      const bool recovering = report.inverted > 0;
      if (lag > MAX_TURN && !recovering && h > 1.001 * shortest)
      {
        takeBack();
        // A lagged step turns an element that spins at w by atan(w h).
        const double pieces = std::ceil(std::tan(std::min(lag, 1.5)) / MAX_TURN);
        h = std::max(h / std::max(pieces, 2.0), shortest);
        continue;
      }
      if (corotated() && attempt.finite)
      {
        if (!report.second_order) shorten(h, attempt);
        std::swap(state_.rotations, w_.candidate);
      }
      report = attempt;
      ++report.substeps;
      state_.time += h;
    }
    ++state_.steps;
    state_.time = settings_.time_step * static_cast<double>(state_.steps);
    if (settings_.elasticity == Elasticity::GREEN) report.inverted = invertedElements(model_, state_.x);
    w_.history = report.substeps == 1 ? std::min(w_.history + 1, 3) : 0;
    total.lap(report.ms.total);
    return report;
  }

private:
  bool corotated() const { return settings_.elasticity == Elasticity::COROTATED; }

  /** Linearised implicit Euler. Returns how far (rad) the rotations that it used were behind those that it led to. */
  double euler(double h, StepReport& report)
  {
    takeLoads(state_.time + h / 2, state_.x, report);
    leadTo(h);
    const bool whole = h == settings_.time_step;
    solveStage({h, whole ? w_.history : 0, whole, 1}, state_.rotations, report);
    remember();
    return turn(state_.x, state_.rotations, w_.candidate, report);
  }

  /**
   * Rotations that are held during a step hide how a stressed body resists being turned. Where that is more than what
   * K' knows of, a long step goes too far, and the next one as far back, for ever. Such a step is shortened to about
   * where the momentum out of balance, with the rotations of its end, no longer does work on it (Matthies and Strang
   * 1979).
   */
  void shorten(double h, StepReport& report)
  {
    constexpr int MAX_TRIALS = 8;
    constexpr double ENOUGH = 0.5;
    Stopwatch watch;
    keepMomentum();
    // With the old rotations the slope along the change goes from -start at length 0 to 0 at length 1.
    const double start = w_.rhs.matrix().cwiseProduct(w_.change.matrix()).sum();
    double low = 0, low_slope = -start, high = 0, high_slope = 0, length = 1;
    for (int trial = 0; trial < MAX_TRIALS; ++trial)
    {
      const double turned = turnWork(model_, w_.partition, state_.rotations, w_.candidate, state_.x, w_.change);
      const double slope = start * (length - 1) + h * turned;
      watch.lap(report.ms.force);
      if (slope <= ENOUGH * start && (length == 1 || slope >= -ENOUGH * start)) return;
      (slope < 0 ? low : high) = length;
      (slope < 0 ? low_slope : high_slope) = slope;
      const double next = low + std::clamp(low_slope / (low_slope - high_slope), 0.1, 0.9) * (high - low);
      state_.v.matrix() += (next - length) * w_.change.matrix();
      state_.x.matrix() += h * (next - length) * w_.change.matrix();
      length = next;
      turn(state_.x, state_.rotations, w_.candidate, report);
    }
  }

  /** Takes the translation along axes that nothing holds out of `change`: gravity's share of it is not to be shortened.
   */
  void keepMomentum()
  {
    const int held = std::accumulate(supports_.held.begin(), supports_.held.end(), 0, std::bit_or<>());
    if (held == 7) return;
    Eigen::Vector3d mean = Eigen::Vector3d::Zero();
    for (int i = 0; i < model_.num_nodes; ++i) mean += model_.node_mass[i] * w_.change[i];
    mean /= std::accumulate(model_.node_mass.begin(), model_.node_mass.end(), 0.0);
    for (int axis = 0; axis < 3; ++axis)
    {
      if (!(held >> axis & 1)) w_.change.matrix().row(axis).array() -= mean[axis];
    }
  }

  /** Two stages of length GAMMA h, from x and v, and from where the first one's slope leads in (1 - GAMMA) h. */
  double sdirk2(double h, StepReport& report)
  {
    // Loads that come and go do so between steps: one time for both stages, and their impulse is exact.
    const double stage = GAMMA * h, ahead = (1 - GAMMA) / GAMMA, load_time = state_.time + h / 2;
    const bool lasting = h == settings_.time_step;
    const int known = lasting ? 2 * w_.history : 0;

    // Led components: the first stage has the slope of a chord around its end, so that the second one's velocity,
    // which takes them to where they have to be, is of second order too.
    leadTo(2 * stage);
    forEachHeld([&](int i) { w_.led[i] = (w_.led[i] + state_.x[i]) / 2; });
    NodalField& x = w_.predicted;
    forEachChunk(w_.partition, [&](int first, int count) {
      x.columns(first, count) = state_.x.columns(first, count) + stage * state_.v.columns(first, count);
    });
    turn(x, state_.rotations, w_.stage_rotations, report);
    takeLoads(load_time, x, report);
    solveStage({stage, known, lasting, 1 / ahead}, w_.stage_rotations, report);
    remember();
    if (!report.finite) return 0;

    forEachChunk(w_.partition, [&](int first, int count) {
      const auto x_before = w_.x_before.columns(first, count), v_before = w_.v_before.columns(first, count);
      auto now = state_.x.columns(first, count), v = state_.v.columns(first, count), next = x.columns(first, count);
      next = v - v_before;
      v = v_before + ahead * next;
      now = x_before + ahead * (now - x_before);
      next = now + stage * (v + next);
    });
    turn(x, w_.stage_rotations, w_.candidate, report);
    takeLoads(load_time, x, report);
    leadTo(h);
    solveStage({stage, known + 1, lasting, 0}, w_.candidate, report);
    remember();
    std::swap(w_.stage_rotations, w_.candidate);
    return turn(state_.x, w_.stage_rotations, w_.candidate, report);
  }

  void takeLoads(double time, const NodalField& x, StepReport& report)
  {
    Stopwatch watch;
    externalForce(model_, w_.partition, settings_, loads_, external_, time, x, w_.load);
    watch.lap(report.ms.force);
  }

  /** Calls f(node) for nodes of which a component is held. */
  template <class F>
  void forEachHeld(const F& f)
  {
    forEachPiece(w_.partition, [&](int t) {
      for (int i = w_.partition.nodeBegin(t); i < w_.partition.nodeEnd(t); ++i)
      {
        if (supports_.held[i]) f(i);
      }
    });
  }

  /** Sets where led and held components have to be in `ahead` seconds; those of other nodes are not looked at. */
  void leadTo(double ahead)
  {
    forEachHeld([&](int i) { w_.led[i] = state_.x[i]; });
    applySupports(supports_, state_.time + ahead, (state_.time + ahead - begin_) / settings_.time_step, w_.led);
  }

  /** The solved change of v, for the next ones to start from. */
  void remember()
  {
    std::rotate(w_.past.begin(), w_.past.end() - 1, w_.past.end());
    w_.past[0].matrix() = w_.change.matrix();
  }

  /**
   * Makes of where led and held components have to be in h the change of v that takes them there, zero where not held.
   * @return  whether there is any; otherwise nodes without a held component are left as they are
   */
  bool changeOfLed(double h)
  {
    std::atomic<bool> any = false;
    forEachHeld([&](int i) {
      for (int axis = 0; axis < 3; ++axis)
      {
        double& led = w_.led[i][axis];
        led = supports_.held[i] >> axis & 1 ? (led - state_.x[i][axis]) / h - state_.v[i][axis] : 0;
        if (led != 0) any.store(true, std::memory_order_relaxed);
      }
    });
    if (!any) return false;
    forEachPiece(w_.partition, [&](int t) {
      for (int i = w_.partition.nodeBegin(t); i < w_.partition.nodeEnd(t); ++i)
      {
        if (!supports_.held[i]) w_.led[i].setZero();
      }
    });
    return true;
  }

  double turn(const NodalField& x, const Rotations& before, Rotations& after, StepReport& report)
  {
    if (!corotated() || !report.finite) return 0;
    Stopwatch watch;
    const Turn turn = updateRotations(model_, w_.partition, x, before, after, w_.turned);
    report.turn = std::max(report.turn, turn.angle);
    report.inverted = turn.inverted;
    watch.lap(report.ms.rotation);
    return turn.angle;
  }

  void solveStage(const Stage& stage, const Rotations& rotations, StepReport& report)
  {
    if (settings_.elasticity == Elasticity::GREEN)
    {
      newtonStage(model_, settings_, supports_, stage, state_, w_, report);
    }
    else
    {
      laggedStage(stage, rotations, report);
    }
  }

  /** Implicit Euler with the rotations given: updates x and v, and leaves in `change` what was solved for. */
  void laggedStage(const Stage& stage, const Rotations& rotations, StepReport& report)
  {
    Stopwatch watch;
    const double h = stage.length, damp_m = settings_.damping.mass, damp_k = settings_.damping.stiffness;

    // f_el(x) + (h + b) K' v = f_el(x + (h + b) v), because f_el is affine while the rotations are held.
    forEachChunk(w_.partition, [&](int first, int count) {
      w_.predicted.columns(first, count) =
          state_.x.columns(first, count) + (h + damp_k) * state_.v.columns(first, count);
    });
    elasticForce(model_, w_.partition, rotations, w_.predicted, w_.force);
    forEachChunk(w_.partition, [&](int first, int count) {
      w_.rhs.columns(first, count) = h * (w_.load.columns(first, count) - w_.force.columns(first, count));
    });
    const auto subtractForce = [&] {
      forEachChunk(w_.partition,
                   [&](int first, int count) { w_.rhs.columns(first, count) -= w_.force.columns(first, count); });
    };
    if (damp_m > 0)
    {
      systemProduct(model_, w_.partition, rotations, h * damp_m, 0, state_.v, w_.force);
      subtractForce();
    }
    watch.lap(report.ms.force);

    const double alpha = 1 + h * damp_m, beta = h * (h + damp_k);
    const MatrixFreeSystem<Rotations> matrix_free(model_, w_.partition, rotations, alpha, beta);
    const SystemOperator& system =
        prepareSystem(model_, settings_, supports_, matrix_free, rotations, alpha, beta, 1e-3 * h, w_);
    watch.lap(report.ms.assembly);

    const bool led = changeOfLed(h);
    if (led)
    {
      system.product(w_.led, w_.force);
      subtractForce();
    }

    // The nearest start costs as much as two iterations with the diagonal blocks, which is what it saves where there
    // are few.
    constexpr int FEW = 20;
    const auto start = [&](Preconditioner* rough) {
      if (w_.preconditioner || w_.last_iterations > FEW)
      {
        w_.solver.start(system, w_.partition, w_.rhs, w_.past, std::min(stage.past, 3), w_.change, rough);
      }
      else if (!extrapolate(stage, w_))
      {
        w_.change.setZero();
      }
    };
    const int before = report.iterations;
    solveLinear(model_, settings_, supports_, rotations, system, alpha, beta, settings_.solver.tolerance,
                std::max(1, settings_.solver.max_iterations),
                !stage.lasting                               ? Serves::ONCE
                : settings_.elasticity == Elasticity::LINEAR ? Serves::ALWAYS
                                                             : Serves::SAME_COEFFICIENTS,
                std::ref(start), w_, report);
    w_.last_iterations = report.iterations - before;
    std::atomic<bool> finite = true;
    forEachChunk(w_.partition, [&](int first, int count) {
      w_.balance.columns(first, count) = w_.solver.residual().columns(first, count) / -h;
      auto v = state_.v.columns(first, count), x = state_.x.columns(first, count);
      v += w_.change.columns(first, count);
      if (led) v += w_.led.columns(first, count);
      x += h * v;
      if (!x.allFinite()) finite.store(false, std::memory_order_relaxed);
    });
    report.finite = finite;
    watch.lap(report.ms.solve);
  }

  const Model& model_;
  const StepSettings& settings_;
  const Supports& supports_;
  const std::vector<AppliedLoad>& loads_;
  const NodalField& external_;
  State& state_;
  Workspace& w_;
  const double begin_;  // s
};

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
      force(model.num_nodes),
      rhs(model.num_nodes),
      led(model.num_nodes),
      change(model.num_nodes),
      x_before(model.num_nodes),
      v_before(model.num_nodes),
      predicted(model.num_nodes),
      candidate(startRotations(model, settings)),
      stage_rotations(candidate),
      turned(candidate.flags.size())
{
  past.fill(NodalField(model.num_nodes));
  if (settings.solver.system_operator == Scene::Solver::Operator::ASSEMBLED)
  {
    assembled = std::make_unique<AssembledSystem>(model, partition);
  }
}

StepReport implicitEulerStep(const Model& model, const StepSettings& settings, const Supports& supports,
                             const std::vector<AppliedLoad>& loads, const NodalField& external, State& state,
                             Workspace& w)
{
  return ImplicitStep(model, settings, supports, loads, external, state, w).run(ImplicitStep::Method::EULER);
}

StepReport sdirk2Step(const Model& model, const StepSettings& settings, const Supports& supports,
                      const std::vector<AppliedLoad>& loads, const NodalField& external, State& state, Workspace& w)
{
  return ImplicitStep(model, settings, supports, loads, external, state, w).run(ImplicitStep::Method::SDIRK2);
}

StepReport automaticStep(const Model& model, const StepSettings& settings, const Supports& supports,
                         const std::vector<AppliedLoad>& loads, const NodalField& external, State& state, Workspace& w)
{
  return ImplicitStep(model, settings, supports, loads, external, state, w).run(ImplicitStep::Method::AUTO);
}

Workspace::~Workspace() = default;

void Workspace::forgetHistory()
{
  history = 0;
  last_iterations = 0;
  newton.reset();
  preconditioner.reset();
  preconditioner_failed = false;
  prepared.reset();
}

void Workspace::forgetMaterials()
{
  bound.reset();
  if (preconditioner) preconditioner->forget();
  preconditioner_failed = false;
  prepared.reset();
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
