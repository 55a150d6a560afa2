// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <string>

#include "mesh_checks.h"

namespace make_model
{
/**
 * Writes Gmsh's format 2.2 as text, lengths in m, ids from 1. Each body is a physical volume: `body`, or `body_1`,
 * `body_2`, ... by decreasing volume. The file appears under its name only when it is whole.
 * @throws std::runtime_error if it cannot be written
 */
void writeMsh(const std::string& path, const Tets& mesh, const Topology& topology);

}  // namespace make_model
