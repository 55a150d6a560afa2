#include "bezier_fem/tuning.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <map>

#include "bezier_fem/error.h"
#include "bezier_fem/mesh_io.h"

namespace bezier_fem
{
namespace
{
constexpr double REFERENCE_SHARE = 0.25;       // of the wanted error, that the reference's own may be
constexpr double CLIMB_SHARE = 0.5;            // of the time for tuning, until the reference stands
constexpr double CLIMB_LIMIT = 0.65;           // after which the last run of that is stopped
constexpr int OWN_MESH = 0;                    // level: the scene's cell size; of a file of tetrahedra, not refined
constexpr int FIRST_STEP = -1, LAST_STEP = 8;  // time steps: the scene's / 2^j
constexpr int FIRST_SURFACE_LEVEL = -4, LAST_SURFACE_LEVEL = 16;  // cell sizes: the scene's / 2^(k/4)
constexpr int FIRST_REFINE_LEVEL = 0, LAST_REFINE_LEVEL = 4;      // model.refine
constexpr double NO_ERROR_KNOWN = VariantErrors::NOTHING;

std::string printed(double value)
{
  std::array<char, 32> text{};
  std::snprintf(text.data(), text.size(), "%.3g", value);
  return text.data();
}

/** As a scene file has it: YAML 1.1 takes 1e-05 for text and 1.0e-05 for a number. */
std::string inYaml(double value)
{
  std::array<char, 32> text{};
  std::snprintf(text.data(), text.size(), "%.6g", value);
  std::string number = text.data();
  const std::size_t exponent = number.find('e');
  if (exponent != std::string::npos && number.find('.') == std::string::npos) number.insert(exponent, ".0");
  return number;
}

std::string percent(double value)
{
  return printed(100 * value) + " %";
}

double rounded(double value)
{
  return std::stod(printed(value));
}

double orderOf(Integrator integrator)
{
  return integrator == Integrator::IMPLICIT_EULER ? 1 : 2;
}

/**
 * Roache's grid convergence index of the last of a row.
 * @param last    difference of the last two
 * @param before  difference of the two before; NaN: not known
 * @param ratio   of their sizes
 * @param most    highest order that the method can show
 */
double convergenceIndex(double last, double before, double ratio, double most)
{
  if (std::isnan(before)) return 3 * last / (ratio - 1);
  const double seen = last > 0 ? std::log(before / last) / std::log(ratio) : most;
  return 1.25 * last / (std::pow(ratio, std::clamp(seen, 0.5, most)) - 1);
}

class Search
{
public:
  Search(const Scene& scene, const TuneRequest& request, const Runner& run,
         const std::function<void(const std::string&)>& progress)
      : scene_(scene), request_(request), runner_(run), progress_(progress), surface_(!isTetMeshFile(scene.model.file))
  {
    result_.chosen = numericsOf(scene);
    if (request.plan.statics || scene.integrator == Integrator::EXPLICIT)
    {
      integrators_ = {scene.integrator};
    }
  }

  Tuning search()
  {
    if (request_.local && !surface_)
    {
      throw InputError("--local: needs a surface to mesh anew, but model.file is a mesh of tetrahedra");
    }
    chooseStep();
    climbMeshes();
    if (std::isnan(result_.reference_error))
    {
      result_.why = "No error could be estimated: of the finer meshes that it takes, the last one was " +
                    std::string(nameOf(result_.trials.back().status)) +
                    (result_.trials.back().reason.empty() ? "." : ": " + result_.trials.back().reason + ".");
      return std::move(result_);
    }
    measureLinearMeshes();
    addMeshesBetween();
    tryCandidates();
    if (best_ && request_.local) tryLocally();
    if (!best_) settleForLess();
    explain();
    return std::move(result_);
  }

private:
  /** A mesh and what is known of it. */
  struct Mesh
  {
    Element element;
    int level;
    double error;  // its own part, estimated
    double ms;     // a step at the reference's step and tolerance
  };
  /** An integrator's step and what is known of it. */
  struct Step
  {
    Integrator integrator;
    int j;
    double error;  // its own part, estimated
    double ms;     // a step on the coarsest mesh
  };
  struct Candidate
  {
    Mesh mesh;
    Step step;
    double cost;  // foreseen, at a tolerance of 1e-2
  };

  const Scene& scene_;
  const TuneRequest& request_;
  const Runner& runner_;
  const std::function<void(const std::string&)>& progress_;
  const bool surface_;
  std::vector<Integrator> integrators_{Integrator::IMPLICIT_EULER, Integrator::AUTO};  // the last is the most accurate
  std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();

  Tuning result_;
  std::optional<BodyPoints> points_;
  Step reference_step_{};
  double reference_tolerance_ = 1e-4;
  double step_error_ = 0, tolerance_error_ = 0;  // of the reference
  std::vector<Step> steps_;
  std::vector<Mesh> meshes_;
  Recording reference_;
  int reference_level_ = 0;
  std::optional<Trial> best_;
  std::string local_ = " There was no time left for graded meshes.";

  // The grid

  int firstLevel() const { return surface_ ? FIRST_SURFACE_LEVEL : FIRST_REFINE_LEVEL; }
  int lastLevel() const { return surface_ ? LAST_SURFACE_LEVEL : LAST_REFINE_LEVEL; }
  int levelsPerHalf() const { return surface_ ? 4 : 1; }
  /** From one mesh to the next in the rows that show how errors fall. */
  int stride() const { return surface_ ? 2 : 1; }
  bool statics() const { return request_.plan.statics; }
  // What a residual leaves of an equilibrium's error grows with the mesh; of a step's, whose mass is there, hardly.
  double exactTolerance() const { return statics() ? 1e-8 : 1e-6; }

  Numerics numerics(Element element, int level, const Step& step, double tolerance) const
  {
    Numerics n = numericsOf(scene_);
    n.element = element;
    if (surface_)
    {
      n.cell_size = level == 0 ? *scene_.model.cell_size : rounded(*scene_.model.cell_size * std::pow(2, -level / 4.0));
    }
    else
    {
      n.refine = level;
    }
    if (!statics())
    {
      n.integrator = step.integrator;
      n.time_step = timeStep(step.j);
    }
    n.tolerance = tolerance;
    return n;
  }

  // Runs

  double passed() const { return std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count(); }
  double left() const { return request_.seconds - passed(); }

  /** Wall clock of a step in ms: the mean, of which the cost is made. */
  double msOf(const Recording& r, double time_step) const
  {
    return statics() ? r.ms_per_step : r.ms_per_second * time_step;
  }
  double timeStep(int j) const { return scene_.time_step * std::pow(2, -j); }

  double costOf(double ms_per_step, double time_step) const
  {
    return statics() ? ms_per_step : ms_per_step * scene_.time_step / time_step;
  }

  Recording run(Trial::Role role, const Numerics& n) { return run(role, n, request_.seconds); }
  /** @param until  seconds passed after which it is stopped */
  Recording run(Trial::Role role, const Numerics& n, double until)
  {
    if (progress_)
    {
      progress_(std::string(nameOf(n.element)) +
                (surface_ ? ", cells of " + printed(*n.cell_size) + " m" : ", refine " + std::to_string(n.refine)) +
                (statics() ? "" : std::string(", ") + nameOf(n.integrator) + " at " + printed(n.time_step) + " s") +
                ", tolerance " + printed(n.tolerance) + "; " + std::to_string(result_.trials.size()) + " models run");
    }
    RunPlan plan = request_.plan;
    plan.time_limit = std::max(1.0, until - passed());
    Scene scene = with(scene_, n);
    // What others are measured by has to be solved, whatever it takes.
    if (role != Trial::Role::CANDIDATE) scene.solver.max_iterations = std::max(scene.solver.max_iterations, 20000);
    Recording r = runner_(scene, plan, points_ ? &*points_ : nullptr);
    const double cost = statics() ? r.ms_per_step : r.ms_per_second * scene_.time_step;
    result_.trials.push_back({role, n, r.status, r.reason, r.tets, r.nodes, r.ms_per_step, cost, NO_ERROR_KNOWN});
    return r;
  }

  double difference(const Recording& a, const Recording& b) const { return errorOf(compare(a, b), request_.quantity); }

  // The axis of time, and of the tolerance, on the scene's own mesh

  void chooseStep()
  {
    const Recording first = run(
        Trial::Role::STEP, numerics(Element::QUADRATIC, OWN_MESH, {integrators_.back(), 0, 0, 0}, exactTolerance()));
    if (first.status == RunStatus::REFUSED) throw InputError(first.reason);
    points_ = first.body;

    Recording exact;  // in time
    if (statics())
    {
      exact = first;
      reference_step_ = {scene_.integrator, 0, 0, first.ms_per_step};
      steps_ = {reference_step_};
    }
    else
    {
      exact = refineSteps();
    }
    if (std::isnan(difference(first, exact)))
    {
      throw InputError(!exact.comparable() ? "the scene's own mesh: " + exact.reason
                       : request_.quantity == Quantity::STRESS
                           ? "--quantity: is stress, but the scene has no probes, or they bear no stress"
                           : "the scene does not move: there is no error to speak of");
    }
    const std::vector<double> tolerances =
        statics() ? std::vector<double>{1e-7} : std::vector<double>{1e-3, 1e-4, 1e-5};
    for (const double tolerance : tolerances)
    {
      const Recording r = run(Trial::Role::STEP, numerics(Element::QUADRATIC, OWN_MESH, reference_step_, tolerance));
      result_.trials.back().error = tolerance_error_ = difference(r, exact);
      reference_tolerance_ = tolerance;
      if (tolerance_error_ <= 0.05 * request_.error) break;
    }
  }

  /** Halves the step until the error left is small; returns the recording with the finest. */
  Recording refineSteps()
  {
    const Integrator finest = integrators_.back();
    std::vector<Recording> row;
    std::vector<double> differences;
    std::vector<std::size_t> trials;
    int j = FIRST_STEP;
    double error = NO_ERROR_KNOWN;
    for (;; ++j)
    {
      const Numerics n = numerics(Element::QUADRATIC, OWN_MESH, {finest, j, 0, 0}, exactTolerance());
      row.push_back(run(Trial::Role::STEP, n));
      trials.push_back(result_.trials.size() - 1);
      if (row.size() > 1)
      {
        differences.push_back(difference(row[row.size() - 2], row.back()));
        error = convergenceIndex(differences.back(),
                                 differences.size() > 1 ? differences[differences.size() - 2] : NO_ERROR_KNOWN, 2,
                                 orderOf(finest));
      }
      // The reference takes as many steps on a mesh some 16 times as large, and the meshes before it about as long
      // again.
      const double wall = row.back().ms_per_second * request_.plan.duration / 1000;
      const bool good = row.size() > 2 && error <= REFERENCE_SHARE / 2 * request_.error;
      if (good || j == LAST_STEP || (row.size() > 2 && 2 * wall * 40 > CLIMB_SHARE * request_.seconds)) break;
    }
    const Recording& last = row.back();
    step_error_ = error;
    for (std::size_t k = 0; k < row.size(); ++k)
    {
      const double own = k + 1 == row.size() ? error : difference(row[k], last) + error;
      result_.trials[trials[k]].error = own;
      const int at = FIRST_STEP + static_cast<int>(k);
      steps_.push_back({finest, at, own, msOf(row[k], timeStep(at))});
    }
    reference_step_ = steps_.back();
    const double most = 0.6 * request_.error;  // the mesh has its part too
    double enough = row.back().ms_per_second;  // what a step that will do costs
    for (std::size_t k = 0; k < row.size(); ++k)
    {
      if (steps_[k].error <= most) enough = std::min(enough, row[k].ms_per_second);
    }
    for (std::size_t i = 0; i + 1 < integrators_.size(); ++i)
    {
      for (int other = FIRST_STEP; other <= LAST_STEP; ++other)
      {
        const Recording r =
            run(Trial::Role::STEP, numerics(Element::QUADRATIC, OWN_MESH, {integrators_[i], other, 0, 0}, 1e-4));
        const double own = difference(r, last) + error;
        result_.trials.back().error = own;
        if (std::isnan(own)) continue;
        steps_.push_back({integrators_[i], other, own, msOf(r, timeStep(other))});
        // A step of half the size costs somewhat more than half as much, and has half the error at best.
        const double halvings = std::max(0.0, std::log2(own / most));
        if (own <= most / 2 || r.ms_per_second * std::pow(1.3, std::max(1.0, halvings)) > enough) break;
      }
    }
    return last;
  }

  // The axis of the mesh

  void climbMeshes()
  {
    std::map<int, Recording> row;
    std::map<int, std::size_t> trials;
    const double growth = surface_ ? 3.5 : 10;  // of the time of a run, from one level to the next
    double wall = 0;
    for (int level = firstLevel(); level <= lastLevel(); level += stride())
    {
      if (!std::isnan(result_.reference_error) && passed() + growth * wall > CLIMB_SHARE * request_.seconds) break;
      const double before = passed();
      // The first ones may take all the time that there is: without them nothing can be said.
      Recording r = run(Trial::Role::MESH, numerics(Element::QUADRATIC, level, reference_step_, reference_tolerance_),
                        (std::isnan(result_.reference_error) ? 1 : CLIMB_LIMIT) * request_.seconds);
      wall = passed() - before;
      if (r.status != RunStatus::OK)
      {
        if (level >= OWN_MESH) break;
        row.clear();  // too coarse: a region may be empty, the surface too rough to be filled
        continue;
      }
      row[level] = std::move(r);
      trials[level] = result_.trials.size() - 1;
      reference_level_ = level;
      result_.reference_error = meshError(row, level) + step_error_ + tolerance_error_;
      if (row.size() > 2 && level > OWN_MESH && result_.reference_error <= REFERENCE_SHARE * request_.error) break;
    }
    if (std::isnan(result_.reference_error)) return;
    reference_ = row.at(reference_level_);
    const double own = meshError(row, reference_level_);
    for (const auto& [level, r] : row)
    {
      const double error = level == reference_level_ ? own : difference(r, reference_) + own;
      result_.trials[trials[level]].error = error;
      meshes_.push_back({Element::QUADRATIC, level, error, msOf(r, timeStep(reference_step_.j))});
    }
    result_.reference = result_.trials[trials.at(reference_level_)];
    result_.reference.error = result_.reference_error;
  }

  /** Of a level, from the row of meshes up to it; NaN where the row is too short. */
  double meshError(const std::map<int, Recording>& row, int level) const
  {
    constexpr double MOST = 2;
    const int half = levelsPerHalf();
    const auto apart = [&](int a, int b) {
      return row.count(a) && row.count(b) ? difference(row.at(a), row.at(b)) : NO_ERROR_KNOWN;
    };
    const double neighbours = apart(level - stride(), level);
    const double neighbours_before = apart(level - 2 * stride(), level - stride());
    const double last = apart(level - half, level);
    // Where the row is too short for three sizes in ratios of 2, the order is that of three neighbours.
    double before = apart(level - 2 * half, level - half);
    if (std::isnan(before)) before = last * std::pow(neighbours_before / neighbours, half / stride());
    if (std::isnan(last)) return NO_ERROR_KNOWN;
    const double index = convergenceIndex(last, before, 2, MOST);
    if (!surface_) return index;
    // Meshes of a surface that differ little scatter as well: by as much as neighbours do, less with the cell size.
    return std::fmax(index, 2 * std::fmax(neighbours, neighbours_before / std::sqrt(2.0)));
  }

  void measureLinearMeshes()
  {
    const double growth = surface_ ? 2.8 : 8, gain = surface_ ? 2 : 4;  // at best: of time, of error, a level
    double enough = std::numeric_limits<double>::infinity();            // what a quadratic mesh that will do takes
    for (const Mesh& mesh : meshes_)
    {
      if (mesh.error <= request_.error || mesh.level == reference_level_) enough = std::min(enough, mesh.ms);
    }
    const double own = result_.reference_error - step_error_ - tolerance_error_;
    for (int level = firstLevel(); level <= reference_level_ && left() > 0; level += stride())
    {
      const Recording r =
          run(Trial::Role::MESH, numerics(Element::LINEAR, level, reference_step_, reference_tolerance_));
      if (r.status != RunStatus::OK && level >= OWN_MESH) break;
      if (r.status != RunStatus::OK) continue;
      const double apart = difference(r, reference_);
      result_.trials.back().error = apart + own;
      const double ms = msOf(r, timeStep(reference_step_.j));
      meshes_.push_back({Element::LINEAR, level, apart + own, ms});
      // Until it is good enough, or could not become so for less than a quadratic mesh takes.
      const double levels = std::log(apart / (0.8 * request_.error)) / std::log(gain);
      if (levels <= 0 || ms * std::pow(growth, std::max(1.0, levels)) > enough) break;
    }
  }

  /** Those that the rows skipped, with what can be expected of them. */
  void addMeshesBetween()
  {
    if (!surface_) return;
    const std::vector<Mesh> known = meshes_;
    for (std::size_t k = 0; k + 1 < known.size(); ++k)
    {
      const Mesh &a = known[k], &b = known[k + 1];
      if (a.element != b.element || b.level - a.level != 2) continue;
      meshes_.push_back({a.element, a.level + 1, std::sqrt(a.error * b.error), std::sqrt(a.ms * b.ms)});
    }
  }

  // The candidates

  static double work(double tolerance) { return 1 + std::log10(1 / tolerance); }

  double costForeseen(const Mesh& mesh, const Step& step, double tolerance) const
  {
    const double ms =
        mesh.ms * (statics() ? 1 : step.ms / reference_step_.ms) * work(tolerance) / work(reference_tolerance_);
    return costOf(ms, timeStep(step.j));
  }

  std::vector<Candidate> candidates(double error) const
  {
    std::vector<Candidate> list;
    for (const Mesh& mesh : meshes_)
    {
      for (const Step& step : steps_)
      {
        if (mesh.error + (statics() ? 0 : step.error) > error) continue;
        list.push_back({mesh, step, costForeseen(mesh, step, 1e-2)});
      }
    }
    std::sort(list.begin(), list.end(), [](const Candidate& a, const Candidate& b) { return a.cost < b.cost; });
    return list;
  }

  /** Wall clock. */
  double secondsForeseen(const Candidate& c) const
  {
    return c.cost / 1000 * (statics() ? 1 : request_.plan.duration / scene_.time_step);
  }

  bool affordable(double cost) const { return !request_.budget_ms || cost <= *request_.budget_ms; }

  /** Runs a candidate; its error is that against the reference and the reference's own. */
  Trial tryOut(const Candidate& c, double tolerance)
  {
    const Numerics n = numerics(c.mesh.element, c.mesh.level, c.step, tolerance);
    const Recording r = run(Trial::Role::CANDIDATE, n);
    Trial& trial = result_.trials.back();
    trial.error = difference(r, reference_) + result_.reference_error;
    return trial;
  }

  bool wasTried(const Candidate& c) const
  {
    const Numerics n = numerics(c.mesh.element, c.mesh.level, c.step, 1e-2);
    return std::any_of(result_.trials.begin(), result_.trials.end(), [&](const Trial& t) {
      return t.role == Trial::Role::CANDIDATE && t.numerics.element == n.element &&
             t.numerics.cell_size == n.cell_size && t.numerics.refine == n.refine &&
             t.numerics.time_step == n.time_step && t.numerics.integrator == n.integrator;
    });
  }

  void tryCandidates()
  {
    const auto accurate = [&](const Trial& t) { return t.error <= request_.error; };
    const auto better = [&](const Trial& t) {
      return t.status == RunStatus::OK && accurate(t) && affordable(t.cost) && (!best_ || t.cost < best_->cost);
    };
    std::optional<Candidate> of_best;
    for (const Candidate& c : candidates(1.5 * request_.error))
    {
      if (best_ && c.cost >= best_->cost) break;
      if (request_.budget_ms && c.cost > 2 * *request_.budget_ms) break;
      if (secondsForeseen(c) > left()) continue;
      Trial trial = tryOut(c, 1e-2);
      if (!accurate(trial) && trial.error <= 1.3 * request_.error) trial = tryOut(c, 1e-3);
      if (accurate(trial) && !affordable(trial.cost) && affordable(0.5 * trial.cost)) trial = tryOut(c, 1e-1);
      if (!better(trial)) continue;
      best_ = trial;
      of_best = c;
    }
    if (!of_best || best_->numerics.tolerance != 1e-2) return;
    const Trial loose = tryOut(*of_best, 1e-1);
    if (better(loose)) best_ = loose;
  }

  /** The best candidate again, on meshes that are fine only where the error comes from. */
  void tryLocally()
  {
    const Trial uniform = *best_;
    const double own_cell = *scene_.model.cell_size;
    Numerics n = uniform.numerics;
    n.cell_size = own_cell;
    const std::vector<SizePoint> balanced = request_.local->sizes(with(scene_, n), request_.plan);
    n.sizing = request_.local->file;
    constexpr int MOST_TRIED = 5;
    for (int k = 0; k < MOST_TRIED && left() > 0; ++k)
    {
      local_ = " No graded mesh that was tried was as accurate.";
      // A quarter of the elements of the uniform mesh, then 2^(3/4) times as many each time
      const double factor = *uniform.numerics.cell_size / own_cell * std::cbrt(4) * std::pow(2, -k / 4.0);
      std::vector<SizePoint> sizes = balanced;
      double largest = 0;
      for (SizePoint& point : sizes)
      {
        point.size = std::min(point.size * factor, 2 * own_cell);
        largest = std::max(largest, point.size);
      }
      n.cell_size = rounded(largest);
      writeSizing(*n.sizing, sizes);
      const Recording r = run(Trial::Role::LOCAL, n);
      Trial& trial = result_.trials.back();
      trial.error = difference(r, reference_) + result_.reference_error;
      if (trial.status != RunStatus::OK || !(trial.error <= request_.error)) continue;
      if (trial.cost < uniform.cost) best_ = trial;
      local_ = " With local refinement: " + std::to_string(trial.tets) + " tetrahedra, " + percent(trial.error) + ", " +
               printed(trial.cost) + " ms; with the best uniform mesh " + std::to_string(uniform.tets) + ", " +
               percent(uniform.error) + ", " + printed(uniform.cost) + " ms.";
      break;
    }
    if (!best_->numerics.sizing) std::remove(n.sizing->c_str());
  }

  /**
   * Nothing is accurate enough and cheap enough: the cheapest of what comes nearest, within the budget if there is one.
   */
  void settleForLess()
  {
    constexpr double AS_GOOD = 1.25;
    std::vector<Candidate> list = candidates(std::numeric_limits<double>::infinity());
    const double most = request_.budget_ms ? 1.5 * *request_.budget_ms : std::numeric_limits<double>::infinity();
    list.erase(std::remove_if(list.begin(), list.end(), [&](const Candidate& c) { return c.cost > most; }), list.end());
    double least = std::numeric_limits<double>::infinity();
    for (const Candidate& c : list) least = std::min(least, c.mesh.error + c.step.error);
    int tried = 0;
    for (const Candidate& c : list)
    {
      if (c.mesh.error + c.step.error > AS_GOOD * least || secondsForeseen(c) > left() || wasTried(c)) continue;
      tryOut(c, 1e-2);
      if (++tried == 4) break;
    }
    least = std::numeric_limits<double>::infinity();
    // The finest meshes were run whole already, at the reference's step.
    std::vector<Trial> whole;
    for (Trial t : result_.trials)
    {
      if (t.role == Trial::Role::MESH) t.error += step_error_ + tolerance_error_;
      if (t.role == Trial::Role::STEP || t.status != RunStatus::OK || !affordable(t.cost)) continue;
      least = std::min(least, t.error);
      whole.push_back(t);
    }
    for (const Trial& t : whole)
    {
      if (t.error <= AS_GOOD * least && (!best_ || t.cost < best_->cost)) best_ = t;
    }
  }

  // In words

  std::string describe(const Trial& t) const
  {
    const Numerics& n = t.numerics;
    return std::string(nameOf(n.element)) + " elements" +
           (surface_ ? (n.sizing ? " of up to " : " of ") + printed(*n.cell_size) + " m"
                     : ", refine " + std::to_string(n.refine)) +
           " (" + std::to_string(t.tets) + " tetrahedra)" +
           (statics() ? "" : std::string(", ") + nameOf(n.integrator) + " at " + printed(1000 * n.time_step) + " ms") +
           ", tolerance " + printed(n.tolerance);
  }

  void explain()
  {
    const std::string unit = statics() ? " ms" : " ms for every " + printed(1000 * scene_.time_step) + " ms";
    if (!best_)
    {
      result_.why = "Nothing that was tried could be run within the limits: the scene stays as it is.";
      return;
    }
    result_.chosen = best_->numerics;
    result_.error = best_->error;
    result_.cost = best_->cost;
    result_.accurate = best_->error <= request_.error;
    result_.affordable = affordable(best_->cost);
    std::string why = describe(*best_) + ": estimated error " + percent(best_->error) + ", of which " +
                      percent(result_.reference_error) + " is the uncertainty of the reference (" +
                      describe(result_.reference) + "); " + printed(best_->cost) + unit + ".";
    if (result_.accurate)
    {
      const Trial* next = nullptr;  // the best of what is cheaper
      for (const Trial& t : result_.trials)
      {
        if (t.role != Trial::Role::CANDIDATE || t.cost >= best_->cost || std::isnan(t.error)) continue;
        if (!next || t.error < next->error) next = &t;
      }
      why += next
                 ? " Of what is cheaper the nearest is " + describe(*next) + ", with " + percent(next->error) + "."
                 : " What is cheaper has more than one and a half times the wanted error in its mesh or its time step.";
    }
    else
    {
      why += request_.budget_ms && result_.reference_error < request_.error
                 ? " That is what the budget of " + printed(*request_.budget_ms) +
                       " ms buys: " + percent(request_.error) + " needs more."
                 : " The wanted " + percent(request_.error) +
                       " could not be shown in the time for tuning: the reference itself is not certain to that.";
    }
    result_.why = why + (result_.accurate && request_.local ? local_ : "");
  }
};
}  // namespace

double errorOf(const VariantErrors& errors, Quantity quantity)
{
  switch (quantity)
  {
    case Quantity::FIELD:
      return errors.field_rms;
    case Quantity::MAX:
      return errors.field_max;
    case Quantity::STRESS:
      return errors.von_mises;
    default:
      return errors.tip;
  }
}

const char* nameOf(Element element)
{
  return element == Element::LINEAR ? "linear" : "quadratic";
}

const char* nameOf(Integrator integrator)
{
  switch (integrator)
  {
    case Integrator::EXPLICIT:
      return "explicit";
    case Integrator::STATIC:
      return "static";
    case Integrator::AUTO:
      return "auto";
    case Integrator::SDIRK2:
      return "sdirk2";
    default:
      return "implicit_euler";
  }
}

Numerics numericsOf(const Scene& scene)
{
  return {scene.element,   scene.model.cell_size, scene.model.sizing,    scene.model.refine,
          scene.time_step, scene.integrator,      scene.solver.tolerance};
}

Scene with(Scene scene, const Numerics& numerics)
{
  scene.element = numerics.element;
  scene.model.cell_size = numerics.cell_size;
  scene.model.sizing = numerics.sizing;
  scene.model.refine = numerics.refine;
  scene.time_step = numerics.time_step;
  scene.integrator = numerics.integrator;
  scene.solver.tolerance = numerics.tolerance;
  return scene;
}

std::vector<std::string> overridesOf(const Numerics& n, bool statics)
{
  std::vector<std::string> overrides{std::string("element=") + nameOf(n.element),
                                     "solver.tolerance=" + inYaml(n.tolerance)};
  if (n.cell_size) overrides.push_back("model.cell_size=" + inYaml(*n.cell_size));
  if (n.refine > 0) overrides.push_back("model.refine=" + std::to_string(n.refine));
  if (statics) return overrides;
  overrides.push_back("time_step=" + inYaml(n.time_step));
  overrides.push_back(std::string("integrator=") + nameOf(n.integrator));
  return overrides;
}

Tuning tune(const Scene& scene, const TuneRequest& request, const Runner& run,
            const std::function<void(const std::string&)>& progress)
{
  return Search(scene, request, run, progress).search();
}

}  // namespace bezier_fem
