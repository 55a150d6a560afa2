// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <optional>
#include <string>

namespace make_model
{
/** What a run is asked for. */
struct Options
{
  std::string surface, output;         // files
  double cell_size = 0;                // m, after scaling
  std::optional<std::string> sizing;   // a file
  std::optional<double> scale;         // factor from the surface's coordinates to m
  std::optional<double> longest_side;  // m, of the bounding box after scaling; instead of a scale
  std::optional<double> density;       // kg/m^3
};

}  // namespace make_model
