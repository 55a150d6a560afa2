// SPDX-License-Identifier: GPL-3.0-or-later
#include "volume_fit.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

namespace make_model
{
namespace
{
/** How far the surface lies outside a triangle on average, along the triangle's unit normal [m]. */
double meanGap(const Eigen::Matrix3d& corners, const Eigen::Vector3d& normal, const ClosestPoint& closest, double reach)
{
  // Corners, middles of the edges and centroid; with these weights exact for cubics.
  const auto gap = [&](const Eigen::Vector3d& at) {
    const auto [point, surface_normal] = closest(at);
    if (surface_normal.dot(normal) < 0.5) return 0.;  // another part of the surface, or around a sharp edge
    return std::clamp((point - at).dot(normal), -reach, reach);
  };
  double sum = 27 * gap(corners.rowwise().mean());
  for (int i = 0; i < 3; ++i) sum += 3 * gap(corners.col(i)) + 8 * gap((corners.col(i) + corners.col((i + 1) % 3)) / 2);
  return sum / 60;
}

}  // namespace

void fitVolume(Tets& mesh, const Eigen::Matrix3Xi& boundary, const ClosestPoint& closest, double reach,
               double keep_dihedral)
{
  constexpr int PASSES = 3;  // the first leaves a tenth of the gap, the third a thousandth
  std::vector<std::vector<Eigen::Index>> tets_of(static_cast<std::size_t>(mesh.points.cols()));
  for (Eigen::Index t = 0; t < mesh.tets.cols(); ++t)
    for (const int corner : mesh.tets.col(t)) tets_of[corner].push_back(t);
  const auto worstAround = [&](Eigen::Index point) {
    double worst = 180;
    for (const Eigen::Index t : tets_of[point])
      worst = std::min(worst, smallestDihedral(mesh.points(Eigen::all, mesh.tets.col(t))));
    return worst;
  };

  for (int pass = 0; pass < PASSES; ++pass)
  {
    Eigen::Matrix3Xd normals = Eigen::Matrix3Xd::Zero(3, mesh.points.cols());  // times twice the area around
    Eigen::VectorXd gaps = Eigen::VectorXd::Zero(mesh.points.cols()), areas = gaps;
    for (const auto& triangle : boundary.colwise())
    {
      const Eigen::Matrix3d corners = mesh.points(Eigen::all, triangle);
      const Eigen::Vector3d normal = (corners.col(1) - corners.col(0)).cross(corners.col(2) - corners.col(0));
      const double area = normal.norm();
      if (!(area > 0)) continue;
      const double gap = meanGap(corners, normal / area, closest, reach);
      for (const int point : triangle)
      {
        normals.col(point) += normal;
        gaps[point] += gap * area;
        areas[point] += area;
      }
    }
    for (Eigen::Index point = 0; point < mesh.points.cols(); ++point)
    {
      const double length = normals.col(point).norm();
      if (mesh.on_sharp[point] || gaps[point] == 0 || length == 0) continue;
      // The volume swept by a point is its move times |sum of normals| / 3; dividing by that length instead of the
      // area makes up for normals that differ, up to the factor of two that a very sharp corner would ask for.
      const Eigen::Vector3d before = mesh.points.col(point);
      const double worst_before = worstAround(point);
      const double move = gaps[point] / std::max(length, areas[point] / 2);
      mesh.points.col(point) += move * normals.col(point) / length;
      if (worstAround(point) < std::min(keep_dihedral, worst_before)) mesh.points.col(point) = before;
    }
  }
}

}  // namespace make_model
