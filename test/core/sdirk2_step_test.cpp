#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>

#include "bezier_fem/element_operator.h"
#include "bezier_fem/measures.h"
#include "bezier_fem/step.h"
#include "core/bar.h"

namespace bezier_fem
{
namespace
{
using Eigen::MatrixXd;
using Eigen::Vector3d;
using Eigen::VectorXd;

struct Law
{
  const char* name;
  Element element;
  Elasticity elasticity;
  RotationRule rotation;
};

class Sdirk2 : public testing::TestWithParam<Law>
{
protected:
  Model model = test::boxModel(test::irregularBox({2, 2, 3}, {0.4, 0.4, 1.0}, 0.1), GetParam().element);
  NodalField no_force{model.num_nodes};

  StepSettings settings(double dt, double tolerance = 1e-9) const
  {
    return {dt, GetParam().elasticity, GetParam().rotation, {0, 0}, {0, -9.81, 0}, {tolerance, 5000}};
  }
  using Step = decltype(&implicitEulerStep);
  State run(Step step, const StepSettings& s, const Supports& supports, const State& start, double duration) const
  {
    Workspace workspace(model, s, 1);
    State state = start;
    state.time = 0;
    state.steps = 0;
    for (int k = 0; k < std::lround(duration / s.time_step); ++k)
    {
      const StepReport report = step(model, s, supports, {}, no_force, state, workspace);
      EXPECT_TRUE(report.finite && report.converged);
    }
    return state;
  }
};
INSTANTIATE_TEST_SUITE_P(
    Laws, Sdirk2,
    testing::Values(Law{"linear_corotated", Element::LINEAR, Elasticity::COROTATED, RotationRule::FROM_CORNERS},
                    Law{"quadratic_small_strain", Element::QUADRATIC, Elasticity::LINEAR, RotationRule::FROM_CORNERS},
                    Law{"quadratic_corners", Element::QUADRATIC, Elasticity::COROTATED, RotationRule::FROM_CORNERS},
                    Law{"quadratic_four", Element::QUADRATIC, Elasticity::COROTATED, RotationRule::FOUR_POINTS},
                    Law{"quadratic_green", Element::QUADRATIC, Elasticity::GREEN, RotationRule::FROM_CORNERS}),
    [](const auto& p) { return std::string(p.param.name); });

TEST_P(Sdirk2, ABodyFallsAsItMust)
{
  const StepSettings s = settings(0.02);
  Workspace workspace(model, s, 1);
  const Supports supports = test::holdNothing(model);
  const Vector3d velocity(1, 2, 3);
  State state = startState(model, s, supports, model.rest, velocity, workspace);
  for (int k = 0; k < 10; ++k) sdirk2Step(model, s, supports, {}, no_force, state, workspace);
  EXPECT_NEAR(state.time, 0.2, 1e-15);
  for (int i = 0; i < model.num_nodes; ++i)
  {
    EXPECT_LT((state.x[i] - model.rest[i] - velocity * 0.2 - s.gravity * 0.02).norm(), 1e-8);
    EXPECT_LT((state.v[i] - velocity - s.gravity * 0.2).norm(), 1e-7);
  }
}

TEST_P(Sdirk2, FallsByFourAsTheStepHalves)
{
  // A smooth start: gravity has grown as slowly as sin^2, integrated by explicit steps; so is the reference.
  const Supports supports = test::holdFoot(model);
  StepSettings fine = settings(2.5e-4);
  Workspace workspace(model, fine, 1);
  State start = startState(model, fine, supports, model.rest, Vector3d::Zero(), workspace);
  constexpr int RAMP = 800;
  for (int k = 0; k < RAMP; ++k)
  {
    fine.gravity.y() = -9.81 * std::pow(std::sin(M_PI / 2 * (k + 0.5) / RAMP), 2);
    explicitStep(model, fine, supports, {}, no_force, start, workspace);
  }
  fine = settings(2.5e-4);
  constexpr double DURATION = 0.16;
  const State exact = run(explicitStep, fine, supports, start, DURATION);
  const auto error = [&](double dt) {
    const State state = run(sdirk2Step, settings(dt), supports, start, DURATION);
    return (state.x.matrix() - exact.x.matrix()).norm() / (exact.x.matrix() - start.x.matrix()).norm();
  };
  const double coarse = error(0.01), half = error(0.005);
  EXPECT_NEAR(std::log2(coarse / half), 2, 0.25);
  EXPECT_LT(half, 2e-3);
}

TEST_P(Sdirk2, ALedBodyArrivesAndIsAsFastAsItsSupport)
{
  // The support turns ever faster; its nodes' velocities are no average over the step.
  const auto angle = [](double t) { return 0.5 * 4 * t * t; };
  std::vector<MotionSample> motion;
  for (int k = 0; k <= 1000; ++k)
  {
    const double half = angle(k * 2e-4) / 2;
    motion.push_back({k * 2e-4, {0, 0, 0}, {0, 0, std::sin(half), std::cos(half)}});
  }
  const Supports supports = test::holdFoot(model, motion);
  const auto error = [&](double dt) {
    const StepSettings s = settings(dt);
    Workspace workspace(model, s, 1);
    const State state =
        run(sdirk2Step, s, supports, startState(model, s, supports, model.rest, Vector3d::Zero(), workspace), 0.16);
    const Vector3d omega(0, 0, 4 * 0.16);
    const Eigen::Matrix3d R = Eigen::AngleAxisd(angle(0.16), Vector3d::UnitZ()).toRotationMatrix();
    double largest = 0;
    for (const int i : supports.regions[0].nodes)
    {
      EXPECT_LT((state.x[i] - R * Vector3d(model.rest[i])).norm(), 1e-9);
      largest = std::max(largest, (state.v[i] - omega.cross(Vector3d(state.x[i]))).norm());
    }
    return largest;
  };
  const double coarse = error(0.02), half = error(0.01);
  EXPECT_LT(half, 1e-3);
  EXPECT_GT(coarse / half, 3);
}

TEST_P(Sdirk2, AStiffBodyTurnsFastWithoutRinging)
{
  // One rad a step at 100 MPa: the lagged implicit Euler step has to be cut. No energy may come from nowhere.
  setMaterials(model, std::vector<Material>(model.num_tets, {1e8, 0.34, 500}));
  StepSettings s = settings(0.02, 1e-7);
  s.gravity.setZero();
  Workspace workspace(model, s, 1);
  const Supports supports = test::holdNothing(model);
  if (s.elasticity == Elasticity::LINEAR) return;  // knows no rotation
  for (const double turn : {0.05, 0.2, 0.5, 1.0})
  {
    State state = startState(model, s, supports, model.rest, Vector3d::Zero(), workspace);
    for (int i = 0; i < model.num_nodes; ++i)
    {
      state.v[i] = Vector3d(turn / s.time_step, 0, 0).cross(Vector3d(state.x[i]) - Vector3d(0.2, 0.2, 0.5));
    }
    const double start = kineticEnergy(model, state.v);
    for (int k = 0; k < 50; ++k)
    {
      const StepReport report = automaticStep(model, s, supports, {}, no_force, state, workspace);
      ASSERT_TRUE(report.finite);
      ASSERT_LT(kineticEnergy(model, state.v), 1.05 * start) << turn << " rad a step, step " << k;
    }
    EXPECT_EQ(invertedElements(model, state.x), 0);
    if (turn == 0.05)
    {
      EXPECT_GT(kineticEnergy(model, state.v), 0.9 * start);  // 2.5 rad
    }
  }
}

TEST(Sdirk2Formula, IsTheMethodsStabilityFunctionOfTheWholeSystem)
{
  // y' = A y of small strain: one step is (1 - g h A)^-2 (1 + (1 - 2 g) h A), g = 1 - sqrt(1/2).
  const Model model = test::boxModel(test::irregularBox({1, 1, 2}, {0.4, 0.4, 1.0}), Element::QUADRATIC);
  const NodalField no_force(model.num_nodes);
  StepSettings s{0.02, Elasticity::LINEAR, RotationRule::FROM_CORNERS, {0.7, 0.01}, {0, 0, 0}, {1e-12, 5000}};
  Workspace workspace(model, s, 1);
  const Supports supports = test::holdNothing(model);
  State state = startState(model, s, supports, model.rest, Vector3d::Zero(), workspace);
  const NodalField displacement = test::randomField(model.num_nodes, 3),
                   velocity = test::randomField(model.num_nodes, 4);
  state.x.matrix() += 0.01 * displacement.matrix();
  state.v.matrix() = velocity.matrix();

  const int n = 3 * model.num_nodes;
  const auto dense = [&](double alpha, double beta) {
    MatrixXd A(n, n);
    NodalField unit(model.num_nodes), column(model.num_nodes);
    for (int j = 0; j < n; ++j)
    {
      unit.setZero();
      unit[j / 3][j % 3] = 1;
      systemProduct(model, workspace.partition, state.rotations, alpha, beta, unit, column);
      for (int i = 0; i < model.num_nodes; ++i) A.block<3, 1>(3L * i, j) = column[i];
    }
    return A;
  };
  const MatrixXd M = dense(1, 0), K = dense(0, 1);
  MatrixXd A = MatrixXd::Zero(2L * n, 2L * n);
  A.topRightCorner(n, n).setIdentity();
  A.bottomLeftCorner(n, n) = -M.ldlt().solve(K);
  A.bottomRightCorner(n, n) = -M.ldlt().solve(0.7 * M + 0.01 * K);
  VectorXd y(2L * n);
  for (int i = 0; i < model.num_nodes; ++i)
  {
    y.segment<3>(3L * i) = state.x[i] - model.rest[i];
    y.segment<3>(n + 3L * i) = state.v[i];
  }
  const double h = s.time_step, g = 1 - std::sqrt(0.5);
  const MatrixXd one = MatrixXd::Identity(2L * n, 2L * n);
  const Eigen::PartialPivLU<MatrixXd> solver(one - g * h * A);
  y = solver.solve(solver.solve((one + (1 - 2 * g) * h * A) * y));

  EXPECT_TRUE(sdirk2Step(model, s, supports, {}, no_force, state, workspace).converged);
  for (int i = 0; i < model.num_nodes; ++i)
  {
    EXPECT_LT((state.x[i] - model.rest[i] - y.segment<3>(3L * i)).norm(), 1e-9);
    EXPECT_LT((state.v[i] - y.segment<3>(n + 3L * i)).norm(), 1e-7);
  }
}

TEST(AutomaticStep, RecoversWhereTheSecondOrderStepDoesNot)
{
  const Model model = test::boxModel(test::kuhnBox({2, 2, 5}, {0.4, 0.4, 1}), Element::QUADRATIC);
  const NodalField no_force(model.num_nodes);
  StepSettings s{0.02, Elasticity::COROTATED, RotationRule::FROM_CORNERS, {2, 0}, {0, -9.81, 0}, {1e-4, 500}};
  Workspace workspace(model, s, 1);
  const Supports supports = test::holdFoot(model);
  NodalField mirrored = model.rest;
  for (int i = 0; i < model.num_nodes; ++i) mirrored[i].z() *= -1;
  constexpr int STEPS = 200;
  const auto end = [&](decltype(&automaticStep) step, long& second_order) {
    State state = startState(model, s, supports, mirrored, Vector3d::Zero(), workspace);
    second_order = 0;
    for (int k = 0; k < STEPS; ++k)
      second_order += step(model, s, supports, {}, no_force, state, workspace).second_order;
    return invertedElements(model, state.x);
  };
  long second_order;
  EXPECT_EQ(end(automaticStep, second_order), 0);
  EXPECT_GT(second_order, 20);
  EXPECT_LT(second_order, STEPS);
  EXPECT_GT(end(sdirk2Step, second_order), 0);
  EXPECT_EQ(second_order, STEPS);
}

}  // namespace
}  // namespace bezier_fem
