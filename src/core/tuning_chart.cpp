#include "bezier_fem/tuning_chart.h"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <limits>
#include <sstream>

#include "bezier_fem/error.h"

namespace bezier_fem
{
namespace
{
const char* roleOf(const Trial& trial)
{
  switch (trial.role)
  {
    case Trial::Role::STEP:
      return "step";
    case Trial::Role::MESH:
      return "mesh";
    case Trial::Role::LOCAL:
      return "local";
    default:
      return "candidate";
  }
}

void save(const std::string& path, const std::string& text)
{
  std::ofstream out(path, std::ios::binary);
  out << text;
  out.close();
  if (!out) throw InputError(path + ": cannot be written");
}

/** A logarithmic axis. */
struct Axis
{
  double low = std::numeric_limits<double>::infinity(), high = 0;  // of the data, then whole decades
  double from, to;                                                 // in the picture

  void take(double value)
  {
    if (!(value > 0) || !std::isfinite(value)) return;
    low = std::min(low, value);
    high = std::max(high, value);
  }
  void close()
  {
    if (high == 0) low = high = 1;
    low = std::pow(10, std::floor(std::log10(low) - 0.05));
    high = std::pow(10, std::ceil(std::log10(high) + 0.05));
  }
  double at(double value) const { return from + (to - from) * std::log(value / low) / std::log(high / low); }
};
}  // namespace

void writeTuningCsv(const std::string& path, const Tuning& tuning)
{
  std::ostringstream out;
  out.precision(6);
  out << "role,element,cell_size,refine,time_step,integrator,tolerance,status,tets,nodes,ms_per_step,cost_ms,error\n";
  for (const Trial& t : tuning.trials)
  {
    const Numerics& n = t.numerics;
    out << roleOf(t) << ',' << nameOf(n.element) << ',';
    if (n.cell_size) out << *n.cell_size;
    out << ',' << n.refine << ',' << n.time_step << ',' << nameOf(n.integrator) << ',' << n.tolerance << ','
        << nameOf(t.status) << ',' << t.tets << ',' << t.nodes << ',' << t.ms_per_step << ',' << t.cost << ',';
    if (std::isfinite(t.error)) out << t.error;
    out << '\n';
  }
  save(path, out.str());
}

void writeTuningChart(const std::string& path, const Tuning& tuning, const TuneRequest& request)
{
  constexpr int WIDTH = 720, HEIGHT = 480;
  Axis x, y;
  x.from = 80;
  x.to = WIDTH - 40;
  y.from = HEIGHT - 60;
  y.to = 56;
  // What is far below the wanted error matters to nobody, and would press the rest together: it stands at the foot.
  const auto shown = [&](double error) { return std::max(error, 0.01 * request.error); };
  for (const Trial& t : tuning.trials)
  {
    if (!(t.error > 0)) continue;
    x.take(t.cost);
    y.take(shown(t.error));
  }
  y.take(request.error);
  if (request.budget_ms) x.take(*request.budget_ms);
  x.close();
  y.close();

  std::ostringstream svg;
  svg.precision(5);
  const auto text = [&](double at_x, double at_y, const std::string& what, const char* anchor) {
    svg << "<text x=\"" << at_x << "\" y=\"" << at_y << "\" text-anchor=\"" << anchor << "\">" << what << "</text>\n";
  };
  const auto line = [&](double x0, double y0, double x1, double y1, const char* style) {
    svg << "<line x1=\"" << x0 << "\" y1=\"" << y0 << "\" x2=\"" << x1 << "\" y2=\"" << y1 << "\" " << style << "/>\n";
  };
  const char* const GRID = "stroke=\"#ddd\"";
  const char* const WANTED = "stroke=\"#c00\" stroke-dasharray=\"6 4\"";
  svg << "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"" << WIDTH << "\" height=\"" << HEIGHT
      << "\" font-family=\"sans-serif\" font-size=\"13\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n";
  const auto tick = [](double value) {
    std::ostringstream out;
    out << value;
    return out.str();
  };
  for (double v = x.low; v <= x.high * 1.001; v *= 10)
  {
    line(x.at(v), y.from, x.at(v), y.to, GRID);
    text(x.at(v), y.from + 18, tick(v), "middle");
  }
  for (double v = y.low; v <= y.high * 1.001; v *= 10)
  {
    line(x.from, y.at(v), x.to, y.at(v), GRID);
    text(x.from - 6, y.at(v) + 4, tick(100 * v) + " %", "end");
  }
  line(x.from, y.at(request.error), x.to, y.at(request.error), WANTED);
  if (request.budget_ms) line(x.at(*request.budget_ms), y.from, x.at(*request.budget_ms), y.to, WANTED);
  text((x.from + x.to) / 2, HEIGHT - 20,
       request.plan.statics ? "time of the solve, ms" : "time for one time_step of the scene as given, ms", "middle");
  text(x.from, 20, "Estimated error. Filled: of the whole model; empty: the part of its mesh or its time step alone.",
       "start");
  text(x.from, 40, "Blue: quadratic elements, orange: linear, green: graded mesh. Ring: chosen. Dashed: wanted.",
       "start");
  for (const Trial& t : tuning.trials)
  {
    if (!(t.error > 0) || !std::isfinite(t.error) || !(t.cost > 0)) continue;
    const char* const color = t.role == Trial::Role::LOCAL            ? "#090"
                              : t.numerics.element == Element::LINEAR ? "#e80"
                                                                      : "#06c";
    const bool whole = t.role == Trial::Role::CANDIDATE || t.role == Trial::Role::LOCAL;
    svg << "<circle cx=\"" << x.at(t.cost) << "\" cy=\"" << y.at(shown(t.error)) << "\" r=\"4\" stroke=\"" << color
        << "\" fill=\"" << (whole ? color : "none") << "\"/>\n";
  }
  if (std::isfinite(tuning.error) && tuning.error > 0)
  {
    svg << "<circle cx=\"" << x.at(tuning.cost) << "\" cy=\"" << y.at(shown(tuning.error))
        << "\" r=\"9\" stroke=\"black\" stroke-width=\"2\" fill=\"none\"/>\n";
  }
  svg << "</svg>\n";
  save(path, svg.str());
}

}  // namespace bezier_fem
