#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <string>
#include <vector>

namespace bezier_fem
{
/** A mid-edge node of a second-order mesh file. Its position is not kept: elements are straight-sided at rest. */
struct MidEdgeNode
{
  int corner_a;     // index into TetMesh::corners
  int corner_b;     // index into TetMesh::corners
  std::int64_t id;  // the file's id
};

/** A named part of a mesh file: a Gmsh physical group, a TetGen region attribute, a Medit reference. */
struct MeshGroup
{
  std::string name;          // the physical name, or the number as text where the file gives no name
  std::vector<int> corners;  // indices into TetMesh::corners of all corners of the group's entities, sorted, unique
  std::vector<int> tets;     // indices into TetMesh::tets, sorted; empty for groups of lower dimension
};

/**
 * A tetrahedral mesh as read from a file: indices compact, every tetrahedron of positive volume
 * det(v1-v0, v2-v0, v3-v0)/6, no corner outside a tetrahedron, at least one tetrahedron. Lengths in the file's unit.
 */
struct TetMesh
{
  Eigen::Matrix3Xd corners;              // 3 x corners
  Eigen::Matrix4Xi tets;                 // 4 x tets, columns of corner indices
  std::vector<std::int64_t> corner_ids;  // the file's node ids, one a corner
  std::vector<MidEdgeNode> mid_edges;    // empty for a first-order file, else one for every edge
  std::int64_t largest_id = 0;           // largest node id in the file, of unused nodes too
  std::vector<MeshGroup> groups;

  int flipped = 0;                     // elements that came inverted and were turned round
  double largest_curvature = 0;        // largest distance of a file's mid-edge node from the middle of its edge
  std::vector<std::string> warnings;   // one line each; nothing here stops a run
};

}  // namespace bezier_fem
