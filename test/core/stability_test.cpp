// What the default settings must survive, beside robustness_test: a short row of the atlas that scripts/stability
// draws.

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <map>

#include "bezier_fem/measures.h"
#include "bezier_fem/step.h"
#include "core/bar.h"

namespace bezier_fem
{
namespace
{
using Eigen::Vector3d;

const Vector3d SIZE(0.4, 0.4, 1.0);
const Vector3d WEIGHT(0, -9.81, 0);

StepSettings defaults()
{
  const Scene scene{};
  return {scene.time_step, scene.elasticity, scene.rotation, scene.damping, Vector3d::Zero(), scene.solver};
}

TetMesh barMesh()
{
  return test::kuhnBox({2, 2, 5}, SIZE);
}

Model defaultModel(const TetMesh& mesh, const Material& material = test::RUBBER)
{
  return test::boxModel(mesh, Element::QUADRATIC, material, Scene().dilatation);
}

/** A body that is stepped. */
struct Motion
{
  const Model& model;
  StepSettings settings;
  Supports supports;
  std::vector<AppliedLoad> loads;
  NodalField no_force;
  Workspace workspace;
  State state;
  bool converged = true;

  Motion(const Model& body, const StepSettings& with, const Supports& held)
      : model(body),
        settings(with),
        supports(held),
        no_force(body.num_nodes),
        workspace(body, with, 1),
        state(startState(body, with, held, body.rest, Vector3d::Zero(), workspace))
  {
  }

  void step(int steps)
  {
    for (int k = 0; k < steps; ++k)
    {
      const StepReport report = implicitEulerStep(model, settings, supports, loads, no_force, state, workspace);
      ASSERT_TRUE(report.finite);
      converged = converged && report.converged;
    }
  }
};

/** Where the bar's lower free corner comes to rest under its weight; every system must have been solved. */
Vector3d sag(const Model& model, const Vector3d& corner, const Vector3d& origin)
{
  StepSettings settings = defaults();
  settings.gravity = WEIGHT;
  settings.damping.mass = 15;  // about critical
  Supports supports = test::holdFoot(model, model.rest);
  for (int i = 0; i < model.num_nodes; ++i)
  {
    if (model.rest[i].z() > origin.z() + 1e-9) continue;
    supports.held[i] = 7;
    supports.region[i] = {0, 0, 0};
    supports.regions[0].nodes.push_back(i);
  }
  Motion run(model, settings, supports);
  run.step(75);
  EXPECT_TRUE(run.converged);
  for (int i = 0; i < model.num_nodes; ++i)
  {
    if ((model.rest[i] - corner).norm() < 1e-9) return run.state.x[i] - model.rest[i];
  }
  ADD_FAILURE() << "no such corner";
  return Vector3d::Zero();
}

/** Every second element gets a corner so near to one of its faces that the dihedral angles there are `angle`, rad. */
TetMesh withSlivers(const TetMesh& mesh, double angle)
{
  TetMesh out = mesh;
  std::vector<Vector3d> corners;
  std::vector<Eigen::Vector4i> tets;
  for (Eigen::Index i = 0; i < mesh.corners.cols(); ++i) corners.emplace_back(mesh.corners.col(i));
  for (Eigen::Index t = 0; t < mesh.tets.cols(); ++t)
  {
    const Eigen::Vector4i tet = mesh.tets.col(t);
    if (t % 2 == 0)
    {
      tets.push_back(tet);
      continue;
    }
    const Vector3d a = corners[tet[0]], b = corners[tet[1]], c = corners[tet[2]];
    const Vector3d normal = (b - a).cross(c - a);  // towards the fourth corner
    const double ab = (b - a).norm(), bc = (c - b).norm(), ca = (a - c).norm(), around = ab + bc + ca;
    const int added = static_cast<int>(corners.size());
    corners.emplace_back((bc * a + ca * b + ab * c) / around + std::tan(angle) * normal / around);
    tets.emplace_back(tet[0], tet[1], tet[2], added);
    tets.emplace_back(tet[0], tet[1], added, tet[3]);
    tets.emplace_back(tet[1], tet[2], added, tet[3]);
    tets.emplace_back(tet[2], tet[0], added, tet[3]);
  }
  out.corners.resize(3, static_cast<Eigen::Index>(corners.size()));
  out.tets.resize(4, static_cast<Eigen::Index>(tets.size()));
  for (std::size_t i = 0; i < corners.size(); ++i) out.corners.col(static_cast<Eigen::Index>(i)) = corners[i];
  for (std::size_t t = 0; t < tets.size(); ++t) out.tets.col(static_cast<Eigen::Index>(t)) = tets[t];
  out.corner_ids.clear();
  for (std::size_t i = 0; i < corners.size(); ++i) out.corner_ids.push_back(static_cast<std::int64_t>(i) + 1);
  out.largest_id = out.corner_ids.back();
  return out;
}

TEST(Stability, SliversAndAFarOriginChangeLittle)
{
  const Vector3d corner(0, 0, 1);
  const TetMesh mesh = barMesh();
  const Vector3d plain = sag(defaultModel(mesh), corner, Vector3d::Zero());
  EXPECT_GT(plain.norm(), 0.2);

  const Vector3d spoilt = sag(defaultModel(withSlivers(mesh, 0.5 * M_PI / 180)), corner, Vector3d::Zero());
  // The body bends by more than a sliver is thick, so that its corners alone are inside out, and its rotation is off.
  EXPECT_LT((spoilt - plain).norm(), 0.05 * plain.norm());

  const Vector3d far(1e4, 1e4, 1e4);
  TetMesh moved = mesh;
  moved.corners.colwise() += far;
  EXPECT_LT((sag(defaultModel(moved), corner + far, far) - plain).norm(), 0.001 * plain.norm());
  // The same with coordinates of single precision, which are 1 mm apart there.
  moved.corners = moved.corners.cast<float>().cast<double>();
  EXPECT_LT((sag(defaultModel(moved), corner + far, far) - plain).norm(), 0.01 * plain.norm());
}

TEST(Stability, NearlyIncompressibleSystemsAreSolved)
{
  for (const double poisson : {0.499, 0.4999})
  {
    for (const double young : {2e5, 1e12})
    {
      for (const double time_step : {0.02, 1.0})
      {
        for (const Dilatation dilatation : {Scene().dilatation, Dilatation::FULL})
        {
          const Model model = test::boxModel(barMesh(), Element::QUADRATIC, {young, poisson, 500}, dilatation);
          StepSettings settings = defaults();
          settings.gravity = WEIGHT;
          settings.time_step = time_step;
          Motion run(model, settings, test::holdFoot(model, model.rest));
          run.step(20);
          EXPECT_TRUE(run.converged) << young << " Pa, " << poisson << ", " << time_step << " s";
        }
      }
    }
  }
}

TEST(Stability, LongStepsOfASoftBodyComeToRest)
{
  for (const double young : {1e4, 2e4, 2e5})
  {
    const Model model = defaultModel(barMesh(), {young, 0.34, 500});
    StepSettings settings = defaults();
    settings.gravity = WEIGHT;
    settings.time_step = 1;
    const Supports supports = test::holdFoot(model, model.rest);
    Motion run(model, settings, supports);
    double peak = 0;
    for (int k = 0; k < 60; ++k)
    {
      run.step(1);
      peak = std::max(peak, kineticEnergy(model, run.state.v));
    }
    EXPECT_TRUE(run.converged);
    EXPECT_LT(kineticEnergy(model, run.state.v), 1e-6 * peak) << young << " Pa";

    Motion rest(model, settings, supports);
    const NodalField no_force(model.num_nodes);
    ASSERT_TRUE(solveStatic(model, settings, supports, {}, no_force, rest.state, rest.workspace, {}).converged);
    EXPECT_LT((run.state.x.matrix() - rest.state.x.matrix()).colwise().norm().maxCoeff(), 1e-3) << young << " Pa";
  }
}

TEST(Stability, ATwistOfTwoTurnsStays)
{
  const Vector3d size(0.1, 0.1, 1.0);
  TetMesh mesh = test::kuhnBox({2, 2, 20}, size);
  mesh.corners.topRows<2>().array() -= 0.05;
  const Model model = defaultModel(mesh);
  Supports supports = test::holdFoot(model, model.rest);
  HeldRegion hand;
  hand.axes = {true, true, true};
  constexpr double ANGLE = 4 * M_PI, DURATION = 2;
  for (int k = 0; k <= 24; ++k)
  {
    const double half = ANGLE * k / 24 / 2;
    hand.motion.push_back({DURATION * k / 24, Vector3d::Zero(), {0, 0, std::sin(half), std::cos(half)}});
  }
  for (int i = 0; i < model.num_nodes; ++i)
  {
    if (model.rest[i].z() < 1 - 1e-9) continue;
    hand.nodes.push_back(i);
    supports.held[i] = 7;
    supports.region[i] = {1, 1, 1};
  }
  supports.regions.push_back(hand);
  StepSettings settings = defaults();
  settings.damping.mass = 5;
  Motion run(model, settings, supports);
  run.step(140);

  // Angles of the sections' corners, each from the one below.
  std::map<long, std::pair<double, double>> sums;  // of products with the section at rest: along it, across it
  for (int i = 0; i < model.num_nodes; ++i)
  {
    if (model.ends[i][0] != model.ends[i][1]) continue;
    const Vector3d X = model.rest[i], x = run.state.x[i];
    auto& [along, across] = sums[std::lround(20 * X.z())];
    along += X.x() * x.x() + X.y() * x.y();
    across += X.x() * x.y() - X.y() * x.x();
  }
  double angle = 0;
  for (const auto& [section, sum] : sums)
  {
    angle += std::remainder(std::atan2(sum.second, sum.first) - angle, 2 * M_PI);
    EXPECT_NEAR(angle, ANGLE * static_cast<double>(section) / 20, 0.05 * ANGLE) << "section " << section;
  }
  EXPECT_EQ(invertedElements(model, run.state.x), 0);
}

TEST(Stability, StiffBodiesThatSpinStayWhole)
{
  const Material stiff{1e8, 0.34, 500};
  const Model model = defaultModel(barMesh(), stiff);
  Supports free;
  free.start = model.rest;
  free.held.assign(model.num_nodes, 0);
  free.region.assign(model.num_nodes, {-1, -1, -1});
  for (const double turn : {0.05, 0.2, 1.0, 5.0})
  {
    Motion run(model, defaults(), free);
    const double rate = turn / run.settings.time_step;
    for (int i = 0; i < model.num_nodes; ++i)
    {
      run.state.v[i] = Vector3d(rate, 0, 0).cross(Vector3d(model.rest[i] - SIZE / 2));
    }
    const double energy = kineticEnergy(model, run.state.v);
    // A free bar that turns about its middle: the mean of the stress rho w^2 (L^2/4 - s^2)/2 is rho w^2 L^2/12.
    const double stretched = SIZE.z() * (1 + stiff.density * rate * rate / (12 * stiff.young));
    double longest = 0;
    for (int k = 0; k < 25; ++k)
    {
      run.step(1);
      Vector3d between = Vector3d::Zero();
      for (int i = 0; i < model.num_nodes; ++i)
      {
        if (model.ends[i][0] != model.ends[i][1]) continue;
        const double z = model.rest[i].z();
        if (z < 1e-9 || z > 1 - 1e-9) between += (z < 0.5 ? -1.0 : 1.0) / 9 * run.state.x[i];
      }
      longest = std::max(longest, between.norm());
    }
    EXPECT_NEAR(longest / stretched, 1, 0.05) << turn;
    // It rings, but with less energy than it spins with.
    EXPECT_LT(kineticEnergy(model, run.state.v), 2 * energy) << turn;
    EXPECT_GT(kineticEnergy(model, run.state.v), 0.4 * energy) << turn;
  }
}

TEST(Stability, AnElementThatAForceInvertsComesBack)
{
  const Model model = defaultModel(barMesh());
  StepSettings settings = defaults();
  settings.damping.mass = 5;
  Motion run(model, settings, test::holdFoot(model, model.rest));
  AppliedLoad push;
  push.from = 0;
  push.until = 1;
  for (int i = 0; i < model.num_nodes; ++i)
  {
    if ((model.rest[i] - Vector3d(0.4, 0, 1)).norm() < 1e-9) push.nodal.emplace_back(i, Vector3d(-2300, 2300, -2300));
  }
  ASSERT_EQ(push.nodal.size(), 1u);
  run.loads.push_back(push);
  run.step(50);
  EXPECT_GT(invertedElements(model, run.state.x), 0);
  run.step(250);
  EXPECT_LT((run.state.x.matrix() - model.rest.matrix()).colwise().norm().maxCoeff(), 1e-4);
}

}  // namespace
}  // namespace bezier_fem
