#pragma once

#include "bezier_fem/mesh.h"

namespace bezier_fem
{
/**
 * The mesh with every tetrahedron cut into eight, `levels` times: red refinement (Bey, Tetrahedral grid refinement,
 * Computing 55, 1995). The four tetrahedra at the corners have the shape of the whole; the octahedron that is left is
 * cut into four along the edge between the middles of edges 02 and 13, with the children's corners in Bey's order, so
 * that all descendants of a tetrahedron fall into at most three shapes however often it is refined.
 *
 * The middle of an edge becomes a corner with the id of midEdges(), so that an id goes on naming the same place; the
 * refined mesh has none of its own left (TetMesh::mid_edges is empty), and TetMesh::parents tells which edge it was. A
 * group keeps its tetrahedra, and wins every new corner whose edge has both ends in it: what a fixed region holds of an
 * edge, and what a load takes of a face, stays the same part of the body.
 */
TetMesh refined(TetMesh mesh, int levels);

}  // namespace bezier_fem
