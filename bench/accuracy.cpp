// Evidence of how accurate the package is: studies, each printed as a table and written for plots.

#include "accuracy.h"

#include <CLI/CLI.hpp>
#include <cstdio>
#include <fstream>
#include <functional>
#include <iostream>

namespace bezier_fem::bench
{
void progress(const std::string& what)
{
  std::cerr << what << std::endl;
}

namespace
{
std::string cell(const Table& value, const char* format)
{
  if (value.is_null()) return "";
  if (value.is_string()) return value.get<std::string>();
  if (value.is_number_integer()) return value.dump();
  char text[32];
  std::snprintf(text, sizeof text, format, value.get<double>());
  return text;
}

void writeRows(std::ostream& out, const Table& table, const std::string& before, const std::string& between,
               const std::string& after, const char* format)
{
  for (const auto& row : table)
  {
    std::string line;
    for (const auto& value : row) line += (line.empty() ? before : between) + cell(value, format);
    out << line << after << '\n';
  }
}

Table names(const Table& table, const char* instead = nullptr)
{
  Table row = Table::array();
  for (const auto& item : table.at(0).items()) row.push_back(instead ? instead : item.key());
  return Table::array({row});
}

void print(const Table& table)
{
  for (const Table& part : {names(table), names(table, "---"), table})
  {
    writeRows(std::cout, part, "| ", " | ", " |", "%.4g");
  }
}

/** Only what the runs of a study came to: rows of the last time. */
Table lastRows(const Table& table)
{
  if (!table.at(0).contains("time")) return table;
  Table rows = Table::array();
  for (const auto& row : table)
  {
    if (row["time"] == table.back()["time"]) rows.push_back(row);
  }
  return rows;
}

std::ofstream openFile(const std::string& path)
{
  std::ofstream out(path);
  out.exceptions(std::ios::failbit | std::ios::badbit);
  return out;
}

void run(const std::function<Table()>& study, const char* legend, const std::string& csv, const std::string& json)
{
  const Table table = study();
  std::cout << legend << "\n\n";
  print(lastRows(table));
  if (!csv.empty())
  {
    std::ofstream out = openFile(csv);
    writeRows(out, names(table), "", ",", "", "");
    writeRows(out, table, "", ",", "", "%.10g");
  }
  if (!json.empty()) openFile(json) << table.dump(1) << '\n';
}
}  // namespace
}  // namespace bezier_fem::bench

int main(int argc, char** argv)
{
  using namespace bezier_fem::bench;
  CLI::App app{"Studies of accuracy; each prints a table (Markdown) and writes it for plots."};
  app.require_subcommand(1);
  std::string csv, json;
  const auto add = [&](const char* name, const char* what, const char* legend, const std::function<Table()>& study) {
    CLI::App* command = app.add_subcommand(name, what);
    command->add_option("--csv", csv, "Write the rows to this file");
    command->add_option("--json", json, "Write the rows to this file, as an array of objects");
    command->callback([&csv, &json, legend, study] { run(study, legend, csv, json); });
  };
  add("convergence", "Error over mesh size: a smooth problem, and the clamped bar",
      "Small strain. smooth: made-up displacement in a cube of 1 m, irregular meshes, relative errors in L2. clamped "
      "bar: "
      "static deflection of the tip under gravity, relative to a fine mesh that is graded towards the clamped edges. "
      "h: "
      "size of a cell, m.",
      convergence);
#ifdef BEZIER_FEM_SPECTRA
  add("frequencies", "Lowest ten frequencies of clamped bars, beside other programs' and beam theory",
      "Hz. dense_reference: a nodal element of other making on the same mesh; dense_like_calculix: with the mass "
      "integrated as CalculiX does, with four points (linear elements: one), which is not exact. beam_theory: "
      "Timoshenko for bending, Saint-Venant for torsion (free to warp at the clamped end), rod for axial.",
      frequencies);
#endif
  add("locking", "Errors of linear and quadratic elements, of either dilatation, as Poisson's ratio goes to one half",
      "E 200 kPa. point force: a cube of 1 m beside a point force in an infinite body, for which there is a closed "
      "form at "
      "every ratio; irregular meshes, errors in L2. bar: the clamped bar under gravity; bonded block: 1 x 1 x 0.3 m, "
      "squeezed by 1 % between plates that hold its faces; errors at 64 points inside against a graded mesh of mean "
      "dilatation, and how far from that full dilatation is on the same mesh. Stresses: means at the nodes, linear in "
      "between. iterations: medians of ten steps of 20 ms from rest, default tolerance.",
      locking);
  add("spin", "Momentum, angular momentum and energy over 10 s of free motion; the files hold a row every 0.1 s",
      "spin: a bar turns at 5 rad/s; swing: a bar bent by 0.6 rad is let go. 120 elements, time_step in s. momentum, "
      "angular_momentum: change since the start, relative to what all the energy of the start would be worth as a "
      "translation or as a turn across the bar; energy: relative to the start; worst_residual: of any step, 1e-7 "
      "wanted.",
      spin);
  add("equal_accuracy", "Time per step of the coarsest meshes of 2 % tip error, quadratic against linear",
      "Coarsest meshes of the clamped bar whose static deflection is within 2 % of a fine reference, and a step of "
      "implicit Euler on them: 20 ms, tolerance 1e-4, one thread, medians of 45 from rest. ratio: to the quadratic "
      "one.",
      equalAccuracy);
  try
  {
    app.parse(argc, argv);
  }
  catch (const CLI::ParseError& error)
  {
    return app.exit(error);
  }
  catch (const std::exception& error)
  {
    std::cerr << "bench_accuracy: " << error.what() << std::endl;
    return 1;
  }
}
