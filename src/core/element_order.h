#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "bezier_fem/mesh.h"

namespace bezier_fem
{
/** In which order a model has the tetrahedra of a mesh, and each of them its corners. */
struct ElementOrder
{
  struct Tet
  {
    int tet;                     // of the mesh
    std::array<int, 4> corners;  // of the mesh: an even permutation of the tetrahedron's, so that volumes stay positive
  };
  std::vector<Tet> tets;
  std::vector<std::uint8_t> pairing;  // kernels::Pairing of each block of LANES of them
};

/**
 * Puts neighbours near each other, and most elements in pairs. Every half of the order, and of a half, lies on one side
 * of a plane across the longest extent of what is halved: at first of centroids, in small parts of the centres of
 * pairs. At the end of a part come those that are left alone, wherever they lie in it.
 */
ElementOrder orderElements(const TetMesh& mesh);

}  // namespace bezier_fem
