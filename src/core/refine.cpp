#include "bezier_fem/refine.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <numeric>
#include <unordered_map>

#include "bezier_fem/bernstein.h"

namespace bezier_fem
{
namespace
{
/** A tetrahedron's children by their corners, as control points of bernstein.h: Bey 1995, section 3. */
constexpr int CHILDREN[8][4] = {{CONTROL_POINT[0][0], CONTROL_POINT[0][1], CONTROL_POINT[0][2], CONTROL_POINT[0][3]},
                                {CONTROL_POINT[0][1], CONTROL_POINT[1][1], CONTROL_POINT[1][2], CONTROL_POINT[1][3]},
                                {CONTROL_POINT[0][2], CONTROL_POINT[1][2], CONTROL_POINT[2][2], CONTROL_POINT[2][3]},
                                {CONTROL_POINT[0][3], CONTROL_POINT[1][3], CONTROL_POINT[2][3], CONTROL_POINT[3][3]},
                                {CONTROL_POINT[0][1], CONTROL_POINT[0][2], CONTROL_POINT[0][3], CONTROL_POINT[1][3]},
                                {CONTROL_POINT[0][1], CONTROL_POINT[0][2], CONTROL_POINT[1][2], CONTROL_POINT[1][3]},
                                {CONTROL_POINT[0][2], CONTROL_POINT[0][3], CONTROL_POINT[1][3], CONTROL_POINT[2][3]},
                                {CONTROL_POINT[0][2], CONTROL_POINT[1][2], CONTROL_POINT[1][3], CONTROL_POINT[2][3]}};
constexpr int NUM_CHILDREN = 8;

std::uint64_t keyOf(int a, int b)
{
  return static_cast<std::uint64_t>(std::min(a, b)) << 32 | static_cast<std::uint32_t>(std::max(a, b));
}

/** One level; the children's corners are in Bey's order, in which some have a negative volume. */
TetMesh cut(const TetMesh& mesh)
{
  const std::vector<MidEdgeNode> edges = midEdges(mesh);
  const int old_count = static_cast<int>(mesh.corners.cols());
  const int count = old_count + static_cast<int>(edges.size());

  // Corners stand in the order of their ids. A second-order file may have numbered middles among its corners.
  std::vector<std::int64_t> ids = mesh.corner_ids;
  for (const MidEdgeNode& edge : edges) ids.push_back(edge.id);
  std::vector<int> order(count), place(count);
  std::iota(order.begin(), order.end(), 0);
  std::sort(order.begin(), order.end(), [&](int a, int b) { return ids[a] < ids[b]; });
  for (int i = 0; i < count; ++i) place[order[i]] = i;

  TetMesh fine;
  fine.flipped = mesh.flipped;
  fine.largest_curvature = mesh.largest_curvature;
  fine.warnings = mesh.warnings;
  fine.largest_id = std::max(mesh.largest_id, ids[order.back()]);
  fine.corners.resize(3, count);
  fine.corner_ids.resize(count);
  fine.parents.resize(count);
  for (int i = 0; i < count; ++i)
  {
    const int from = order[i];
    const MidEdgeNode* edge = from < old_count ? nullptr : &edges[from - old_count];
    fine.corner_ids[i] = ids[from];
    fine.corners.col(i) = edge ? (mesh.corners.col(edge->corner_a) + mesh.corners.col(edge->corner_b)) / 2
                               : mesh.corners.col(from).eval();
    const std::array<int, 2> parents = edge                   ? std::array<int, 2>{edge->corner_a, edge->corner_b}
                                       : mesh.parents.empty() ? std::array<int, 2>{from, from}
                                                              : mesh.parents[from];
    fine.parents[i] = {place[parents[0]], place[parents[1]]};
  }

  std::unordered_map<std::uint64_t, int> middle;  // of an edge of the old mesh: new corner
  for (std::size_t e = 0; e < edges.size(); ++e)
  {
    middle[keyOf(edges[e].corner_a, edges[e].corner_b)] = place[old_count + e];
  }
  fine.tets.resize(4, NUM_CHILDREN * mesh.tets.cols());
  for (Eigen::Index t = 0; t < mesh.tets.cols(); ++t)
  {
    const Eigen::Vector4i tet = mesh.tets.col(t);
    std::array<int, QUADRATIC_NODES> points{};
    for (int a = 0; a < CORNERS; ++a) points[a] = place[tet[a]];
    for (int e = 0; e < EDGES; ++e)
    {
      points[CORNERS + e] = middle.at(keyOf(tet[EDGE_CORNERS[e][0]], tet[EDGE_CORNERS[e][1]]));
    }
    for (int k = 0; k < NUM_CHILDREN; ++k)
    {
      for (int a = 0; a < CORNERS; ++a) fine.tets(a, NUM_CHILDREN * t + k) = points[CHILDREN[k][a]];
    }
  }

  for (const MeshGroup& group : mesh.groups)
  {
    MeshGroup& kept = fine.groups.emplace_back();
    kept.name = group.name;
    std::vector<bool> inside(old_count, false);
    for (const int c : group.corners)
    {
      inside[c] = true;
      kept.corners.push_back(place[c]);
    }
    for (std::size_t e = 0; e < edges.size(); ++e)
    {
      if (inside[edges[e].corner_a] && inside[edges[e].corner_b]) kept.corners.push_back(place[old_count + e]);
    }
    std::sort(kept.corners.begin(), kept.corners.end());
    for (const int t : group.tets)
    {
      for (int k = 0; k < NUM_CHILDREN; ++k) kept.tets.push_back(NUM_CHILDREN * t + k);
    }
  }
  return fine;
}
}  // namespace

TetMesh refined(TetMesh mesh, int levels)
{
  for (int level = 0; level < levels; ++level) mesh = cut(mesh);
  for (Eigen::Index t = 0; levels > 0 && t < mesh.tets.cols(); ++t)
  {
    auto tet = mesh.tets.col(t);
    const Eigen::Vector3d origin = mesh.corners.col(tet[0]);
    const Eigen::Vector3d a = mesh.corners.col(tet[1]) - origin, b = mesh.corners.col(tet[2]) - origin;
    if (a.cross(b).dot(mesh.corners.col(tet[3]) - origin) < 0) std::swap(tet[2], tet[3]);
  }
  return mesh;
}

}  // namespace bezier_fem
