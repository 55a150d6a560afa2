#include "bezier_fem/wrench.h"

#include <gtest/gtest.h>

#include <random>
#include <tuple>

#include "bar.h"

namespace bezier_fem::test
{
namespace
{
using Eigen::Matrix3Xd;
using Eigen::Matrix3Xi;
using Eigen::Vector3d;

/** The boundary of a box, over the corners of its elements, in a deformed state. */
struct Body
{
  Model model;
  NodalField x;
  std::vector<MaterialPoint> points;
  Matrix3Xi triangles;

  Body(const Eigen::Vector3i& cells, const Vector3d& size, Element element = Element::QUADRATIC)
      : model(boxModel(irregularBox(cells, size), element)), x(model.rest)
  {
    std::mt19937 random(3);
    const Eigen::Matrix3d turn = randomRotation(random);
    const NodalField noise = randomField(model.num_nodes, 5);
    for (int i = 0; i < model.num_nodes; ++i) x[i] = turn * model.rest[i] + 0.02 * noise[i] + Vector3d(3, -2, 1);

    std::map<int, int> index;
    triangles.resize(3, static_cast<Eigen::Index>(model.boundary.size()));
    for (Eigen::Index t = 0; t < triangles.cols(); ++t)
    {
      const Model::Face& face = model.boundary[t];
      for (int k = 0; k < 3; ++k)
      {
        const int corner = FACE_CORNERS[face.opposite][k];
        const auto [entry, is_new] = index.emplace(model.nodesOf(face)[k], static_cast<int>(points.size()));
        if (is_new) points.push_back({face.tet, Eigen::Vector4d::Unit(corner)});
        triangles(k, t) = entry->second;
      }
    }
  }

  Matrix3Xd positions() const
  {
    Matrix3Xd result(3, points.size());
    for (std::size_t i = 0; i < points.size(); ++i) result.col(i) = position(model, x, points[i]);
    return result;
  }

  SurfaceTree tree() const { return SurfaceTree(triangles, positions()); }
};

/** Of forces on control points, about the world's origin. */
Wrench resultant(const NodalField& x, const NodalField& f)
{
  Wrench sum;
  for (int i = 0; i < f.size(); ++i)
  {
    sum.force += f[i];
    sum.torque += Vector3d(x[i]).cross(Vector3d(f[i]));
  }
  return sum;
}

const Wrench GIVEN{{3, -5, 7}, {0.4, 0.9, -0.6}};

TEST(SurfaceTree, FindsWhatASearchOfAllTrianglesFinds)
{
  const Body body({3, 4, 5}, {0.4, 0.5, 1});
  const SurfaceTree tree = body.tree();
  const Matrix3Xd p = body.positions();
  const NodalField where = randomField(300, 11);
  for (int i = 0; i < where.size(); ++i)
  {
    const Vector3d point = p.rowwise().mean() + Vector3d(where[i]);
    const SurfaceTree::Nearest found = tree.nearest(point);
    ASSERT_GE(found.barycentric.minCoeff(), 0);
    ASSERT_NEAR(found.barycentric.sum(), 1, 1e-14);
    Vector3d spot = Vector3d::Zero();
    for (int k = 0; k < 3; ++k) spot += found.barycentric[k] * p.col(body.triangles(k, found.triangle));
    ASSERT_NEAR((point - spot).norm(), found.distance, 1e-14);
    // No point of a dense sampling of every triangle is nearer
    for (Eigen::Index t = 0; t < body.triangles.cols(); ++t)
      for (double a = 0; a <= 1; a += 0.125)
        for (double b = 0; a + b <= 1; b += 0.125)
          ASSERT_GE((a * p.col(body.triangles(0, t)) + b * p.col(body.triangles(1, t)) +
                     (1 - a - b) * p.col(body.triangles(2, t)) - point)
                        .norm(),
                    found.distance - 1e-12);
    // and the way to a nearest point inside a triangle is along its normal
    if (found.barycentric.minCoeff() < 1e-9) continue;
    for (int k = 1; k < 3; ++k)
    {
      const Vector3d edge = p.col(body.triangles(k, found.triangle)) - p.col(body.triangles(0, found.triangle));
      ASSERT_NEAR((point - spot).dot(edge), 0, 1e-12);
    }
  }
}

TEST(SurfaceTree, FollowsTheSurface)
{
  Body body({2, 2, 2}, {1, 1, 1});
  SurfaceTree tree = body.tree();
  const Vector3d away(50, 0, 0);
  for (int i = 0; i < body.x.size(); ++i) body.x[i] += away;
  const Vector3d point = body.positions().col(3);
  EXPECT_GT(tree.nearest(point).distance, 40);
  tree.refit(body.positions());
  EXPECT_LT(tree.nearest(point).distance, 1e-12);
}

TEST(SurfaceTree, CopesWithTrianglesWithoutArea)
{
  Matrix3Xd points(3, 4);
  points << 0, 1, 2, 5, 0, 0, 0, 5, 0, 0, 0, 5;
  Matrix3Xi triangles(3, 3);
  triangles << 0, 0, 3, 1, 0, 3, 2, 1, 3;  // on a line, with an edge of no length, a point
  const SurfaceTree tree(triangles, points);
  EXPECT_DOUBLE_EQ(tree.nearest({0.5, 2, 0}).distance, 2);
  EXPECT_DOUBLE_EQ(tree.nearest({3, 0, 0}).distance, 1);
  EXPECT_DOUBLE_EQ(tree.nearest({5, 5, 8}).distance, 3);
}

class Patch : public testing::TestWithParam<std::tuple<Element, double>>
{
};

TEST_P(Patch, TakesUpTheWholeWrench)
{
  const auto [element, radius] = GetParam();
  const Body body({2, 2, 4}, {0.4, 0.4, 1}, element);
  const SurfaceTree tree = body.tree();
  const NodalField where = randomField(20, 17);
  for (int i = 0; i < where.size(); ++i)
  {
    const Vector3d middle = body.positions().rowwise().mean();
    const Vector3d point = middle + 0.5 * Vector3d(where[i]);
    const SurfacePatch patch = patchAround(tree, body.points, tree.nearest(point), radius);

    double sum = 0;
    for (const SurfacePatch::Sample& sample : patch.samples)
    {
      ASSERT_GT(sample.weight, 0);
      sum += sample.weight;
    }
    ASSERT_NEAR(sum, 1, 1e-12);

    const Vector3d centre = patchCentre(body.model, body.x, patch);
    NodalField f(body.model.num_nodes);
    addWrench(body.model, body.x, patch, GIVEN.about(point - centre), f);
    const Wrench total = resultant(body.x, f);
    const Wrench expected = GIVEN.about(point);
    // The forces of a couple are as large as 1/radius, and so is what their sum loses to rounding
    const double tolerance = 2e-13 * (1 + 1 / radius);
    EXPECT_LT((total.force - expected.force).norm(), tolerance) << "radius " << radius;
    EXPECT_LT((total.torque - expected.torque).norm(), tolerance) << "radius " << radius;
  }
}

// From within one triangle to more than the whole surface
INSTANTIATE_TEST_SUITE_P(Sizes, Patch,
                         testing::Combine(testing::Values(Element::LINEAR, Element::QUADRATIC),
                                          testing::Values(1e-6, 1e-3, 0.02, 0.1, 0.5, 100.0)));

TEST(WrenchTest, StaysInsideOneTriangleWhereThePatchIsSmall)
{
  const Body body({1, 1, 1}, {1, 1, 1});
  const SurfaceTree tree = body.tree();
  const Matrix3Xd p = body.positions();
  const Vector3d middle = (p.col(body.triangles(0, 0)) + p.col(body.triangles(1, 0)) + p.col(body.triangles(2, 0))) / 3;
  const SurfacePatch patch = patchAround(tree, body.points, tree.nearest(middle), 1e-3);
  EXPECT_EQ(patch.points.size(), 3u);
  EXPECT_GE(patch.samples.size(), 10u);
  EXPECT_LT((patchCentre(body.model, body.x, patch) - middle).norm(), 1e-4);
}

TEST(WrenchTest, KeepsItsResultantsWhileTheBodyDeforms)
{
  Body body({2, 2, 4}, {0.4, 0.4, 1});
  const SurfaceTree tree = body.tree();
  const SurfacePatch patch = patchAround(tree, body.points, tree.nearest(body.positions().col(0)), 0.2);
  const NodalField noise = randomField(body.model.num_nodes, 23);
  for (int i = 0; i < body.x.size(); ++i) body.x[i] += 0.1 * noise[i];
  NodalField f(body.model.num_nodes);
  addWrench(body.model, body.x, patch, GIVEN, f);
  const Wrench total = resultant(body.x, f);
  const Wrench expected = GIVEN.about(patchCentre(body.model, body.x, patch));
  EXPECT_LT((total.force - expected.force).norm(), 1e-12);
  EXPECT_LT((total.torque - expected.torque).norm(), 1e-12);
}

TEST(WrenchTest, IsLinear)
{
  const Body body({2, 2, 4}, {0.4, 0.4, 1});
  const SurfaceTree tree = body.tree();
  const SurfacePatch patch = patchAround(tree, body.points, tree.nearest(body.positions().col(5)), 0.15);
  NodalField whole(body.model.num_nodes), parts(body.model.num_nodes);
  addWrench(body.model, body.x, patch, {2 * GIVEN.force, 3 * GIVEN.torque}, whole);
  for (int i = 0; i < 2; ++i) addWrench(body.model, body.x, patch, {GIVEN.force, Vector3d::Zero()}, parts);
  for (int i = 0; i < 3; ++i) addWrench(body.model, body.x, patch, {Vector3d::Zero(), GIVEN.torque}, parts);
  EXPECT_LT((whole.matrix() - parts.matrix()).cwiseAbs().maxCoeff(), 1e-12);
}

/** No jump when the spot wanders: the forces of two spots 1 um apart differ by about 1e-6 of their size. */
TEST(WrenchTest, ChangesSmoothlyWithTheSpot)
{
  const Body body({3, 3, 6}, {0.4, 0.4, 1});
  const SurfaceTree tree = body.tree();
  const Matrix3Xd p = body.positions();
  const auto forces = [&](const Vector3d& point) {
    NodalField f(body.model.num_nodes);
    addWrench(body.model, body.x, patchAround(tree, body.points, tree.nearest(point), 0.12), GIVEN, f);
    return f;
  };
  const Vector3d from = p.col(body.triangles(0, 40)), to = p.col(body.triangles(1, 40));
  for (double t = 0; t < 1; t += 0.05)
  {
    const Vector3d point = from + t * (to - from);
    const NodalField a = forces(point), b = forces(point + 1e-6 * (to - from).normalized());
    EXPECT_LT((a.matrix() - b.matrix()).norm(), 1e-4 * a.matrix().norm()) << t;
  }
}

TEST(WrenchTest, APointTakesUpItsForceAndNoTorque)
{
  const Body body({1, 1, 2}, {0.4, 0.4, 1});
  const SurfaceTree tree = body.tree();
  const SurfaceTree::Nearest spot = tree.nearest(body.positions().rowwise().mean() + Vector3d(0.3, 0, 0));
  const SurfacePatch patch = pointPatch(tree, body.points, spot);
  NodalField f(body.model.num_nodes);
  addWrench(body.model, body.x, patch, GIVEN, f);
  const Wrench total = resultant(body.x, f);
  EXPECT_LT((total.force - GIVEN.force).norm(), 1e-13);
  EXPECT_LT((total.torque - patchCentre(body.model, body.x, patch).cross(GIVEN.force)).norm(), 1e-12);
}

}  // namespace
}  // namespace bezier_fem::test
