// Which preconditioner a scene's systems get, and what of it is kept from step to step.

#include "linear_solve.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <limits>

#include "bezier_fem/element_operator.h"
#include "bezier_fem/green_strain.h"
#include "bezier_fem/p_multigrid.h"
#include "bezier_fem/refine.h"
#include "core/bar.h"
#include "turned_inverse.h"

namespace bezier_fem
{
namespace
{
using Eigen::Vector3d;
using Kind = Scene::Solver::Preconditioner;

constexpr Material STIFF{2e6, 0.45, 500};

StepSettings settingsOf(Elasticity elasticity, Kind preconditioner, double tolerance = 1e-4)
{
  StepSettings settings{0.02, elasticity, RotationRule::FROM_CORNERS, {0, 0}, {0, -9.81, 0}, {}};
  settings.solver.preconditioner = preconditioner;
  settings.solver.tolerance = tolerance;
  settings.solver.max_iterations = 5000;
  return settings;
}

/** A bar that is held at its foot and falls to its side. */
struct Bar
{
  Model model;
  StepSettings settings;
  Supports supports;
  NodalField no_force;
  Workspace workspace;
  State state;

  explicit Bar(const StepSettings& with, Element element = Element::QUADRATIC, int threads = 1,
               const Eigen::Vector3i& cells = {3, 3, 6})
      : Bar(with, test::irregularBox(cells, {0.4, 0.4, 1.0}), element, threads)
  {
  }
  Bar(const StepSettings& with, const TetMesh& mesh, Element element, int threads)
      : model(test::boxModel(mesh, element, STIFF)),
        settings(with),
        supports(test::holdFoot(model, model.rest)),
        no_force(model.num_nodes),
        workspace(model, settings, threads),
        state(startState(model, settings, supports, model.rest, Vector3d::Zero(), workspace))
  {
  }
  /** Keeps what steps would make for themselves, but for how. */
  void multigrid(bool factored)
  {
    workspace.preconditioner = std::make_unique<PMultigrid>(model, workspace.partition, factored);
    workspace.preconditioner_kind = Kind::PMULTIGRID;
  }
  StepReport step()
  {
    const StepReport report = implicitEulerStep(model, settings, supports, {}, no_force, state, workspace);
    EXPECT_TRUE(report.converged);
    EXPECT_LE(report.residual, settings.solver.tolerance);
    return report;
  }
};

double distance(const Bar& a, const Bar& b)
{
  return (a.state.x.matrix() - b.state.x.matrix()).colwise().norm().maxCoeff();
}

TEST(LinearSolve, EveryPreconditionerGivesTheSameMotion)
{
  for (const Elasticity elasticity : {Elasticity::COROTATED, Elasticity::LINEAR})
  {
    for (const Element element : {Element::LINEAR, Element::QUADRATIC})
    {
      Bar reference(settingsOf(elasticity, Kind::BLOCK_JACOBI, 1e-9), element);
      for (int k = 0; k < 10; ++k) EXPECT_EQ(reference.step().preconditioner, Kind::BLOCK_JACOBI);
      for (const Kind kind : {Kind::PMULTIGRID, Kind::DIRECT})
      {
        Bar bar(settingsOf(elasticity, kind, 1e-9), element);
        for (int k = 0; k < 10; ++k) EXPECT_EQ(bar.step().preconditioner, kind);
        EXPECT_LT(distance(bar, reference), 1e-7);
      }
    }
  }
}

TEST(LinearSolve, AggregatesGiveTheMotionOfTheFactorAndStandForItInLargeBodies)
{
  // Below and above the vertices up to which multigrid factors.
  struct
  {
    Element element;
    Eigen::Vector3i cells;
    bool large;
  } const cases[] = {{Element::LINEAR, {5, 5, 8}, false},
                     {Element::QUADRATIC, {3, 3, 6}, false},
                     {Element::LINEAR, {10, 10, 44}, true},
                     {Element::QUADRATIC, {8, 8, 40}, true}};
  for (const auto& c : cases)
  {
    for (const Elasticity elasticity : {Elasticity::COROTATED, Elasticity::LINEAR})
    {
      if (c.large && elasticity == Elasticity::LINEAR) continue;
      SCOPED_TRACE(testing::Message() << test::name(c.element) << (c.large ? ", large" : ", small"));
      const StepSettings settings = settingsOf(elasticity, Kind::PMULTIGRID, c.large ? 1e-7 : 1e-9);
      Bar factored(settings, c.element, 2, c.cells), aggregated(settings, c.element, 2, c.cells);
      Bar chosen(settings, c.element, 2, c.cells);
      factored.multigrid(true);
      aggregated.multigrid(false);
      int by_factor = 0, by_aggregates = 0;
      for (int k = 0; k < (c.large ? 2 : 10); ++k)
      {
        EXPECT_EQ(chosen.step().preconditioner, Kind::PMULTIGRID);
        by_factor += factored.step().iterations;
        by_aggregates += aggregated.step().iterations;
      }
      EXPECT_LT(by_factor, by_aggregates);
      EXPECT_LT(distance(aggregated, factored), c.large ? 1e-6 : 1e-7);
      EXPECT_GT(distance(aggregated, factored), 0);
      EXPECT_EQ(distance(chosen, c.large ? aggregated : factored), 0);
      EXPECT_GT((chosen.state.x.matrix() - chosen.model.rest.matrix()).norm(), 1e-2);
    }
  }
}

TEST(LinearSolve, ARefinedBarMovesTheSameWithAggregates)
{
  StepSettings settings = settingsOf(Elasticity::COROTATED, Kind::PMULTIGRID, 1e-8);
  for (const Element element : {Element::LINEAR, Element::QUADRATIC})
  {
    const TetMesh mesh = refined(test::irregularBox({2, 2, 5}, {0.4, 0.4, 1.0}), element == Element::LINEAR ? 2 : 1);
    Bar factored(settings, mesh, element, 1), aggregated(settings, mesh, element, 2);
    factored.multigrid(true);
    aggregated.multigrid(false);
    // It turns over, and what was made for it at rest has to follow.
    for (int k = 0; k < 15; ++k)
    {
      factored.step();
      aggregated.step();
    }
    EXPECT_LT(distance(aggregated, factored), 1e-6);
  }
}

TEST(LinearSolve, StepsAreTheSameToTheBitForAnyNumberOfThreads)
{
  for (const Element element : {Element::LINEAR, Element::QUADRATIC})
  {
    // Several chunks of nodes, the last one not full.
    const Eigen::Vector3i cells = element == Element::LINEAR ? Eigen::Vector3i(6, 6, 10) : Eigen::Vector3i(3, 3, 6);
    for (const bool aggregated : {false, true})
    {
      const StepSettings settings = settingsOf(Elasticity::COROTATED, Kind::PMULTIGRID);
      Bar one(settings, element, 1, cells), two(settings, element, 2, cells), three(settings, element, 3, cells);
      for (Bar* bar : {&one, &two, &three}) bar->multigrid(!aggregated);
      for (int k = 0; k < 3; ++k)
      {
        one.step();
        for (Bar* bar : {&two, &three})
        {
          bar->step();
          EXPECT_TRUE((bar->state.x.matrix().array() == one.state.x.matrix().array()).all());
        }
      }
    }
    for (const Kind kind : {Kind::BLOCK_JACOBI, Kind::PMULTIGRID, Kind::DIRECT})
    {
      for (const auto system : {Scene::Solver::Operator::MATRIX_FREE, Scene::Solver::Operator::ASSEMBLED})
      {
        SCOPED_TRACE(testing::Message() << test::name(element) << ", preconditioner " << static_cast<int>(kind)
                                        << ", operator " << static_cast<int>(system));
        if (system == Scene::Solver::Operator::ASSEMBLED && kind != Kind::BLOCK_JACOBI) continue;
        StepSettings settings = settingsOf(Elasticity::COROTATED, kind);
        settings.solver.system_operator = system;
        Bar one(settings, element, 1, cells);
        ASSERT_GE(one.workspace.partition.numChunks(), 3);
        ASSERT_NE(one.model.num_nodes % Partition::CHUNK, 0);
        Bar two(settings, element, 2, cells), three(settings, element, 3, cells);
        ASSERT_EQ(three.workspace.partition.threads(), 3);
        for (int k = 0; k < 3; ++k)
        {
          EXPECT_EQ(one.step().preconditioner, kind);
          for (Bar* bar : {&two, &three})
          {
            bar->step();
            EXPECT_TRUE((bar->state.x.matrix().array() == one.state.x.matrix().array()).all());
            EXPECT_TRUE((bar->state.v.matrix().array() == one.state.v.matrix().array()).all());
          }
        }
      }
    }
  }
}

TEST(LinearSolve, BodiesOfFewBlocksAndWhateverIsHeldAreStepped)
{
  // One block of elements and several, of fewer chunks of nodes than pieces; threads that there is no work for.
  enum class Held
  {
    NOTHING,
    FOOT,
    ALL
  };
  const auto supportsOf = [](const Model& model, Held held) {
    return test::hold(model,
                      [&](const Vector3d& X) { return held == Held::ALL || (held == Held::FOOT && X.z() < 1e-9); });
  };
  for (const Eigen::Vector3i& cells : {Eigen::Vector3i(1, 1, 1), Eigen::Vector3i(1, 1, 3), Eigen::Vector3i(1, 2, 6)})
  {
    for (const Element element : {Element::LINEAR, Element::QUADRATIC})
    {
      const Model model = test::boxModel(test::irregularBox(cells, {0.4, 0.4, 1.0}), element, STIFF);
      const NodalField none(model.num_nodes);
      for (const Elasticity elasticity : {Elasticity::COROTATED, Elasticity::LINEAR})
      {
        for (const Kind kind : {Kind::AUTO, Kind::BLOCK_JACOBI, Kind::PMULTIGRID, Kind::DIRECT})
        {
          for (const Held held : {Held::NOTHING, Held::FOOT, Held::ALL})
          {
            for (const double gravity : {0.0, -9.81})
            {
              SCOPED_TRACE(testing::Message()
                           << model.num_tets << " tets, " << test::name(element) << ", elasticity "
                           << static_cast<int>(elasticity) << ", preconditioner " << static_cast<int>(kind) << ", held "
                           << static_cast<int>(held) << ", gravity " << gravity);
              StepSettings settings = settingsOf(elasticity, kind);
              settings.gravity = {0, gravity, 0};
              const Supports supports = supportsOf(model, held);
              for (const auto step : {implicitEulerStep, sdirk2Step})
              {
                NodalField first;
                for (const int threads : {1, 2, 3, 8})
                {
                  Workspace w(model, settings, threads);
                  ASSERT_EQ(w.partition.threads(), std::min(threads, model.num_blocks));
                  State state = startState(model, settings, supports, model.rest, Vector3d::Zero(), w);
                  for (int k = 0; k < 4; ++k)
                  {
                    const StepReport report = step(model, settings, supports, {}, none, state, w);
                    EXPECT_TRUE(report.converged && report.finite);
                  }
                  if (threads == 1) first = state.x;
                  EXPECT_EQ((state.x.matrix() - first.matrix()).cwiseAbs().maxCoeff(), 0) << threads;
                }
                const double moved = (first.matrix() - model.rest.matrix()).cwiseAbs().maxCoeff();
                if (held == Held::ALL)
                {
                  EXPECT_EQ(moved, 0);
                }
                else if (gravity == 0)
                {
                  EXPECT_LT(moved, 1e-12);
                }
                else
                {
                  EXPECT_GT(moved, 1e-6);
                }
              }
            }
          }
        }
      }
    }
  }
}

TEST(LinearSolve, ToleranceIsMetByTheTrueResidualInDoublePrecision)
{
  for (const Element element : {Element::LINEAR, Element::QUADRATIC})
  {
    for (const Kind kind : {Kind::BLOCK_JACOBI, Kind::PMULTIGRID, Kind::DIRECT})
    {
      for (const double tolerance : {1e-2, 1e-4, 1e-8, 1e-12})
      {
        Bar bar(settingsOf(Elasticity::COROTATED, kind, tolerance), element);
        const double h = bar.settings.time_step;
        NodalField residual(bar.model.num_nodes);
        // The first one starts from nothing, later ones from what was.
        for (int k = 0; k < 8; ++k)
        {
          const Rotations rotations = bar.state.rotations;
          bar.step();
          systemProduct(bar.model, bar.workspace.partition, rotations, 1, h * h, bar.workspace.change, residual);
          residual.matrix() = bar.workspace.rhs.matrix() - residual.matrix();
          EXPECT_LE(bar.workspace.solver.relativeNorm(bar.workspace.partition, residual, bar.workspace.rhs),
                    1.001 * tolerance + 1e-15)
              << test::name(element) << ", preconditioner " << static_cast<int>(kind) << ", step " << k;
        }
      }
    }
  }
}

TEST(LinearSolve, AStiffBodyThatFallsStartsFromWhereItEnds)
{
  // Each step as the one before: what starts are made with must not strain it by its motion's rounding.
  for (const double young : {2e6, 2e9, 2e11})
  {
    StepSettings settings = settingsOf(Elasticity::COROTATED, Kind::PMULTIGRID);
    Bar bar(settings);
    setMaterials(bar.model, std::vector<Material>(bar.model.num_tets, {young, 0.3, 1000}));
    bar.supports = test::holdNothing(bar.model);
    int iterations = 0;
    for (int k = 0; k < 50; ++k) iterations += bar.step().iterations;
    EXPECT_LE(iterations, 100) << young;
    for (int i = 0; i < bar.model.num_nodes; ++i)
    {
      EXPECT_LT((bar.state.v[i] - Vector3d(0, -9.81, 0)).norm(), 1e-3);
    }
  }
}

TEST(LinearSolve, LedBodiesMoveTheSameWithStartsInSinglePrecision)
{
  // Carried, turned and stopped, by the steps of one stage and of two.
  const std::vector<MotionSample> motion{
      {0, {0, 0, 0}, {0, 0, 0, 1}}, {0.3, {0.2, 0.1, 0}, {0, 0, 0.28, 0.96}}, {0.5, {0, 0, 0}, {0, 0, 0.28, 0.96}}};
  for (const auto step : {implicitEulerStep, sdirk2Step})
  {
    const auto run = [&](Kind kind, bool forget, int& iterations) {
      Bar bar(settingsOf(Elasticity::COROTATED, kind, 1e-9));
      bar.supports = test::holdFoot(bar.model, motion);
      iterations = 0;
      for (int k = 0; k < 30; ++k)
      {
        if (forget) bar.workspace.history = 0;
        const StepReport report =
            step(bar.model, bar.settings, bar.supports, {}, bar.no_force, bar.state, bar.workspace);
        EXPECT_TRUE(report.converged);
        EXPECT_LE(report.residual, 1e-9);
        iterations += report.iterations;
      }
      return bar.state.x;
    };
    int plain = 0, started = 0, from_nothing = 0;
    const NodalField expected = run(Kind::BLOCK_JACOBI, false, plain);
    const NodalField x = run(Kind::PMULTIGRID, false, started);
    run(Kind::PMULTIGRID, true, from_nothing);
    EXPECT_LT((x.matrix() - expected.matrix()).colwise().norm().maxCoeff(), 1e-7);
    EXPECT_LT(started, from_nothing);
    EXPECT_LT(3 * started, plain);
  }
}

TEST(LinearSolve, WhatIsMadeOfALikeSystemOnlyPreconditions)
{
  // Of Green's strain, stretched by a twentieth. What multigrid solves by itself is the co-rotated system, and goes
  // astray: it takes twice the iterations; nor is its product that of the system, to start with.
  Bar bar(settingsOf(Elasticity::GREEN, Kind::PMULTIGRID));
  Workspace& w = bar.workspace;
  NodalField x = bar.model.rest, residual(bar.model.num_nodes);
  x.matrix().row(2) *= 1.05;
  GreenTangent tangent(bar.model);
  linearise(bar.model, w.partition, x, Projection::POSITIVE_STRESS, tangent);
  const MatrixFreeSystem<GreenTangent> system(bar.model, w.partition, tangent, 1, 4e-4);
  w.solver.prepare(system, bar.model, w.partition, bar.supports.held, 0);
  w.rhs = test::randomField(bar.model.num_nodes, 3);
  const auto iterations = [&](Likeness likeness, double tolerance) {
    StepReport report;
    int starts = 0;
    const SolveReport solved = solvePreconditioned(
        bar.model, bar.settings, bar.supports, restRotations(bar.model), likeness, system, 1, 4e-4, tolerance, 5000,
        Serves::SAME_COEFFICIENTS,
        [&](Preconditioner* rough) {
          EXPECT_EQ(rough == nullptr, likeness == Likeness::LIKE);
          w.change.setZero();
          ++starts;
        },
        w, report);
    EXPECT_EQ(starts, 1);
    EXPECT_TRUE(solved.converged);
    EXPECT_EQ(solved.iterations, report.iterations);
    system.product(w.change, residual);
    residual.matrix() = w.rhs.matrix() - residual.matrix();
    const double truth = w.solver.relativeNorm(w.partition, residual, w.rhs);
    EXPECT_LE(truth, tolerance);
    EXPECT_NEAR(solved.residual, truth, 1e-6 * truth);
    return solved.iterations;
  };
  for (const double tolerance : {1e-2, 1e-4})
  {
    const int like = iterations(Likeness::LIKE, tolerance), same = iterations(Likeness::SAME, tolerance);
    EXPECT_LT(3 * like, 2 * same) << tolerance;
  }
}

TEST(LinearSolve, LinearElasticityIsFactoredOnceAndHardlyIterates)
{
  Bar bar(settingsOf(Elasticity::LINEAR, Kind::AUTO));
  for (int k = 0; k < 50; ++k)
  {
    const StepReport report = bar.step();
    EXPECT_EQ(report.preconditioner, Kind::DIRECT);
    EXPECT_LE(report.iterations, 2) << "step " << k;
  }
  const Preconditioner* kept = bar.workspace.preconditioner.get();
  bar.step();
  EXPECT_EQ(bar.workspace.preconditioner.get(), kept);
}

TEST(LinearSolve, LinearElasticityFollowsWhateverChangesItsSystem)
{
  enum Change
  {
    MATERIAL,
    DAMPING,
    TIME_STEP,
    SUPPORTS,
    EQUILIBRIUM,
    EXPLICIT_STEP
  };
  for (const Change change : {MATERIAL, DAMPING, TIME_STEP, SUPPORTS, EQUILIBRIUM, EXPLICIT_STEP})
  {
    // One bar remembers; the other one's memory is new for the last step.
    Bar bar(settingsOf(Elasticity::LINEAR, Kind::AUTO, 1e-9));
    for (int k = 0; k < 5; ++k) bar.step();
    const std::vector<Material> soft(bar.model.num_tets, {2e4, 0.3, 900});
    switch (change)
    {
      case MATERIAL:
        setMaterials(bar.model, soft);
        bar.workspace.forgetMaterials();
        break;
      case DAMPING:
        bar.settings.damping = {3, 0.01};
        break;
      case TIME_STEP:
        bar.settings.time_step = 0.005;
        break;
      case SUPPORTS:
        bar.supports.held[bar.model.num_nodes - 1] |= 1;
        bar.workspace.history = 0;  // the last changes do not hold it
        break;
      case EQUILIBRIUM:
        solveStatic(bar.model, bar.settings, bar.supports, {}, bar.no_force, bar.state, bar.workspace, {});
        bar.settings.gravity = {0, 0, 9.81};
        break;
      case EXPLICIT_STEP:
        explicitStep(bar.model, bar.settings, bar.supports, {}, bar.no_force, bar.state, bar.workspace);
        break;
    }
    Workspace anew(bar.model, bar.settings, 1);
    State state = bar.state;
    EXPECT_TRUE(implicitEulerStep(bar.model, bar.settings, bar.supports, {}, bar.no_force, state, anew).converged);
    const StepReport report = bar.step();
    EXPECT_EQ(report.preconditioner, Kind::DIRECT);
    EXPECT_LE(report.iterations, 5) << change;
    EXPECT_LT((bar.state.x.matrix() - state.x.matrix()).colwise().norm().maxCoeff(), 1e-8) << change;
  }
}

TEST(LinearSolve, AFactorIsRenewedWhenExcessIterationsHavePaidForIt)
{
  const Model model = test::boxModel(test::irregularBox({1, 1, 2}, {0.4, 0.4, 1.0}), Element::QUADRATIC, STIFF);
  TurnedInverse factor(model, 1, TurnedInverse::Form::FACTOR);
  const Rotations rest = restRotations(model);
  const HeldAxes held(model.num_nodes, 0);
  EXPECT_FALSE(factor.valid());
  ASSERT_TRUE(factor.make(rest, rest, held, 1, 4e-4));
  EXPECT_TRUE(factor.isOf(held, 1, 4e-4));
  EXPECT_FALSE(factor.isOf(held, 1, 5e-4));
  EXPECT_FALSE(factor.isOf(HeldAxes(model.num_nodes, 1), 1, 4e-4));
  for (const int iterations : {3, 3, 7, 3, 9})  // 4 and 6 in excess of 3
  {
    factor.took(iterations, 10);
    EXPECT_TRUE(factor.valid());
  }
  EXPECT_EQ(factor.patience(10), 4);
  factor.took(4, 10);
  EXPECT_FALSE(factor.valid());
}

TEST(LinearSolve, NegativeCurvatureEndsASolveThatOtherwiseGoesOnWithMultigrid)
{
  // A slender bar squeezed along its axis: its own tangent has directions along which it buckles. What the diagonal
  // blocks have reached until one is met leads downhill, which is all that Newton's method asks for. Its residual is
  // larger than that of zero, from where multigrid would begin, and with multigrid the first direction is such a one.
  const StepSettings settings = settingsOf(Elasticity::GREEN, Kind::AUTO);
  const Model model = test::boxModel(test::kuhnBox({1, 1, 6}, {0.1, 0.1, 1}), Element::QUADRATIC);
  const Supports supports = test::holdNothing(model);
  NodalField x = model.rest;
  x.matrix().row(2) *= 0.9;
  constexpr double ALPHA = 1e-3, BETA = 1, TOLERANCE = 1e-8;
  for (const Projection projection : {Projection::NONE, Projection::POSITIVE_STRESS})
  {
    const bool indefinite = projection == Projection::NONE;
    for (const Serves serves : {Serves::ONCE, Serves::SAME_COEFFICIENTS})
    {
      Workspace w(model, settings, 1);
      GreenTangent tangent(model);
      linearise(model, w.partition, x, projection, tangent);
      const MatrixFreeSystem<GreenTangent> system(model, w.partition, tangent, ALPHA, BETA);
      ASSERT_TRUE(w.solver.prepare(system, model, w.partition, supports.held, 0));
      w.rhs = test::randomField(model.num_nodes, 4);
      NodalField expected(model.num_nodes);
      const SolveReport plain = w.solver.solve(system, w.partition, w.rhs, expected, TOLERANCE, 5000);

      StepReport report;
      w.change.setZero();
      const SolveReport solved = solvePreconditioned(
          model, settings, supports, restRotations(model), Likeness::LIKE, system, ALPHA, BETA, TOLERANCE, 5000, serves,
          [](Preconditioner*) {}, w, report);
      EXPECT_EQ(solved.indefinite, indefinite);
      EXPECT_EQ(solved.converged, !indefinite);
      EXPECT_EQ(solved.iterations, report.iterations);
      EXPECT_EQ(report.preconditioner, indefinite ? Kind::BLOCK_JACOBI : Kind::PMULTIGRID);
      EXPECT_EQ(w.preconditioner == nullptr, indefinite);
      EXPECT_GT(w.change.matrix().cwiseProduct(w.rhs.matrix()).sum(), 0);
      if (indefinite)
      {
        EXPECT_EQ(solved.iterations, plain.iterations);
        EXPECT_EQ((w.change.matrix() - expected.matrix()).cwiseAbs().maxCoeff(), 0);
      }
    }
  }
}

class Turned : public testing::TestWithParam<TurnedInverse::Form>
{
};
INSTANTIATE_TEST_SUITE_P(Forms, Turned, testing::Values(TurnedInverse::Form::FACTOR, TurnedInverse::Form::AGGREGATION),
                         [](const auto& p) {
                           return std::string(p.param == TurnedInverse::Form::FACTOR ? "factor" : "aggregation");
                         });

TEST_P(Turned, TurnsWithTheBodyAndLeavesOutWhatIsHeld)
{
  const Model model = test::boxModel(test::irregularBox({2, 2, 4}, {0.4, 0.4, 1.0}), Element::QUADRATIC, STIFF);
  const int n = model.num_nodes;
  const Rotations rest = restRotations(model);
  const NodalField b = test::randomField(n, 3);
  const Eigen::Matrix3d Q = Eigen::AngleAxisd(2, Vector3d(1, 2, 3).normalized()).toRotationMatrix();
  Rotations turned = rest;
  const auto lanesOf = [&](AlignedVector<double>& blocks, const Eigen::Matrix3d& m, bool columns) {
    for (std::size_t k = 0; k < blocks.size(); ++k)
    {
      const std::size_t entry = k / LANES % 9;
      const double* from = (columns ? rest.gradients : rest.matrices).data() + (k - entry * LANES);
      blocks[k] = 0;
      // Rotations by rows, gradients by columns.
      for (std::size_t j = 0; j < 3; ++j)
      {
        blocks[k] += columns ? m(entry % 3, j) * from[(entry / 3 * 3 + j) * LANES]
                             : m(entry / 3, j) * from[(3 * j + entry % 3) * LANES];
      }
    }
  };
  lanesOf(turned.matrices, Q, false);
  lanesOf(turned.gradients, Q, true);

  for (const bool foot : {false, true})
  {
    HeldAxes held(n, 0);
    for (int i = 0; foot && i < n; ++i) held[i] = model.rest[i].z() < 1e-9 ? i % 8 : 0;
    TurnedInverse at_rest(model, 1, GetParam()), anew(model, 1, GetParam());
    ASSERT_TRUE(at_rest.make(rest, rest, held, 1, 4e-4));
    ASSERT_TRUE(anew.make(turned, turned, held, 1, 4e-4));
    const auto solve = [&](TurnedInverse& factor, float in_held) {
      const float* left = factor.solve([&](const int* nodes, int count) {
        for (int k = 0; k < count; ++k)
        {
          const int i = nodes[k];
          for (int axis = 0; axis < 3; ++axis)
          {
            factor.right()[4 * i + axis] = held[i] >> axis & 1 ? in_held : static_cast<float>(b[i][axis]);
          }
          factor.right()[4 * i + 3] = in_held;
        }
      });
      return Eigen::MatrixXf(Eigen::Map<const Eigen::MatrixXf>(left, 4, n));
    };
    at_rest.turn(turned);
    anew.turn(turned);
    const Eigen::MatrixXf expected = solve(anew, 0), served = solve(at_rest, 0);
    // Turned as a whole, a free body's system is the one at rest, turned.
    if (!foot)
    {
      // A cycle's largest eigenvalue is estimated from another random field.
      EXPECT_LT((served - expected).norm(),
                (GetParam() == TurnedInverse::Form::FACTOR ? 1e-4 : 2e-2) * expected.norm());
    }
    for (TurnedInverse* factor : {&at_rest, &anew})
    {
      const Eigen::MatrixXf left = solve(*factor, std::numeric_limits<float>::quiet_NaN());
      EXPECT_EQ(left, factor == &anew ? expected : served);
      for (int i = 0; i < n; ++i)
      {
        for (int axis = 0; axis < 3; ++axis)
        {
          if (held[i] >> axis & 1)
          {
            EXPECT_EQ(left(axis, i), 0);
          }
        }
        EXPECT_EQ(left(3, i), 0);
      }
    }
  }
}

}  // namespace
}  // namespace bezier_fem
