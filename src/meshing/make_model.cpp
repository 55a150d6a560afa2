// SPDX-License-Identifier: GPL-3.0-or-later
//
// make_model: a closed surface -> a checked tetrahedral mesh. Copyright (C) 2024 the bezier_fem developers.
//
// This program is free software: you can redistribute it and/or modify it under the terms of the GNU General Public
// License as published by the Free Software Foundation, either version 3 of the License, or (at your option) any later
// version. It is distributed in the hope that it will be useful, but WITHOUT ANY WARRANTY; without even the implied
// warranty of MERCHANTABILITY or FITNESS FOR A PARTICULAR PURPOSE. See the file COPYING beside this one.

#include <CGAL/AABB_face_graph_triangle_primitive.h>
#include <CGAL/AABB_traits.h>
#include <CGAL/AABB_tree.h>
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Mesh_complex_3_in_triangulation_3.h>
#include <CGAL/Mesh_criteria_3.h>
#include <CGAL/Mesh_triangulation_3.h>
#include <CGAL/Polygon_mesh_processing/compute_normal.h>
#include <CGAL/Polygon_mesh_processing/connected_components.h>
#include <CGAL/Polygon_mesh_processing/detect_features.h>
#include <CGAL/Polygon_mesh_processing/measure.h>
#include <CGAL/Polygon_mesh_processing/orient_polygon_soup.h>
#include <CGAL/Polygon_mesh_processing/orientation.h>
#include <CGAL/Polygon_mesh_processing/polygon_soup_to_polygon_mesh.h>
#include <CGAL/Polygon_mesh_processing/repair_degeneracies.h>
#include <CGAL/Polygon_mesh_processing/repair_polygon_soup.h>
#include <CGAL/Polygon_mesh_processing/self_intersections.h>
#include <CGAL/Polyhedral_mesh_domain_with_features_3.h>
#include <CGAL/Random.h>
#include <CGAL/Side_of_triangle_mesh.h>
#include <CGAL/Surface_mesh.h>
#include <CGAL/make_mesh_3.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <chrono>
#include <climits>
#include <cmath>
#include <cstdarg>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <map>
#include <memory>
#include <numeric>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "bezier_fem/error.h"
#include "bezier_fem/sizing.h"
#include "bezier_fem/surface_mesh.h"
#include "mesh_checks.h"
#include "msh_writer.h"
#include "sizing_field.h"
#include "volume_fit.h"

namespace make_model
{
namespace
{
namespace PMP = CGAL::Polygon_mesh_processing;
using bezier_fem::InputError;
using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
using Point = Kernel::Point_3;
using Surface = CGAL::Surface_mesh<Point>;
using SurfaceTree = CGAL::AABB_tree<CGAL::AABB_traits<Kernel, CGAL::AABB_face_graph_triangle_primitive<Surface>>>;
using Domain = CGAL::Polyhedral_mesh_domain_with_features_3<Kernel, Surface>;
using Triangulation = CGAL::Mesh_triangulation_3<Domain>::type;
using Complex = CGAL::Mesh_complex_3_in_triangulation_3<Triangulation, Domain::Corner_index, Domain::Curve_index>;
using Criteria = CGAL::Mesh_criteria_3<Triangulation>;

struct Options
{
  std::string surface, output;
  double cell_size = 0;               // m, after scaling
  std::optional<std::string> sizing;  // a file
  std::optional<double> scale, longest_side, density;
};

__attribute__((format(printf, 1, 2))) std::string text(const char* format, ...)
{
  std::array<char, 1024> buffer;
  va_list arguments;
  va_start(arguments, format);
  std::vsnprintf(buffer.data(), buffer.size(), format, arguments);
  va_end(arguments);
  return buffer.data();
}

std::string text(const Point& p)
{
  return text("(%.6g, %.6g, %.6g)", p.x(), p.y(), p.z());
}

std::string counted(std::size_t count, const char* noun)
{
  return text("%zu %s%s", count, noun, count == 1 ? "" : "s");
}

/** What the run is busy with, on a terminal only. */
class Progress
{
public:
  ~Progress() { show(""); }
  void show(const std::string& stage) const
  {
    if (on_terminal_) std::fprintf(stderr, "\r\033[K%s", stage.c_str());
  }

private:
  const bool on_terminal_ = isatty(STDERR_FILENO) != 0;
};

/** Kept until the mesh is written: a refused surface gets one line and nothing beside it. */
struct Remarks
{
  std::vector<std::string> repairs, warnings;
};

// The surface: from triangles as the file gives them to the closed boundary of a solid ---------------------------
//
// Messages up to the scaling give coordinates as they stand in the file.

using Soup = std::vector<std::vector<std::size_t>>;

struct Edge
{
  std::size_t a, b;       // a < b
  std::size_t triangles;  // how many share it
};

std::vector<Edge> edgesOf(const Soup& triangles)
{
  std::vector<std::pair<std::size_t, std::size_t>> sides;
  for (const auto& t : triangles)
    for (int i = 0; i < 3; ++i) sides.push_back(std::minmax({t[i], t[(i + 1) % 3]}));
  std::sort(sides.begin(), sides.end());
  std::vector<Edge> edges;
  for (const auto& [a, b] : sides)
  {
    if (edges.empty() || edges.back().a != a || edges.back().b != b) edges.push_back({a, b, 0});
    ++edges.back().triangles;
  }
  return edges;
}

std::size_t removeDuplicates(Soup& triangles)
{
  std::map<std::array<std::size_t, 3>, std::size_t> known;
  Soup unique;
  for (auto& t : triangles)
  {
    std::array<std::size_t, 3> key{t[0], t[1], t[2]};
    std::sort(key.begin(), key.end());
    if (known.emplace(key, unique.size()).second) unique.push_back(t);
  }
  const std::size_t removed = triangles.size() - unique.size();
  triangles = std::move(unique);
  return removed;
}

/** Joins boundary points that rounding in the file has split: closer than a millionth of the longest side. */
std::size_t weld(const std::vector<Point>& points, Soup& triangles, double longest)
{
  const double tolerance = 1e-6 * longest;
  std::vector<std::size_t> border;
  for (const Edge& edge : edgesOf(triangles))
    if (edge.triangles == 1) border.insert(border.end(), {edge.a, edge.b});
  std::sort(border.begin(), border.end(), [&](std::size_t i, std::size_t j) {
    return std::make_pair(points[i].x(), i) < std::make_pair(points[j].x(), j);
  });
  border.erase(std::unique(border.begin(), border.end()), border.end());

  std::map<std::size_t, std::size_t> becomes;
  for (std::size_t i = 0; i < border.size(); ++i)
    for (std::size_t j = i + 1; j < border.size() && points[border[j]].x() - points[border[i]].x() <= tolerance; ++j)
      if (!becomes.count(border[i]) &&
          CGAL::squared_distance(points[border[i]], points[border[j]]) <= tolerance * tolerance)
        becomes.emplace(border[j], border[i]);
  for (auto& t : triangles)
    for (std::size_t& corner : t)
      if (const auto found = becomes.find(corner); found != becomes.end()) corner = found->second;
  triangles.erase(std::remove_if(triangles.begin(), triangles.end(),
                                 [](const auto& t) { return t[0] == t[1] || t[1] == t[2] || t[2] == t[0]; }),
                  triangles.end());
  return becomes.size();
}

/** Says where a surface is open: the loops of its boundary edges, the longest first. */
std::string describeHoles(const std::vector<Point>& points, const std::vector<Edge>& border)
{
  std::map<std::size_t, std::size_t> parent;
  const auto find = [&](std::size_t i) {
    while (parent.at(i) != i) i = parent[i] = parent.at(parent.at(i));
    return i;
  };
  for (const Edge& edge : border)
  {
    parent.emplace(edge.a, edge.a);
    parent.emplace(edge.b, edge.b);
    parent[find(edge.a)] = find(edge.b);
  }
  struct Hole
  {
    std::size_t edges = 0;
    CGAL::Bbox_3 box;
  };
  std::map<std::size_t, Hole> holes;
  for (const Edge& edge : border)
  {
    Hole& hole = holes[find(edge.a)];
    ++hole.edges;
    hole.box += points[edge.a].bbox() + points[edge.b].bbox();
  }
  const Hole& largest = std::max_element(holes.begin(), holes.end(), [](const auto& a, const auto& b) {
                          return a.second.edges < b.second.edges;
                        })->second;
  const CGAL::Bbox_3& box = largest.box;
  const Point centre((box.xmin() + box.xmax()) / 2, (box.ymin() + box.ymax()) / 2, (box.zmin() + box.zmax()) / 2);
  return text("%s in %s, the longest (%s) around %s", counted(border.size(), "boundary edge").c_str(),
              counted(holes.size(), "hole").c_str(), counted(largest.edges, "edge").c_str(), text(centre).c_str());
}

void refuseUnlessClosed(const std::string& file, const std::vector<Point>& points, const Soup& triangles)
{
  std::vector<Edge> border, crowded;
  for (const Edge& edge : edgesOf(triangles))
  {
    if (edge.triangles == 1) border.push_back(edge);
    if (edge.triangles > 2) crowded.push_back(edge);
  }
  std::string fault;
  if (!border.empty()) fault = "the surface is open: " + describeHoles(points, border);
  if (!crowded.empty())
    fault += text("%s %s shared by more than two triangles, one around %s",
                  fault.empty() ? "the surface is not manifold:" : "; and",
                  (counted(crowded.size(), "edge") + (crowded.size() == 1 ? " is" : " are")).c_str(),
                  text(CGAL::midpoint(points[crowded[0].a], points[crowded[0].b])).c_str());
  if (!fault.empty()) throw InputError(file + ": " + fault + "; a solid needs a closed surface");
}

/** Turns the triangles so that neighbours agree. */
Surface orientedSurface(const std::string& file, std::vector<Point> points, Soup triangles, bool& turned)
{
  PMP::remove_isolated_points_in_polygon_soup(points, triangles);
  const std::size_t distinct_points = points.size();
  const Soup before = triangles;
  // Where neighbours cannot agree, or a point has two sheets, CGAL cuts the surface open with copies of the points.
  PMP::orient_polygon_soup(points, triangles);
  if (points.size() > distinct_points)
  {
    const auto border = edgesOf(triangles);
    const bool one_sided = std::any_of(border.begin(), border.end(), [](const Edge& e) { return e.triangles != 2; });
    throw InputError(
        file + (one_sided ? ": the surface has one side only, near " : ": the surface touches itself at the point ") +
        text(points[distinct_points]) + "; a solid needs an inside and an outside");
  }
  turned = before != triangles;
  Surface surface;
  PMP::polygon_soup_to_polygon_mesh(points, triangles, surface);
  return surface;
}

Point centre(const Surface& surface, Surface::Face_index face)
{
  const auto h = surface.halfedge(face);
  return CGAL::centroid(surface.point(surface.source(h)), surface.point(surface.target(h)),
                        surface.point(surface.target(surface.next(h))));
}

void refuseSelfIntersections(const std::string& file, const Surface& surface)
{
  std::vector<std::pair<Surface::Face_index, Surface::Face_index>> pairs;
  PMP::self_intersections(surface, std::back_inserter(pairs));
  if (pairs.empty()) return;
  const auto& [a, b] = *std::min_element(pairs.begin(), pairs.end());
  const auto smaller = PMP::face_area(a, surface) < PMP::face_area(b, surface) ? a : b;
  throw InputError(file + ": the surface cuts or touches itself: " + counted(pairs.size(), "pair") +
                   " of triangles, one near " + text(centre(surface, smaller)));
}

double longestSide(const CGAL::Bbox_3& box)
{
  return std::max({box.xmax() - box.xmin(), box.ymax() - box.ymin(), box.zmax() - box.zmin()});
}

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

void describeShells(const std::string& file, Solid& solid, Remarks& remarks)
{
  Surface& surface = solid.surface;
  const auto shell_of = surface.add_property_map<Surface::Face_index, std::size_t>("f:shell").first;
  const auto volume_of = surface.add_property_map<Surface::Face_index, std::size_t>("f:volume").first;
  std::vector<std::size_t> depth;  // shells around each shell
  PMP::volume_connected_components(
      surface, volume_of,
      CGAL::parameters::do_orientation_tests(false).face_connected_component_map(shell_of).nesting_levels(
          std::ref(depth)));
  solid.shells.resize(depth.size());
  for (const auto v : surface.vertices()) solid.shells[shell_of[surface.face(surface.halfedge(v))]].push_back(v);
  solid.bodies = static_cast<int>(std::count_if(depth.begin(), depth.end(), [](std::size_t d) { return d % 2 == 0; }));
  if (solid.bodies > 1)
    remarks.warnings.push_back(
        text("%s holds %d separate bodies; nothing keeps them together", file.c_str(), solid.bodies));
  if (const std::size_t cavities = depth.size() - solid.bodies; cavities > 0)
    remarks.repairs.push_back(counted(cavities, "closed surface") + " inside another: taken as " +
                              (cavities == 1 ? "a cavity" : "cavities"));
}

void scaleToMetres(const Options& options, Solid& solid, Remarks& remarks)
{
  Surface& surface = solid.surface;
  const CGAL::Bbox_3 box = PMP::bbox(surface);
  const double scale = options.longest_side ? *options.longest_side / longestSide(box) : options.scale.value_or(1);
  for (const auto v : surface.vertices()) surface.point(v) = CGAL::ORIGIN + scale * (surface.point(v) - CGAL::ORIGIN);
  solid.box = PMP::bbox(surface);
  solid.volume = PMP::volume(surface);
  solid.area = PMP::area(surface);
  solid.euler = static_cast<int>(surface.number_of_vertices()) - static_cast<int>(surface.number_of_edges()) +
                static_cast<int>(surface.number_of_faces());
  const double longest = longestSide(solid.box);
  if (!(std::isfinite(longest) && solid.volume > 0))
    throw InputError(options.surface + text(": has no volume at scale %g", scale));
  if (longest > 50)
    remarks.warnings.push_back(
        text("%s is %.4g m long: if its coordinates are in millimetres, give scale 0.001 or the "
             "longest side in m",
             options.surface.c_str(), longest));
  if (longest < 5e-3)
    remarks.warnings.push_back(
        text("%s is only %.4g mm long: if its coordinates are not in metres, give the scale or "
             "the longest side in m",
             options.surface.c_str(), 1e3 * longest));
}

Solid readSolid(const Options& options, Remarks& remarks)
{
  const std::string& file = options.surface;
  const bezier_fem::SurfaceMesh read = bezier_fem::readSurfaceMesh(file);
  std::vector<Point> points;
  for (const auto& p : read.points.colwise()) points.emplace_back(p.x(), p.y(), p.z());
  Soup triangles;
  for (const auto& t : read.triangles.colwise())
    triangles.push_back(
        {static_cast<std::size_t>(t[0]), static_cast<std::size_t>(t[1]), static_cast<std::size_t>(t[2])});

  if (const std::size_t removed = removeDuplicates(triangles))
    remarks.repairs.push_back(counted(removed, "triangle") + " given twice: removed");
  if (const std::size_t joined = weld(points, triangles, longestSide(CGAL::bbox_3(points.begin(), points.end()))))
    remarks.repairs.push_back(counted(joined, "boundary point") + " within a millionth of the size: joined");
  refuseUnlessClosed(file, points, triangles);

  Solid solid;
  bool turned = false;
  solid.surface = orientedSurface(file, std::move(points), std::move(triangles), turned);
  std::vector<Surface::Face_index> flat;
  PMP::degenerate_faces(solid.surface, std::back_inserter(flat));
  if (!flat.empty())
  {
    const Point where = centre(solid.surface, flat[0]);
    if (!PMP::remove_degenerate_faces(solid.surface) || !CGAL::is_closed(solid.surface) || solid.surface.is_empty())
      throw InputError(file + ": has " + counted(flat.size(), "triangle") +
                       " without area that cannot be removed, one at " + text(where));
    remarks.repairs.push_back(counted(flat.size(), "triangle") + " without area: removed");
    solid.surface.collect_garbage();
  }
  refuseSelfIntersections(file, solid.surface);
  const Surface before = solid.surface;
  PMP::orient_to_bound_a_volume(solid.surface);
  turned = turned || std::any_of(before.faces_begin(), before.faces_end(), [&](Surface::Face_index f) {
             return PMP::compute_face_normal(f, before) * PMP::compute_face_normal(f, solid.surface) < 0;
           });
  if (turned) remarks.repairs.push_back("triangles that did not face outwards: turned round");
  describeShells(file, solid, remarks);
  scaleToMetres(options, solid, remarks);
  return solid;
}

// The mesh ---------------------------------------------------------------------------------------------------------

// The surface is sampled finer than the volume: a coarse mesh of some thousand tetrahedra keeps limbs and curvature.
// Measured on the bear, bunny, armadillo and elephant of CGAL's examples at 1000 to 10000 tetrahedra.
constexpr double FACET_SIZE = 0.7;       // times the cell size: the largest circumradius of a boundary triangle
constexpr double FACET_DISTANCE = 0.2;   // times the cell size: between its circumcentre and the surface
constexpr double FACET_ANGLE = 25;       // degrees, the smallest in a boundary triangle
constexpr double RADIUS_EDGE_RATIO = 2;  // circumradius / shortest edge of a tetrahedron
constexpr double SLIVER = 12;            // degrees: dihedral angles below are improved; 20 takes ten times as long
constexpr double GOOD_DIHEDRAL = 10;     // degrees: with that, no other mesh is looked for
constexpr double SHARP_EDGE = 60;        // degrees between the normals of the two triangles
constexpr int SHARP_WORTH = 2;           // sharp edges are kept if that at most doubles the number of elements ...
constexpr double SHARP_DIHEDRAL = 8;     // ... and leaves no smaller angle [degrees]
constexpr int SHARP_ALONE = 1000000;     // elements, where there is no mesh without them to compare with
constexpr double MOST_ELEMENTS = 5e6;    // some GB and hours
constexpr double MOST_NODES = 10;        // times those expected (thin, curved solids took 3) ...
constexpr double FREE_NODES = 5000;      // ... and these, whatever is expected
constexpr double SPECK = 1e-4;           // times the cell size: refinement that comes to such edges has run away
constexpr double NOTABLE_VOLUME = 5;     // per cent more or less than the surface's: worth a warning
constexpr double LOST_VOLUME = 25;       // the same: not this solid any more

Eigen::Vector3d toEigen(const Point& p)
{
  return {p.x(), p.y(), p.z()};
}

/** What decides on the number of elements: the integral of 1/h^3 over a solid and that of 1/h^2 over its surface. */
struct Amount
{
  double solid, surface;  // no more than some MOST_ELEMENTS, where the size h differs from place to place
};

Amount amountOf(const Solid& solid, const ScaledField& sizes)
{
  if (sizes.field.isUniform())
  {
    const double h = sizes(Eigen::Vector3d::Zero());
    return {solid.volume / (h * h * h), solid.area / (h * h)};
  }
  Amount amount{0, 0};
  for (const auto face : solid.surface.faces())
  {
    Eigen::Matrix3d corners;
    Eigen::Index i = 0;
    for (const auto v : solid.surface.vertices_around_face(solid.surface.halfedge(face)))
      corners.col(i++) = toEigen(solid.surface.point(v));
    amount.surface += integralOverTriangle(sizes, corners, MOST_ELEMENTS - amount.surface);
    if (amount.surface > MOST_ELEMENTS) return amount;
  }
  const SurfaceTree tree(solid.surface.faces_begin(), solid.surface.faces_end(), solid.surface);
  const CGAL::Side_of_triangle_mesh<Surface, Kernel> side(solid.surface);
  const auto depth = [&](const Eigen::Vector3d& p) {
    const Point point(p.x(), p.y(), p.z());
    return (side(point) == CGAL::ON_UNBOUNDED_SIDE ? -1 : 1) * std::sqrt(tree.squared_distance(point));
  };
  const CGAL::Bbox_3& box = solid.box;
  const Eigen::AlignedBox3d around(Eigen::Vector3d(box.xmin(), box.ymin(), box.zmin()),
                                   Eigen::Vector3d(box.xmax(), box.ymax(), box.zmax()));
  amount.solid = integralOverSolid(sizes, around, depth, MOST_ELEMENTS);
  return amount;
}

/** Points of each shell, as far from one another as they go: every piece and limb gets some, however small. */
std::vector<Point> seeds(const Solid& solid, double spacing)
{
  constexpr std::size_t FEWEST = 8, MOST = 64;
  std::vector<Point> chosen;
  for (const auto& shell : solid.shells)
  {
    std::vector<double> distance(shell.size(), std::numeric_limits<double>::infinity());
    std::size_t next = 0;
    for (std::size_t count = 0; count < MOST; ++count)
    {
      if (count >= FEWEST && distance[next] < spacing * spacing) break;
      if (distance[next] == 0) break;
      const Point& p = solid.surface.point(shell[next]);
      chosen.push_back(p);
      for (std::size_t i = 0; i < shell.size(); ++i)
        distance[i] = std::min(distance[i], CGAL::squared_distance(p, solid.surface.point(shell[i])));
      next = static_cast<std::size_t>(std::max_element(distance.begin(), distance.end()) - distance.begin());
    }
  }
  return chosen;
}

Tets extract(const Complex& complex)
{
  Tets mesh;
  mesh.points.resize(3, static_cast<Eigen::Index>(complex.triangulation().number_of_vertices()));
  mesh.tets.resize(4, static_cast<Eigen::Index>(complex.number_of_cells_in_complex()));
  std::map<Triangulation::Vertex_handle, int> index;
  Eigen::Index t = 0;
  for (auto cell = complex.cells_in_complex_begin(); cell != complex.cells_in_complex_end(); ++cell, ++t)
    for (int i = 0; i < 4; ++i)
    {
      const auto vertex = cell->vertex(i);
      const auto [entry, is_new] = index.emplace(vertex, static_cast<int>(index.size()));
      mesh.tets(i, t) = entry->second;
      if (!is_new) continue;
      const auto& p = vertex->point();
      mesh.points.col(entry->second) << p.x(), p.y(), p.z();
      mesh.on_sharp.push_back(vertex->in_dimension() < 2);
    }
  mesh.points.conservativeResize(3, static_cast<Eigen::Index>(index.size()));
  return mesh;
}

struct Model
{
  Tets mesh;
  Topology topology;
  Quality quality;
};

struct Style
{
  bool keep_sharp;          // edges; else they are rounded off
  bool insist_on_manifold;  // boundary; else it is only checked. At sharp edges and corners insisting need not end
};
constexpr Style SHARP{true, false}, ROUNDED{false, true}, SHARP_AND_MANIFOLD{true, true};

/** A share of the cell size, as CGAL asks for it. */
struct SizeCriterion
{
  double share;
  ScaledField sizes;
  double operator()(const Point& p, int /*dimension*/, const Triangulation::Vertex::Index& /*index*/) const
  {
    return share * sizes(toEigen(p));
  }
};

/** No criterion to be met: notes whether refinement has come to edges of triangles shorter than `length`. */
class SpeckDetector : public Criteria::Facet_criteria::Abstract_criterion
{
public:
  SpeckDetector(double length, bool& found) : squared_length_(length * length), found_(&found) {}

protected:
  void do_accept(Criteria::Facet_criteria::Visitor& visitor) const override { visitor.visit(*this); }
  SpeckDetector* do_clone() const override { return new SpeckDetector(*this); }
  Is_bad do_is_bad(const Triangulation& /*triangulation*/, const Triangulation::Facet& facet) const override
  {
    for (int i = 1; i <= 3; ++i)
    {
      const auto a = facet.first->vertex((facet.second + i) % 4),
                 b = facet.first->vertex((facet.second + i % 3 + 1) % 4);
      const bool given = a->in_dimension() < 2 && b->in_dimension() < 2;  // on sharp edges
      if (!given && CGAL::squared_distance(a->point().point(), b->point().point()) < squared_length_) *found_ = true;
    }
    return {};
  }

private:
  double squared_length_;
  bool* found_;
};

/** Delaunay refinement of a solid and the removal of slivers. */
class Mesher
{
public:
  Mesher(const Solid& solid, const ScaledField& sizes, Style style, const Progress& progress)
      : solid_(solid),
        sizes_(sizes),
        cell_size_(sizes.factor * sizes.field.largest()),
        style_(style),
        progress_(progress),
        random_(0),
        domain_(solid.surface, &random_)
  {
    if (style.keep_sharp) domain_.detect_features(SHARP_EDGE);
  }

  struct Refined
  {
    Complex complex;
    Topology topology;
  };

  /**
   * Null where the boundary does not become that of a solid, or not with fewer than `most_nodes` or any sensible number
   * of them. Where pieces get lost or stick together, it is tried again from more points.
   */
  std::unique_ptr<Refined> refined(std::size_t most_nodes = SIZE_MAX)
  {
    most_nodes_ = std::min(most_nodes, sensibleNodes());
    std::unique_ptr<Refined> first;
    for (const double spacing : {2., 1., 0.5})
    {
      seed_spacing_ = spacing * cell_size_;
      auto result = refine();
      if (gave_up_) return nullptr;
      if (result && keepsPieces(result->topology)) return result;
      if (!first) first = std::move(result);
    }
    return first;
  }

  /** Whether refined() would have needed more nodes than it may have, or would never have ended. */
  bool gaveUp() const { return gave_up_; }

  bool keepsPieces(const Topology& topology) const
  {
    return topology.bodies == solid_.bodies && topology.shells == static_cast<int>(solid_.shells.size());
  }

  /** Takes what refined() gave. */
  std::optional<Model> withoutSlivers(std::unique_ptr<Refined> start)
  {
    namespace P = CGAL::parameters;
    // Perturbing moves boundary points too, and can tear a coarse boundary; then a milder or no treatment has to do.
    for (const double sliver : {SLIVER, SLIVER / 2, 0.})
    {
      if (!start) start = refine();
      progress_.show("removing slivers ...");
      if (sliver > 0) CGAL::perturb_mesh_3(start->complex, domain_, P::sliver_bound = sliver);
      CGAL::exude_mesh_3(start->complex, P::sliver_bound = SLIVER);
      Model model{extract(start->complex), {}, {}};
      model.topology = findTopology(model.mesh);
      model.quality = measureQuality(model.mesh);
      if (model.topology.non_manifold == 0 && model.topology.euler == start->topology.euler &&
          model.topology.bodies == start->topology.bodies)
        return model;
      start.reset();
    }
    return std::nullopt;
  }

private:
  std::unique_ptr<Refined> refine()
  {
    namespace P = CGAL::parameters;
    CGAL::get_default_random() = CGAL::Random(0);
    const auto size = [&](double share) { return SizeCriterion{share, sizes_}; };
    Criteria criteria(P::edge_size = size(1), P::facet_angle = FACET_ANGLE, P::facet_size = size(FACET_SIZE),
                      P::facet_distance = size(FACET_DISTANCE), P::cell_radius_edge_ratio = RADIUS_EDGE_RATIO,
                      P::cell_size = size(1));
    auto result = std::make_unique<Refined>();
    Complex& complex = result->complex;
    if (style_.keep_sharp)
      CGAL::Mesh_3::internal::init_c3t3_with_features(complex, domain_, criteria, false, most_nodes_);
    insertSeeds(complex);
    bool has_speck = false;
    criteria.add_facet_criterion(new SpeckDetector(SPECK * sizes_.factor * sizes_.field.smallest(), has_speck));
    gave_up_ = !finishes(complex, criteria, has_speck);
    if (gave_up_ || complex.number_of_cells_in_complex() == 0) return nullptr;
    result->topology = findTopology(extract(complex));
    return result->topology.non_manifold == 0 ? std::move(result) : nullptr;
  }

  /**
   * What CGAL::refine_mesh_3 does, but step by step: that one has no end at a corner where it makes ever smaller
   * triangles, until the point that should split one is rounded to a place where it does not. False where not finished.
   */
  bool finishes(Complex& complex, const Criteria& criteria, const bool& has_speck) const
  {
    using Boundary = CGAL::parameters::internal::Manifold_options;
    const Triangulation& triangulation = complex.triangulation();
    complex.clear_cells_and_facets_from_c3t3();
    CGAL::Mesh_3::Mesher_3<Complex, Criteria, Domain> mesher(
        complex, domain_, criteria, style_.insist_on_manifold ? Boundary::MANIFOLD : Boundary::NON_MANIFOLD,
        most_nodes_);
    mesher.initialize();
    std::size_t nodes = triangulation.number_of_vertices(), idle_steps = 0;
    for (std::size_t step = 0; step == 0 || !mesher.is_algorithm_done(); ++step)
    {
      if (step % 1000 == 0)
        progress_.show((style_.keep_sharp ? "meshing with sharp edges" : "meshing") + text(": %zu nodes", nodes));
      mesher.one_step();
      const std::size_t nodes_before = std::exchange(nodes, triangulation.number_of_vertices());
      idle_steps = nodes > nodes_before ? 0 : idle_steps + 1;
      if (has_speck || idle_steps > 1000 + nodes) return false;  // two idle steps in a row are rare
    }
    complex.clear_manifold_info();
    return nodes < most_nodes_;
  }

  /** A limit for refinement that runs away. */
  std::size_t sensibleNodes() const
  {
    // Thin solids are meshed as fine as they are thin.
    const double thickness = 2 * solid_.volume / solid_.area;
    const Amount expected = amountOf(solid_, {sizes_.field, sizes_.factor, thickness});
    return static_cast<std::size_t>(
        std::min(MOST_NODES * (expected.solid + expected.surface) + FREE_NODES, MOST_ELEMENTS));
  }

  void insertSeeds(Complex& complex) const
  {
    std::vector<Point> protected_points;
    for (const auto v : complex.triangulation().finite_vertex_handles()) protected_points.push_back(v->point().point());
    for (const Point& p : seeds(solid_, seed_spacing_))
    {
      const bool near_sharp = std::any_of(protected_points.begin(), protected_points.end(), [&](const Point& q) {
        return CGAL::squared_distance(p, q) < cell_size_ * cell_size_;
      });
      if (near_sharp) continue;
      const auto v = complex.triangulation().insert(Triangulation::Weighted_point(p));
      if (v == Triangulation::Vertex_handle()) continue;
      complex.set_dimension(v, 2);
      complex.set_index(v, domain_.index_from_surface_patch_index(1));
    }
  }

  const Solid& solid_;
  const ScaledField sizes_;
  const double cell_size_;  // the largest
  const Style style_;
  const Progress& progress_;
  std::size_t most_nodes_ = 0;
  double seed_spacing_ = 0;  // m
  bool gave_up_ = false;
  CGAL::Random random_;
  Domain domain_;
};

bool hasSharpEdges(Surface surface)
{
  auto sharp = get(CGAL::edge_is_feature, surface);
  PMP::detect_sharp_edges(surface, SHARP_EDGE, sharp);
  return std::any_of(surface.edges_begin(), surface.edges_end(), [&](Surface::Edge_index e) { return get(sharp, e); });
}

void refuseTooFine(const Options& options, const Solid& solid, const SizingField& sizes)
{
  // What the criteria above give for a compact and for a thin body, within some tens of per cent.
  const auto elements = [&](const SizingField& field) {
    const Amount amount = amountOf(solid, {field});
    return 5 * amount.solid + 1.5 * amount.surface;
  };
  const auto expected = [&](double h) { return elements(SizingField(h)); };
  if (expected(options.cell_size) < MOST_ELEMENTS)
  {
    if (sizes.isUniform() || elements(sizes) < MOST_ELEMENTS) return;
    throw InputError(options.surface + text(": the sizing, down to %.3g m, asks for more than %.0g elements; larger "
                                            "sizes, or small ones in fewer places, make fewer",
                                            sizes.smallest(), MOST_ELEMENTS));
  }
  double h = options.cell_size;
  while (expected(h) > MOST_ELEMENTS) h *= 1.1;
  throw InputError(options.surface + text(": cell size %g m is too small for a longest side of %.4g m: about %.1g "
                                          "elements; from %.2g m on there are fewer than %.0g",
                                          options.cell_size, longestSide(solid.box), expected(options.cell_size), h,
                                          MOST_ELEMENTS));
}

void fitTo(const Solid& solid, double cell_size, Model& model)
{
  const SurfaceTree tree(solid.surface.faces_begin(), solid.surface.faces_end(), solid.surface);
  const auto closest = [&](const Eigen::Vector3d& p) {
    const auto [q, face] = tree.closest_point_and_primitive(Point(p.x(), p.y(), p.z()));
    const auto n = PMP::compute_face_normal(face, solid.surface);
    return std::make_pair(toEigen(q), Eigen::Vector3d(n.x(), n.y(), n.z()));
  };
  fitVolume(model.mesh, model.topology.boundary, closest, FACET_DISTANCE * cell_size, SLIVER);
  model.quality = measureQuality(model.mesh);
}

/** The volume that the mesh has more than the surface, in per cent. */
double excessVolume(const Solid& solid, const Model& model)
{
  return 100 * (model.quality.volume / solid.volume - 1);
}

int handles(int shells, int euler)
{
  return shells - euler / 2;
}

/** Over the tetrahedra. */
double meanSize(const SizingField& sizes, const Tets& mesh)
{
  double sum = 0;
  for (const auto& tet : mesh.tets.colwise()) sum += sizes(mesh.points(Eigen::all, tet).rowwise().mean());
  return sum / static_cast<double>(mesh.tets.cols());
}

void checkAgainst(const Options& options, const Solid& solid, const SizingField& sizes,
                  const std::optional<Model>& model, Remarks& remarks)
{
  const double h = options.cell_size;
  const std::string& file = options.surface;
  const auto refuse = [&](const std::string& why) {
    throw InputError(
        file +
        text(": cell size %g m is too coarse for this surface (longest side %.4g m): ", h, longestSide(solid.box)) +
        why + "; try half of it");
  };
  if (!model) refuse("the mesh does not become a solid");
  const Topology& topology = model->topology;
  if (topology.bodies != solid.bodies) refuse(text("the mesh has %d bodies, not %d", topology.bodies, solid.bodies));
  const double excess = excessVolume(solid, *model);
  if (std::abs(excess) > LOST_VOLUME) refuse(text("the mesh's volume is off by %+.0f %%", excess));

  const auto warn = [&](const std::string& warning) { remarks.warnings.push_back(file + ": " + warning); };
  const int shells = static_cast<int>(solid.shells.size());
  if (topology.shells != shells)
    warn(text("%d of %d cavities are filled; a cell size below %g m keeps them", shells - topology.shells,
              shells - solid.bodies, h));
  if (handles(topology.shells, topology.euler) != handles(shells, solid.euler))
    warn(text("the surface has %d handles, the mesh %d: cell size %g m closes gaps or opens holes",
              handles(shells, solid.euler), handles(topology.shells, topology.euler), h));
  if (std::abs(excess) > NOTABLE_VOLUME)
    warn(text("cell size %g m is coarse: the volume is off by %+.1f %%", h, excess));
  if (const double size = meanSize(sizes, model->mesh); model->quality.mean_edge < 0.4 * size)
    warn(text("is thinner than the cell size %g m: the elements are smaller, their mean edge is %.3g m", size,
              model->quality.mean_edge));
}

/** What a mesh with sharp edges must be better than: one without. */
struct Yardstick
{
  std::size_t most_elements = SIZE_MAX;
  int most_euler_off = INT_MAX;  // from the surface's, see Topology
};

int eulerOff(const Solid& solid, const Topology& topology)
{
  return std::abs(topology.euler - solid.euler);
}

/** Where an element stays flat, a slightly smaller cell size leads to another mesh; the best of three is taken. */
std::optional<Model> bestMesh(const Solid& solid, const SizingField& sizes, Style style, const Yardstick& limit,
                              const Progress& progress)
{
  std::optional<Model> best;
  std::pair<bool, double> best_score(false, -1);
  for (const double factor : {1., 0.97, 0.94})
  {
    Mesher mesher(solid, {sizes, factor}, style, progress);
    auto refined = mesher.refined(limit.most_elements / 2);  // with more nodes it has more elements
    if (mesher.gaveUp()) break;
    if (!refined || eulerOff(solid, refined->topology) > limit.most_euler_off) continue;
    if (refined->complex.number_of_cells_in_complex() > limit.most_elements) break;
    std::optional<Model> model = mesher.withoutSlivers(std::move(refined));
    if (!model) continue;
    const std::pair<bool, double> score(mesher.keepsPieces(model->topology), model->quality.smallest_dihedral);
    if (score > best_score) best = std::move(model);
    best_score = std::max(best_score, score);
    if (best_score.first && best_score.second >= GOOD_DIHEDRAL) break;
  }
  return best;
}

Model meshSolid(const Options& options, const Solid& solid, const SizingField& sizes, Remarks& remarks,
                const Progress& progress)
{
  refuseTooFine(options, solid, sizes);
  std::optional<Model> model;
  if (hasSharpEdges(solid.surface))
  {
    Yardstick limit{SHARP_ALONE, INT_MAX};
    if (const auto rounded = Mesher(solid, {sizes}, ROUNDED, progress).refined())
      limit = {SHARP_WORTH * rounded->complex.number_of_cells_in_complex(), eulerOff(solid, rounded->topology)};
    model = bestMesh(solid, sizes, SHARP, limit, progress);
    if (model && (model->topology.bodies != solid.bodies || model->quality.smallest_dihedral < SHARP_DIHEDRAL))
      model.reset();
  }
  if (!model) model = bestMesh(solid, sizes, ROUNDED, {}, progress);
  if (!model)
    model = bestMesh(solid, sizes, SHARP_AND_MANIFOLD, {}, progress);  // thin wedges, however flat the elements
  progress.show("fitting the volume ...");
  if (model) fitTo(solid, options.cell_size, *model);
  checkAgainst(options, solid, sizes, model, remarks);
  return *std::move(model);
}

// The program ------------------------------------------------------------------------------------------------------

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
