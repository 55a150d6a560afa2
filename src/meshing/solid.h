// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <CGAL/AABB_face_graph_triangle_primitive.h>
#include <CGAL/AABB_traits.h>
#include <CGAL/AABB_tree.h>
#include <CGAL/Bbox_3.h>
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Surface_mesh.h>

#include <Eigen/Core>
#include <vector>

#include "messages.h"
#include "options.h"

namespace make_model
{
using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
using Point = Kernel::Point_3;
using Surface = CGAL::Surface_mesh<Point>;
/** For distances from a surface and the closest points on it. */
using SurfaceTree = CGAL::AABB_tree<CGAL::AABB_traits<Kernel, CGAL::AABB_face_graph_triangle_primitive<Surface>>>;

/** A closed, oriented surface in metres. */
struct Solid
{
  Surface surface;
  std::vector<std::vector<Surface::Vertex_index>> shells;  // the points of each connected piece of the surface
  int bodies = 0;                                          // shells that are not cavities
  int euler = 0;                                           // of the surface, see Topology
  double volume = 0;                                       // m^3
  double area = 0;                                         // m^2
  CGAL::Bbox_3 box;                                        // m
};

/**
 * Reads the surface, repairs what is safe to repair (orientation, points and triangles given twice, triangles without
 * area, cracks from rounding), and scales it to metres.
 * @param remarks  gets what has been repaired, and what the user should look at
 * @throws bezier_fem::InputError if it cannot be read or does not bound a solid: open, not manifold, cutting itself
 */
Solid readSolid(const Options& options, Remarks& remarks);

/** In the box's own unit. */
double longestSide(const CGAL::Bbox_3& box);

inline Eigen::Vector3d toEigen(const Point& p)
{
  return {p.x(), p.y(), p.z()};
}

}  // namespace make_model
