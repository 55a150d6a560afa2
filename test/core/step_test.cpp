#include "bezier_fem/step.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <atomic>
#include <cstdlib>
#include <new>
#include <utility>

#include "bezier_fem/element_operator.h"
#include "bezier_fem/measures.h"
#include "bezier_fem/p_multigrid.h"
#include "core/bar.h"

namespace
{
// Every way of asking for memory ends in malloc(); counted while `counting` is set, whatever thread asks.
std::atomic<bool> counting = false;
std::atomic<long> allocations = 0;
}  // namespace

extern "C" void* __libc_malloc(std::size_t size);
extern "C" void* __libc_memalign(std::size_t alignment, std::size_t size);
extern "C" void* malloc(std::size_t size)
{
  if (counting) ++allocations;
  return __libc_malloc(size);
}
extern "C" void* aligned_alloc(std::size_t alignment, std::size_t size)
{
  if (counting) ++allocations;
  return __libc_memalign(alignment, size);
}

namespace bezier_fem
{
namespace
{
using Eigen::MatrixXd;
using Eigen::Vector3d;
using Eigen::VectorXd;
using test::hold;
using test::holdFoot;
using test::holdNothing;

constexpr double DT = 0.02;

StepSettings settings(Elasticity elasticity = Elasticity::COROTATED)
{
  return {DT, elasticity, RotationRule::FROM_CORNERS, {0, 0}, {0, -9.81, 0}, {1e-10, 5000}};
}

Vector3d momentum(const Model& model, const NodalField& v)
{
  Vector3d sum = Vector3d::Zero();
  for (int i = 0; i < model.num_nodes; ++i) sum += model.node_mass[i] * v[i];
  return sum;
}

class Stepping : public testing::TestWithParam<Element>
{
protected:
  Model model = test::boxModel(test::irregularBox({2, 2, 4}, {0.4, 0.4, 1.0}), GetParam());
  Workspace workspace{model, settings(), 1};
  NodalField no_force{model.num_nodes};
};
INSTANTIATE_TEST_SUITE_P(Elements, Stepping, testing::Values(Element::LINEAR, Element::QUADRATIC),
                         [](const auto& p) { return std::string(test::name(p.param)); });

TEST_P(Stepping, IsTheFormulaSolvedDirectly)
{
  // (M + dt^2 K' + dt D) dv = dt (f_ext - f_el(x) - dt K' v - D v), by a dense factorisation.
  StepSettings s = settings();
  s.damping = {0.7, 0.01};
  const Supports supports = holdFoot(model);
  State state = startState(model, s, supports, model.rest, Vector3d::Zero(), workspace);
  for (int k = 0; k < 10; ++k) implicitEulerStep(model, s, supports, {}, no_force, state, workspace);
  const State before = state;

  const int n = model.num_nodes;
  const auto dense = [&](double alpha, double beta) {
    MatrixXd A(3L * n, 3L * n);
    NodalField unit(n), column(model.num_nodes);
    for (int j = 0; j < 3 * n; ++j)
    {
      unit.setZero();
      unit[j / 3][j % 3] = 1;
      systemProduct(model, workspace.partition, before.rotations, alpha, beta, unit, column);
      for (int i = 0; i < n; ++i) A.block<3, 1>(3L * i, j) = column[i];
    }
    return A;
  };
  const auto flat = [&](const NodalField& f) { return VectorXd(MatrixXd(f.matrix().topLeftCorner(3, n)).reshaped()); };
  const MatrixXd M = dense(1, 0), K = dense(0, 1);
  const MatrixXd D = s.damping.mass * M + s.damping.stiffness * K;
  NodalField elastic(n);
  elasticForce(model, workspace.partition, before.rotations, before.x, elastic);
  const VectorXd v = flat(before.v);
  VectorXd external(3L * n);
  for (int i = 0; i < n; ++i) external.segment<3>(3L * i) = model.node_mass[i] * s.gravity;
  MatrixXd A = M + DT * DT * K + DT * D;
  VectorXd b = DT * (external - flat(elastic) - DT * K * v - D * v);
  for (int i = 0; i < 3 * n; ++i)
  {
    if (supports.held[i / 3] == 0) continue;
    A.row(i).setZero();
    A.col(i).setZero();
    A(i, i) = 1;
    b[i] = 0;
  }
  const VectorXd expected = A.ldlt().solve(b);

  const StepReport report = implicitEulerStep(model, s, supports, {}, no_force, state, workspace);
  EXPECT_EQ(report.substeps, 1);
  EXPECT_TRUE(report.converged);
  EXPECT_LT((flat(state.v) - v - expected).norm(), 1e-8 * expected.norm());
  EXPECT_LT((flat(state.x) - flat(before.x) - DT * flat(state.v)).norm(), 1e-14);
  EXPECT_EQ(state.time, 11 * DT);
}

TEST_P(Stepping, FreeFallIsExactAndKeepsItsShape)
{
  const Supports supports = holdNothing(model);
  State state = startState(model, settings(), supports, model.rest, Vector3d(0.3, 0, 0.1), workspace);
  for (int k = 1; k <= 50; ++k)
  {
    implicitEulerStep(model, settings(), supports, {}, no_force, state, workspace);
    const Vector3d v = Vector3d(0.3, 0, 0.1) + k * DT * settings().gravity;
    for (int i = 0; i < model.num_nodes; ++i) ASSERT_LT((state.v[i] - v).norm(), 1e-8);
  }
  EXPECT_LT(elasticEnergy(model, state.rotations, state.x), 1e-12);
}

TEST_P(Stepping, InnerForcesKeepLinearMomentum)
{
  StepSettings s = settings();
  s.gravity.setZero();
  const Supports supports = holdNothing(model);
  NodalField x = model.rest;
  x.matrix() += 0.02 * test::randomField(model.num_nodes, 3).matrix();
  State state = startState(model, s, supports, x, Vector3d(0.1, 0.2, 0.3), workspace);
  const Vector3d start = momentum(model, state.v);
  double largest = 0;
  for (int k = 0; k < 50; ++k)
  {
    implicitEulerStep(model, s, supports, {}, no_force, state, workspace);
    largest = std::max(largest, kineticEnergy(model, state.v));
    ASSERT_LT((momentum(model, state.v) - start).norm(), 1e-7 * start.norm());
  }
  EXPECT_GT(largest, 1.001 * start.squaredNorm() / 2 / model.mass());  // it did move inside
}

TEST_P(Stepping, EveryStepStartsFromTheLastTwo)
{
  // Also those whose ends are, for rounding, less than a time step apart: 0.06 - 0.04 < 0.02. All falling steps change
  // v alike, so that the third has nothing left to solve.
  const Supports supports = holdNothing(model);
  StepSettings s = settings();
  s.solver.tolerance = 1e-6;
  State state = startState(model, s, supports, model.rest, Vector3d::Zero(), workspace);
  int first = 0;
  for (int k = 0; k < 40; ++k)
  {
    const int iterations = implicitEulerStep(model, s, supports, {}, no_force, state, workspace).iterations;
    if (k == 0) first = iterations;
    if (k >= 2)
    {
      EXPECT_LE(iterations, first / 2) << k << ", the first: " << first;
    }
  }
}

TEST_P(Stepping, AShortenedStepFallsAsFar)
{
  // Pulled apart along z, so soft and the step so long that steps across would go too far.
  constexpr double YOUNG = 1e4;
  setMaterials(model, std::vector<Material>(model.num_tets, {YOUNG, 0.34, 500}));
  StepSettings s = settings();
  s.time_step = 0.3;
  const Supports supports = holdNothing(model);
  NodalField x = model.rest, pull(model.num_nodes);
  double middle = 0;
  for (int i = 0; i < model.num_nodes; ++i) middle += model.node_mass[i] / model.mass() * model.rest[i].z();
  for (int i = 0; i < model.num_nodes; ++i)
  {
    x[i] += 0.01 * Vector3d(std::sin(7 * x[i].z()), std::cos(5 * x[i].z()), 0);
    pull[i].z() = 4 * YOUNG * model.node_mass[i] / model.mass() * (model.rest[i].z() - middle);
  }
  State state = startState(model, s, supports, x, Vector3d::Zero(), workspace);
  for (int k = 1; k <= 20; ++k)
  {
    implicitEulerStep(model, s, supports, {}, pull, state, workspace);
    const Vector3d falling = k * s.time_step * s.gravity;
    EXPECT_LT((momentum(model, state.v) / model.mass() - falling).norm(), 1e-6 * falling.norm());
  }
}

TEST_P(Stepping, MassDampingSlowsATranslationByItsFormula)
{
  StepSettings s = settings();
  s.gravity.setZero();
  s.damping.mass = 3;
  const Supports supports = holdNothing(model);
  State state = startState(model, s, supports, model.rest, Vector3d(1, 0, 0), workspace);
  for (int k = 0; k < 20; ++k) implicitEulerStep(model, s, supports, {}, no_force, state, workspace);
  EXPECT_NEAR(state.v[0].x(), std::pow(1 + 3 * DT, -20), 1e-8);
}

TEST_P(Stepping, StiffnessDampingDampsVibrationButNotFalling)
{
  const Supports supports = holdNothing(model);
  NodalField stretched = model.rest;
  stretched.matrix() *= 1.05;
  double energy[2];
  for (int damped = 0; damped < 2; ++damped)
  {
    StepSettings s = settings();
    s.damping.stiffness = damped ? 0.002 : 0;
    State state = startState(model, s, supports, stretched, Vector3d::Zero(), workspace);
    for (int k = 0; k < 10; ++k) implicitEulerStep(model, s, supports, {}, no_force, state, workspace);
    const double fall = model.mass() * (10 * DT * s.gravity).squaredNorm() / 2;
    energy[damped] = elasticEnergy(model, state.rotations, state.x) + kineticEnergy(model, state.v) - fall;
    EXPECT_LT((momentum(model, state.v) / model.mass() - 10 * DT * s.gravity).norm(), 1e-7);
  }
  EXPECT_LT(energy[1], 0.9 * energy[0]);
  EXPECT_GT(energy[1], 0);
}

TEST_P(Stepping, AHeldBodyStandsAndItsReactionIsItsWeight)
{
  StepSettings s = settings();
  s.damping.mass = 5;
  const Supports supports = holdFoot(model);
  State state = startState(model, s, supports, model.rest, Vector3d::Zero(), workspace);
  for (int k = 0; k < 400; ++k) implicitEulerStep(model, s, supports, {}, no_force, state, workspace);
  EXPECT_LT(kineticEnergy(model, state.v), 1e-9);
  for (const int i : supports.regions[0].nodes) EXPECT_EQ(state.x[i], model.rest[i]);
  const Reaction reaction = reactions(supports, state.x, workspace.balance)[0];
  const Vector3d weight = model.mass() * s.gravity;
  EXPECT_LT((reaction.force + weight).norm(), 1e-5 * weight.norm());
  Vector3d torque = Vector3d::Zero();
  for (int i = 0; i < model.num_nodes; ++i) torque += Vector3d(state.x[i]).cross(model.node_mass[i] * s.gravity);
  // One rotation an element keeps angular momentum only roughly for quadratic elements: 2 % on this mesh, and a quarter
  // of that with every halving of its cells.
  EXPECT_LT((reaction.torque + torque).norm(), (GetParam() == Element::LINEAR ? 1e-4 : 0.03) * torque.norm());

  State equilibrium = state;
  const StepReport report = solveStatic(model, s, supports, {}, no_force, equilibrium, workspace, {});
  EXPECT_TRUE(report.converged);
  EXPECT_LT((equilibrium.x.matrix() - state.x.matrix()).cwiseAbs().maxCoeff(), 1e-5);
}

TEST_P(Stepping, ALedRegionIsWhereItsMotionSays)
{
  StepSettings s = settings();
  s.gravity.setZero();
  const double half = std::sqrt(0.5);
  const std::vector<MotionSample> motion{{0, {0, 0, 0}, {0, 0, 0, 1}}, {1, {0.1, 0.2, 0}, {0, 0, half, half}}};
  const Supports supports = hold(
      model, [](const Vector3d& X) { return X.z() < 1e-9; }, motion);
  State state = startState(model, s, supports, model.rest, Vector3d::Zero(), workspace);
  for (int k = 1; k <= 60; ++k)
  {
    implicitEulerStep(model, s, supports, {}, no_force, state, workspace);
    const double part = std::min(1.0, k * DT);
    const Eigen::Isometry3d pose =
        Eigen::Translation3d(part * Vector3d(0.1, 0.2, 0)) * Eigen::AngleAxisd(part * M_PI / 2, Vector3d::UnitZ());
    for (const int i : supports.regions[0].nodes)
    {
      ASSERT_LT((state.x[i] - pose * Vector3d(model.rest[i])).norm(), 1e-12) << "step " << k;
    }
  }
  s.damping.mass = 5;
  for (int k = 0; k < 400; ++k) implicitEulerStep(model, s, supports, {}, no_force, state, workspace);
  // The rest of the body has followed, as a rigid body.
  const Eigen::Isometry3d pose = Eigen::Translation3d(0.1, 0.2, 0) * Eigen::AngleAxisd(M_PI / 2, Vector3d::UnitZ());
  for (int i = 0; i < model.num_nodes; ++i) EXPECT_LT((state.x[i] - pose * Vector3d(model.rest[i])).norm(), 1e-5);
}

TEST_P(Stepping, AFastTurnIsSubSteppedAndASlowOneIsNot)
{
  StepSettings s = settings();
  s.gravity.setZero();
  const Supports supports = holdNothing(model);
  for (const double angle : {0.05, 0.19, 0.25, 1.0, 3.0})
  {
    State state = startState(model, s, supports, model.rest, Vector3d::Zero(), workspace);
    const Vector3d omega(angle / DT, 0, 0);
    Vector3d centre = Vector3d::Zero();
    for (int i = 0; i < model.num_nodes; ++i) centre += model.node_mass[i] / model.mass() * model.rest[i];
    for (int i = 0; i < model.num_nodes; ++i) state.v[i] = omega.cross(Vector3d(model.rest[i]) - centre);
    const StepReport report = implicitEulerStep(model, s, supports, {}, no_force, state, workspace);
    EXPECT_TRUE(report.finite);
    if (angle < MAX_TURN)
    {
      EXPECT_EQ(report.substeps, 1);
      EXPECT_NEAR(report.turn, std::atan(angle), 0.02);
    }
    else
    {
      EXPECT_GE(report.substeps, angle / MAX_TURN);
      EXPECT_LE(report.substeps, MAX_SUBSTEPS);
      // At 3 rad a step the tips outrun sound twice and elements invert.
      if (angle < 3)
      {
        EXPECT_LE(report.turn, MAX_TURN);
      }
    }
    EXPECT_NEAR(state.time, DT, 1e-15);
  }
}

TEST_P(Stepping, AllocatesNothingAfterTheFirstStep)
{
  using Kind = Scene::Solver::Preconditioner;
  const Supports supports = hold(model, [](const Vector3d& X) { return X.z() < 1e-9; },
                                 {{0, {0, 0, 0}, {0, 0, 0, 1}}, {1, {3, 0, 0}, {0, 0, 1, 0}}});
  std::vector<AppliedLoad> loads(1);
  loads[0].from = 0;
  loads[0].until = 1;
  loads[0].pressure = 100;
  loads[0].faces = model.boundary;
  for (const Elasticity elasticity : {Elasticity::COROTATED, Elasticity::LINEAR, Elasticity::GREEN})
  {
    // Multigrid once more with aggregates in place of the factor, as larger bodies have them
    for (const auto& [kind, aggregated] : {std::pair{Kind::AUTO, false},
                                           {Kind::BLOCK_JACOBI, false},
                                           {Kind::PMULTIGRID, false},
                                           {Kind::PMULTIGRID, true},
                                           {Kind::DIRECT, false}})
    {
      // These age so fast that they are made anew, which asks for a little memory.
      if (elasticity == Elasticity::GREEN && aggregated) continue;
      for (const int threads : {1, 2})
      {
        for (const auto step : {implicitEulerStep, sdirk2Step})
        {
          StepSettings s = settings(elasticity);
          s.damping = {0.5, 0.001};
          s.solver.preconditioner = kind;
          SCOPED_TRACE(testing::Message() << "elasticity " << static_cast<int>(elasticity) << ", preconditioner "
                                          << static_cast<int>(kind) << ", " << threads << " threads");
          Workspace w(model, s, threads);
          ASSERT_EQ(w.partition.threads(), threads);
          State state = startState(model, s, supports, model.rest, Vector3d::Zero(), w);
          if (aggregated)
          {
            w.preconditioner = std::make_unique<PMultigrid>(model, w.partition, false);
            w.preconditioner_kind = kind;
          }
          step(model, s, supports, loads, no_force, state, w);
          allocations = 0;
          counting = true;
          int substeps = 0;
          for (int k = 0; k < 20; ++k) substeps += step(model, s, supports, loads, no_force, state, w).substeps;
          counting = false;
          EXPECT_EQ(allocations, 0);
          EXPECT_GE(substeps, 20);
        }
      }
    }
  }
  // The counter does count.
  counting = true;
  const NodalField field(10);
  const MatrixXd matrix = MatrixXd::Zero(10, 10);
  counting = false;
  EXPECT_GE(allocations, 2);
}

TEST_P(Stepping, ThreadsChangeNothing)
{
  // Linear elements: several chunks of nodes need more of them.
  const Eigen::Vector3i cells = model.quadratic() ? Eigen::Vector3i(2, 3, 5) : Eigen::Vector3i(5, 6, 8);
  const Model larger = test::boxModel(test::irregularBox(cells, {0.4, 0.4, 1.0}), GetParam());
  const Supports supports = holdFoot(larger);
  const NodalField none(larger.num_nodes);
  for (const Elasticity elasticity : {Elasticity::COROTATED, Elasticity::GREEN})
  {
    for (const auto step : {implicitEulerStep, sdirk2Step, explicitStep})
    {
      StepSettings s = settings(elasticity);
      if (step == explicitStep) s.time_step = 1e-4;
      s.solver.tolerance = 1e-4;
      std::vector<State> states;
      for (const int threads : {1, 2, 3})
      {
        Workspace w(larger, s, threads);
        ASSERT_EQ(w.partition.threads(), threads);
        ASSERT_GT(w.partition.numChunks(), 1);
        State& state = states.emplace_back(startState(larger, s, supports, larger.rest, Vector3d::Zero(), w));
        for (int k = 0; k < 4; ++k) step(larger, s, supports, {}, none, state, w);
        EXPECT_EQ((state.x.matrix() - states[0].x.matrix()).cwiseAbs().maxCoeff(), 0) << threads;
        EXPECT_EQ((state.v.matrix() - states[0].v.matrix()).cwiseAbs().maxCoeff(), 0) << threads;
      }
    }
  }
}

TEST(ConjugateGradients, StartFromTheNearestOfTheExtrapolationAndTheLastSolution)
{
  const Model model = test::boxModel(test::irregularBox({2, 2, 3}, {0.4, 0.4, 0.6}), Element::QUADRATIC);
  const int n = model.num_nodes;
  const Partition partition(model, 2);
  const Supports supports = holdFoot(model);
  const Rotations rotations = restRotations(model);
  const MatrixFreeSystem<Rotations> system(model, partition, rotations, 1, 4e-4);
  ConjugateGradient solver(model, partition);
  solver.prepare(system, model, partition, supports.held, 0);
  const auto random = [&](unsigned seed) {
    NodalField field = test::randomField(n, seed);
    for (int i = 0; i < n; ++i)
    {
      if (supports.held[i]) field[i].setZero();
    }
    return field;
  };
  const auto dot = [](const NodalField& a, const NodalField& c) { return a.matrix().cwiseProduct(c.matrix()).sum(); };
  const auto norm = [](const NodalField& a) { return a.matrix().norm(); };
  const auto times = [&](const NodalField& a) {
    NodalField product(n);
    system.product(a, product);
    return product;
  };
  const std::array<NodalField, 3> past{random(1), random(2), random(3)};
  NodalField u(n);
  for (const int count : {1, 2, 3})
  {
    // The polynomial through the past ones, one further.
    NodalField next = past[0];
    if (count == 2) next.matrix() += past[0].matrix() - past[1].matrix();
    if (count == 3) next.matrix() += 2 * past[0].matrix() - 3 * past[1].matrix() + past[2].matrix();
    NodalField b = random(4);
    solver.start(system, partition, b, past, count, u);
    NodalField residual = b;
    residual.matrix() -= times(u).matrix();
    EXPECT_GT(norm(u), 0);
    for (const NodalField* direction : {&std::as_const(next), &past[0]})
    {
      EXPECT_LT(std::abs(dot(*direction, residual)), 1e-12 * norm(*direction) * norm(b)) << count;
    }
    // What is in their span is found, and solve() knows its product.
    NodalField expected(n);
    expected.matrix() = 0.7 * next.matrix() + 0.2 * past[0].matrix();
    b = times(expected);
    solver.start(system, partition, b, past, count, u);
    EXPECT_LT((u.matrix() - expected.matrix()).norm(), 1e-11 * norm(expected)) << count;
    const SolveReport report = solver.solve(system, partition, b, u, 1e-10, 100);
    EXPECT_TRUE(report.converged);
    EXPECT_EQ(report.iterations, 0) << count;
  }

  // Nothing to start from; and solutions that do not differ, of which one says all: not farther than zero.
  const NodalField b = random(4), zero(n);
  solver.start(system, partition, b, past, 0, u);
  EXPECT_EQ(norm(u), 0);
  for (const NodalField& same : {zero, past[0]})
  {
    for (const int count : {1, 2, 3})
    {
      solver.start(system, partition, b, {same, same, same}, count, u);
      EXPECT_TRUE(u.matrix().allFinite());
      EXPECT_LE(dot(u, times(u)) - 2 * dot(u, b), 1e-12 * std::abs(dot(u, b)));
      EXPECT_TRUE(solver.solve(system, partition, b, u, 1e-8, 10000).converged);
    }
  }
}

TEST(ConjugateGradients, SolveAndTellTheTruth)
{
  // Density contrast of a million.
  TetMesh mesh = test::irregularBox({2, 2, 3}, {0.4, 0.4, 0.6});
  std::vector<Material> materials(mesh.tets.cols(), test::RUBBER);
  for (std::size_t t = 0; t < materials.size(); t += 2) materials[t].density = 5e8;
  const Model model = buildModel(mesh, Element::QUADRATIC, materials);
  const Partition partition(model, 1);
  const Supports supports = holdFoot(model);
  const Rotations rotations = restRotations(model);
  const NodalField b = test::randomField(model.num_nodes, 4);
  ConjugateGradient solver(model, partition);
  const MatrixFreeSystem<Rotations> system(model, partition, rotations, 1, 4e-4);
  solver.prepare(system, model, partition, supports.held, 0);
  double last = 1e300;
  for (const double tolerance : {1e-2, 1e-4, 1e-8, 1e-12})
  {
    NodalField u(model.num_nodes), product(model.num_nodes);
    const SolveReport report = solver.solve(system, partition, b, u, tolerance, 10000);
    EXPECT_TRUE(report.converged);
    EXPECT_LE(report.residual, tolerance);
    systemProduct(model, partition, rotations, 1, 4e-4, u, product);
    NodalField residual = b;
    residual.matrix() -= product.matrix();
    EXPECT_NEAR(solver.norm(partition, residual) / solver.norm(partition, b), report.residual,
                1e-3 * report.residual + 1e-15);
    EXPECT_LT(report.residual, last);
    last = report.residual;
  }
  NodalField u(model.num_nodes);
  const SolveReport cut = solver.solve(system, partition, b, u, 1e-12, 3);
  EXPECT_FALSE(cut.converged);
  EXPECT_EQ(cut.iterations, 3);
  EXPECT_GT(cut.residual, 1e-12);
}

TEST(StaticEquilibrium, ABarInTensionHasItsClosedForm)
{
  // Poisson's ratio 0: one-dimensional, u = F z/(E A) for small loads; the stress is F/A everywhere.
  for (const Element element : {Element::LINEAR, Element::QUADRATIC})
  {
    const Material material{2e5, 0, 500};
    const Model model = test::boxModel(test::irregularBox({2, 2, 4}, {0.4, 0.4, 1.0}), element, material);
    StepSettings s = settings(Elasticity::LINEAR);
    Workspace workspace(model, s, 1);
    s.gravity.setZero();
    const Supports supports = holdFoot(model);
    NodalField force(model.num_nodes);
    const double traction = 100;  // Pa
    for (const Model::Face& face : model.boundary)
    {
      const auto nodes = model.nodesOf(face);
      if (std::min({model.rest[nodes[0]].z(), model.rest[nodes[1]].z(), model.rest[nodes[2]].z()}) < 1 - 1e-9) continue;
      const int count = model.quadratic() ? 6 : 3;
      for (int k = 0; k < count; ++k) force[nodes[k]].z() += traction * model.area(face) / count;
    }
    State state = startState(model, s, supports, model.rest, Vector3d::Zero(), workspace);
    const StepReport report = solveStatic(model, s, supports, {}, force, state, workspace, {});
    EXPECT_TRUE(report.converged);
    for (int i = 0; i < model.num_nodes; ++i)
    {
      const Vector3d X = model.rest[i];
      EXPECT_LT((state.x[i] - X - Vector3d(0, 0, traction / material.young * X.z())).norm(), 1e-11);
    }
    const auto stress = nodalStress(model, state.rotations, state.x);
    EXPECT_NEAR(stress.row(2).minCoeff(), traction, 1e-5);
    EXPECT_NEAR(stress.row(2).maxCoeff(), traction, 1e-5);
    EXPECT_NEAR(reactions(supports, state.x, workspace.balance)[0].force.z(), -traction * 0.16, 1e-6);
  }
}

TEST(StaticEquilibrium, IsFoundForSoftBodiesToo)
{
  // Ever more of the bar hangs; the last one is as soft as to stretch to twice its length.
  for (const Element element : {Element::LINEAR, Element::QUADRATIC})
  {
    double last = 0;
    for (const double young : {2e5, 5e4, 1e4, 2e3})
    {
      const Model model = test::boxModel(test::kuhnBox({2, 2, 5}, {0.4, 0.4, 1.0}), element, {young, 0.34, 500});
      StepSettings s = settings();
      Workspace workspace(model, s, 1);
      s.solver.tolerance = 1e-6;
      const Supports supports = holdFoot(model);
      const NodalField no_force(model.num_nodes);
      State state = startState(model, s, supports, model.rest, Vector3d::Zero(), workspace);
      const StepReport report = solveStatic(model, s, supports, {}, no_force, state, workspace, {});
      EXPECT_TRUE(report.converged) << test::name(element) << " E = " << young;
      const double lowest = state.x.matrix().row(1).minCoeff();
      EXPECT_LT(lowest, last);
      last = lowest;
      // It is an equilibrium of the stepper as well.
      const NodalField before = state.x;
      implicitEulerStep(model, s, supports, {}, no_force, state, workspace);
      EXPECT_LT((state.x.matrix() - before.matrix()).cwiseAbs().maxCoeff(), 1e-5);
    }
  }
}

TEST(Loads, PressureOnAClosedSurfaceHasNoResultantAndDoesTheWorkOfAVolume)
{
  for (const Element element : {Element::LINEAR, Element::QUADRATIC})
  {
    const Model model = test::boxModel(test::irregularBox({2, 2, 2}, {1, 1, 1}), element);
    NodalField x = model.rest, f(model.num_nodes);
    x.matrix() += 0.05 * test::randomField(model.num_nodes, 6).matrix();
    AppliedLoad load;
    load.from = 0;
    load.until = 1;
    load.pressure = 1000;
    load.faces = model.boundary;
    addLoads(model, {load}, 0.5, x, f);
    Vector3d force = Vector3d::Zero(), torque = Vector3d::Zero();
    for (int i = 0; i < model.num_nodes; ++i)
    {
      force += f[i];
      torque += Vector3d(x[i]).cross(Vector3d(f[i]));
    }
    EXPECT_LT(force.norm(), 1e-10 * load.pressure);
    EXPECT_LT(torque.norm(), 1e-10 * load.pressure);
    // Virtual work: f . d = -p dV/dd, with the volume's derivative by a central difference.
    const NodalField d = test::randomField(model.num_nodes, 7);
    NodalField forward = x, back = x;
    forward.matrix() += 1e-5 * d.matrix();
    back.matrix() -= 1e-5 * d.matrix();
    const double slope = (currentVolume(model, forward) - currentVolume(model, back)) / 2e-5;
    EXPECT_NEAR(f.matrix().cwiseProduct(d.matrix()).sum(), -load.pressure * slope, 1e-5 * load.pressure);

    NodalField none(model.num_nodes);
    addLoads(model, {load}, 1, x, none);
    addLoads(model, {load}, -0.1, x, none);
    EXPECT_EQ(none.matrix().norm(), 0);
  }
}

}  // namespace
}  // namespace bezier_fem
