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

/** Tetrahedra that share no node, every one with a shape of its own. */
Model separateTets(int count, std::mt19937& random)
{
  std::uniform_real_distribution<double> uniform(-0.2, 0.2);
  TetMesh mesh;
  mesh.corners = Eigen::Matrix3Xd::NullaryExpr(3, 4 * count, [&]() { return uniform(random); });
  mesh.tets.resize(4, count);
  for (int t = 0; t < count; ++t)
  {
    for (int a = 0; a < 4; ++a)
    {
      mesh.tets(a, t) = 4 * t + a;
      mesh.corner_ids.push_back(4 * t + a + 1);
      if (a > 0) mesh.corners(a - 1, 4 * t + a) += 1;
    }
  }
  mesh.largest_id = 4L * count;
  return test::boxModel(mesh, Element::LINEAR);
}

constexpr int KINDS = 10;

/** Of every kind of gradient one. */
Matrix3d randomGradient(int kind, std::mt19937& random)
{
  std::uniform_real_distribution<double> uniform;
  const auto small = [&]() { return std::pow(10.0, -14 * uniform(random)); };
  Vector3d s(0.2 + uniform(random), 0.2 + uniform(random), 0.2 + uniform(random));
  switch (kind)
  {
    case 0:  // anything
      return randomMatrix(random);
    case 1:  // little strained
      return test::randomRotation(random) * (Matrix3d::Identity() + 0.1 * randomMatrix(random));
    case 2:  // inverted
      s[2] *= -1;
      break;
    case 3:  // flat, or nearly
      s[2] = uniform(random) < 0.5 ? 0 : small();
      break;
    case 4:  // a segment, or nearly
      s[1] *= small();
      s[2] = uniform(random) < 0.5 ? 0 : s[1] * (2 * uniform(random) - 1);
      break;
    case 5:  // a cube, but for rounding; mirrored, it has no rotation of its own
      s = Vector3d(1, 1, uniform(random) < 0.5 ? 1 : -1) * s[0];
      return test::randomRotation(random) *
             (s.asDiagonal() * test::randomRotation(random) + small() * randomMatrix(random));
    case 6:  // the two shorter ones nearly meet in an inverted element
      s[0] += 1;
      s[2] = -s[1] * (1 - small());
      break;
    case 7:  // small
      return small() * randomMatrix(random);
    case 8:  // large, to where fourth powers overflow
      return std::pow(10.0, 150 * uniform(random)) * randomMatrix(random);
    default:  // nothing
      return Matrix3d::Zero();
  }
  return test::randomRotation(random) * s.asDiagonal() * test::randomRotation(random);
}

TEST(UpdateRotations, IsTheSingularValueDecompositionsForAMillionGradients)
{
  constexpr int TETS = 20000, ROUNDS = 50;
  std::mt19937 random(4);
  const Model model = separateTets(TETS, random);
  ASSERT_EQ(model.num_tets, TETS);
  const Partition partition(model, 1);
  AlignedVector<double> turned(static_cast<std::size_t>(model.num_blocks) * LANES);
  Rotations now = restRotations(model), last = now;
  NodalField x(model.num_nodes);
  int unique = 0, ties = 0, certain = 0;
  for (int round = 0; round < ROUNDS; ++round)
  {
    for (int t = 0; t < TETS; ++t)
    {
      const Matrix3d F = randomGradient((t + round) % KINDS, random);
      for (int a = 0; a < 4; ++a) x[model.nodesOf(t)[a]] = F * model.rest[model.nodesOf(t)[a]];
    }
    // From no rotation, then from those of the round before, which have nothing to do with these.
    std::swap(now, last);
    updateRotations(model, partition, x, last, now, turned);
    for (int t = 0; t < TETS; ++t)
    {
      Matrix3d edges;
      for (int k = 0; k < 3; ++k) edges.col(k) = x[model.nodesOf(t)[k + 1]] - x[model.nodesOf(t)[0]];
      const Matrix3d F = edges * model.gradients.middleCols<3>(3L * t).transpose();
      const Matrix3d R = now.matrix(t);
      ASSERT_LT((R.transpose() * R - Matrix3d::Identity()).norm(), 1e-12) << F;
      ASSERT_GT(R.determinant(), 0) << F;

      const Eigen::JacobiSVD<Matrix3d> svd(F, Eigen::ComputeFullU | Eigen::ComputeFullV);
      const Vector3d& s = svd.singularValues();
      Matrix3d U = svd.matrixU();
      const double sign = (U * svd.matrixV().transpose()).determinant() < 0 ? -1 : 1;
      U.col(2) *= sign;
      const double margin = s[1] + sign * s[2], all = s[0] + s[1], least = 1e-6 * std::max(all, 0.5);
      // Where the maximum is one only, the rotation is known to rounding over the margin; what it gives is, anyhow.
      if (margin > 1.01 * least)
      {
        ASSERT_LT((R - U * svd.matrixV().transpose()).norm(), 5e-14 * all / margin) << F;
        ++unique;
      }
      else
      {
        ++ties;
      }
      const double maximum = s[0] + margin, reached = (R.transpose() * F).trace();
      ASSERT_LE(maximum - reached, 1e-13 * all + (margin < 1.01 * least ? 2 * least : 0)) << F << "\nmargin " << margin;
      if (now.flags[t] & 1)
      {
        ++certain;
        ASSERT_GT(margin, 0.02 * all) << F;
      }
    }
  }
  EXPECT_GT(unique, 650000);
  EXPECT_GT(ties, 250000);
  EXPECT_GT(certain, 600000);
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
