// SPDX-License-Identifier: GPL-3.0-or-later
//
// make_model: a closed surface -> a checked tetrahedral mesh. Copyright (C) 2024 the bezier_fem developers.
//
// This program is free software: you can redistribute it and/or modify it under the terms of the GNU General Public
// License as published by the Free Software Foundation, either version 3 of the License, or (at your option) any later
// version. It is distributed in the hope that it will be useful, but WITHOUT ANY WARRANTY; without even the implied
// warranty of MERCHANTABILITY or FITNESS FOR A PARTICULAR PURPOSE. See the file COPYING beside this one.

#include <CGAL/assertions_behaviour.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "bezier_fem/error.h"
#include "bezier_fem/sizing.h"
#include "messages.h"
#include "msh_writer.h"
#include "options.h"
#include "sizing_field.h"
#include "solid.h"
#include "solid_mesh.h"

namespace make_model
{
namespace
{
using bezier_fem::InputError;

void checkOptions(const Options& options)
{
  const auto check = [](const char* name, double value) {
    if (!(std::isfinite(value) && value > 0)) throw InputError(text("%s %g: must be a positive number", name, value));
  };
  check("--cell-size", options.cell_size);
  if (options.scale) check("--scale", *options.scale);
  if (options.longest_side) check("--longest-side", *options.longest_side);
  if (options.density) check("--density", *options.density);

  const std::filesystem::path output(options.output);
  if (output.extension() != ".msh") throw InputError(options.output + ": the output's name must end in .msh");
  if (std::filesystem::is_directory(output)) throw InputError(options.output + ": is a directory");
  const std::filesystem::path folder = output.has_parent_path() ? output.parent_path() : ".";
  if (!std::filesystem::is_directory(folder))
    throw InputError(options.output + ": there is no directory " + folder.string());
  if (access(folder.c_str(), W_OK) != 0) throw InputError(options.output + ": cannot be written to " + folder.string());
}

void report(const Options& options, const Solid& solid, const Model& model, const Remarks& remarks, double seconds)
{
  const CGAL::Bbox_3& box = solid.box;
  std::printf("%s: %zu triangles, closed, %.4g x %.4g x %.4g m, volume %.6g m3\n", options.surface.c_str(),
              static_cast<std::size_t>(solid.surface.number_of_faces()), box.xmax() - box.xmin(),
              box.ymax() - box.ymin(), box.zmax() - box.zmin(), solid.volume);
  for (const std::string& repair : remarks.repairs) std::printf("  %s\n", repair.c_str());
  const bool sharp =
      std::find(model.mesh.on_sharp.begin(), model.mesh.on_sharp.end(), true) != model.mesh.on_sharp.end();
  std::printf(
      "%s: %lld tetrahedra, %lld nodes, %s, mean edge %.4g m%s\n", options.output.c_str(),
      static_cast<long long>(model.mesh.tets.cols()), static_cast<long long>(model.mesh.points.cols()),
      model.topology.bodies == 1 ? "one watertight body" : text("%d watertight bodies", model.topology.bodies).c_str(),
      model.quality.mean_edge, sharp ? ", sharp edges kept" : "");
  const double excess = std::round(100 * excessVolume(solid, model)) / 100;
  std::printf("  volume %.6g m3 (%+.2f %% of the surface's)", model.quality.volume, excess + 0.);  // no -0.00
  if (options.density) std::printf(", mass %.6g kg", *options.density * model.quality.volume);
  std::printf("\n  smallest dihedral angle %.1f degrees, worst radius ratio %.3f (regular: 1)\n",
              model.quality.smallest_dihedral, model.quality.worst_radius_ratio);
  std::printf("  %.2f s\n", seconds);
  std::fflush(stdout);
  for (const std::string& warning : remarks.warnings) std::fprintf(stderr, "warning: %s\n", warning.c_str());
}

void run(const Options& options)
{
  const auto start = std::chrono::steady_clock::now();
  checkOptions(options);
  const SizingField sizes(options.cell_size, options.sizing ? bezier_fem::readSizing(*options.sizing)
                                                            : std::vector<bezier_fem::SizePoint>());
  Remarks remarks;
  const auto progress = std::make_unique<Progress>();
  progress->show("checking the surface ...");
  const Solid solid = readSolid(options, remarks);
  const Model model = meshSolid(options, solid, sizes, remarks, *progress);
  writeMsh(options.output, model.mesh, model.topology);
  progress->show("");
  report(options, solid, model, remarks,
         std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
}

int fail(int status, std::string message)
{
  std::replace(message.begin(), message.end(), '\n', ' ');
  std::fprintf(stderr, "%s\n", message.c_str());
  return status;
}

}  // namespace
}  // namespace make_model

int main(int argc, char** argv)
{
  using namespace make_model;
  // CGAL throws as well; what it would print has no place beside the one line that is promised.
  const auto silent = [](const char*, const char*, const char*, int, const char*) {};
  CGAL::set_error_handler(silent);
  CGAL::set_warning_handler(silent);
  Options options;
  CLI::App app(
      "Makes a tetrahedral mesh of the solid inside a closed surface, checks it and tells its size, volume and "
      "quality.\n"
      "The surface is repaired where that is safe (orientation, points and triangles given twice, triangles without\n"
      "area, cracks from rounding) and refused where it is open, not manifold, or cuts itself. A closed surface "
      "inside\n"
      "another is a cavity. The same input gives the same file, byte for byte.\n"
      "Exit status: 0 done, 1 the run failed, 2 the input is wrong (one line on stderr says what and where).");
  app.add_option("SURFACE", options.surface, "The surface: .off, .obj, .stl or .ply")->required();
  app.add_option("OUT.msh", options.output, "The mesh: Gmsh format 2.2, text, in m; each body is a physical volume")
      ->required();
  app.add_option("--cell-size", options.cell_size,
                 "Largest circumradius of a tetrahedron, in m after scaling; edges come out about as long")
      ->required()
      ->type_name("H");
  app.add_option(
         "--sizing", options.sizing,
         text("CSV x,y,z,size: smaller cell sizes at points, m in OUT.msh's coordinates; away from them the size\n"
              "grows by %g m a metre, up to H",
              SizingField::GRADATION))
      ->type_name("FILE.csv");
  auto* scale = app.add_option("--scale", options.scale, "Factor from the file's coordinates to m (millimetres: 0.001)")
                    ->type_name("S");
  app.add_option("--longest-side", options.longest_side, "Scales so that the longest side of the bounding box is L m")
      ->type_name("L")
      ->excludes(scale);
  app.add_option("--density", options.density, "Tells the mass too; kg/m3")->type_name("RHO");
  try
  {
    app.parse(argc, argv);
    run(options);
    return 0;
  }
  catch (const CLI::CallForHelp&)
  {
    std::fputs(app.help().c_str(), stdout);
    return 0;
  }
  catch (const CLI::ParseError& error)
  {
    return fail(2, std::string("make_model: ") + error.what() + " (make_model --help tells more)");
  }
  catch (const bezier_fem::InputError& error)
  {
    return fail(2, error.what());
  }
  catch (const std::bad_alloc&)
  {
    return fail(1, options.surface + text(": not enough memory for cell size %g m", options.cell_size));
  }
  catch (const std::exception& error)
  {
    return fail(1, options.surface + ": meshing failed: " + error.what());
  }
}
