#include "bezier_fem/rotation.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <random>

#include "bezier_fem/partition.h"
#include "core/bar.h"

namespace bezier_fem
{
namespace
{
using Eigen::Matrix3d;
using Eigen::Vector3d;

/** U diag(1, 1, det(U W^T)) W^T from a singular value decomposition: the definition. */
Matrix3d reference(const Matrix3d& F)
{
  const Eigen::JacobiSVD<Matrix3d> svd(F, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Matrix3d U = svd.matrixU();
  if ((U * svd.matrixV().transpose()).determinant() < 0) U.col(2) *= -1;
  return U * svd.matrixV().transpose();
}

Matrix3d randomMatrix(std::mt19937& random)
{
  std::normal_distribution<double> normal;
  return Matrix3d::NullaryExpr([&]() { return normal(random); });
}

bool isRotation(const Matrix3d& R)
{
  return (R.transpose() * R - Matrix3d::Identity()).norm() < 1e-12 && R.determinant() > 0;
}

TEST(PolarRotation, IsTheSingularValueDecompositionsForAnyMatrix)
{
  std::mt19937 random(1);
  for (int k = 0; k < 20000; ++k)
  {
    const Matrix3d F = randomMatrix(random) * std::pow(10.0, static_cast<double>(k % 10) - 3);
    double margin;
    const Matrix3d R = polarRotation(F, Matrix3d::Identity(), &margin);
    ASSERT_TRUE(isRotation(R));
    if (margin * F.norm() < 1e-5) continue;  // not unique
    ASSERT_LT((R - reference(F)).norm(), 1e-13 / margin) << F << "\nmargin " << margin;
  }
}

TEST(PolarRotation, KeepsTheLastOneWhereItIsNotUnique)
{
  std::mt19937 random(2);
  for (int k = 0; k < 200; ++k)
  {
    const Matrix3d before = test::randomRotation(random), other = test::randomRotation(random);
    // Nothing, a segment along an axis, and mirror images with two equal short sides.
    EXPECT_EQ(polarRotation(Matrix3d::Zero(), before), before);
    EXPECT_LT((polarRotation(1e-12 * randomMatrix(random), before) - before).norm(), 1e-6);
    const Vector3d axis = other.col(0);
    EXPECT_LT((polarRotation(before * axis * axis.transpose(), before) - before).norm(), 1e-6);
    const Matrix3d mirrored = before * (Matrix3d::Identity() - 2 * axis * axis.transpose());
    const Matrix3d R = polarRotation(mirrored, before);
    EXPECT_LT((R - before).norm(), 1e-6);
    // However the tie breaks.
    const Matrix3d perturbed = mirrored + 1e-12 * randomMatrix(random);
    EXPECT_LT((polarRotation(perturbed, before) - before).norm(), 1e-6);
  }
}

TEST(UpdateRotations, FindsTheMaximumFromAnyStart)
{
  const Model model = test::boxModel(test::irregularBox({3, 3, 4}, {1, 1, 1}), Element::LINEAR);
  const Partition partition(model, 1);
  std::mt19937 random(3);
  AlignedVector<double> turned(static_cast<std::size_t>(model.num_blocks) * LANES);
  const Rotations rest = restRotations(model);
  Rotations now = rest, last = rest;
  int checked = 0;
  for (int round = 0; round < 50; ++round)
  {
    // Nodes thrown about: every kind of gradient, half of them inverted; started from the round before.
    const NodalField x = test::randomField(model.num_nodes, 100 + round);
    std::swap(now, last);
    updateRotations(model, partition, x, last, now, turned);
    for (int t = 0; t < model.num_tets; ++t)
    {
      Matrix3d edges;
      for (int k = 0; k < 3; ++k) edges.col(k) = x[model.nodesOf(t)[k + 1]] - x[model.nodesOf(t)[0]];
      const Matrix3d F = edges * model.gradients.middleCols<3>(3L * t).transpose();
      const Matrix3d R = now.matrix(t);
      ASSERT_TRUE(isRotation(R));
      double margin;
      polarRotation(F, R, &margin);
      if (margin < 1e-5) continue;
      ASSERT_LT((R - reference(F)).norm(), 1e-12 / margin) << "element " << t << " round " << round;
      ASSERT_NEAR(turned[t], (R - last.matrix(t)).squaredNorm(), 1e-12);
      for (int a = 0; a < 3; ++a)
      {
        ASSERT_LT((now.gradient(t).col(a + 1) - R * model.gradients.col(3L * t + a)).norm(), 1e-10);
      }
      ++checked;
    }
  }
  EXPECT_GT(checked, 10000);
}

TEST(UpdateRotations, TellsTheAngleOfATurnedBody)
{
  const Model model = test::boxModel(test::kuhnBox({2, 2, 2}, {1, 1, 1}), Element::QUADRATIC);
  const Partition partition(model, 1);
  AlignedVector<double> turned(static_cast<std::size_t>(model.num_blocks) * LANES);
  for (const double angle : {0.0, 1e-6, 0.1, 0.2, 1.0, 2.0, 3.0, 3.14})
  {
    const Matrix3d R = Eigen::AngleAxisd(angle, Vector3d(1, 2, -1).normalized()).toRotationMatrix();
    NodalField x = model.rest;
    x.matrix().topRows<3>() = R * model.rest.matrix().topRows<3>();
    Rotations after = restRotations(model);
    EXPECT_NEAR(updateRotations(model, partition, x, restRotations(model), after, turned).angle, angle, 1e-9);
    EXPECT_LT((after.matrix(3) - R).norm(), 1e-13);
  }
}

}  // namespace
}  // namespace bezier_fem
