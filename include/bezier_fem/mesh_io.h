#pragma once

#include <string>

#include "bezier_fem/mesh.h"

namespace bezier_fem
{
/**
 * Reads .msh (Gmsh 2.2 and 4.1, ASCII and binary), .node or .ele (TetGen, either names the pair), .vtk (legacy up to
 * 5.1, ASCII and binary), .vtu (every encoding, uncompressed or zlib) and .mesh (Medit, ASCII), first or second order,
 * each with its own order of the ten nodes.
 *
 * Elements of lower dimension count for groups only. These become warnings: inverted elements, which are turned round;
 * curved elements, which are taken as straight; volume elements that are not tetrahedra, which are left out; nodes at
 * the same place; pieces that do not touch, or only at an edge or a vertex; elements that overlap at a shared face.
 * @throws InputError with file, line (byte in a binary file) and value for anything else that is wrong: elements
 *         without volume or with a node twice, missing or duplicate nodes, non-finite coordinates, a file cut short,
 *         an index or count out of range, an element twice, three elements at a face, two nodes for the middle of an
 *         edge, first and second order in one file, no tetrahedra, an unknown format or version.
 */
TetMesh readTetMesh(const std::string& path);

/** True if the file name's extension is one that readTetMesh() reads, in either case. */
bool isTetMeshFile(const std::string& path);

}  // namespace bezier_fem
