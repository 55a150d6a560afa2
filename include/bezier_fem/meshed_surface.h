#pragma once

#include <functional>
#include <string>

namespace bezier_fem
{
/**
 * The tetrahedral mesh of a surface file, made by the program `make_model` (found beside the running executable) and
 * cached by the content of the surface, the cell size and the scale in ${XDG_CACHE_HOME:-~/.cache}/bezier_fem, so
 * that a second call returns at once. Two processes that ask for the same model at the same time both get it whole.
 *
 * @param surface    .off, .obj, .stl or .ply
 * @param cell_size  m, after scaling
 * @param scale      factor on the file's coordinates
 * @param log        gets the lines that make_model prints, where it had to run
 * @return path of a .msh file whose coordinates are scaled already
 * @throws InputError with make_model's own line where it refuses the surface, or where make_model is missing.
 */
std::string meshedSurface(const std::string& surface, double cell_size, double scale,
                          const std::function<void(const std::string&)>& log);

}  // namespace bezier_fem
