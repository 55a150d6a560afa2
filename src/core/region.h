#pragma once

#include <string>
#include <unordered_map>
#include <vector>

#include "bezier_fem/mesh.h"
#include "bezier_fem/scene.h"

namespace bezier_fem
{
/** Looks up what a scene's regions select in a mesh at rest (world frame, m). */
class RegionSelector
{
public:
  explicit RegionSelector(const TetMesh& mesh);

  /** True for every mesh corner inside. `key` begins the message of an InputError for a region that selects none. */
  std::vector<bool> corners(const Region& region, const std::string& key) const;

  /** Mesh tets whose centroid is inside, or that are in the group, or all of whose corners are listed. */
  std::vector<int> tets(const Region& region, const std::string& key) const;

  /** The two corners of a node of the file: equal for a corner, the ends of its edge for a mid-edge node. */
  std::pair<int, int> ends(std::int64_t id, const std::string& key) const;

private:
  const TetMesh& mesh_;
  std::unordered_map<std::int64_t, std::pair<int, int>> ends_of_id_;

  const MeshGroup& group(const std::string& name, const std::string& key) const;
};

}  // namespace bezier_fem
