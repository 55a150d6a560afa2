#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <string>
#include <vector>

namespace bezier_fem
{
/** A mid-edge node of a second-order mesh file. Its position is not kept: elements are straight-sided at rest. */
struct MidEdgeNode
{
  int corner_a;     // index into TetMesh::corners
  int corner_b;     // index into TetMesh::corners, greater than corner_a
  std::int64_t id;  // the file's id
};

/**
 * A named part of a mesh file: a Gmsh physical group, a TetGen region attribute, a Medit reference other than 0 of
 * elements (not of vertices). Names are unique: where groups of several dimensions share a name, it stands for all of
 * them; where they share a number, for the one of the highest dimension. A warning tells of both.
 */
struct MeshGroup
{
  std::string name;          // the physical name, or the number as text where the file gives no name
  std::vector<int> corners;  // indices into TetMesh::corners of all corners of the group's entities, increasing
  std::vector<int> tets;     // indices into TetMesh::tets, increasing; empty for groups of lower dimension
};

/**
 * A tetrahedral mesh as read from a file: indices compact, every tetrahedron of positive volume
 * det(v1-v0, v2-v0, v3-v0)/6, no corner outside a tetrahedron, at least one tetrahedron. Lengths in the file's unit.
 */
struct TetMesh
{
  Eigen::Matrix3Xd corners;                 // 3 x corners, in the order of their ids
  Eigen::Matrix4Xi tets;                    // 4 x tets, columns of corner indices; in the file's order
  std::vector<std::int64_t> corner_ids;     // the file's node ids, one a corner, increasing; from 0 in VTK files
  std::vector<MidEdgeNode> mid_edges;       // empty for a first-order file, else one for every edge, sorted by corners
  std::int64_t largest_id = 0;              // largest node id in the file, of unused nodes too
  std::vector<MeshGroup> groups;            // sorted by name; none in VTK files
  std::vector<std::array<int, 2>> parents;  // one a corner: itself twice, or where refined() made it the two corners
                                            // that it was halfway between; empty: not refined

  int flipped = 0;                    // elements that came inverted and were turned round
  double largest_curvature = 0;       // largest distance of a file's mid-edge node from the middle of its edge
  std::vector<std::string> warnings;  // one line each, with the file's name; nothing here stops a run
};

/**
 * A mid-edge node for every edge: the file's, or where it has none with the ids after its largest, in the order of the
 * (smaller, larger) ids of their corners.
 */
std::vector<MidEdgeNode> midEdges(const TetMesh& mesh);

}  // namespace bezier_fem
