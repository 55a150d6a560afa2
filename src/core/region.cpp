#include "region.h"

#include <algorithm>

#include "bezier_fem/bernstein.h"
#include "bezier_fem/error.h"

namespace bezier_fem
{
namespace
{
bool contains(const Region& region, const Eigen::Vector3d& p)
{
  if (region.box) return (p.array() >= region.box->min.array()).all() && (p.array() <= region.box->max.array()).all();
  return (p - region.sphere->center).norm() <= region.sphere->radius;
}
}  // namespace

RegionSelector::RegionSelector(const TetMesh& mesh) : mesh_(mesh)
{
  for (std::size_t c = 0; c < mesh.corner_ids.size(); ++c)
  {
    ends_of_id_[mesh.corner_ids[c]] = {static_cast<int>(c), static_cast<int>(c)};
  }
  for (const MidEdgeNode& mid : midEdges(mesh)) ends_of_id_[mid.id] = {mid.corner_a, mid.corner_b};
}

const MeshGroup& RegionSelector::group(const std::string& name, const std::string& key) const
{
  std::string known;
  for (const MeshGroup& g : mesh_.groups)
  {
    if (g.name == name) return g;
    known += (known.empty() ? "" : ", ") + g.name;
  }
  throw InputError(key + ".group: the mesh has no group '" + name + "'" +
                   (known.empty() ? " and no other" : "; it has: " + known));
}

std::pair<int, int> RegionSelector::ends(std::int64_t id, const std::string& key) const
{
  const auto found = ends_of_id_.find(id);
  if (found == ends_of_id_.end())
  {
    throw InputError(key + ": no tetrahedron of the mesh has a node " + std::to_string(id));
  }
  return found->second;
}

std::vector<bool> RegionSelector::corners(const Region& region, const std::string& key) const
{
  std::vector<bool> inside(mesh_.corners.cols(), false);
  if (region.group)
  {
    for (const int c : group(*region.group, key).corners) inside[c] = true;
  }
  else if (region.nodes)
  {
    for (const std::int64_t id : *region.nodes)
    {
      const auto [a, b] = ends(id, key + ".nodes");
      if (a == b) inside[a] = true;
    }
    for (const std::int64_t id : *region.nodes)
    {
      const auto [a, b] = ends(id, key + ".nodes");
      if (inside[a] && inside[b]) continue;
      throw InputError(key + ".nodes: node " + std::to_string(id) + " is the middle of the edge from " +
                       std::to_string(mesh_.corner_ids[a]) + " to " + std::to_string(mesh_.corner_ids[b]) +
                       "; list both ends too");
    }
  }
  else
  {
    for (Eigen::Index c = 0; c < mesh_.corners.cols(); ++c) inside[c] = contains(region, mesh_.corners.col(c));
  }
  if (std::find(inside.begin(), inside.end(), true) == inside.end())
  {
    throw InputError(key + ": no node of the mesh lies in this region");
  }
  return inside;
}

std::vector<int> RegionSelector::tets(const Region& region, const std::string& key) const
{
  std::vector<int> result;
  if (region.group)
  {
    result = group(*region.group, key).tets;
  }
  else if (region.nodes)
  {
    const std::vector<bool> inside = corners(region, key);
    for (Eigen::Index t = 0; t < mesh_.tets.cols(); ++t)
    {
      const auto tet = mesh_.tets.col(t);
      if (std::all_of(tet.begin(), tet.end(), [&](int c) { return inside[c]; })) result.push_back(static_cast<int>(t));
    }
  }
  else
  {
    for (Eigen::Index t = 0; t < mesh_.tets.cols(); ++t)
    {
      Eigen::Vector3d centroid = Eigen::Vector3d::Zero();
      for (int a = 0; a < CORNERS; ++a) centroid += mesh_.corners.col(mesh_.tets(a, t)) / CORNERS;
      if (contains(region, centroid)) result.push_back(static_cast<int>(t));
    }
  }
  if (result.empty()) throw InputError(key + ": no element of the mesh lies in this region");
  return result;
}

}  // namespace bezier_fem
