#pragma once

#include <functional>
#include <string>
#include <vector>

#include "bezier_fem/sizing.h"

namespace bezier_fem
{
/**
 * The tetrahedral mesh of a surface file, made by the program `make_model` (found beside the running executable) and
 * cached by the content of the surface, the cell size, the scale and the sizing in
 * ${XDG_CACHE_HOME:-~/.cache}/bezier_fem, so that a second call returns at once. Two processes that ask for the same
 * model at the same time both get it whole.
 *
 * @param surface    .off, .obj, .stl or .ply
 * @param cell_size  m, after scaling
 * @param scale      factor on the file's coordinates
 * @param sizing     where elements shall be smaller than the cell size, in the surface's coordinates after scaling;
 *                   may be empty
 * @param log        gets the lines that make_model prints, where it had to run
 * @return path of a .msh file whose coordinates are scaled already
 * @throws InputError with make_model's own line where it refuses the surface, or where make_model is missing.
 */
std::string meshedSurface(const std::string& surface, double cell_size, double scale,
                          const std::vector<SizePoint>& sizing, const std::function<void(const std::string&)>& log);

}  // namespace bezier_fem
