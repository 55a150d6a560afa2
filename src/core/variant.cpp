#include "bezier_fem/variant.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <exception>
#include <numeric>
#include <random>
#include <set>

#include "bezier_fem/embedding.h"
#include "bezier_fem/error.h"
#include "stopwatch.h"

namespace bezier_fem
{
namespace
{
constexpr int INNER_POINTS = 1000, BOUNDARY_POINTS = 500;
constexpr double RECORDS = 200;      // of a run, at least, where it has as many steps
constexpr double SHORT_RUN_MS = 50;  // repeated
constexpr double REPEATED_MS = 200;  // in all
constexpr double TURN_BACK = 0.05;   // of the range of a signal, for a turning point

double median(std::vector<double> values)
{
  if (values.empty()) return 0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/** Thrown out of a static solve that takes too long. */
struct TooLong
{
};

class Recorder
{
public:
  Recorder(const RunPlan& plan, const BodyPoints* points, Simulation& simulation, Recording& recording)
      : plan_(plan), simulation_(simulation), r_(recording)
  {
    const Model& model = simulation.model();
    r_.tets = model.num_tets;
    r_.nodes = model.num_nodes;
    r_.degrees_of_freedom = 3L * model.num_nodes;
    for (const std::uint8_t axes : simulation.supports().held)
    {
      r_.degrees_of_freedom -= (axes & 1) + (axes >> 1 & 1) + (axes >> 2 & 1);
    }
    r_.body = points ? *points : bodyPoints(model);
    const PointLocator locator(model);
    for (Eigen::Index i = 0; i < r_.body.rest.cols(); ++i) points_.push_back(locator.locate(r_.body.rest.col(i)));
    const auto& probes = simulation.scene().probes;
    r_.probe_rest.resize(3, static_cast<Eigen::Index>(probes.size()));
    for (std::size_t i = 0; i < probes.size(); ++i)
    {
      r_.probe_rest.col(static_cast<Eigen::Index>(i)) = probes[i].second;
      probes_.push_back(locator.locate(probes[i].second));
    }
    r_.starts_at_rest = simulation.scene().initial.velocity.isZero(0);
  }

  void run()
  {
    plan_.statics ? solve(true) : simulate(true);
    if (!r_.comparable()) return;
    simulation_.evaluateStress(probes_, r_.von_mises);
    for (const bool is_short = wall_ms_ < SHORT_RUN_MS; is_short && wall_ms_ < REPEATED_MS;)
    {
      simulation_.reset();
      plan_.statics ? solve(false) : simulate(false);
    }
    r_.ms_per_step = median(step_ms_);
    if (!plan_.statics)
    {
      const double computed = static_cast<double>(step_ms_.size()) * simulation_.scene().time_step;  // s
      r_.ms_per_second = computed > 0 ? std::accumulate(step_ms_.begin(), step_ms_.end(), 0.0) / computed : 0;
    }
  }

private:
  const RunPlan& plan_;
  Simulation& simulation_;
  Recording& r_;
  std::vector<MaterialPoint> points_, probes_;
  std::vector<double> step_ms_;  // of each step, the least of its repetitions: what else runs only ever adds
  double wall_ms_ = 0;           // of all runs

  void snapshot()
  {
    const auto positions = [&](const std::vector<MaterialPoint>& points) {
      Eigen::Matrix3Xd x(3, static_cast<Eigen::Index>(points.size()));
      for (std::size_t i = 0; i < points.size(); ++i)
      {
        x.col(static_cast<Eigen::Index>(i)) = position(simulation_.model(), simulation_.state().x, points[i]);
      }
      return x;
    };
    r_.times.push_back(simulation_.time());
    r_.probes.push_back(positions(probes_));
    r_.points.push_back(positions(points_));
  }

  void fail(RunStatus status, const std::string& reason)
  {
    r_.status = status;
    r_.reason = reason;
  }

  void takeTime(std::size_t step, double ms)
  {
    if (step == step_ms_.size()) step_ms_.push_back(ms);
    step_ms_[step] = std::min(step_ms_[step], ms);
  }

  void take(const StepReport& report)
  {
    r_.residual = std::max(r_.residual, report.residual);
    r_.substeps += report.substeps;
    if (!report.converged && r_.status == RunStatus::OK)
    {
      fail(RunStatus::NOT_CONVERGED, "a system was left above its tolerance");
    }
    if (!report.finite) fail(RunStatus::DIVERGED, "positions are no longer finite");
  }

  void simulate(bool first)
  {
    const double dt = simulation_.scene().time_step;
    const auto steps = static_cast<long>(std::ceil(plan_.duration / dt - 1e-6));
    const long every = std::max(1L, static_cast<long>(plan_.duration / RECORDS / dt + 1e-6));
    std::vector<double> iterations;
    std::size_t computed = 0;
    if (first) snapshot();
    for (long step = 1; step <= steps; ++step)
    {
      Stopwatch watch;
      const StepReport report = simulation_.step();
      double ms = 0;
      watch.lap(ms);
      // A body asleep says nothing of what its motion costs.
      if (!report.asleep) takeTime(computed++, ms);
      wall_ms_ += ms;
      if (!first) continue;
      take(report);
      ++r_.steps;
      if (!report.asleep) iterations.push_back(report.iterations);
      if (!report.finite) return;
      if (step % every == 0 || step == steps) snapshot();
      if (wall_ms_ > 1000 * plan_.time_limit)
      {
        return fail(RunStatus::STOPPED, "stopped after " + std::to_string(step) + " of " + std::to_string(steps) +
                                            " steps: the time limit of the run");
      }
    }
    if (first) r_.iterations = median(iterations);
  }

  void solve(bool first)
  {
    Stopwatch watch;
    double ms = 0;
    StepReport report;
    try
    {
      Stopwatch limit;
      double passed = 0;
      report = simulation_.solveStatic([&](int /*round*/, double /*residual*/) {
        limit.lap(passed);
        if (passed > 1000 * plan_.time_limit) throw TooLong();
      });
    }
    catch (const TooLong&)
    {
      return fail(RunStatus::STOPPED, "stopped before it was solved: the time limit of the run");
    }
    watch.lap(ms);
    takeTime(0, ms);
    wall_ms_ += ms;
    if (!first) return;
    take(report);
    r_.iterations = report.iterations;
    if (report.finite) snapshot();
  }
};

/** Positions at a time between the first and the last, by cubics through the four nearest times. */
class Interpolated
{
public:
  Interpolated(const Recording& recording, double time)
  {
    const std::vector<double>& t = recording.times;
    count_ = std::min<std::size_t>(4, t.size());
    const auto after = static_cast<std::size_t>(std::lower_bound(t.begin(), t.end(), time) - t.begin());
    first_ = std::min(after < 2 ? 0 : after - 2, t.size() - count_);
    for (std::size_t i = 0; i < count_; ++i)
    {
      weights_[i] = 1;
      for (std::size_t j = 0; j < count_; ++j)
      {
        if (j != i) weights_[i] *= (time - t[first_ + j]) / (t[first_ + i] - t[first_ + j]);
      }
    }
  }
  Eigen::Matrix3Xd of(const std::vector<Eigen::Matrix3Xd>& positions) const
  {
    Eigen::Matrix3Xd sum = weights_[0] * positions[first_];
    for (std::size_t i = 1; i < count_; ++i) sum += weights_[i] * positions[first_ + i];
    return sum;
  }

private:
  std::size_t first_ = 0, count_ = 0;
  std::array<double, 4> weights_{};
};

/** The largest length of a column, and its column; -1 without columns. */
struct Farthest
{
  double distance = 0;
  Eigen::Index column = -1;
};

Farthest farthest(const std::vector<Eigen::Matrix3Xd>& positions, const Eigen::Matrix3Xd& rest)
{
  Farthest result;
  for (const Eigen::Matrix3Xd& x : positions)
  {
    for (Eigen::Index i = 0; i < x.cols(); ++i)
    {
      const double distance = (x.col(i) - rest.col(i)).norm();
      if (result.column < 0 || distance > result.distance) result = {distance, i};
    }
  }
  return result;
}

struct Coordinate
{
  bool probe;
  Eigen::Index column;
  Eigen::Index axis;
};

/** The coordinate of the widest range, of the probes where there are some. */
Coordinate mainCoordinate(const Recording& r)
{
  const bool probe = r.probe_rest.cols() > 0;
  const std::vector<Eigen::Matrix3Xd>& positions = probe ? r.probes : r.points;
  Eigen::Matrix3Xd low = positions.front(), high = low;
  for (const Eigen::Matrix3Xd& x : positions)
  {
    low = low.cwiseMin(x);
    high = high.cwiseMax(x);
  }
  Coordinate widest{probe, 0, 0};
  (high - low).maxCoeff(&widest.axis, &widest.column);
  return widest;
}

std::vector<TurningPoint> turnsOf(const Recording& r, const Coordinate& c)
{
  std::vector<double> values;
  for (const Eigen::Matrix3Xd& x : c.probe ? r.probes : r.points) values.push_back(x(c.axis, c.column));
  return turningPoints(r.times, values, r.starts_at_rest);
}

double relativeTo(double reference, double value)
{
  return reference > 0 ? value / reference : VariantErrors::NOTHING;
}
}  // namespace

BodyPoints bodyPoints(const Model& model)
{
  std::set<int> corners;
  for (const Model::Face& face : model.boundary)
  {
    for (const int c : FACE_CORNERS[face.opposite]) corners.insert(model.nodesOf(face.tet)[c]);
  }
  const std::vector<int> boundary(corners.begin(), corners.end());
  const int on_boundary = std::min(BOUNDARY_POINTS, static_cast<int>(boundary.size()));

  BodyPoints points;
  points.rest.resize(3, INNER_POINTS + on_boundary);
  points.weights = Eigen::VectorXd::Zero(INNER_POINTS + on_boundary);
  // One in every thousandth of the volume, elements in the model's order, which follows a curve through the body; at a
  // random place of its element.
  const double share = model.volume() / INNER_POINTS;
  std::mt19937 random(1);
  double passed = 0;
  int tet = 0;
  for (int i = 0; i < INNER_POINTS; ++i)
  {
    while (tet + 1 < model.num_tets && passed + model.volumes[tet] < (i + 0.5) * share) passed += model.volumes[tet++];
    Eigen::Vector4d lambda;
    for (double& l : lambda) l = -std::log((random() + 0.5) / 4294967296.0);  // uniform in the tetrahedron
    lambda /= lambda.sum();
    points.rest.col(i) = position(model, model.rest, {tet, lambda});
    points.weights[i] = share;
  }
  for (int i = 0; i < on_boundary; ++i)
  {
    points.rest.col(INNER_POINTS + i) = model.rest[boundary[boundary.size() * i / on_boundary]];
  }
  return points;
}

const char* nameOf(RunStatus status)
{
  constexpr std::array<const char*, 5> NAMES{"ok", "not_converged", "diverged", "refused", "stopped"};
  return NAMES[static_cast<std::size_t>(status)];
}

Recording record(Scene scene, const RunPlan& plan, const BodyPoints* points, const Simulation::Log& log)
{
  Recording recording;
  try
  {
    for (const Scene::Fixed& fixed : scene.fixed)
    {
      if (fixed.frame) throw InputError(fixed.key + ".frame: only the ROS node can follow a frame");
    }
    if (!plan.statics && scene.integrator == Integrator::STATIC)
    {
      throw InputError("integrator: is static, must be one that moves the body for a run of some duration");
    }
    scene.surface_file.reset();
    Stopwatch watch;
    double ms = 0;
    Simulation simulation(std::move(scene), plan.threads, log);
    watch.lap(ms);
    recording.load_seconds = ms / 1000;
    Recorder(plan, points, simulation, recording).run();
  }
  catch (const InputError& error)
  {
    recording.status = RunStatus::REFUSED;
    recording.reason = error.what();
  }
  catch (const std::bad_alloc&)
  {
    recording.status = RunStatus::REFUSED;
    recording.reason = "out of memory";
  }
  return recording;
}

VariantErrors compare(const Recording& variant, const Recording& reference)
{
  VariantErrors errors;
  if (!variant.comparable() || !reference.comparable()) return errors;
  const Eigen::Index num_probes = reference.probe_rest.cols();
  const Farthest probe = farthest(reference.probes, reference.probe_rest);
  const Farthest point = farthest(reference.points, reference.body.rest);
  const double largest = std::max(probe.distance, point.distance);

  const bool variant_is_coarser = variant.times.size() <= reference.times.size();
  const std::vector<double>& times = (variant_is_coarser ? variant : reference).times;
  const double end = std::min(variant.times.back(), reference.times.back()) * (1 + 1e-9);
  double tip_squares = 0, field_squares = 0, field_max = 0;
  int count = 0;
  for (const double time : times)
  {
    if (time > end) break;
    const Interpolated ours(variant, time), theirs(reference, time);
    const Eigen::Matrix3Xd field = ours.of(variant.points) - theirs.of(reference.points);
    const Eigen::VectorXd squares = field.colwise().squaredNorm();
    field_squares += squares.dot(reference.body.weights) / reference.body.weights.sum();
    field_max = std::max(field_max, std::sqrt(squares.maxCoeff()));
    if (num_probes > 0)
    {
      const Eigen::VectorXd at_probes = (ours.of(variant.probes) - theirs.of(reference.probes)).colwise().squaredNorm();
      tip_squares += at_probes[probe.column];
      field_max = std::max(field_max, std::sqrt(at_probes.maxCoeff()));
    }
    else
    {
      tip_squares += squares[point.column];
    }
    ++count;
  }
  errors.tip = relativeTo(largest, std::sqrt(tip_squares / count));
  errors.field_rms = relativeTo(largest, std::sqrt(field_squares / count));
  errors.field_max = relativeTo(largest, field_max);

  for (Eigen::Index i = 0; i < num_probes; ++i)
  {
    const double error = relativeTo(reference.von_mises[i], std::abs(variant.von_mises[i] - reference.von_mises[i]));
    errors.von_mises_of_probes.push_back(error);
    errors.von_mises = std::fmax(errors.von_mises, error);
  }

  if (times.size() < 3) return errors;
  const Coordinate main = mainCoordinate(reference);
  const std::vector<TurningPoint> ours = turnsOf(variant, main), theirs = turnsOf(reference, main);
  const std::size_t turns = std::min(ours.size(), theirs.size());
  const Swing a = swingOf(ours, turns), b = swingOf(theirs, turns);
  errors.period = std::abs(a.period / b.period - 1);
  errors.decay = std::abs(a.decay - b.decay);
  return errors;
}

std::vector<TurningPoint> turningPoints(const std::vector<double>& times, const std::vector<double>& values,
                                        bool starts_at_rest)
{
  std::vector<TurningPoint> turns;
  if (values.size() < 3) return turns;
  const auto [least, most] = std::minmax_element(values.begin(), values.end());
  const double enough = TURN_BACK * (*most - *least);
  if (!(enough > 0)) return turns;

  const auto add = [&](std::size_t i) {
    if (i == 0 || i + 1 == values.size())
    {
      if (i == 0 && starts_at_rest) turns.push_back({times[0], values[0]});
      return;
    }
    // Newton's form of the parabola, and where its derivative is zero
    const double h0 = times[i] - times[i - 1], h1 = times[i + 1] - times[i];
    const double d0 = (values[i] - values[i - 1]) / h0, d1 = (values[i + 1] - values[i]) / h1;
    const double curvature = (d1 - d0) / (h0 + h1);
    const double slope = d0 + curvature * h0;  // at times[i]
    const double shift = curvature == 0 ? 0 : std::clamp(-slope / (2 * curvature), -h0, h1);
    turns.push_back({times[i] + shift, values[i] + shift * (slope + curvature * shift)});
  };
  std::size_t lowest = 0, highest = 0;  // since the last turn
  int direction = 0;                    // 1 rises, -1 falls, 0 not known yet
  for (std::size_t i = 1; i < values.size(); ++i)
  {
    if (values[i] < values[lowest]) lowest = i;
    if (values[i] > values[highest]) highest = i;
    if (direction >= 0 && values[highest] - values[i] > enough)
    {
      add(highest);
      direction = -1;
      lowest = highest = i;
    }
    else if (direction <= 0 && values[i] - values[lowest] > enough)
    {
      add(lowest);
      direction = 1;
      lowest = highest = i;
    }
  }
  return turns;
}

Swing swingOf(const std::vector<TurningPoint>& points, std::size_t count)
{
  Swing swing;
  if (count < 3) return swing;
  const double half_periods = static_cast<double>(count) - 1;
  swing.period = 2 * (points[count - 1].time - points[0].time) / half_periods;
  const double first = std::abs(points[1].value - points[0].value);
  const double last = std::abs(points[count - 1].value - points[count - 2].value);
  swing.decay = 1 - std::pow(last / first, 2 / (half_periods - 1));
  return swing;
}

Swing swingOf(const Recording& recording)
{
  if (!recording.comparable() || recording.times.size() < 3) return {};
  const std::vector<TurningPoint> points = turnsOf(recording, mainCoordinate(recording));
  return swingOf(points, points.size());
}

}  // namespace bezier_fem
