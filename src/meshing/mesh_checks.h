// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <Eigen/Core>
#include <vector>

namespace make_model
{
/** A first-order tetrahedral mesh; lengths in m. */
struct Tets
{
  Eigen::Matrix3Xd points;
  Eigen::Matrix4Xi tets;       // columns of point indices, positive volume
  std::vector<bool> on_sharp;  // one a point: lies on a sharp edge of the surface and must stay there
};

/** The boundary of a mesh and what hangs together. */
struct Topology
{
  Eigen::Matrix3Xi boundary;  // columns of point indices, counter-clockwise seen from outside
  std::vector<int> body;      // one a tetrahedron: pieces that hang together by faces, largest volume first
  int bodies = 0;
  int shells = 0;        // pieces of the boundary that hang together by edges
  int non_manifold = 0;  // boundary edges without exactly two triangles, and points where the boundary touches itself
  int euler = 0;         // points - edges + triangles of the boundary; 2 for each sphere, 2 less for each handle
};

Topology findTopology(const Tets& mesh);

struct Quality
{
  double volume = 0;               // m^3
  double smallest_dihedral = 180;  // degrees
  double worst_radius_ratio = 1;   // 3 inradius / circumradius: 1 for a regular tetrahedron, 0 for a flat one
  double mean_edge = 0;            // m, over tetrahedra
};

Quality measureQuality(const Tets& mesh);

/** det(v1-v0, v2-v0, v3-v0)/6 */
double signedVolume(const Eigen::Matrix<double, 3, 4>& corners);

/** The smallest of the six dihedral angles, in degrees; 0 where the volume is not positive. */
double smallestDihedral(const Eigen::Matrix<double, 3, 4>& corners);

}  // namespace make_model
