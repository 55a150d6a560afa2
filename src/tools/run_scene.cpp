// Runs a scene file from the command line: simulates, and writes what is asked for. INTERFACE of the files: README.md.

#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <memory>
#include <nlohmann/json.hpp>
#include <numeric>
#include <optional>
#include <sstream>

#include "bezier_fem/error.h"
#include "bezier_fem/simulation.h"
#include "bezier_fem/surface_mesh.h"
#include "bezier_fem/vtu_series.h"

namespace
{
using namespace bezier_fem;

constexpr int DONE = 0, FAILED = 1, WRONG_INPUT = 2;
constexpr long MOST_STEPS = 1000000000;

struct Options
{
  std::string scene;
  double duration = 1;
  long steps = -1;
  bool statics = false;
  std::vector<std::string> overrides;
  std::string probes, nodes, vtu, surface, summary;
  long every = 1;
  int threads = 1;
};

/** A CSV file with 17 significant digits: what is read back is what was written. */
class CsvFile
{
public:
  explicit CsvFile(const std::string& path) : path_(path), file_(path)
  {
    if (!file_) throw InputError(path + ": cannot be written");
    file_.precision(17);
  }
  std::ofstream& out() { return file_; }
  void close()
  {
    file_.close();
    if (!file_) throw std::runtime_error(path_ + ": cannot be written, is the disk full?");
  }

private:
  std::string path_;
  std::ofstream file_;
};

/** One line on the terminal that is overwritten as the work goes on; nothing where stderr is a file or a pipe. */
class Progress
{
public:
  void show(const std::string& text)
  {
    const auto now = std::chrono::steady_clock::now();
    if (!terminal_ || now - last_ < std::chrono::milliseconds(200)) return;
    last_ = now;
    shown_ = true;
    std::fprintf(stderr, "\r\033[K%s", text.c_str());
  }
  void clear()
  {
    if (shown_) std::fprintf(stderr, "\r\033[K");
    shown_ = false;
  }

private:
  bool terminal_ = isatty(STDERR_FILENO) == 1;
  bool shown_ = false;
  std::chrono::steady_clock::time_point last_;
};

std::string toString(double value)
{
  std::ostringstream text;
  text << value;
  return text.str();
}

const char* nameOf(Scene::Solver::Preconditioner preconditioner)
{
  using Preconditioner = Scene::Solver::Preconditioner;
  return preconditioner == Preconditioner::DIRECT       ? "direct"
         : preconditioner == Preconditioner::PMULTIGRID ? "pmultigrid"
                                                        : "block_jacobi";
}

class Run
{
public:
  Run(const Options& options, Simulation& simulation) : options_(options), simulation_(simulation)
  {
    if (!options.probes.empty())
    {
      probes_ = std::make_unique<CsvFile>(options.probes);
      probes_->out() << "time";
      for (const auto& probe : simulation.scene().probes)
      {
        for (const char* axis : {"x", "y", "z"}) probes_->out() << ',' << probe.first << '.' << axis;
      }
      probes_->out() << '\n';
    }
    if (!options.nodes.empty())
    {
      nodes_ = std::make_unique<CsvFile>(options.nodes);
      nodes_->out() << "time,node,x,y,z\n";
      const auto& ids = simulation.model().ids;
      order_.resize(ids.size());
      std::iota(order_.begin(), order_.end(), 0);
      std::sort(order_.begin(), order_.end(), [&](int a, int b) { return ids[a] < ids[b]; });
    }
    if (!options.vtu.empty())
    {
      vtu_ = std::make_unique<VtuSeries>(options.vtu, std::filesystem::path(options.scene).stem().string());
    }
    if (!options.surface.empty())
    {
      std::error_code error;
      std::filesystem::create_directories(options.surface, error);
      if (error) throw InputError(options.surface + ": cannot make this folder: " + error.message());
    }
    if (!options.summary.empty()) summary_ = std::make_unique<CsvFile>(options.summary);
  }

  void simulate()
  {
    const double dt = simulation_.scene().time_step;
    const double wanted =
        options_.steps >= 0 ? static_cast<double>(options_.steps) : std::ceil(options_.duration / dt - 1e-6);
    if (wanted > static_cast<double>(MOST_STEPS))
    {
      throw InputError("run_scene: --duration " + toString(options_.duration) + " is more than " +
                       std::to_string(MOST_STEPS) + " steps of " + toString(dt) + " s");
    }
    const long steps = std::lround(wanted);
    writeRow();
    watchEnergy();
    for (long step = 1; step <= steps; ++step)
    {
      const StepReport report = simulation_.step();
      take(report);
      ++steps_;
      if (report.finite) watchEnergy();
      if (step % options_.every == 0 || step == steps || !report.finite) writeRow();
      if (!report.finite) break;
      progress_.show("step " + std::to_string(step) + " of " + std::to_string(steps) + ", " +
                     std::to_string(100 * step / steps) + " %, " + std::to_string(report.iterations) + " iterations");
    }
    progress_.clear();
  }

  void solveStatic()
  {
    writeRow();
    const auto start = std::chrono::steady_clock::now();
    StepReport report = simulation_.solveStatic([&](int round, double residual) {
      progress_.show("static equilibrium, round " + std::to_string(round) + ", residual " + std::to_string(residual));
    });
    report.ms.total = std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
    take(report);
    writeRow();
    progress_.clear();
  }

  /** Writes the summary and closes all files; returns the exit status. */
  int finish()
  {
    if (summary_) summary_->out() << summary().dump(2) << '\n';
    for (CsvFile* file : {probes_.get(), nodes_.get(), summary_.get()})
    {
      if (file) file->close();
    }
    if (finite_ && converged_) return DONE;
    std::cerr << options_.scene
              << (!finite_ ? ": diverged: positions are no longer finite"
                           : ": not converged: the worst residual is " + toString(residual_) + ", the tolerance " +
                                 toString(simulation_.scene().solver.tolerance))
              << std::endl;
    return FAILED;
  }

private:
  const Options& options_;
  Simulation& simulation_;
  std::unique_ptr<CsvFile> probes_, nodes_, summary_;
  std::unique_ptr<VtuSeries> vtu_;
  std::vector<int> order_;  // nodes by id
  Progress progress_;
  Eigen::Matrix3Xd surface_, normals_;
  long surfaces_ = 0;  // files written

  long steps_ = 0, substeps_ = 0, substepped_ = 0, second_order_ = 0, asleep_ = 0;
  bool converged_ = true, finite_ = true;
  Scene::Solver::Preconditioner preconditioner_ = Scene::Solver::Preconditioner::BLOCK_JACOBI;
  double residual_ = 0, turn_ = 0, kinetic_ = 0, kinetic_peak_ = 0;
  std::vector<double> iterations_;
  std::array<std::vector<double>, 6> ms_;  // rotation, assembly, force, solve, surface, total

  void take(const StepReport& report)
  {
    converged_ = converged_ && report.converged;
    finite_ = finite_ && report.finite;
    residual_ = std::max(residual_, report.residual);
    turn_ = std::max(turn_, report.turn);
    using Preconditioner = Scene::Solver::Preconditioner;
    if (report.preconditioner != Preconditioner::BLOCK_JACOBI) preconditioner_ = report.preconditioner;
    substeps_ += report.substeps;
    substepped_ += report.substeps > 1;
    second_order_ += report.second_order;
    asleep_ += report.asleep;
    if (report.asleep) return;  // medians are of steps that were computed
    iterations_.push_back(report.iterations);
    double surface_ms = 0;
    if (summary_ && simulation_.scene().surface_file)
    {
      const auto start = std::chrono::steady_clock::now();
      simulation_.evaluateSurface(surface_, &normals_);
      surface_ms = std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
    }
    const StageTimes& ms = report.ms;
    const std::array<double, 6> times{ms.rotation, ms.assembly, ms.force, ms.solve, surface_ms, ms.total + surface_ms};
    for (std::size_t k = 0; k < ms_.size(); ++k) ms_[k].push_back(times[k]);
  }

  void watchEnergy()
  {
    if (!summary_) return;
    kinetic_ = kineticEnergy(simulation_.model(), simulation_.state().v);
    kinetic_peak_ = std::max(kinetic_peak_, kinetic_);
  }

  void writeRow()
  {
    const double time = simulation_.time();
    if (probes_)
    {
      probes_->out() << time;
      for (const Eigen::Vector3d& p : simulation_.probes())
        probes_->out() << ',' << p.x() << ',' << p.y() << ',' << p.z();
      probes_->out() << '\n';
    }
    const Model& model = simulation_.model();
    const State& state = simulation_.state();
    for (const int i : order_)
    {
      const Eigen::Vector3d p = nodePosition(model, state.x, i);
      nodes_->out() << time << ',' << model.ids[i] << ',' << p.x() << ',' << p.y() << ',' << p.z() << '\n';
    }
    if (vtu_) vtu_->write(model, state.x, state.v, simulation_.nodalStress(), time);
    if (!options_.surface.empty())
    {
      std::array<char, 32> number{};
      std::snprintf(number.data(), number.size(), "_%06ld.ply", surfaces_++);
      simulation_.evaluateSurface(surface_, &normals_);
      writePly(options_.surface + "/" + std::filesystem::path(options_.scene).stem().string() + number.data(), surface_,
               normals_, simulation_.surface().triangles);
    }
  }

  static double median(std::vector<double> values)
  {
    if (values.empty()) return 0;
    std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2), values.end());
    return values[values.size() / 2];
  }

  nlohmann::ordered_json summary() const
  {
    const Model& model = simulation_.model();
    const State& state = simulation_.state();
    const auto vector = [](const Eigen::Vector3d& v) { return nlohmann::ordered_json{v.x(), v.y(), v.z()}; };
    nlohmann::ordered_json j;
    j["elements"] = model.num_tets;
    j["nodes"] = model.num_nodes;
    long held = 0;
    for (const std::uint8_t axes : simulation_.supports().held) held += (axes & 1) + (axes >> 1 & 1) + (axes >> 2 & 1);
    j["degrees_of_freedom"] = 3L * model.num_nodes - held;
    j["steps"] = steps_;
    j["time"] = simulation_.time();
    j["status"] = !finite_ ? "diverged" : converged_ ? "ok" : "not_converged";
    j["settled"] = finite_ && kinetic_ <= 1e-6 * kinetic_peak_;
    j["inverted_elements"] = invertedElements(model, state.x);
    j["substeps"] = substeps_;
    j["substepped_steps"] = substepped_;
    j["sdirk2_steps"] = second_order_;
    j["asleep_steps"] = asleep_;
    j["largest_turn"] = turn_;
    j["threads"] = options_.threads;
    j["ms_per_step"] = {{"rotation", median(ms_[0])},
                        {"assembly", median(ms_[1])},
                        {"force", median(ms_[2])},
                        {"solve", median(ms_[3])},
                        {"contact", 0.0},
                        {"surface", median(ms_[4])},
                        {"total", median(ms_[5])}};
    j["iterations"] = median(iterations_);
    j["preconditioner"] = nameOf(preconditioner_);
    j["residual"] = residual_;
    const Energies energy = simulation_.energies();
    j["energy"] = {{"kinetic", energy.kinetic}, {"elastic", energy.elastic}, {"gravity", energy.gravity}};
    const auto stress = simulation_.nodalStress();
    double largest = 0;
    for (Eigen::Index i = 0; i < stress.cols(); ++i) largest = std::max(largest, vonMises(stress.col(i)));
    j["max_von_mises"] = largest;
    j["mass"] = model.mass();
    j["volume"] = model.volume();
    j["current_volume"] = currentVolume(model, state.x);
    j["reaction"] = nlohmann::ordered_json::object();
    const std::vector<Reaction> reactions = simulation_.reactions();
    for (std::size_t k = 0; k < reactions.size(); ++k)
    {
      j["reaction"][simulation_.supports().regions[k].name] = vector(reactions[k].force);
    }
    return j;
  }
};

/** Lines worth telling while a scene loads. Held back until it has loaded, so that an error stands alone. */
class Notes
{
public:
  void operator()(const std::string& line)
  {
    if (isatty(STDERR_FILENO) == 1) return print(line);
    lines_.push_back(line);
  }
  void flush()
  {
    for (const std::string& line : lines_) print(line);
    lines_.clear();
  }

private:
  std::vector<std::string> lines_;
  static void print(const std::string& line) { std::cerr << line << std::endl; }
};

std::unique_ptr<Simulation> load(Scene scene, const Options& options, Notes& notes)
{
  try
  {
    return std::make_unique<Simulation>(std::move(scene), options.threads,
                                        [&](const std::string& line) { notes(line); });
  }
  catch (const InputError& error)
  {
    throw InputError(options.scene + ": " + error.what());
  }
}

int run(const Options& options)
{
  Scene scene = loadScene(options.scene, options.overrides);
  for (const Scene::Fixed& fixed : scene.fixed)
  {
    if (fixed.frame)
      throw InputError(options.scene + ": " + fixed.key + ".frame: only the ROS node can follow a frame");
  }
  const bool statics = options.statics || scene.integrator == Integrator::STATIC;
  Notes notes;
  const std::unique_ptr<Simulation> simulation = load(std::move(scene), options, notes);
  Run run(options, *simulation);
  if (statics)
  {
    run.solveStatic();
  }
  else
  {
    run.simulate();
  }
  notes.flush();
  return run.finish();
}
}  // namespace

int main(int argc, char** argv)
{
  Options options;
  std::vector<std::string> positional;
  const auto wholeNumber = [](long least, long most) {
    return CLI::Validator(
        [least, most](const std::string& text) {
          long value = 0;
          const bool ok = CLI::detail::lexical_cast(text, value) && value >= least && value <= most;
          return ok ? std::string()
                    : text + " is not a whole number from " + std::to_string(least) + " to " + std::to_string(most);
        },
        "");
  };
  CLI::App app{
      "Simulates a scene: a deformable body, how it is held and what acts on it. SI units; see doc/scene_file.md."};
  app.add_option("SCENE", positional, "Scene file, YAML")->required();
  auto* duration = app.add_option("--duration", options.duration, "Simulated time in s (default 1)");
  auto* steps = app.add_option("--steps", options.steps, "Number of time steps, instead of a duration")
                    ->check(wholeNumber(0, MOST_STEPS))
                    ->excludes(duration);
  app.add_flag("--static", options.statics,
               "Static equilibrium instead of a simulation; overrides the scene's integrator")
      ->excludes(duration)
      ->excludes(steps);
  app.add_option("--set", options.overrides,
                 "KEY=VALUE: overrides a key of the scene, e.g. material.young=1.0e+6; any number of them")
      ->take_all()
      ->allow_extra_args(false);
  app.add_option("--probes", options.probes, "CSV file for the positions of the scene's probes, in m");
  app.add_option("--nodes", options.nodes, "CSV file for the positions of all nodes, in m");
  app.add_option("--vtu", options.vtu, "Folder for a ParaView series");
  app.add_option("--surface", options.surface, "Folder for the surface, a .ply with normals for each row");
  app.add_option("--summary", options.summary, "JSON file for what came out of the run");
  app.add_option("--every", options.every, "Rows and ParaView files only for every K-th step, and the first and last")
      ->check(wholeNumber(1, MOST_STEPS));
  app.add_option("--threads", options.threads, "Threads (default 1)")->check(wholeNumber(1, 1024));
  app.footer("Exit status: 0 done, 1 the run failed (diverged, not converged), 2 the input is wrong.");
  try
  {
    app.parse(argc, argv);
    // `--set A=1 B=2` too: what follows the scene and is no other option's is an override.
    options.scene = positional.front();
    for (std::size_t k = 1; k < positional.size(); ++k)
    {
      if (options.overrides.empty() || positional[k].find('=') == std::string::npos)
      {
        throw CLI::ExtrasError({positional[k]});
      }
      options.overrides.push_back(positional[k]);
    }
    if (!(options.duration >= 0) || !std::isfinite(options.duration))
    {
      throw CLI::ValidationError("--duration", "must be a time in s, at least 0");
    }
  }
  catch (const CLI::ParseError& error)
  {
    if (error.get_exit_code() == 0) return app.exit(error);
    std::cerr << "run_scene: " << error.what() << std::endl;
    return WRONG_INPUT;
  }
  try
  {
    return run(options);
  }
  catch (const InputError& error)
  {
    std::cerr << error.what() << std::endl;
    return WRONG_INPUT;
  }
  catch (const std::exception& error)
  {
    std::cerr << "run_scene: " << error.what() << std::endl;
    return FAILED;
  }
}
