// Finds the cheapest model of a scene that is accurate enough, and writes it as a scene. What an error is, and how it
// is estimated: doc/tune.md.

#include <unistd.h>

#include <CLI/CLI.hpp>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <iostream>
#include <map>

#include "bezier_fem/error.h"
#include "bezier_fem/local_sizes.h"
#include "bezier_fem/tuning.h"
#include "bezier_fem/tuning_chart.h"
#include "bezier_fem/write_scene.h"

namespace
{
using namespace bezier_fem;

constexpr int DONE = 0, NOT_MET = 1, WRONG_INPUT = 2;

struct Options
{
  std::string scene, out;
  std::vector<std::string> overrides;
  bool local = false;
  TuneRequest request;
};

std::string toString(double value)
{
  std::ostringstream text;
  text << value;
  return text.str();
}

/** The models' lines are for run_scene; here they would drown what is told. */
void noLog(const std::string& /*line*/)
{
}

void progress(const std::string& text)
{
  if (isatty(STDERR_FILENO) == 1) std::fprintf(stderr, "\r\033[K%s", text.c_str());
}

std::vector<std::string> headOf(const Options& options, const Tuning& tuning)
{
  const std::map<Quantity, const char*> names{
      {Quantity::TIP, "tip"}, {Quantity::FIELD, "field"}, {Quantity::MAX, "max"}, {Quantity::STRESS, "stress"}};
  const TuneRequest& request = options.request;
  std::vector<std::string> head{"Written by tune_scene of " + std::filesystem::path(options.scene).filename().string() +
                                ": " + (tuning.accurate && tuning.affordable ? "met" : "NOT met") + " an error of " +
                                toString(100 * request.error) + " % (" + names.at(request.quantity) + ", " +
                                (request.plan.statics ? "static" : toString(request.plan.duration) + " s") +
                                (request.budget_ms ? ", " + toString(*request.budget_ms) + " ms" : "") + ")."};
  // In lines of readable length
  std::istringstream words(tuning.why);
  std::string line;
  for (std::string word; words >> word;)
  {
    if (line.size() + word.size() > 110)
    {
      head.push_back(line);
      line.clear();
    }
    line += (line.empty() ? "" : " ") + word;
  }
  head.push_back(line);
  return head;
}

int run(Options& options)
{
  namespace fs = std::filesystem;
  const Scene scene = loadScene(options.scene, options.overrides);
  options.request.plan.statics = options.request.plan.statics || scene.integrator == Integrator::STATIC;
  if (options.out.empty()) options.out = fs::path(options.scene).replace_extension(".tuned.yaml").string();
  const fs::path stem = fs::path(options.out).replace_extension();
  const std::string sizing = stem.string() + ".sizing.csv";
  if (options.local) options.request.local = {fs::absolute(sizing).string(), balancedSizes};
  Tuning tuning;
  try
  {
    tuning = tune(
        scene, options.request,
        [](const Scene& variant, const RunPlan& plan, const BodyPoints* points) {
          return record(variant, plan, points, noLog);
        },
        progress);
  }
  catch (const InputError& error)
  {
    progress("");
    throw InputError(options.scene + ": " + error.what());
  }
  progress("");

  std::vector<std::string> overrides = options.overrides;
  for (const std::string& change : overridesOf(tuning.chosen, options.request.plan.statics))
    overrides.push_back(change);
  if (tuning.chosen.sizing && options.local)
  {
    const fs::path folder = fs::absolute(fs::path(options.scene)).parent_path();
    overrides.push_back("model.sizing=\"" + fs::path(*tuning.chosen.sizing).lexically_proximate(folder).string() +
                        "\"");
  }
  writeScene(options.scene, overrides, options.out, headOf(options, tuning));
  writeTuningCsv(stem.string() + ".csv", tuning);
  writeTuningChart(stem.string() + ".svg", tuning, options.request);
  std::cout << tuning.why << std::endl;
  return tuning.accurate && tuning.affordable ? DONE : NOT_MET;
}
}  // namespace

int main(int argc, char** argv)
{
  Options options;
  TuneRequest& request = options.request;
  const std::map<std::string, Quantity> quantities{
      {"tip", Quantity::TIP}, {"field", Quantity::FIELD}, {"max", Quantity::MAX}, {"stress", Quantity::STRESS}};
  double budget = 0;
  CLI::App app{
      "Finds the cheapest model of a scene - element, cell size or refinement, time step, integrator, solver tolerance "
      "- "
      "whose error is below the wanted one, and writes it as SCENE.tuned.yaml, with what was tried in SCENE.tuned.csv "
      "and SCENE.tuned.svg.\n\n"
      "Errors are against the limit of ever finer meshes, steps and tolerances of the same scene, relative to the "
      "largest displacement of the body:\n"
      "  tip     of the probe that moves most, root mean square over time (of the body's point, without probes)\n"
      "  field   of the whole body, root mean square over volume and time\n"
      "  max     the largest anywhere, at any time\n"
      "  stress  von Mises at the probes at the end, relative to each one's own; the largest\n"
      "An estimate is the difference from a finer model and what that one may be wrong by itself."};
  app.add_option("SCENE", options.scene, "Scene file, YAML")->required();
  app.add_option("--error", request.error, "Wanted error, relative")
      ->required()
      ->check(CLI::Validator(
          [](const std::string& text) {
            double value = 0;
            const bool ok = CLI::detail::lexical_cast(text, value) && value > 0 && value < 1;
            return ok ? std::string() : text + " is not a number above 0 and below 1";
          },
          ""));
  auto* budget_option = app.add_option("--budget-ms", budget,
                                       "Largest wall-clock time in ms for as much motion as one time_step of the scene "
                                       "as it is given (20 for one of 20 ms: real time); static: of the solve")
                            ->check(CLI::PositiveNumber);
  app.add_option("--quantity", request.quantity, "Error of what: tip (default), field, max, stress")
      ->transform(CLI::CheckedTransformer(quantities).description(""));
  app.add_flag(
      "--local", options.local,
      "Surfaces: also try meshes that are finer only where the error comes from; writes SCENE.tuned.sizing.csv");
  auto* duration = app.add_option("--duration", request.plan.duration, "Simulated time that counts, s (default 1)")
                       ->check(CLI::PositiveNumber);
  app.add_flag("--static", request.plan.statics,
               "The static equilibrium; so too where the scene's integrator is static")
      ->excludes(duration);
  app.add_option("--seconds", request.seconds, "How long tuning may take, about (default 90)")
      ->check(CLI::PositiveNumber);
  app.add_option("--threads", request.plan.threads, "Threads (default 1)")->check(CLI::Range(1, 1024));
  app.add_option("--set", options.overrides, "KEY=VALUE: overrides a key of the scene first; any number of them")
      ->take_all()
      ->allow_extra_args(false);
  app.add_option("--out", options.out, "The scene to write, instead of SCENE.tuned.yaml");
  app.footer(
      "Exit status: 0 done, 1 the error or the budget is not met (the nearest model is written), 2 the input is "
      "wrong.");
  try
  {
    app.parse(argc, argv);
    if (budget_option->count() > 0) request.budget_ms = budget;
  }
  catch (const CLI::ParseError& error)
  {
    if (error.get_exit_code() == 0) return app.exit(error);
    std::cerr << "tune_scene: " << error.what() << std::endl;
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
    std::cerr << "tune_scene: " << error.what() << std::endl;
    return NOT_MET;
  }
}
