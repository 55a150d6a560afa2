#pragma once

#include <Eigen/Dense>
#include <Eigen/Eigenvalues>
#include <map>
#include <vector>

#include "bezier_fem/bernstein.h"
#include "bezier_fem/model.h"
#include "core/quadrature.h"

namespace bezier_fem::test
{
/** Dense stiffness and mass of nodal (Lagrange) tetrahedra with 4 or 10 nodes; rows 3 node + axis. */
struct LagrangeSystem
{
  Eigen::MatrixXd K, M;
  Eigen::Matrix3Xd nodes;  // m: corners, then middles of edges
};

/**
 * The textbook element (Zienkiewicz and Taylor 2000, vol. 1, sections 6.2 and 8.11: engineering strains, B^T D B,
 * quadrature) with a numbering of its own. It spans the same functions as the package's element by another basis and
 * shares no formula with it; so eigenvalues must agree, though no entry of the matrices does.
 */
inline LagrangeSystem lagrangeSystem(const TetMesh& mesh, Element element, const Material& m)
{
  const int nodes = element == Element::QUADRATIC ? 10 : 4;
  const auto corners = static_cast<int>(mesh.corners.cols());
  std::map<std::pair<int, int>, int> middles;
  if (nodes == 10)
  {
    for (Eigen::Index t = 0; t < mesh.tets.cols(); ++t)
    {
      for (const auto& [a, b] : EDGE_CORNERS)
      {
        middles.try_emplace(std::minmax(mesh.tets(a, t), mesh.tets(b, t)), corners + static_cast<int>(middles.size()));
      }
    }
  }
  LagrangeSystem system;
  const Eigen::Index count = corners + static_cast<Eigen::Index>(middles.size());
  system.nodes.resize(3, count);
  system.nodes.leftCols(corners) = mesh.corners;
  for (const auto& [ends, node] : middles)
  {
    system.nodes.col(node) = (mesh.corners.col(ends.first) + mesh.corners.col(ends.second)) / 2;
  }

  Eigen::Matrix<double, 6, 6> D = Eigen::Matrix<double, 6, 6>::Zero();
  D.topLeftCorner<3, 3>().setConstant(m.poisson);
  D.topLeftCorner<3, 3>().diagonal().setConstant(1 - m.poisson);
  D.bottomRightCorner<3, 3>().diagonal().setConstant((1 - 2 * m.poisson) / 2);
  D *= m.young / ((1 + m.poisson) * (1 - 2 * m.poisson));

  system.K = system.M = Eigen::MatrixXd::Zero(3 * count, 3 * count);
  const std::vector<QuadraturePoint> rule = tetRule(4);  // degree 5; the mass needs 4
  for (Eigen::Index t = 0; t < mesh.tets.cols(); ++t)
  {
    // Local coordinates xi, eta, zeta are those of corners 1, 2, 3.
    Eigen::Matrix3d jacobian;
    for (int k = 0; k < 3; ++k)
    {
      jacobian.row(k) = (mesh.corners.col(mesh.tets(k + 1, t)) - mesh.corners.col(mesh.tets(0, t))).transpose();
    }
    Eigen::Matrix<double, 3, 4> local;
    local << -1, 1, 0, 0, -1, 0, 1, 0, -1, 0, 0, 1;
    const Eigen::Matrix<double, 3, 4> slopes = jacobian.inverse() * local;
    const double volume = jacobian.determinant() / 6;

    std::vector<int> index;
    for (int a = 0; a < 4; ++a) index.push_back(mesh.tets(a, t));
    for (int e = 0; nodes == 10 && e < EDGES; ++e)
    {
      index.push_back(middles.at(std::minmax(index[EDGE_CORNERS[e][0]], index[EDGE_CORNERS[e][1]])));
    }
    Eigen::MatrixXd stiffness = Eigen::MatrixXd::Zero(3 * nodes, 3 * nodes), mass = stiffness;
    for (const auto& [lambda, weight] : rule)
    {
      Eigen::VectorXd shape(nodes);
      Eigen::Matrix3Xd slope(3, nodes);
      for (int a = 0; a < 4; ++a)
      {
        shape[a] = nodes == 4 ? lambda[a] : lambda[a] * (2 * lambda[a] - 1);
        slope.col(a) = (nodes == 4 ? 1 : 4 * lambda[a] - 1) * slopes.col(a);
      }
      for (int e = 0; nodes == 10 && e < EDGES; ++e)
      {
        const auto [a, b] = EDGE_CORNERS[e];
        shape[4 + e] = 4 * lambda[a] * lambda[b];
        slope.col(4 + e) = 4 * (lambda[a] * slopes.col(b) + lambda[b] * slopes.col(a));
      }
      Eigen::MatrixXd B = Eigen::MatrixXd::Zero(6, 3 * nodes), N = Eigen::MatrixXd::Zero(3, 3 * nodes);
      for (int i = 0; i < nodes; ++i)
      {
        const double x = slope(0, i), y = slope(1, i), z = slope(2, i);
        B.middleCols<3>(3L * i) << x, 0, 0, 0, y, 0, 0, 0, z, y, x, 0, 0, z, y, z, 0, x;
        N.middleCols<3>(3L * i) = shape[i] * Eigen::Matrix3d::Identity();
      }
      stiffness += weight * volume * B.transpose() * D * B;
      mass += weight * volume * m.density * N.transpose() * N;
    }
    for (int i = 0; i < nodes; ++i)
    {
      for (int j = 0; j < nodes; ++j)
      {
        system.K.block<3, 3>(3L * index[i], 3L * index[j]) += stiffness.block<3, 3>(3L * i, 3L * j);
        system.M.block<3, 3>(3L * index[i], 3L * index[j]) += mass.block<3, 3>(3L * i, 3L * j);
      }
    }
  }
  return system;
}

/** All lambda of K u = lambda M u, increasing, 1/s^2: the squares of angular frequencies. */
inline Eigen::VectorXd squaredFrequencies(const Eigen::MatrixXd& K, const Eigen::MatrixXd& M)
{
  const auto options = Eigen::EigenvaluesOnly | Eigen::Ax_lBx;
  return Eigen::GeneralizedSelfAdjointEigenSolver<Eigen::MatrixXd>(K, M, options).eigenvalues();
}

}  // namespace bezier_fem::test
