#pragma once

#include <string>

#include "bezier_fem/mesh.h"

namespace bezier_fem
{
/**
 * Reads .msh (Gmsh 2.2 and 4.1, ASCII and binary), .node or .ele (TetGen, either names the pair), .vtk (legacy), .vtu
 * and .mesh (Medit), first or second order, each with its own order of the ten nodes.
 *
 * Inverted elements are flipped and counted; curved elements are taken as straight. Duplicate nodes, disconnected
 * pieces, and pieces that hang together by an edge or a vertex only, become warnings.
 * @throws InputError with file, line and value for anything else that is wrong: zero-volume elements, missing nodes,
 *         non-finite coordinates, a file cut short, an index out of range, no tetrahedra, an unknown format.
 */
TetMesh readTetMesh(const std::string& path);

/** True if the file name's extension is one that readTetMesh() reads. */
bool isTetMeshFile(const std::string& path);

}  // namespace bezier_fem
