#pragma once

#include <Eigen/Core>
#include <Eigen/Eigenvalues>
#include <cmath>
#include <vector>

namespace bezier_fem::test
{
/** A point of a rule on a tetrahedron: barycentric coordinates and its part of the volume; the parts add up to 1. */
struct QuadraturePoint
{
  Eigen::Vector4d lambda;
  double weight;
};

/**
 * Gauss-Legendre points of a cube collapsed into the tetrahedron (Stroud 1971): n^3 points, exact for polynomials of
 * degree 2n - 3. Not the formulas of the package, which integrates products of Bernstein polynomials.
 */
inline std::vector<QuadraturePoint> tetRule(int n)
{
  // Points and weights on [0, 1] from the eigenvalues of the Jacobi matrix (Golub and Welsch 1969).
  Eigen::MatrixXd jacobi = Eigen::MatrixXd::Zero(n, n);
  for (int k = 1; k < n; ++k) jacobi(k, k - 1) = jacobi(k - 1, k) = k / std::sqrt(4.0 * k * k - 1);
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(jacobi);
  const Eigen::ArrayXd at = (eigen.eigenvalues().array() + 1) / 2;
  const Eigen::ArrayXd weight = eigen.eigenvectors().row(0).array().square();

  std::vector<QuadraturePoint> rule;
  for (int i = 0; i < n; ++i)
  {
    for (int j = 0; j < n; ++j)
    {
      for (int k = 0; k < n; ++k)
      {
        const double b = at[i], c = at[j] * (1 - b), d = at[k] * (1 - b - c);
        const double shrink = (1 - at[i]) * (1 - at[i]) * (1 - at[j]);
        rule.push_back({{1 - b - c - d, b, c, d}, 6 * shrink * weight[i] * weight[j] * weight[k]});
      }
    }
  }
  return rule;
}

/** The rules that finite-element programs are content with: one point (degree 1) or four (degree 2). */
inline std::vector<QuadraturePoint> shortTetRule(int points)
{
  if (points == 1) return {{Eigen::Vector4d::Constant(0.25), 1}};
  std::vector<QuadraturePoint> rule(4, {Eigen::Vector4d::Constant((5 - std::sqrt(5.0)) / 20), 0.25});
  for (int q = 0; q < 4; ++q) rule[q].lambda[q] = (5 + 3 * std::sqrt(5.0)) / 20;
  return rule;
}

}  // namespace bezier_fem::test
