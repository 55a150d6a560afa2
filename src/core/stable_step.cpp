#include "bezier_fem/stable_step.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cassert>
#include <cmath>

#include "parallel.h"

namespace bezier_fem
{
namespace
{
using Eigen::Matrix3d;
using Eigen::MatrixXd;
using Eigen::VectorXd;

/** Inverse of the matrix of the integrals of B_I B_J over an element of volume one. */
MatrixXd inverseMass(bool quadratic)
{
  if (!quadratic)
  {
    const MatrixXd mass = (MatrixXd::Ones(CORNERS, CORNERS) + MatrixXd::Identity(CORNERS, CORNERS)) / 20;
    return mass.inverse();
  }
  MatrixXd mass(QUADRATIC_NODES, QUADRATIC_NODES);
  for (int J = 0; J < QUADRATIC_NODES; ++J)
  {
    // (M u)_ab = (S + t_a + t_b + u_ab)/210, t_a = 2 u_aa + sum_{b != a} u_ab, S = sum_a t_a / 2
    const Eigen::VectorXd u = Eigen::VectorXd::Unit(QUADRATIC_NODES, J);
    Eigen::Vector4d t;
    for (int a = 0; a < CORNERS; ++a)
    {
      t[a] = u[a];
      for (int b = 0; b < CORNERS; ++b) t[a] += u[CONTROL_POINT[a][b]];
    }
    for (int a = 0; a < CORNERS; ++a)
    {
      for (int b = a; b < CORNERS; ++b)
      {
        const int I = CONTROL_POINT[a][b];
        mass(I, J) = (t.sum() / 2 + t[a] + t[b] + u[I]) / 210;
      }
    }
  }
  return mass.inverse();
}

/**
 * Y = W^1/2 B M^-1 B^T W^1/2 of an element of density one: B takes a scalar field to its gradients at the corners
 * (linear elements: to the one that it has), W weighs these so that |W^1/2 B u|^2 is the integral of |grad u|^2.
 * 3 rows and columns a corner.
 */
MatrixXd gradientGram(const Eigen::Matrix<double, 3, CORNERS>& g, const MatrixXd& inverse_mass)
{
  if (inverse_mass.rows() == CORNERS) return g * inverse_mass * g.transpose();
  MatrixXd gram(3 * CORNERS, 3 * CORNERS);
  for (int c = 0; c < CORNERS; ++c)
  {
    for (int d = 0; d < CORNERS; ++d)
    {
      Eigen::Matrix4d m;
      for (int a = 0; a < CORNERS; ++a)
      {
        for (int b = 0; b < CORNERS; ++b) m(a, b) = 4 * inverse_mass(CONTROL_POINT[c][a], CONTROL_POINT[d][b]);
      }
      gram.block<3, 3>(3L * c, 3L * d) = g * m * g.transpose();
    }
  }
  // The integral of lambda_c lambda_d is (1 + delta_cd)/20; the root of 1 1^T + identity is identity + w 1 1^T.
  const double w = (std::sqrt(5.0) - 1) / 4;
  Eigen::Matrix<double, 3 * CORNERS, 3 * CORNERS> root = Eigen::Matrix<double, 3 * CORNERS, 3 * CORNERS>::Identity();
  for (int c = 0; c < CORNERS; ++c)
  {
    for (int d = 0; d < CORNERS; ++d) root.block<3, 3>(3L * c, 3L * d) += w * Matrix3d::Identity();
  }
  return root * gram * root / 20;
}

/**
 * Largest eigenvalue of C^1/2 sym Y sym^T C^1/2, which has the eigenvalues of M^-1 K beside zeros.
 * @param mean_lambda  part of lambda that acts on the mean dilatation
 */
double largestStiffness(const MatrixXd& gram, const Material& material, double mean_lambda)
{
  constexpr int COMPONENTS[6][2] = {{0, 0}, {1, 1}, {2, 2}, {0, 1}, {1, 2}, {0, 2}};
  const double two_mu = 2 * lameMu(material), bulk = 3 * (lameLambda(material) - mean_lambda) + two_mu;
  // C^1/2 on strains whose shears have the factor sqrt(2): dilations by the root of the bulk's eigenvalue.
  Eigen::Matrix<double, 6, 6> root = std::sqrt(two_mu) * Eigen::Matrix<double, 6, 6>::Identity();
  root.topLeftCorner<3, 3>().array() += (std::sqrt(bulk) - std::sqrt(two_mu)) / 3;
  const Eigen::Index corners = gram.rows() / 3;
  MatrixXd dual(6 * corners, 6 * corners);
  for (Eigen::Index c = 0; c < corners; ++c)
  {
    for (Eigen::Index d = 0; d < corners; ++d)
    {
      const Matrix3d y = gram.block<3, 3>(3 * c, 3 * d);
      Eigen::Matrix<double, 6, 6> block;
      for (int i = 0; i < 6; ++i)
      {
        const auto [p, q] = COMPONENTS[i];
        for (int j = 0; j < 6; ++j)
        {
          const auto [r, s] = COMPONENTS[j];
          const double sum =
              (p == r ? y(q, s) : 0) + (p == s ? y(q, r) : 0) + (q == r ? y(p, s) : 0) + (q == s ? y(p, r) : 0);
          block(i, j) = sum / 4 * (i < 3 ? 1 : M_SQRT2) * (j < 3 ? 1 : M_SQRT2);
        }
      }
      dual.block<6, 6>(6 * c, 6 * d) = root * block * root;
    }
  }
  if (mean_lambda > 0)
  {
    // A uniform dilation is an eigenvector of C, with this part of lambda in its eigenvalue too; it is the same in all
    // corners after W^1/2 as well.
    VectorXd uniform = VectorXd::Zero(6 * corners);
    for (Eigen::Index c = 0; c < corners; ++c) uniform.segment<3>(6 * c).setConstant(1 / std::sqrt(3.0 * corners));
    const double stretch = std::sqrt((bulk + 3 * mean_lambda) / bulk) - 1;
    dual += stretch * (uniform * (uniform.transpose() * dual)).eval();
    dual += stretch * ((dual * uniform) * uniform.transpose()).eval();
  }
  return Eigen::SelfAdjointEigenSolver<MatrixXd>(dual, Eigen::EigenvaluesOnly).eigenvalues().maxCoeff();
}

double largestEigenvalue(const Matrix3d& symmetric)
{
  return Eigen::SelfAdjointEigenSolver<Matrix3d>().computeDirect(symmetric, Eigen::EigenvaluesOnly).eigenvalues()[2];
}
}  // namespace

SpectralBound::SpectralBound(const Model& model, const Partition& partition)
    : stiffness_(model.num_tets), gradient_(model.num_tets)
{
  const MatrixXd inverse_mass = inverseMass(model.quadratic());
  forEachPiece(partition, [&](int thread) {
    const int end = std::min(partition.blockEnd(thread) * LANES, model.num_tets);
    for (int t = partition.blockBegin(thread) * LANES; t < end; ++t)
    {
      Eigen::Matrix<double, 3, CORNERS> g;
      g.rightCols<3>() = model.gradients.middleCols<3>(3L * t);
      g.col(0) = -g.rightCols<3>().rowwise().sum();
      const MatrixXd gram = gradientGram(g, inverse_mass) / model.materials[t].density;
      stiffness_[t] = largestStiffness(gram, model.materials[t], meanLambda(model, t));
      gradient_[t] = Eigen::SelfAdjointEigenSolver<MatrixXd>(gram, Eigen::EigenvaluesOnly).eigenvalues().maxCoeff();
    }
  });
}

double SpectralBound::corotated() const
{
  return *std::max_element(stiffness_.begin(), stiffness_.end());
}

double SpectralBound::green(const Model& model, const Partition& partition, const NodalField& x) const
{
  assert(model.block_mean.empty());
  // u^T K_T u is the integral of dE : C : dE, dE = sym(F^T grad u), and of tr(grad u S grad u^T). With F = A + D, A the
  // mean of F at the corners, the norm of the first is at most that of sym(A^T grad u), the strain of A^T u at rest,
  // and of sym(D^T grad u); and it is at most the largest stretch times that of the stiffest strain. F is linear and
  // F^T F convex in between the corners: their largest values are there.
  std::vector<double> largest(partition.pieces(), 0.0);
  forEachPiece(partition, [&](int thread) {
    const int end = std::min(partition.blockEnd(thread) * LANES, model.num_tets);
    const int corners = model.quadratic() ? CORNERS : 1;
    for (int t = partition.blockBegin(thread) * LANES; t < end; ++t)
    {
      const int* nodes = model.nodesOf(t);
      const double lambda = lameLambda(model.materials[t]), two_mu = 2 * lameMu(model.materials[t]);
      std::array<Matrix3d, CORNERS> F;
      Matrix3d mean = Matrix3d::Zero();
      double stress = 0, deviation = 0, stretch = 0;
      for (int c = 0; c < corners; ++c)
      {
        Matrix3d edges;
        for (int d = 1; d < CORNERS; ++d)
        {
          edges.col(d - 1) = model.quadratic() ? 2 * (x[nodes[CONTROL_POINT[c][d]]] - x[nodes[CONTROL_POINT[c][0]]])
                                               : Eigen::Vector3d(x[nodes[d]] - x[nodes[0]]);
        }
        F[c] = edges * model.gradients.middleCols<3>(3L * t).transpose();
        mean += F[c] / corners;
      }
      for (int c = 0; c < corners; ++c) deviation = std::max(deviation, (F[c] - mean).norm());
      for (int c = 0; c < corners; ++c)
      {
        const double largest_metric = largestEigenvalue(F[c].transpose() * F[c]);
        // A negative lambda makes the smallest tr(F^T F) count instead.
        const double least = std::max(0.0, mean.norm() - deviation);
        const double trace = lambda > 0 ? F[c].squaredNorm() : least * least;
        stress = std::max(stress, lambda * (trace - 3) / 2 + two_mu * (largest_metric - 1) / 2);
        stretch = std::max(stretch, largest_metric);
      }
      const double stiffest = two_mu + std::max(0.0, 3 * lambda);
      const double mean_stretch = std::sqrt(largestEigenvalue(mean.transpose() * mean));
      const double root = mean_stretch * std::sqrt(stiffness_[t]) + deviation * std::sqrt(stiffest * gradient_[t]);
      const double material = std::min(root * root, stretch * stiffest * gradient_[t]);
      largest[thread] = std::max(largest[thread], material + stress * gradient_[t]);
    }
  });
  return *std::max_element(largest.begin(), largest.end());
}

double stableStep(double largest_eigenvalue, const Scene::Damping& damping)
{
  // Eigenvalues of a mode's step stay in the unit circle while dt^2 w^2 + 2 dt (a + b w^2) < 4; the largest w decides.
  const double rate = damping.mass + damping.stiffness * largest_eigenvalue;
  return 4 / (rate + std::sqrt(rate * rate + 4 * largest_eigenvalue));
}

}  // namespace bezier_fem
