// SPDX-License-Identifier: GPL-3.0-or-later
#include "mesh_checks.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <numeric>
#include <tuple>

namespace make_model
{
namespace
{
using Corners = Eigen::Matrix<double, 3, 4>;

/** The faces opposite to the four corners, counter-clockwise seen from outside. */
constexpr int FACES[4][3] = {{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}};

/** Faces and edges keyed by their sorted points, so that two sides of the same thing stand next to each other. */
template <std::size_t N>
struct Side
{
  std::array<int, N> key;
  int owner;
  int local;
};

template <std::size_t N>
void sortSides(std::vector<Side<N>>& sides)
{
  for (Side<N>& side : sides) std::sort(side.key.begin(), side.key.end());
  std::sort(sides.begin(), sides.end(),
            [](const Side<N>& a, const Side<N>& b) { return std::tie(a.key, a.owner) < std::tie(b.key, b.owner); });
}

class DisjointSets
{
public:
  explicit DisjointSets(int count) : parent_(static_cast<std::size_t>(count))
  {
    std::iota(parent_.begin(), parent_.end(), 0);
  }
  int find(int i)
  {
    while (parent_[i] != i) i = parent_[i] = parent_[parent_[i]];
    return i;
  }
  void join(int a, int b) { parent_[find(a)] = find(b); }
  int count()
  {
    int roots = 0;
    for (std::size_t i = 0; i < parent_.size(); ++i) roots += parent_[i] == static_cast<int>(i);
    return roots;
  }

private:
  std::vector<int> parent_;
};

int countPinchedPoints(const Eigen::Matrix3Xi& boundary, Eigen::Index points)
{
  // Around a manifold point the edges opposite to it form one closed loop.
  std::vector<std::vector<std::pair<int, int>>> link(static_cast<std::size_t>(points));
  for (const auto& triangle : boundary.colwise())
    for (int i = 0; i < 3; ++i) link[triangle[i]].emplace_back(triangle[(i + 1) % 3], triangle[(i + 2) % 3]);
  return static_cast<int>(std::count_if(link.begin(), link.end(), [](const auto& edges) {
    if (edges.empty()) return false;
    const std::map<int, int> next(edges.begin(), edges.end());
    std::size_t steps = 0;
    int at = edges.front().first;
    do
    {
      const auto edge = next.find(at);
      if (edge == next.end()) return true;
      at = edge->second;
    } while (++steps < edges.size() && at != edges.front().first);
    return steps != edges.size() || at != edges.front().first;
  }));
}

void numberBodies(const Tets& mesh, DisjointSets& pieces, Topology& topology)
{
  std::map<int, double> volume;  // by the piece's representative
  for (Eigen::Index t = 0; t < mesh.tets.cols(); ++t)
    volume[pieces.find(static_cast<int>(t))] += signedVolume(mesh.points(Eigen::all, mesh.tets.col(t)));
  std::vector<std::pair<double, int>> order;
  for (const auto& [piece, v] : volume) order.emplace_back(-v, piece);
  std::sort(order.begin(), order.end());
  std::map<int, int> number;
  for (const auto& entry : order) number.emplace(entry.second, static_cast<int>(number.size()));
  topology.bodies = static_cast<int>(order.size());
  topology.body.resize(static_cast<std::size_t>(mesh.tets.cols()));
  for (std::size_t t = 0; t < topology.body.size(); ++t) topology.body[t] = number.at(pieces.find(static_cast<int>(t)));
}

}  // namespace

Topology findTopology(const Tets& mesh)
{
  Topology topology;
  const int count = static_cast<int>(mesh.tets.cols());

  std::vector<Side<3>> faces;
  faces.reserve(4 * static_cast<std::size_t>(count));
  for (int t = 0; t < count; ++t)
    for (int f = 0; f < 4; ++f)
      faces.push_back({{mesh.tets(FACES[f][0], t), mesh.tets(FACES[f][1], t), mesh.tets(FACES[f][2], t)}, t, f});
  sortSides(faces);

  DisjointSets pieces(count);
  std::vector<Eigen::Vector3i> boundary;
  for (std::size_t i = 0; i < faces.size(); ++i)
  {
    if (i + 1 < faces.size() && faces[i].key == faces[i + 1].key)
    {
      pieces.join(faces[i].owner, faces[i + 1].owner);
      ++i;
      continue;
    }
    const int* corners = FACES[faces[i].local];
    boundary.emplace_back(mesh.tets(corners[0], faces[i].owner), mesh.tets(corners[1], faces[i].owner),
                          mesh.tets(corners[2], faces[i].owner));
  }
  topology.boundary.resize(3, static_cast<Eigen::Index>(boundary.size()));
  for (std::size_t i = 0; i < boundary.size(); ++i) topology.boundary.col(static_cast<Eigen::Index>(i)) = boundary[i];
  numberBodies(mesh, pieces, topology);

  std::vector<Side<2>> edges;
  for (std::size_t i = 0; i < boundary.size(); ++i)
    for (int e = 0; e < 3; ++e) edges.push_back({{boundary[i][e], boundary[i][(e + 1) % 3]}, static_cast<int>(i), e});
  sortSides(edges);
  int distinct_edges = 0;
  DisjointSets shells(static_cast<int>(boundary.size()));
  for (std::size_t i = 0; i < edges.size();)
  {
    std::size_t end = i;
    for (; end < edges.size() && edges[end].key == edges[i].key; ++end) shells.join(edges[i].owner, edges[end].owner);
    if (end - i != 2) ++topology.non_manifold;
    ++distinct_edges;
    i = end;
  }
  topology.shells = shells.count();
  std::vector<bool> used(static_cast<std::size_t>(mesh.points.cols()), false);
  for (const int point : topology.boundary.reshaped()) used[point] = true;
  topology.euler =
      static_cast<int>(std::count(used.begin(), used.end(), true)) - distinct_edges + static_cast<int>(boundary.size());
  topology.non_manifold += countPinchedPoints(topology.boundary, mesh.points.cols());
  return topology;
}

double signedVolume(const Corners& corners)
{
  return (corners.col(1) - corners.col(0)).cross(corners.col(2) - corners.col(0)).dot(corners.col(3) - corners.col(0)) /
         6;
}

double smallestDihedral(const Corners& corners)
{
  if (!(signedVolume(corners) > 0)) return 0;
  Eigen::Matrix<double, 3, 4> normals;
  for (int f = 0; f < 4; ++f)
  {
    const Eigen::Vector3d origin = corners.col(FACES[f][0]);
    normals.col(f) = (corners.col(FACES[f][1]) - origin).cross(corners.col(FACES[f][2]) - origin).normalized();
  }
  double largest_cosine = -1;
  for (int a = 0; a < 4; ++a)
    for (int b = a + 1; b < 4; ++b) largest_cosine = std::max(largest_cosine, -normals.col(a).dot(normals.col(b)));
  return std::acos(std::min(largest_cosine, 1.)) * 180 / M_PI;
}

Quality measureQuality(const Tets& mesh)
{
  Quality quality;
  for (const auto& tet : mesh.tets.colwise())
  {
    const Corners corners = mesh.points(Eigen::all, tet);
    const double volume = signedVolume(corners);
    quality.volume += volume;
    quality.smallest_dihedral = std::min(quality.smallest_dihedral, smallestDihedral(corners));

    double area = 0;
    for (const auto& face : FACES)
      area +=
          (corners.col(face[1]) - corners.col(face[0])).cross(corners.col(face[2]) - corners.col(face[0])).norm() / 2;
    // Crelle: 6 V R = the area of the triangle whose sides are the products of opposite edges.
    const auto edge = [&](int a, int b) { return (corners.col(a) - corners.col(b)).norm(); };
    const double a = edge(0, 1) * edge(2, 3), b = edge(0, 2) * edge(1, 3), c = edge(0, 3) * edge(1, 2);
    const double crelle = std::sqrt(std::max(0., (a + b + c) * (-a + b + c) * (a - b + c) * (a + b - c))) / 4;
    quality.worst_radius_ratio =
        std::min(quality.worst_radius_ratio, crelle > 0 ? 3 * (3 * volume / area) * (6 * volume) / crelle : 0);
    quality.mean_edge += (edge(0, 1) + edge(0, 2) + edge(0, 3) + edge(1, 2) + edge(1, 3) + edge(2, 3)) / 6 /
                         static_cast<double>(mesh.tets.cols());
  }
  return quality;
}

}  // namespace make_model
