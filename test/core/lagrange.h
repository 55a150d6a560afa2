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
/** Nodal (Lagrange) tetrahedra with 4 or 10 nodes, in a numbering of their own. */
struct LagrangeMesh
{
  Eigen::Matrix3Xd nodes;    // m: corners, then middles of edges
  Eigen::MatrixXi elements;  // 4 or 10 x tets: corners, then edges in the order of EDGE_CORNERS
};

inline LagrangeMesh lagrangeMesh(const TetMesh& mesh, Element element)
{
  const auto corners = static_cast<int>(mesh.corners.cols());
  LagrangeMesh result{mesh.corners, mesh.tets};
  if (element == Element::LINEAR) return result;
  result.elements.conservativeResize(10, Eigen::NoChange);
  std::map<std::pair<int, int>, int> middles;
  for (Eigen::Index t = 0; t < mesh.tets.cols(); ++t)
  {
    for (int e = 0; e < EDGES; ++e)
    {
      const auto ends = std::minmax(mesh.tets(EDGE_CORNERS[e][0], t), mesh.tets(EDGE_CORNERS[e][1], t));
      result.elements(4 + e, t) = middles.try_emplace(ends, corners + static_cast<int>(middles.size())).first->second;
    }
  }
  result.nodes.conservativeResize(Eigen::NoChange, corners + static_cast<Eigen::Index>(middles.size()));
  for (const auto& [ends, node] : middles)
  {
    result.nodes.col(node) = (mesh.corners.col(ends.first) + mesh.corners.col(ends.second)) / 2;
  }
  return result;
}

/** Their dense stiffness and mass; rows 3 node + axis. */
struct LagrangeSystem
{
  Eigen::MatrixXd K, M;
};

/**
 * The textbook element (Zienkiewicz and Taylor 2000, vol. 1: engineering strains, B^T D B, quadrature). It spans the
 * same functions as the package's element by another basis and shares no formula with it; so eigenvalues must agree,
 * though no entry of the matrices does.
 * @param mass_rule  exact from degree 4 on
 */
inline LagrangeSystem lagrangeSystem(const LagrangeMesh& mesh, const Material& m,
                                     const std::vector<QuadraturePoint>& mass_rule = tetRule(4))
{
  const auto nodes = static_cast<int>(mesh.elements.rows());
  Eigen::Matrix<double, 6, 6> D = Eigen::Matrix<double, 6, 6>::Zero();
  D.topLeftCorner<3, 3>().setConstant(m.poisson);
  D.topLeftCorner<3, 3>().diagonal().setConstant(1 - m.poisson);
  D.bottomRightCorner<3, 3>().diagonal().setConstant((1 - 2 * m.poisson) / 2);
  D *= m.young / ((1 + m.poisson) * (1 - 2 * m.poisson));

  LagrangeSystem system;
  system.K = system.M = Eigen::MatrixXd::Zero(3 * mesh.nodes.cols(), 3 * mesh.nodes.cols());
  const std::vector<QuadraturePoint> stiffness_rule = tetRule(3);
  for (Eigen::Index t = 0; t < mesh.elements.cols(); ++t)
  {
    const Eigen::VectorXi index = mesh.elements.col(t);
    // Local coordinates xi, eta, zeta are those of corners 1, 2, 3.
    Eigen::Matrix3d jacobian;
    for (int k = 0; k < 3; ++k)
    {
      jacobian.row(k) = (mesh.nodes.col(index[k + 1]) - mesh.nodes.col(index[0])).transpose();
    }
    Eigen::Matrix<double, 3, 4> local;
    local << -1, 1, 0, 0, -1, 0, 1, 0, -1, 0, 0, 1;
    const Eigen::Matrix<double, 3, 4> slopes = jacobian.inverse() * local;
    const double volume = jacobian.determinant() / 6;

    Eigen::MatrixXd stiffness = Eigen::MatrixXd::Zero(3 * nodes, 3 * nodes), mass = stiffness;
    for (const auto& [lambda, weight] : stiffness_rule)
    {
      Eigen::MatrixXd B = Eigen::MatrixXd::Zero(6, 3 * nodes);
      for (int i = 0; i < nodes; ++i)
      {
        Eigen::Vector3d slope;
        if (i >= 4)
        {
          const auto [a, b] = EDGE_CORNERS[i - 4];
          slope = 4 * (lambda[a] * slopes.col(b) + lambda[b] * slopes.col(a));
        }
        else
        {
          slope = (nodes == 4 ? 1 : 4 * lambda[i] - 1) * slopes.col(i);
        }
        const double x = slope.x(), y = slope.y(), z = slope.z();
        B.middleCols<3>(3L * i) << x, 0, 0, 0, y, 0, 0, 0, z, y, x, 0, 0, z, y, z, 0, x;
      }
      stiffness += weight * volume * B.transpose() * D * B;
    }
    for (const auto& [lambda, weight] : mass_rule)
    {
      Eigen::MatrixXd N(3, 3 * nodes);
      for (int i = 0; i < nodes; ++i)
      {
        double shape;
        if (i >= 4)
        {
          shape = 4 * lambda[EDGE_CORNERS[i - 4][0]] * lambda[EDGE_CORNERS[i - 4][1]];
        }
        else
        {
          shape = nodes == 4 ? lambda[i] : lambda[i] * (2 * lambda[i] - 1);
        }
        N.middleCols<3>(3L * i) = shape * Eigen::Matrix3d::Identity();
      }
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
