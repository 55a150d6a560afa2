#pragma once

#include <Eigen/Core>
#include <array>

/**
 * The quadratic Bernstein basis on a tetrahedron, and the order of an element's control points.
 *
 * Barycentric coordinates lambda_a, a = 0..3. Control points in local order: the corners (a,a), a = 0..3, then the
 * edges (0,1) (0,2) (0,3) (1,2) (1,3) (2,3). A linear element has the four corners only.
 *     B_aa = lambda_a^2,   B_ab = 2 lambda_a lambda_b          (Farin 2002; Weber et al. 2011, Eq. 3)
 * A control point is not a point of the body: the middle of edge ab lies at (x_aa + 2 x_ab + x_bb)/4.
 */
namespace bezier_fem
{
constexpr int CORNERS = 4;
constexpr int EDGES = 6;
constexpr int QUADRATIC_NODES = 10;

/** Corners at the ends of each edge. */
constexpr std::array<std::array<int, 2>, EDGES> EDGE_CORNERS{{{0, 1}, {0, 2}, {0, 3}, {1, 2}, {1, 3}, {2, 3}}};

/** Local control point (a,b), symmetric in a and b. */
constexpr std::array<std::array<int, CORNERS>, CORNERS> CONTROL_POINT{
    {{0, 4, 5, 6}, {4, 1, 7, 8}, {5, 7, 2, 9}, {6, 8, 9, 3}}};

/** Corners of the face opposite to each corner, counter-clockwise seen from outside (volume positive). */
constexpr std::array<std::array<int, 3>, CORNERS> FACE_CORNERS{{{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}}};

/** Basis functions at barycentric coordinates `lambda`, 10 (quadratic) or 4 (linear) of them; they sum to one. */
inline std::array<double, QUADRATIC_NODES> basis(int nodes, const Eigen::Vector4d& lambda)
{
  std::array<double, QUADRATIC_NODES> b{};
  for (int a = 0; a < CORNERS; ++a) b[a] = nodes == CORNERS ? lambda[a] : lambda[a] * lambda[a];
  if (nodes == QUADRATIC_NODES)
  {
    for (int e = 0; e < EDGES; ++e) b[CORNERS + e] = 2 * lambda[EDGE_CORNERS[e][0]] * lambda[EDGE_CORNERS[e][1]];
  }
  return b;
}

}  // namespace bezier_fem
