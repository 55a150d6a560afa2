#include "bezier_fem/embedding.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <numeric>

#include "bezier_fem/measures.h"
#include "core/bar.h"

namespace bezier_fem
{
namespace
{
using Eigen::Matrix3d;
using Eigen::Vector3d;
using Eigen::Vector4d;

class Embedding : public testing::TestWithParam<Element>
{
protected:
  Model model = test::boxModel(test::irregularBox({3, 3, 4}, {0.4, 0.4, 1.0}), GetParam());
  PointLocator locator{model};
  NodalField bent = [this] {
    NodalField x = model.rest;
    x.matrix() += 0.02 * test::randomField(model.num_nodes, 21).matrix();
    return x;
  }();
};
INSTANTIATE_TEST_SUITE_P(Elements, Embedding, testing::Values(Element::LINEAR, Element::QUADRATIC),
                         [](const auto& p) { return std::string(test::name(p.param)); });

TEST_P(Embedding, FindsTheElementOfAnyPointAndTheNearestOfOnesOutside)
{
  const NodalField points = test::randomField(500, 22);
  int outside = 0;
  for (int k = 0; k < 500; ++k)
  {
    const Vector3d p = Vector3d(0.2, 0.2, 0.5) + 1.3 * points[k].cwiseProduct(Vector3d(0.2, 0.2, 0.5));
    double distance;
    const MaterialPoint found = locator.locate(p, &distance);
    // The box's own distance.
    const Vector3d inside = p.cwiseMax(Vector3d::Zero()).cwiseMin(Vector3d(0.4, 0.4, 1.0));
    EXPECT_NEAR(distance, (p - inside).norm(), 1e-12);
    outside += distance > 0;
    EXPECT_NEAR(found.lambda.sum(), 1, 1e-14);
    EXPECT_EQ(distance == 0, found.lambda.minCoeff() >= 0);
    EXPECT_LT((position(model, model.rest, found) - p).norm(), 1e-13);
  }
  EXPECT_GT(outside, 100);
  EXPECT_LT(outside, 400);
}

TEST_P(Embedding, BasisSumsToOneAndInterpolatesCorners)
{
  const Vector4d lambda(0.1, 0.2, 0.3, 0.4);
  const auto b = basis(model.nodes_per_tet, lambda);
  EXPECT_NEAR(std::accumulate(b.begin(), b.end(), 0.0), 1, 1e-15);
  for (int c = 0; c < CORNERS; ++c)
  {
    EXPECT_LT((position(model, bent, {5, Vector4d::Unit(c)}) - bent[model.nodesOf(5)[c]]).norm(), 1e-15);
  }
  // de Casteljau's algorithm, as Weber et al. 2011, section 7, evaluates it.
  if (!model.quadratic()) return;
  std::array<Vector3d, CORNERS> once;
  for (int a = 0; a < CORNERS; ++a)
  {
    once[a].setZero();
    for (int c = 0; c < CORNERS; ++c) once[a] += lambda[c] * bent[model.nodesOf(5)[CONTROL_POINT[a][c]]];
  }
  Vector3d twice = Vector3d::Zero();
  for (int a = 0; a < CORNERS; ++a) twice += lambda[a] * once[a];
  EXPECT_LT((position(model, bent, {5, lambda}) - twice).norm(), 1e-15);
}

TEST_P(Embedding, ForcesGoBackByTheTranspose)
{
  NodalField f(model.num_nodes);
  double work = 0;
  Vector3d total = Vector3d::Zero(), torque = Vector3d::Zero();
  const NodalField forces = test::randomField(20, 23), points = test::randomField(20, 24);
  const NodalField d = test::randomField(model.num_nodes, 25);
  for (int k = 0; k < 20; ++k)
  {
    const MaterialPoint p = locator.locate(Vector3d(0.2, 0.2, 0.5) + 0.5 * points[k]);
    addForce(model, p, forces[k], f);
    work += forces[k].dot(position(model, d, p));
    total += forces[k];
    torque += position(model, bent, p).cross(Vector3d(forces[k]));
  }
  EXPECT_NEAR(f.matrix().cwiseProduct(d.matrix()).sum(), work, 1e-11);
  Vector3d sum = Vector3d::Zero(), sum_torque = Vector3d::Zero();
  for (int i = 0; i < model.num_nodes; ++i)
  {
    sum += f[i];
    sum_torque += Vector3d(bent[i]).cross(Vector3d(f[i]));
  }
  EXPECT_LT((sum - total).norm(), 1e-12);
  EXPECT_LT((sum_torque - torque).norm(), 1e-12);
}

TEST_P(Embedding, DeformationGradientIsTheDerivativeOfPosition)
{
  const double h = 1e-6;
  for (int k = 0; k < 10; ++k)
  {
    const Vector4d lambda = Vector4d(0.15, 0.35, 0.3, 0.2);
    const MaterialPoint p{k, lambda};
    const Matrix3d F = deformationGradient(model, bent, p);
    const auto g = model.gradients.middleCols<3>(3L * k);
    for (int axis = 0; axis < 3; ++axis)
    {
      Vector4d change;
      change.tail<3>() = h * g.transpose() * Vector3d::Unit(axis);
      change[0] = -change.tail<3>().sum();
      const Vector3d slope =
          (position(model, bent, {k, lambda + change}) - position(model, bent, {k, lambda - change})) / (2 * h);
      EXPECT_LT((slope - F.col(axis)).norm(), 1e-8);
    }
  }
}

TEST_P(Embedding, NormalsAreThoseOfTheDeformedSurface)
{
  // Tangents carried by F are orthogonal to the carried normal.
  std::vector<MaterialPoint> points;
  Eigen::Matrix3Xd normals(3, 50), positions, carried;
  const NodalField random = test::randomField(50, 26);
  for (int k = 0; k < 50; ++k)
  {
    points.push_back({k, Vector4d(0.1, 0.2, 0.3, 0.4)});
    normals.col(k) = random[k].normalized();
  }
  for (const int threads : {1, 3})
  {
    const Partition partition(model, threads);
    evaluate(model, partition, bent, points, normals, positions, &carried);
    for (int k = 0; k < 50; ++k)
    {
      const Matrix3d F = deformationGradient(model, bent, points[k]);
      const Vector3d n = normals.col(k), t = n.unitOrthogonal(), s = n.cross(t);
      EXPECT_NEAR(carried.col(k).norm(), 1, 1e-12);
      EXPECT_NEAR(carried.col(k).dot((F * t).normalized()), 0, 1e-12);
      EXPECT_NEAR(carried.col(k).dot((F * s).normalized()), 0, 1e-12);
      EXPECT_GT(carried.col(k).dot(F * n) * F.determinant(), 0);
      EXPECT_LT((positions.col(k) - position(model, bent, points[k])).norm(), 1e-15);
    }
  }
}

TEST_P(Embedding, VolumeIsTheIntegralOfTheDeterminant)
{
  NodalField x = model.rest;
  EXPECT_NEAR(currentVolume(model, x), 0.16, 1e-14);
  Matrix3d A;
  A << 1.1, 0.2, 0, -0.1, 0.9, 0.3, 0, 0.1, 1.3;
  x.matrix().topRows<3>() = A * model.rest.matrix().topRows<3>();
  EXPECT_NEAR(currentVolume(model, x), 0.16 * A.determinant(), 1e-14);
  EXPECT_EQ(invertedElements(model, x), 0);
  x.matrix().row(0) *= -1;
  EXPECT_EQ(invertedElements(model, x), model.num_tets);
  // Moving points inside changes nothing.
  x = model.rest;
  const NodalField noise = test::randomField(model.num_nodes, 27);
  for (int i = 0; i < model.num_nodes; ++i)
  {
    const Vector3d X = model.rest[i];
    if (X.minCoeff() > 1e-9 && X.x() < 0.4 - 1e-9 && X.y() < 0.4 - 1e-9 && X.z() < 1 - 1e-9) x[i] += 0.02 * noise[i];
  }
  EXPECT_NEAR(currentVolume(model, x), 0.16, 1e-14);
}

TEST(VonMises, ClosedForms)
{
  EXPECT_NEAR(vonMises((Stress() << 3, 3, 3, 0, 0, 0).finished()), 0, 1e-15);
  EXPECT_NEAR(vonMises((Stress() << 5, 0, 0, 0, 0, 0).finished()), 5, 1e-15);
  EXPECT_NEAR(vonMises((Stress() << 0, 0, 0, 2, 0, 0).finished()), 2 * std::sqrt(3.0), 1e-15);
  EXPECT_NEAR(vonMises((Stress() << 0, 0, 0, 0, 1, 1).finished()), std::sqrt(6.0), 1e-15);
}

}  // namespace
}  // namespace bezier_fem
