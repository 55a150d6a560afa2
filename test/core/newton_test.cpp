#include "bezier_fem/conjugate_gradient.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>

#include "bezier_fem/element_operator.h"
#include "bezier_fem/green_strain.h"
#include "bezier_fem/measures.h"
#include "bezier_fem/step.h"
#include "core/bar.h"

namespace bezier_fem
{
namespace
{
using Eigen::Vector3d;

constexpr double DT = 0.02;

class Newton : public testing::TestWithParam<Element>
{
protected:
  Model model = test::boxModel(test::irregularBox({2, 2, 4}, {0.4, 0.4, 1.0}), GetParam());
  NodalField no_force{model.num_nodes};

  static StepSettings settings(double tolerance = 1e-8)
  {
    return {DT, Elasticity::GREEN, RotationRule::FROM_CORNERS, {0, 0}, {0, -9.81, 0}, {tolerance, 5000}};
  }
  double energy(const StepSettings& s, const State& state) const
  {
    return kineticEnergy(model, state.v) + greenEnergy(model, state.x) + gravityEnergy(model, s.gravity, state.x);
  }
};
INSTANTIATE_TEST_SUITE_P(Elements, Newton, testing::Values(Element::LINEAR, Element::QUADRATIC),
                         [](const auto& p) { return std::string(test::name(p.param)); });

TEST_P(Newton, AStepSatisfiesImplicitEuler)
{
  // M (v - v_0) + h (f_el(x) + a M v + b K(x_0) v - f_ext) = 0 where free, the supports' force where held.
  StepSettings s = settings(1e-10);
  s.damping = {0.7, 0.01};
  const Supports supports = test::holdFoot(model);
  Workspace workspace(model, s, 1);
  State state = startState(model, s, supports, model.rest, Vector3d::Zero(), workspace);
  for (int k = 0; k < 10; ++k)
  {
    const State before = state;
    const StepReport report = implicitEulerStep(model, s, supports, {}, no_force, state, workspace);
    ASSERT_TRUE(report.converged && report.finite);
    EXPECT_GT(report.iterations, 0);
    GreenTangent damping(model);
    linearise(model, workspace.partition, before.x, Projection::POSITIVE_STRESS, damping);
    NodalField inertia(model.num_nodes), damped(inertia), elastic(inertia), change(model.num_nodes);
    change.matrix() = state.v.matrix() - before.v.matrix();
    systemProduct(model, workspace.partition, damping, 1, 0, change, inertia);
    systemProduct(model, workspace.partition, damping, s.damping.mass, s.damping.stiffness, state.v, damped);
    greenForce(model, workspace.partition, state.x, elastic);
    double largest = 0;
    for (int i = 0; i < model.num_nodes; ++i)
    {
      const Vector3d rest = inertia[i] / DT + damped[i] + elastic[i] - model.node_mass[i] * s.gravity;
      if (supports.held[i])
      {
        EXPECT_LT((rest - workspace.balance[i]).norm(), 1e-9 * model.mass() * 9.81);
        EXPECT_EQ(state.x[i], model.rest[i]);
      }
      else
      {
        largest = std::max(largest, rest.norm());
      }
      EXPECT_LT((state.x[i] - before.x[i] - DT * state.v[i]).norm(), 1e-14);
    }
    EXPECT_LT(largest, 1e-8 * model.mass() * 9.81);
  }
  EXPECT_NEAR(state.time, 10 * DT, 1e-15);
}

TEST_P(Newton, FreeFallIsExactAndKeepsItsShape)
{
  const StepSettings s = settings();
  const Supports supports = test::holdNothing(model);
  Workspace workspace(model, s, 1);
  State state = startState(model, s, supports, model.rest, Vector3d(0.3, 0, 0.1), workspace);
  for (int k = 1; k <= 50; ++k)
  {
    ASSERT_TRUE(implicitEulerStep(model, s, supports, {}, no_force, state, workspace).converged);
    const Vector3d v = Vector3d(0.3, 0, 0.1) + k * DT * s.gravity;
    for (int i = 0; i < model.num_nodes; ++i) ASSERT_LT((state.v[i] - v).norm(), 1e-6);
  }
  EXPECT_LT(greenEnergy(model, state.x), 1e-10);
}

TEST_P(Newton, EveryStepLosesEnergy)
{
  // Implicit Euler minimises |v - v_0|^2/2 + U, which at v_0's own path is no less: it can only damp.
  StepSettings s = settings();
  const Supports supports = test::holdFoot(model);
  Workspace workspace(model, s, 1);
  State state = startState(model, s, supports, model.rest, Vector3d(0, 0.5, 0), workspace);
  double last = energy(s, state), kinetic = 0;
  const double start = last;
  for (int k = 0; k < 100; ++k)
  {
    const StepReport report = implicitEulerStep(model, s, supports, {}, no_force, state, workspace);
    ASSERT_TRUE(report.converged);
    EXPECT_LE(energy(s, state), last + 1e-6 * std::abs(start));
    last = energy(s, state);
    kinetic = std::max(kinetic, kineticEnergy(model, state.v));
  }
  EXPECT_GT(kinetic, 1);
  EXPECT_LT(last, start - 1);
}

TEST_P(Newton, StaticEquilibriumIsWhereADampedMotionEnds)
{
  StepSettings s = settings();
  s.damping.mass = 5;
  const Supports supports = test::holdFoot(model);
  Workspace workspace(model, s, 1);
  State state = startState(model, s, supports, model.rest, Vector3d::Zero(), workspace);
  State equilibrium = state;
  for (int k = 0; k < 400; ++k) implicitEulerStep(model, s, supports, {}, no_force, state, workspace);
  const Vector3d weight = model.mass() * s.gravity;
  EXPECT_LT((reactions(supports, state.x, workspace.balance)[0].force + weight).norm(), 1e-5 * weight.norm());

  int rounds = 0;
  const StepReport report =
      solveStatic(model, s, supports, {}, no_force, equilibrium, workspace, [&](int round, double) { rounds = round; });
  EXPECT_TRUE(report.converged);
  EXPECT_LE(rounds, 15);
  EXPECT_LT((equilibrium.x.matrix() - state.x.matrix()).cwiseAbs().maxCoeff(), 1e-5);
  EXPECT_EQ(equilibrium.v.matrix().norm(), 0);
  const Reaction reaction = reactions(supports, equilibrium.x, workspace.balance)[0];
  EXPECT_LT((reaction.force + weight).norm(), 1e-6 * weight.norm());
  Vector3d torque = Vector3d::Zero();
  for (int i = 0; i < model.num_nodes; ++i) torque += Vector3d(equilibrium.x[i]).cross(model.node_mass[i] * s.gravity);
  EXPECT_LT((reaction.torque + torque).norm(), 1e-6 * torque.norm());
}

TEST_P(Newton, FindsTheEquilibriumOfSoftBodiesHangingAndStanding)
{
  // Hanging, the softest is stretched by half. Standing, the first is stiff enough; the others buckle under their
  // weight, fall over and, there being no contact, hang below their foot.
  for (const double gravity : {9.81, -9.81})
  {
    double last = 1;
    for (const double young : {2e5, 5e4, 1e4, 2e3})
    {
      setMaterials(model, std::vector<Material>(model.num_tets, {young, 0.34, 500}));
      StepSettings s = settings(1e-6);
      s.gravity = {0.05, 0, gravity};
      const Supports supports = test::holdFoot(model);
      Workspace workspace(model, s, 1);
      State state = startState(model, s, supports, model.rest, Vector3d::Zero(), workspace);
      const double before = energy(s, state);
      const StepReport report = solveStatic(model, s, supports, {}, no_force, state, workspace, {});
      EXPECT_TRUE(report.converged) << "gravity " << gravity << ", E = " << young;
      EXPECT_LE(report.residual, 1e-6);
      EXPECT_LT(energy(s, state), before);
      if (gravity < 0 && young < 1e5) continue;
      EXPECT_EQ(report.inverted, 0);
      const double top = state.x.matrix().row(2).maxCoeff();
      EXPECT_GT(gravity * (top - last), 0);
      last = gravity > 0 ? top : 1;
      // It is an equilibrium of the stepper as well.
      const NodalField x = state.x;
      implicitEulerStep(model, s, supports, {}, no_force, state, workspace);
      EXPECT_LT((state.x.matrix() - x.matrix()).cwiseAbs().maxCoeff(), 1e-5);
    }
  }
}

TEST_P(Newton, BalancesAPressureThatTurnsWithTheBody)
{
  // Nearly as much as makes the bar buckle if it did not turn.
  StepSettings s = settings(1e-6);
  const Supports supports = test::holdFoot(model);
  for (const double pressure : {5000.0, -5000.0})
  {
    AppliedLoad load;
    load.from = 0;
    load.until = 1;
    load.pressure = pressure;
    for (const Model::Face& face : model.boundary)
    {
      const auto nodes = model.nodesOf(face);
      if (std::min({model.rest[nodes[0]].z(), model.rest[nodes[1]].z(), model.rest[nodes[2]].z()}) < 1 - 1e-9) continue;
      load.faces.push_back(face);
    }
    Workspace workspace(model, s, 1);
    State state = startState(model, s, supports, model.rest, Vector3d::Zero(), workspace);
    const StepReport report = solveStatic(model, s, supports, {load}, no_force, state, workspace, {});
    EXPECT_TRUE(report.converged) << pressure;
    NodalField applied(model.num_nodes), elastic(model.num_nodes);
    addLoads(model, {load}, 0, state.x, applied);
    greenForce(model, workspace.partition, state.x, elastic);
    for (int i = 0; i < model.num_nodes; ++i)
    {
      if (supports.held[i]) continue;
      EXPECT_LT((applied[i] + model.node_mass[i] * s.gravity - elastic[i]).norm(), 1e-5 * model.mass() * 9.81);
    }
    EXPECT_LT(state.x.matrix().row(1).minCoeff(), -0.03);
  }
}

TEST_P(Newton, ALedRegionIsWhereItsMotionSaysAndTheBodyFollows)
{
  StepSettings s = settings();
  s.gravity.setZero();
  s.damping.mass = 2;
  const double half = std::sqrt(0.5);
  const Supports supports =
      test::holdFoot(model, {{0, {0, 0, 0}, {0, 0, 0, 1}}, {1, {0.1, 0.2, 0}, {0, 0, half, half}}});
  Workspace workspace(model, s, 1);
  State state = startState(model, s, supports, model.rest, Vector3d::Zero(), workspace);
  for (int k = 1; k <= 400; ++k)
  {
    ASSERT_TRUE(implicitEulerStep(model, s, supports, {}, no_force, state, workspace).converged);
    const double part = std::min(1.0, k * DT);
    const Eigen::Isometry3d pose =
        Eigen::Translation3d(part * Vector3d(0.1, 0.2, 0)) * Eigen::AngleAxisd(part * M_PI / 2, Vector3d::UnitZ());
    for (const int i : supports.regions[0].nodes)
    {
      ASSERT_LT((state.x[i] - pose * Vector3d(model.rest[i])).norm(), 1e-12) << "step " << k;
    }
  }
  const Eigen::Isometry3d pose = Eigen::Translation3d(0.1, 0.2, 0) * Eigen::AngleAxisd(M_PI / 2, Vector3d::UnitZ());
  for (int i = 0; i < model.num_nodes; ++i) EXPECT_LT((state.x[i] - pose * Vector3d(model.rest[i])).norm(), 1e-4);
}

TEST_P(Newton, SurvivesInvertedStartsAndLongSteps)
{
  NodalField mirrored = model.rest, flat = model.rest, point = model.rest, wild = model.rest, large = model.rest;
  mirrored.matrix().row(0) *= -1;
  flat.matrix().row(1).setZero();
  point.setZero();
  wild.matrix() += 0.3 * test::randomField(model.num_nodes, 9).matrix();
  large.matrix() *= 30;
  for (const double dt : {0.001, 0.02, 1.0})
  {
    for (const NodalField* x : {&mirrored, &flat, &point, &wild, &large})
    {
      int converged = 0;
      StepSettings s = settings(1e-4);
      s.time_step = dt;
      s.solver.max_iterations = 500;
      const Supports supports = test::holdNothing(model);
      Workspace workspace(model, s, 1);
      State state = startState(model, s, supports, *x, Vector3d::Zero(), workspace);
      double last = energy(s, state);
      const double scale = std::abs(last) + model.mass() * 9.81;
      for (int k = 0; k < 20; ++k)
      {
        const StepReport report = implicitEulerStep(model, s, supports, {}, no_force, state, workspace);
        ASSERT_TRUE(report.finite && state.x.matrix().allFinite() && state.v.matrix().allFinite());
        if (report.converged) ++converged;
        ASSERT_LE(report.inverted, model.num_tets);
        EXPECT_LE(energy(s, state), last + 1e-3 * scale);
        last = energy(s, state);
      }
      // A point is a maximum of the energy: what follows is an explosion with most of the stresses compressive.
      if (x != &point)
      {
        EXPECT_GE(converged, 18) << "dt " << dt;
      }
    }
  }
}

using Kind = Scene::Solver::Preconditioner;
constexpr Kind KINDS[] = {Kind::AUTO, Kind::PMULTIGRID, Kind::DIRECT};

TEST_P(Newton, EveryPreconditionerLeadsToTheSameInFarFewerIterations)
{
  // Bent until its top is level with its foot, and swinging; squeezed; stretched by a half.
  model = test::boxModel(test::irregularBox({3, 3, 8}, {0.2, 0.2, 1.0}), GetParam());
  no_force = NodalField(model.num_nodes);
  const Supports supports = test::holdFoot(model);
  for (const Vector3d& gravity : {Vector3d(30, 0, 0), Vector3d(0, 0, -40), Vector3d(0, 3, 300)})
  {
    const auto run = [&](Kind kind, int& iterations, Kind& used) {
      StepSettings s = settings(1e-7);
      s.gravity = gravity;
      s.solver.preconditioner = kind;
      Workspace workspace(model, s, 1);
      State state = startState(model, s, supports, model.rest, Vector3d::Zero(), workspace);
      iterations = 0;
      for (int k = 0; k < 20; ++k)
      {
        const StepReport report = implicitEulerStep(model, s, supports, {}, no_force, state, workspace);
        EXPECT_TRUE(report.converged);
        iterations += report.iterations;
        used = report.preconditioner;
      }
      return state.x;
    };
    int plain = 0, iterations = 0;
    Kind used = Kind::AUTO;
    const NodalField expected = run(Kind::BLOCK_JACOBI, plain, used);
    EXPECT_EQ(used, Kind::BLOCK_JACOBI);
    EXPECT_GT((expected.matrix() - model.rest.matrix()).colwise().norm().maxCoeff(), 0.05);
    for (const Kind kind : KINDS)
    {
      const NodalField x = run(kind, iterations, used);
      EXPECT_EQ(used, kind == Kind::AUTO ? Kind::PMULTIGRID : kind);
      EXPECT_LT((x.matrix() - expected.matrix()).colwise().norm().maxCoeff(), 1e-5);
      EXPECT_LT(3 * iterations, plain) << gravity.transpose();
    }
  }
}

TEST_P(Newton, EveryPreconditionerLeadsToTheSameEquilibrium)
{
  model = test::boxModel(test::irregularBox({3, 3, 8}, {0.2, 0.2, 1.0}), GetParam());
  no_force = NodalField(model.num_nodes);
  const Supports supports = test::holdFoot(model);
  for (const double poisson : {0.3, 0.49})
  {
    setMaterials(model, std::vector<Material>(model.num_tets, {2e5, poisson, 500}));
    const auto solve = [&](Kind kind, int& iterations) {
      StepSettings s = settings(1e-8);
      s.gravity = {30, 0, 5};
      s.solver.preconditioner = kind;
      Workspace workspace(model, s, 1);
      State state = startState(model, s, supports, model.rest, Vector3d::Zero(), workspace);
      const StepReport report = solveStatic(model, s, supports, {}, no_force, state, workspace, {});
      EXPECT_TRUE(report.converged);
      iterations = report.iterations;
      return state.x;
    };
    int plain = 0, iterations = 0;
    const NodalField expected = solve(Kind::BLOCK_JACOBI, plain);
    EXPECT_GT((expected.matrix() - model.rest.matrix()).colwise().norm().maxCoeff(), 0.3);
    for (const Kind kind : KINDS)
    {
      EXPECT_LT((solve(kind, iterations).matrix() - expected.matrix()).colwise().norm().maxCoeff(), 1e-5);
      EXPECT_LT(3 * iterations, plain) << poisson;
    }
  }
}

TEST_P(Newton, MultigridStepsAreTheSameAfterAResetAndForAnyNumberOfThreads)
{
  StepSettings s = settings(1e-6);
  s.gravity = {30, 0, 0};
  s.solver.preconditioner = Kind::PMULTIGRID;
  const Supports supports = test::holdFoot(model);
  Workspace one(model, s, 1), three(model, s, 3);
  const auto run = [&](Workspace& workspace) {
    State state = startState(model, s, supports, model.rest, Vector3d::Zero(), workspace);
    for (int k = 0; k < 10; ++k) implicitEulerStep(model, s, supports, {}, no_force, state, workspace);
    return state.x;
  };
  const NodalField first = run(one);
  EXPECT_EQ((run(one).matrix() - first.matrix()).cwiseAbs().maxCoeff(), 0);
  EXPECT_EQ((run(three).matrix() - first.matrix()).cwiseAbs().maxCoeff(), 0);
}

TEST_P(Newton, MultigridStepsFromALineDoNotKnowOfTheStateBefore)
{
  // The elements of a body that is squeezed into a line may be turned about it at will: the rotations that make the
  // preconditioner are those nearest to the last ones, which after a reset are not those of another state.
  StepSettings s = settings(1e-6);
  s.solver.preconditioner = Kind::PMULTIGRID;
  NodalField line = model.rest, turned = model.rest;
  line.matrix().topRows<2>().setZero();
  turned.matrix().topRows<3>() =
      Eigen::AngleAxisd(2, Vector3d(1, 2, 3).normalized()).toRotationMatrix() * turned.matrix().topRows<3>();
  const Supports supports = test::holdNothing(model);
  Workspace workspace(model, s, 1);
  const auto run = [&](const NodalField& x) {
    State state = startState(model, s, supports, x, Vector3d::Zero(), workspace);
    const StepReport report = implicitEulerStep(model, s, supports, {}, no_force, state, workspace);
    EXPECT_TRUE(report.finite);
    EXPECT_EQ(report.preconditioner, Kind::PMULTIGRID);
    return state.x;
  };
  const NodalField first = run(line);
  EXPECT_GT((first.matrix() - line.matrix()).cwiseAbs().maxCoeff(), 0.1);
  run(turned);
  EXPECT_EQ((run(line).matrix() - first.matrix()).cwiseAbs().maxCoeff(), 0);
}

TEST_P(Newton, ThreadsChangeNothingButRounding)
{
  const StepSettings s = settings(1e-9);
  const Supports supports = test::holdFoot(model);
  Workspace one(model, s, 1), two(model, s, 2), again(model, s, 2);
  State a = startState(model, s, supports, model.rest, Vector3d::Zero(), one), b = a, c = a;
  for (int k = 0; k < 5; ++k)
  {
    implicitEulerStep(model, s, supports, {}, no_force, a, one);
    implicitEulerStep(model, s, supports, {}, no_force, b, two);
    implicitEulerStep(model, s, supports, {}, no_force, c, again);
  }
  EXPECT_LT((a.x.matrix() - b.x.matrix()).cwiseAbs().maxCoeff(), 1e-8);
  EXPECT_EQ((b.x.matrix() - c.x.matrix()).cwiseAbs().maxCoeff(), 0);
}

TEST(IndefiniteSystems, AreToldOf)
{
  // Squeezed along its axis, a slender body's own tangent has directions of negative curvature, along which it
  // buckles, though no block of its diagonal shows it; the projected one has none.
  const Model model = test::boxModel(test::kuhnBox({1, 1, 6}, {0.1, 0.1, 1}), Element::QUADRATIC);
  const Partition partition(model, 1);
  NodalField x = model.rest;
  x.matrix().row(2) *= 0.9;
  const NodalField b = test::randomField(model.num_nodes, 4);
  HeldAxes held(model.num_nodes, 0);
  for (const bool projected : {false, true})
  {
    GreenTangent tangent(model);
    linearise(model, partition, x, projected ? Projection::POSITIVE_STRESS : Projection::NONE, tangent);
    const MatrixFreeSystem<GreenTangent> system(model, partition, tangent, 1e-3, 1);
    ConjugateGradient solver(model, partition);
    EXPECT_TRUE(solver.prepare(system, model, partition, held, 0));
    NodalField u(model.num_nodes);
    const SolveReport report = solver.solve(system, partition, b, u, 1e-8, 5000);
    EXPECT_EQ(report.indefinite, !projected);
    EXPECT_EQ(report.converged, projected);
  }
  x.matrix() *= 0.3;
  GreenTangent tangent(model);
  linearise(model, partition, x, Projection::NONE, tangent);
  ConjugateGradient solver(model, partition);
  EXPECT_FALSE(
      solver.prepare(MatrixFreeSystem<GreenTangent>(model, partition, tangent, 1e-3, 1), model, partition, held, 0));
}

}  // namespace
}  // namespace bezier_fem
