// Runs variants of a scene and compares each with a reference; a JSON object a line. What the figures mean:
// include/bezier_fem/variant.h.

#include <CLI/CLI.hpp>
#include <cmath>
#include <fstream>
#include <iostream>
#include <nlohmann/json.hpp>
#include <sstream>

#include "bezier_fem/error.h"
#include "bezier_fem/variant.h"

namespace
{
using namespace bezier_fem;
using Json = nlohmann::ordered_json;

Json number(double value)
{
  return std::isfinite(value) ? Json(value) : Json(nullptr);
}

std::vector<std::string> words(const std::string& line)
{
  std::istringstream in(line);
  return {std::istream_iterator<std::string>(in), {}};
}

Json row(const char* role, const std::vector<std::string>& overrides, const Recording& r)
{
  const Swing swing = swingOf(r);
  Json von_mises = Json::array();
  for (Eigen::Index i = 0; i < r.von_mises.size(); ++i) von_mises.push_back(number(r.von_mises[i]));
  return {{"role", role},
          {"overrides", overrides},
          {"status", nameOf(r.status)},
          {"reason", r.reason},
          {"tets", r.tets},
          {"nodes", r.nodes},
          {"degrees_of_freedom", r.degrees_of_freedom},
          {"load_seconds", r.load_seconds},
          {"steps", r.steps},
          {"substeps", r.substeps},
          {"iterations", r.iterations},
          {"residual", number(r.residual)},
          {"ms_per_step", r.ms_per_step},
          {"ms_per_second", r.ms_per_second},
          {"von_mises", von_mises},
          {"period", number(swing.period)},
          {"decay", number(swing.decay)}};
}

void print(const Json& json)
{
  std::cout << json.dump() << std::endl;
}

Recording run(const std::string& scene, const std::vector<std::string>& overrides, const RunPlan& plan,
              const BodyPoints* points)
{
  const auto log = [](const std::string& line) { std::cerr << line << std::endl; };
  try
  {
    return record(loadScene(scene, overrides), plan, points, log);
  }
  catch (const InputError& error)
  {
    Recording refused;
    refused.status = RunStatus::REFUSED;
    refused.reason = error.what();
    return refused;
  }
}

std::vector<double> flat(const Eigen::MatrixXd& m)
{
  return {m.data(), m.data() + m.size()};
}

Eigen::Matrix3Xd points(const Json& json)
{
  const std::vector<double> values = json;
  return Eigen::Map<const Eigen::Matrix3Xd>(values.data(), 3, static_cast<Eigen::Index>(values.size() / 3));
}

/** What compare() needs of a reference, and what it was made of. */
void save(const std::string& path, const Recording& r, const Json& of, const Json& shown)
{
  Json json{{"of", of},
            {"row", shown},
            {"starts_at_rest", r.starts_at_rest},
            {"rest", flat(r.body.rest)},
            {"weights", flat(r.body.weights)},
            {"probe_rest", flat(r.probe_rest)},
            {"times", r.times},
            {"von_mises", flat(r.von_mises)},
            {"probes", Json::array()},
            {"points", Json::array()}};
  for (std::size_t k = 0; k < r.times.size(); ++k)
  {
    json["probes"].push_back(flat(r.probes[k]));
    json["points"].push_back(flat(r.points[k]));
  }
  std::ofstream out(path, std::ios::binary);
  out.exceptions(std::ios::failbit | std::ios::badbit);
  Json::to_cbor(json, nlohmann::detail::output_adapter<char>(out));
}

Recording load(const std::string& path, const Json& of, Json& shown)
{
  std::ifstream in(path, std::ios::binary);
  if (!in) throw InputError(path + ": cannot be read");
  const Json json = Json::from_cbor(in);
  if (json.at("of") != of)
  {
    throw InputError(path + ": is the reference of " + json.at("of").dump() + ", not of " + of.dump());
  }
  shown = json.at("row");
  Recording r;
  r.starts_at_rest = json.at("starts_at_rest");
  r.body.rest = points(json.at("rest"));
  const std::vector<double> weights = json.at("weights"), von_mises = json.at("von_mises");
  r.body.weights = Eigen::Map<const Eigen::VectorXd>(weights.data(), static_cast<Eigen::Index>(weights.size()));
  r.von_mises = Eigen::Map<const Eigen::VectorXd>(von_mises.data(), static_cast<Eigen::Index>(von_mises.size()));
  r.probe_rest = points(json.at("probe_rest"));
  r.times = json.at("times").get<std::vector<double>>();
  for (const Json& x : json.at("probes")) r.probes.push_back(points(x));
  for (const Json& x : json.at("points")) r.points.push_back(points(x));
  return r;
}
}  // namespace

int main(int argc, char** argv)
{
  std::string scene, reference_overrides, save_to, load_from;
  RunPlan plan;
  CLI::App app{
      "Runs variants of a scene, one a line on stdin (KEY=VALUE ..., values without blanks; an empty line is the scene "
      "as it is), and compares each with a reference. Prints a JSON object a line: the reference's, then each "
      "variant's "
      "as soon as it is done. A variant that is refused or diverges has its status and reason."};
  app.add_option("SCENE", scene, "Scene file")->required();
  auto* duration = app.add_option("--duration", plan.duration, "Simulated time, s")->check(CLI::PositiveNumber);
  app.add_flag("--static", plan.statics, "The equilibrium, no motion")->excludes(duration);
  app.add_option("--threads", plan.threads, "Threads")->check(CLI::PositiveNumber);
  app.add_option("--time-limit", plan.time_limit, "Wall-clock seconds after which a variant is stopped")
      ->check(CLI::PositiveNumber);
  auto* reference = app.add_option("--reference", reference_overrides, "Overrides of the reference: \"KEY=VALUE ...\"");
  app.add_option("--save-reference", save_to, "Keep the reference's recording in this file");
  app.add_option("--load-reference", load_from, "Take it from there; refused if scene or settings are other ones");
  CLI11_PARSE(app, argc, argv);
  try
  {
    if (reference->count() == 0) throw InputError("bench_variants: --reference is missing, must be KEY=VALUE ...");
    const std::vector<std::string> overrides = words(reference_overrides);
    const Json of{{"scene", scene},
                  {"overrides", overrides},
                  {"static", plan.statics},
                  {"duration", plan.statics ? 0 : plan.duration}};
    Recording truth;
    Json shown;
    if (load_from.empty())
    {
      RunPlan unlimited = plan;
      unlimited.time_limit = std::numeric_limits<double>::infinity();
      truth = run(scene, overrides, unlimited, nullptr);
      shown = row("reference", overrides, truth);
      if (!truth.comparable()) throw InputError("the reference was " + shown.at("status").dump() + ": " + truth.reason);
    }
    else
    {
      truth = load(load_from, of, shown);
    }
    if (!save_to.empty()) save(save_to, truth, of, shown);
    print(shown);

    for (std::string line; std::getline(std::cin, line);)
    {
      const std::vector<std::string> changes = words(line);
      const Recording variant = run(scene, changes, plan, &truth.body);
      const VariantErrors errors = compare(variant, truth);
      Json json = row("variant", changes, variant);
      Json of_probes = Json::array();
      for (const double error : errors.von_mises_of_probes) of_probes.push_back(number(error));
      json["error"] = {{"tip", number(errors.tip)},
                       {"field_rms", number(errors.field_rms)},
                       {"field_max", number(errors.field_max)},
                       {"von_mises", number(errors.von_mises)},
                       {"von_mises_of_probes", of_probes},
                       {"period", number(errors.period)},
                       {"decay", number(errors.decay)}};
      print(json);
    }
  }
  catch (const InputError& error)
  {
    std::cerr << error.what() << std::endl;
    return 2;
  }
  catch (const std::exception& error)
  {
    std::cerr << "bench_variants: " << error.what() << std::endl;
    return 1;
  }
}
