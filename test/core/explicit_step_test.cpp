#include <gtest/gtest.h>

#include <cmath>

#include "bezier_fem/green_strain.h"
#include "bezier_fem/measures.h"
#include "bezier_fem/step.h"
#include "core/bar.h"

namespace bezier_fem
{
namespace
{
using Eigen::Vector3d;

struct Law
{
  const char* name;
  Element element;
  Elasticity elasticity;
  RotationRule rotation;
  bool conservative;  // the force is the gradient of an energy
};

class Explicit : public testing::TestWithParam<Law>
{
protected:
  Model model = test::boxModel(test::irregularBox({2, 2, 3}, {0.4, 0.4, 1.0}, 0.1), GetParam().element);
  NodalField no_force{model.num_nodes};

  StepSettings settings(double dt) const
  {
    return {dt, GetParam().elasticity, GetParam().rotation, {0, 0}, {0, -9.81, 0}, {1e-9, 1000}};
  }
  double elastic(const State& state) const
  {
    return GetParam().elasticity == Elasticity::GREEN ? greenEnergy(model, state.x)
                                                      : elasticEnergy(model, state.rotations, state.x);
  }
  double energy(const StepSettings& s, const State& state) const
  {
    return kineticEnergy(model, state.v) + elastic(state) + gravityEnergy(model, s.gravity, state.x);
  }
  /** The bar held at its foot, bent by gravity from rest. */
  NodalField swing(double dt, double duration, double* energy_change = nullptr) const
  {
    const StepSettings s = settings(dt);
    Workspace workspace(model, s, 1);
    const Supports supports = test::holdFoot(model);
    State state = startState(model, s, supports, model.rest, Vector3d::Zero(), workspace);
    const double before = energy(s, state);
    for (int k = 0; k < std::lround(duration / dt); ++k)
    {
      const StepReport report = explicitStep(model, s, supports, {}, no_force, state, workspace);
      EXPECT_TRUE(report.finite && report.converged);
      if (!energy_change)
      {
        EXPECT_EQ(report.substeps, 1);
      }
    }
    if (energy_change) *energy_change = std::abs(energy(s, state) - before) / kineticEnergy(model, state.v);
    return state.x;
  }
};
INSTANTIATE_TEST_SUITE_P(
    Laws, Explicit,
    testing::Values(
        Law{"linear_corotated", Element::LINEAR, Elasticity::COROTATED, RotationRule::FROM_CORNERS, true},
        Law{"quadratic_small_strain", Element::QUADRATIC, Elasticity::LINEAR, RotationRule::FROM_CORNERS, true},
        Law{"quadratic_corners", Element::QUADRATIC, Elasticity::COROTATED, RotationRule::FROM_CORNERS, false},
        Law{"quadratic_four", Element::QUADRATIC, Elasticity::COROTATED, RotationRule::FOUR_POINTS, true},
        Law{"linear_green", Element::LINEAR, Elasticity::GREEN, RotationRule::FROM_CORNERS, true},
        Law{"quadratic_green", Element::QUADRATIC, Elasticity::GREEN, RotationRule::FROM_CORNERS, true}),
    [](const auto& p) { return std::string(p.param.name); });

TEST_P(Explicit, ABodyFallsAsItMust)
{
  const StepSettings s = settings(0.02);
  Workspace workspace(model, s, 1);
  const Supports supports = test::holdNothing(model);
  State state = startState(model, s, supports, model.rest, Vector3d(1, 2, 3), workspace);
  for (int k = 0; k < 10; ++k) explicitStep(model, s, supports, {}, no_force, state, workspace);
  EXPECT_NEAR(state.time, 0.2, 1e-15);
  for (int i = 0; i < model.num_nodes; ++i)
  {
    const Vector3d moved = Vector3d(1, 2, 3) * 0.2 + s.gravity * 0.02;
    EXPECT_LT((state.x[i] - model.rest[i] - moved).norm(), 1e-8);
    EXPECT_LT((state.v[i] - Vector3d(1, 2, 3) - s.gravity * 0.2).norm(), 1e-7);
  }
}

TEST_P(Explicit, IsOfSecondOrder)
{
  const NodalField coarse = swing(4e-4, 0.1), middle = swing(2e-4, 0.1), fine = swing(1e-4, 0.1);
  const double first = (coarse.matrix() - middle.matrix()).norm(), second = (middle.matrix() - fine.matrix()).norm();
  EXPECT_NEAR(std::log2(first / second), 2, 0.15);
  EXPECT_GT(first, 1e-7);  // above what the tolerance of the accelerations hides
}

TEST_P(Explicit, KeepsTheEnergyOfAConservativeForce)
{
  double coarse, fine;
  swing(5e-4, 0.4, &coarse);
  swing(2.5e-4, 0.4, &fine);
  if (GetParam().conservative)
  {
    EXPECT_LT(fine, 2e-3);
    EXPECT_LT(fine, 0.5 * coarse);
  }
  else
  {
    // Not an error of the step: it stays as the step shrinks.
    EXPECT_GT(fine, 2e-3);
    EXPECT_NEAR(fine, coarse, 0.2 * coarse);
  }
}

TEST_P(Explicit, ALongStepIsCutIntoStableOnes)
{
  StepSettings s = settings(0.05);
  s.damping = {0.5, 1e-3};
  Workspace workspace(model, s, 1);
  const Supports supports = test::holdFoot(model);
  State state = startState(model, s, supports, model.rest, Vector3d::Zero(), workspace);
  const double stable = stableStep(model, s, state, workspace);
  double largest = 0;
  for (int k = 0; k < 10; ++k)
  {
    const StepReport report = explicitStep(model, s, supports, {}, no_force, state, workspace);
    ASSERT_TRUE(report.finite);
    if (k == 0)
    {
      const double expected = std::ceil(s.time_step / (0.9 * stable));
      EXPECT_GE(report.substeps, expected);
      // Green's strain stiffens as the bar is stretched.
      EXPECT_LE(report.substeps, GetParam().elasticity == Elasticity::GREEN ? 1.1 * expected : expected);
    }
    largest = std::max(largest, elastic(state));
  }
  // What falls can't gain more than it loses in height.
  EXPECT_LT(largest, model.mass() * 9.81);
}

TEST_P(Explicit, LeadsItsSupports)
{
  StepSettings s = settings(0.02);
  s.gravity.setZero();
  s.damping.mass = 15;  // about critical
  Workspace workspace(model, s, 1);
  Supports supports = test::holdFoot(model);
  supports.regions[0].motion = {{0, {0, 0, 0}, {0, 0, 0, 1}}, {0.2, {0.1, 0.2, 0}, {0, 0, 0, 1}}};
  State state = startState(model, s, supports, model.rest, Vector3d::Zero(), workspace);
  for (int k = 0; k < 150; ++k) explicitStep(model, s, supports, {}, no_force, state, workspace);
  for (int i = 0; i < model.num_nodes; ++i)
  {
    EXPECT_LT((state.x[i] - model.rest[i] - Vector3d(0.1, 0.2, 0)).norm(), 1e-4);
  }
}

}  // namespace
}  // namespace bezier_fem
