// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <functional>
#include <utility>

#include "mesh_checks.h"

namespace make_model
{
/** For a point near the surface: the closest point on it, and the outward unit normal there. */
using ClosestPoint = std::function<std::pair<Eigen::Vector3d, Eigen::Vector3d>(const Eigen::Vector3d&)>;

/**
 * A mesh with its boundary points on a curved surface cuts through it: it is too light and too soft, by several per
 * cent where it is coarse. Moves the boundary points along their normals until the triangles around each of them lie
 * as far outside as inside on average. Flat parts and sharp edges stay. No dihedral angle falls below `keep_dihedral`
 * [degrees] that was not below it before, and no triangle is taken to be further than `reach` [m] from the surface.
 */
void fitVolume(Tets& mesh, const Eigen::Matrix3Xi& boundary, const ClosestPoint& closest, double reach,
               double keep_dihedral);

}  // namespace make_model
