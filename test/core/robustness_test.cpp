// States and settings that break other methods: mirrored, flat and collapsed bodies, extreme materials and steps.

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <functional>

#include "bezier_fem/measures.h"
#include "bezier_fem/step.h"
#include "core/bar.h"

namespace bezier_fem
{
namespace
{
using Eigen::Vector3d;

const Vector3d SIZE(0.4, 0.4, 1.0);

/** The bar with its free corners moved by a map of the rest shape and a perturbation; edges halfway. */
NodalField moved(const Model& model, const std::function<Vector3d(const Vector3d&)>& map, double perturbation)
{
  NodalField x = model.rest;
  const NodalField noise = test::randomField(model.num_nodes, 31);
  for (int i = 0; i < model.num_nodes; ++i)
  {
    if (model.rest[i].z() > 1e-9) x[i] = map(model.rest[i]) + perturbation * noise[i];
  }
  for (int i = 0; i < model.num_nodes; ++i)
  {
    const auto [a, b] = model.ends[i];
    if (a != b && model.rest[i].z() > 1e-9) x[i] = (x[model.node_of_corner[a]] + x[model.node_of_corner[b]]) / 2;
  }
  return x;
}

struct Outcome
{
  int inverted_soon;  // after 2 s
  double error;       // m, at the end
  double extent;      // m, the largest coordinate of all times
  bool finite;
};

Outcome recover(const Model& model, const NodalField& start)
{
  const StepSettings settings{0.02,   Elasticity::COROTATED, RotationRule::FROM_CORNERS,
                              {1, 0}, Vector3d::Zero(),      {1e-4, 500}};
  const Supports supports = test::holdFoot(model, model.rest);
  const NodalField no_force(model.num_nodes);
  Workspace workspace(model, settings, 1);
  State state = startState(model, settings, supports, start, Vector3d::Zero(), workspace);
  Outcome outcome{-1, 0, 0, true};
  for (int step = 1; step <= 800 && outcome.finite; ++step)
  {
    outcome.finite = implicitEulerStep(model, settings, supports, {}, no_force, state, workspace).finite;
    outcome.extent = std::max(outcome.extent, state.x.matrix().cwiseAbs().maxCoeff());
    if (step == 100) outcome.inverted_soon = invertedElements(model, state.x);
  }
  outcome.error = (state.x.matrix() - model.rest.matrix()).colwise().norm().maxCoeff();
  return outcome;
}

class Recovery : public testing::TestWithParam<Element>
{
protected:
  Model model = test::boxModel(test::kuhnBox({2, 2, 5}, SIZE), GetParam());
};
INSTANTIATE_TEST_SUITE_P(Elements, Recovery, testing::Values(Element::LINEAR, Element::QUADRATIC),
                         [](const auto& p) { return std::string(test::name(p.param)); });

TEST_P(Recovery, FromMirroredFlatAndCollapsedStates)
{
  std::vector<std::pair<std::string, std::function<Vector3d(const Vector3d&)>>> states;
  for (int axis = 0; axis < 3; ++axis)
  {
    const Vector3d e = Vector3d::Unit(axis);
    for (const double at : {0.0, 0.5})
    {
      const double plane = at * SIZE[axis];
      const std::string where = std::string(1, "xyz"[axis]) + " = " + std::to_string(plane);
      states.emplace_back("mirrored at " + where,
                          [=](const Vector3d& X) { return Vector3d(X - 2 * (X[axis] - plane) * e); });
      states.emplace_back("flattened to " + where,
                          [=](const Vector3d& X) { return Vector3d(X - (X[axis] - plane) * e); });
    }
  }
  states.emplace_back("mirrored at the origin", [](const Vector3d& X) { return Vector3d(-X); });
  states.emplace_back("collapsed to a corner", [](const Vector3d&) { return Vector3d::Zero().eval(); });
  states.emplace_back("collapsed to the centre", [](const Vector3d&) { return Vector3d(SIZE / 2); });
  states.emplace_back("collapsed to a line", [](const Vector3d& X) { return Vector3d(0.2, 0.2, X.z()); });
  for (const auto& [what, map] : states)
  {
    // However ties between singular values break.
    for (const double perturbation : {0.0, 1e-12})
    {
      const Outcome outcome = recover(model, moved(model, map, perturbation));
      EXPECT_TRUE(outcome.finite) << what;
      EXPECT_EQ(outcome.inverted_soon, 0) << what << ", perturbed by " << perturbation;
      EXPECT_LT(outcome.error, 1e-4) << what << ", perturbed by " << perturbation;
    }
  }
}

TEST_P(Recovery, ScrambledBodiesStayBoundedAndMostRecover)
{
  constexpr int SEEDS = 20;
  int recovered = 0;
  for (int seed = 0; seed < SEEDS; ++seed)
  {
    const NodalField noise = test::randomField(model.num_nodes, 1000 + seed);
    int next = 0;
    const auto scramble = [&](const Vector3d&) { return Vector3d(SIZE / 2 + noise[next++].cwiseProduct(SIZE / 2)); };
    const Outcome outcome = recover(model, moved(model, scramble, 0));
    EXPECT_TRUE(outcome.finite) << "seed " << seed;
    EXPECT_LT(outcome.extent, 5) << "seed " << seed;
    recovered += outcome.error < 1e-4 ? 1 : 0;
  }
  RecordProperty("recovered_of_20", recovered);
  // Elements that end inside out against each other, or the bar twisted a full turn, are equilibria of their own.
  EXPECT_GE(recovered, SEEDS / 2);
}

TEST_P(Recovery, ExtremeStepsAndMaterialsGiveNumbersAndTheTruth)
{
  int converged = 0, count = 0;
  for (const double dt : {1e-3, 0.02, 1.0})
  {
    for (const double young : {1.0, 2e5, 1e12})
    {
      for (const double poisson : {0.0, 0.45, 0.4999})
      {
        for (const double contrast : {1.0, 1e6})
        {
          TetMesh mesh = test::kuhnBox({2, 2, 5}, SIZE);
          std::vector<Material> materials(mesh.tets.cols(), {young, poisson, 500});
          for (std::size_t t = 0; t < materials.size(); t += 3) materials[t].density *= contrast;
          const Model hard = buildModel(mesh, GetParam(), materials);
          const StepSettings settings{dt,     Elasticity::COROTATED, RotationRule::FROM_CORNERS,
                                      {0, 0}, {0, -9.81, 0},         {1e-4, 500}};
          const Supports supports = test::holdFoot(hard, hard.rest);
          const NodalField no_force(hard.num_nodes);
          Workspace workspace(hard, settings, 1);
          State state = startState(hard, settings, supports, hard.rest, Vector3d::Zero(), workspace);
          for (int step = 0; step < 10; ++step)
          {
            const StepReport report = implicitEulerStep(hard, settings, supports, {}, no_force, state, workspace);
            ASSERT_TRUE(report.finite) << dt << ' ' << young << ' ' << poisson << ' ' << contrast;
            EXPECT_EQ(report.converged, report.residual <= 1e-4);
            ++count;
            converged += report.converged ? 1 : 0;
          }
          EXPECT_TRUE(std::isfinite(elasticEnergy(hard, state.rotations, state.x)));
        }
      }
    }
  }
  RecordProperty("converged_percent", 100 * converged / count);
  EXPECT_GT(converged, count / 2);
}

}  // namespace
}  // namespace bezier_fem
