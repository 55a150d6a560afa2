#include "newton.h"

#include <algorithm>
#include <cmath>

#include "bezier_fem/element_operator.h"
#include "bezier_fem/measures.h"
#include "forces.h"
#include "parallel.h"
#include "stopwatch.h"

namespace bezier_fem
{
NewtonMemory::NewtonMemory(const Model& model)
    : tangent(model),
      damping(model),
      quadratic(model.num_nodes),
      gradient(model.num_nodes),
      first(model.num_nodes),
      bend(model.num_nodes),
      start(model.num_nodes),
      x(model.num_nodes),
      rotations(restRotations(model)),
      before(rotations),
      turned(rotations.flags.size())
{
}

GreenNewton::GreenNewton(const Model& model, const StepSettings& settings, const Supports& supports,
                         const Rotations& rest, double h, double alpha, double beta, double load_floor, Serves serves,
                         NodalField& x, NodalField& v, Workspace& workspace)
    : model_(model),
      settings_(settings),
      supports_(supports),
      rest_(rest),
      h_(h),
      alpha_(alpha),
      beta_(beta),
      load_floor_(load_floor),
      serves_(serves),
      x_(x),
      v_(v),
      w_(workspace),
      m_(*workspace.newton),
      // K_0 of the damping is replaced by the iterate's K: close to it, and one product instead of two.
      matrix_free_(model, workspace.partition, m_.tangent, alpha, h * h + beta)
{
}

void GreenNewton::quadraticProduct(const NodalField& u, NodalField& out) const
{
  if (beta_ > 0)
  {
    systemProduct(model_, w_.partition, m_.damping, alpha_, beta_, u, out);
  }
  else if (alpha_ > 0)
  {
    systemProduct(model_, w_.partition, rest_, alpha_, 0, u, out);
  }
  else
  {
    out.setZero();
  }
}

void GreenNewton::start()
{
  greenForce(model_, w_.partition, x_, w_.force);
  m_.gradient.matrix() = m_.quadratic.matrix() + h_ * w_.force.matrix();
  m_.first.matrix() = m_.gradient.matrix();
}

void GreenNewton::tryDirection(const NodalField& direction)
{
  search(direction, 1);
}

bool GreenNewton::prepare(Projection projection)
{
  bezier_fem::linearise(model_, w_.partition, x_, projection, m_.tangent);
  projected_ = projection != Projection::NONE;
  system_ = &systemOf(matrix_free_, m_.tangent, alpha_, h_ * h_ + beta_, w_);
  return w_.solver.prepare(*system_, model_, w_.partition, supports_.held, load_floor_);
}

void GreenNewton::linearise(Projection projection)
{
  if (!prepare(projection) && !projected_) prepare(Projection::POSITIVE_STRESS);
}

bool GreenNewton::solve(double forcing, int max_iterations, StepReport& report)
{
  w_.rhs.matrix() = -m_.gradient.matrix();
  w_.change.setZero();
  // Relative to the gradient also where that is below the solver's floor.
  const double part = w_.solver.relativeNorm(w_.partition, m_.gradient, m_.gradient);
  std::swap(m_.rotations, m_.before);
  updateRotations(model_, w_.partition, x_, m_.before, m_.rotations, m_.turned);
  solvePreconditioned(
      model_, settings_, supports_, m_.rotations, Likeness::LIKE, *system_, alpha_, h_ * h_ + beta_, forcing * part,
      max_iterations, serves_, [](Preconditioner*) {}, w_, report);
  return m_.gradient.matrix().cwiseProduct(w_.change.matrix()).sum() < 0;
}

bool GreenNewton::iterate(double forcing, int max_iterations, StepReport& report)
{
  constexpr int TRIALS = 25;
  if (solve(forcing, max_iterations, report) && search(w_.change, TRIALS)) return true;
  if (projected_) return false;
  prepare(Projection::POSITIVE_STRESS);
  return solve(forcing, max_iterations, report) && search(w_.change, TRIALS);
}

bool GreenNewton::search(const NodalField& direction, int trials)
{
  // Along v + length * direction the sum is a polynomial of degree four: Simpson's rule on its slope gives its change
  // exactly, and without the cancellation of two energies, which would hide the last steps' decrease.
  quadraticProduct(direction, m_.bend);
  const double quadratic_slope = m_.quadratic.matrix().cwiseProduct(direction.matrix()).sum();
  const double curvature = m_.bend.matrix().cwiseProduct(direction.matrix()).sum();
  m_.x.matrix() = x_.matrix();
  const auto slopeAt = [&](double length) {
    x_.matrix() = m_.x.matrix() + length * h_ * direction.matrix();
    greenForce(model_, w_.partition, x_, w_.force);
    const double work = w_.force.matrix().cwiseProduct(direction.matrix()).sum();
    return quadratic_slope + length * curvature + h_ * work;
  };
  const double slope = m_.gradient.matrix().cwiseProduct(direction.matrix()).sum();
  double length = 1;
  for (int trial = 0; trial < trials; ++trial)
  {
    const double middle = slopeAt(length / 2), end = slopeAt(length);
    const double change = length / 6 * (slope + 4 * middle + end);
    // Enough of a decrease (Armijo 1966); of a direction that begins uphill, any.
    if (change <= 1e-4 * length * std::min(slope, 0.0))
    {
      v_.matrix() += length * direction.matrix();
      m_.quadratic.matrix() += length * m_.bend.matrix();
      m_.gradient.matrix() = m_.quadratic.matrix() + h_ * w_.force.matrix();
      return true;
    }
    // The zero of the slope on a straight line, where there is one.
    length *= std::clamp(end > 0 ? slope / (slope - end) : 0.5, 0.1, 0.5);
  }
  x_.matrix() = m_.x.matrix();
  return false;
}

bool extrapolate(const Stage& stage, Workspace& w)
{
  if (stage.past == 0 || (stage.past == 1 && stage.ahead != 0)) return false;
  forEachChunk(w.partition, [&](int first, int count) {
    w.change.columns(first, count) =
        (1 + stage.ahead) * w.past[0].columns(first, count) - stage.ahead * w.past[1].columns(first, count);
  });
  return true;
}

void newtonStage(const Model& model, const StepSettings& settings, const Supports& supports, const Stage& stage,
                 State& state, Workspace& w, StepReport& report)
{
  constexpr int MAX_ROUNDS = 100;
  Stopwatch watch;
  if (!w.newton) w.newton = std::make_unique<NewtonMemory>(model);
  NewtonMemory& m = *w.newton;
  const double h = stage.length, damp_m = settings.damping.mass, damp_k = settings.damping.stiffness;
  const int max_iterations = std::max(1, settings.solver.max_iterations);

  // The sum's gradient is the momentum that is out of balance,
  //     M (v - v_0) + h (f_el(x_0 + h v) + D v - f_ext),   D = a M + b K_0 held during the stage.
  if (damp_k > 0) linearise(model, w.partition, state.x, Projection::POSITIVE_STRESS, m.damping);
  systemProduct(model, w.partition, state.rotations, 1, 0, state.v, w.force);
  m.quadratic.matrix() = -h * w.load.matrix() - w.force.matrix();
  m.start.matrix() = state.v.matrix();
  state.x.matrix() += h * state.v.matrix();
  // Held and led components start, and stay, where they have to be at the end of the stage.
  for (int i = 0; i < model.num_nodes; ++i)
  {
    for (int axis = 0; axis < 3; ++axis)
    {
      if (!(supports.held[i] >> axis & 1)) continue;
      state.v[i][axis] += (w.led[i][axis] - state.x[i][axis]) / h;
      state.x[i][axis] = w.led[i][axis];
    }
  }

  GreenNewton newton(model, settings, supports, state.rotations, h, 1 + h * damp_m, h * damp_k, 1e-3 * h,
                     stage.lasting ? Serves::SAME_COEFFICIENTS : Serves::ONCE, state.x, state.v, w);
  newton.quadraticProduct(state.v, w.force);
  m.quadratic.matrix() += w.force.matrix();
  newton.start();
  if (extrapolate(stage, w)) newton.tryDirection(w.change);
  watch.lap(report.ms.force);

  double now = 0, before = 0;
  for (int round = 0;; ++round)
  {
    newton.linearise(Projection::NONE);
    watch.lap(report.ms.assembly);
    const auto residual = [&] { return w.solver.relativeNorm(w.partition, m.gradient, m.first); };
    if (round == 0) now = residual();
    report.finite = std::isfinite(now);
    if (now <= settings.solver.tolerance || !report.finite || round == MAX_ROUNDS) break;

    // Eisenstat and Walker 1996, choice 2; no more than is needed to end a little below the tolerance.
    double forcing = round == 0 ? 0.03 : 0.9 * std::pow(now / before, 2);
    forcing = std::clamp(forcing, 0.3 * settings.solver.tolerance / now, 0.1);
    before = now;
    if (!newton.iterate(forcing, max_iterations, report)) break;
    now = residual();
    watch.lap(report.ms.solve);
    if (now <= settings.solver.tolerance) break;
  }
  report.residual = std::max(report.residual, now);
  report.converged = report.converged && now <= settings.solver.tolerance;
  w.balance.matrix() = m.gradient.matrix() / h;
  for (int i = 0; i < model.num_nodes; ++i)
  {
    for (int axis = 0; axis < 3; ++axis)
    {
      w.change[i][axis] = supports.held[i] >> axis & 1 ? 0 : state.v[i][axis] - m.start[i][axis];
    }
  }
}

}  // namespace bezier_fem
