// SPDX-License-Identifier: GPL-3.0-or-later
//
// From triangles as the file gives them to the closed boundary of a solid.
// Messages up to the scaling give coordinates as they stand in the file.
#include "solid.h"

#include <CGAL/Polygon_mesh_processing/compute_normal.h>
#include <CGAL/Polygon_mesh_processing/connected_components.h>
#include <CGAL/Polygon_mesh_processing/measure.h>
#include <CGAL/Polygon_mesh_processing/orient_polygon_soup.h>
#include <CGAL/Polygon_mesh_processing/orientation.h>
#include <CGAL/Polygon_mesh_processing/polygon_soup_to_polygon_mesh.h>
#include <CGAL/Polygon_mesh_processing/repair_degeneracies.h>
#include <CGAL/Polygon_mesh_processing/repair_polygon_soup.h>
#include <CGAL/Polygon_mesh_processing/self_intersections.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>
#include <map>
#include <string>
#include <utility>

#include "bezier_fem/error.h"
#include "bezier_fem/surface_mesh.h"

namespace make_model
{
namespace
{
namespace PMP = CGAL::Polygon_mesh_processing;
using bezier_fem::InputError;

using make_model::text;
std::string text(const Point& p)
{
  return text("(%.6g, %.6g, %.6g)", p.x(), p.y(), p.z());
}

std::string counted(std::size_t count, const char* noun)
{
  return text("%zu %s%s", count, noun, count == 1 ? "" : "s");
}

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
}  // namespace

double longestSide(const CGAL::Bbox_3& box)
{
  return std::max({box.xmax() - box.xmin(), box.ymax() - box.ymin(), box.zmax() - box.zmin()});
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

}  // namespace make_model
