#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

#include "bezier_fem/bernstein.h"
#include "bezier_fem/mesh.h"
#include "bezier_fem/nodal_field.h"
#include "bezier_fem/scene.h"

namespace bezier_fem
{
/** Elements are stored in blocks of so many, one a SIMD lane, whatever the width of the machine's registers. */
constexpr int LANES = 16;

/**
 * A body at rest: geometry, material and numbering. Does not change while it is simulated, except for its material
 * (setMaterials()). Elements are in the order of a recursive bisection of the body, most of them paired with one that
 * they share a face with, in the same lane of the next block, and control points near their elements, corners among
 * edges: so neighbours in space are neighbours in memory. An element's corners are an even permutation of those of its
 * tetrahedron in the mesh. "Node" is short for control point.
 */
struct Model
{
  int num_tets = 0;
  int num_nodes = 0;      // control points: corners, and for quadratic elements edges
  int num_corners = 0;    // of the mesh
  int nodes_per_tet = 0;  // 4 or 10

  NodalField rest;                  // X, rest control points, m, in the world frame
  std::vector<int> tets;            // num_tets x nodes_per_tet node indices, local order of bernstein.h
  std::vector<double> volumes;      // num_tets, m^3, positive
  Eigen::Matrix3Xd gradients;       // 3 x (3 num_tets): g_1, g_2, g_3 of each element, 1/m; g_0 = -(g_1 + g_2 + g_3)
  std::vector<Material> materials;  // num_tets
  Dilatation dilatation = Dilatation::FULL;

  std::vector<int> node_of_corner;       // mesh corner -> node
  std::vector<std::array<int, 2>> ends;  // node -> its two mesh corners (equal for a corner's node)
  std::vector<std::int64_t> ids;         // node -> the mesh file's id, or one after its largest (INTERFACE)
  std::vector<int> tet_of_mesh_tet;      // mesh tet -> element

  struct Face
  {
    int tet;
    int opposite;  // local corner that the face does not have
  };
  std::vector<Face> boundary;  // faces of one element only

  std::vector<double> node_mass;  // integral of rho B_I, kg: sums to the body's mass (not the diagonal of M)

  // The same in blocks of LANES elements, for the kernels. The last block is filled up with copies of the last
  // element whose coefficients are zero.
  int num_blocks = 0;
  std::vector<std::uint8_t> block_pairing;   // [block]: kernels::Pairing
  AlignedVector<int> block_offsets;          // [block][nodes_per_tet][LANES]: 4 times the node
  AlignedVector<double> block_gradients;     // [block][9][LANES], g_1 g_2 g_3, 1/m
  AlignedVector<double> block_coefficients;  // [block][3][LANES]: V lambda_L, V mu (Pa m^3), V rho (kg)
  // Where elements leave what they add to a node, the two of a pair together (kernels.h, NodeShares)
  std::vector<int> share_begin, share_slots;
  AlignedVector<double> block_mean;  // [block][LANES]: V meanLambda() (Pa m^3); empty where all are zero

  // The largest of the elements': V rho (kg), V (lambda_L + 2 mu) times the largest |g_i|^2, i > 0 (N/m),
  // (lambda_L + 2 mu) / mu
  double largest_mass = 0, largest_stiffness = 0, largest_condition = 0;

  const int* nodesOf(int tet) const { return tets.data() + static_cast<std::ptrdiff_t>(tet) * nodes_per_tet; }
  bool quadratic() const { return nodes_per_tet == QUADRATIC_NODES; }
  double mass() const;    // kg
  double volume() const;  // m^3, at rest

  /** Node indices of a boundary face: three corners, then for quadratic elements the edges 01, 02, 12 of the face. */
  std::array<int, 6> nodesOf(const Face& face) const;
  /** Area at rest, m^2. */
  double area(const Face& face) const;
};

/**
 * @param mesh       corners in the world frame, m
 * @param materials  one a mesh tet
 */
Model buildModel(const TetMesh& mesh, Element element, const std::vector<Material>& materials,
                 Dilatation dilatation = Dilatation::FULL);

/** Changes the material of every element: one a mesh tet. Geometry and numbering stay. */
void setMaterials(Model& model, const std::vector<Material>& materials);

/** Lame's first parameter, Pa. */
inline double lameLambda(const Material& m)
{
  return m.young * m.poisson / ((1 + m.poisson) * (1 - 2 * m.poisson));
}
/** Shear modulus, Pa. */
inline double lameMu(const Material& m)
{
  return m.young / (2 * (1 + m.poisson));
}

/** Above this Poisson's ratio Dilatation::AUTO is MEAN. */
constexpr double LOCKING_POISSON = 0.45;

/**
 * The part of an element's lambda that acts on the mean over the element of the strain's trace, not on the trace at
 * each point, Pa. Were it all of lambda (Nagtegaal, Parks, Rice 1974; Hughes 1980), the pressure would be constant in
 * an element, and of lower order than the strain. With Dilatation::MEAN it is what exceeds the lambda of a Poisson's
 * ratio of 0.3 at the same shear modulus: the rest is as at every point and too soft to lock.
 */
double meanLambda(const Model& model, int tet);

}  // namespace bezier_fem
