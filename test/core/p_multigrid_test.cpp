#include "bezier_fem/p_multigrid.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <atomic>
#include <limits>
#include <vector>

#include "bezier_fem/conjugate_gradient.h"
#include "bezier_fem/element_operator.h"
#include "bezier_fem/step.h"
#include "core/bar.h"
#include "direct_preconditioner.h"
#include "sparse_cholesky.h"

namespace bezier_fem
{
namespace
{
using Eigen::Vector3d;

constexpr Material STIFF{2e6, 0.45, 500};

struct Case
{
  const char* name;
  Element element;
  RotationRule rule;
  Dilatation dilatation = Dilatation::FULL;
  bool factored = true;  // the linear elements' system
};

class Multigrid : public testing::TestWithParam<Case>
{
protected:
  Model model = test::boxModel(test::irregularBox({4, 4, 8}, {0.4, 0.4, 1.0}), GetParam().element, material(),
                               GetParam().dilatation);
  Partition partition{model, 1};
  Rotations rotations = bent(1.5);
  std::vector<std::uint8_t> held = foot();
  ConjugateGradient solver{model, partition};
  PMultigrid multigrid{model, partition, GetParam().factored};

  static Material material() { return {2e6, GetParam().dilatation == Dilatation::MEAN ? 0.49 : 0.45, 500}; }
  /** Turned by up to `angle`, rad, along the bar. */
  Rotations bent(double angle) const
  {
    NodalField x = model.rest;
    for (int i = 0; i < model.num_nodes; ++i)
    {
      const Vector3d X = model.rest[i];
      x[i] = Eigen::AngleAxisd(angle * X.z(), Vector3d(1, 0.5, 0.2).normalized()) * X;
    }
    Rotations result = restRotations(model, GetParam().rule);
    const Rotations before = result;
    AlignedVector<double> turned(result.flags.size());
    updateRotations(model, partition, x, before, result, turned);
    return result;
  }
  /** The foot is held, and one component along an edge of it. */
  std::vector<std::uint8_t> foot() const
  {
    std::vector<std::uint8_t> axes(model.num_nodes, 0);
    for (int i = 0; i < model.num_nodes; ++i)
    {
      // As regions do: an edge where both of its corners are
      const auto all = [&](auto inside) {
        const auto [a, b] = model.ends[i];
        return inside(Vector3d(model.rest[model.node_of_corner[a]])) &&
               inside(Vector3d(model.rest[model.node_of_corner[b]]));
      };
      if (all([](const Vector3d& X) { return X.x() < 1e-9 && X.z() < 0.3; })) axes[i] = 2;
      if (all([](const Vector3d& X) { return X.z() < 1e-9; })) axes[i] = 7;
    }
    return axes;
  }
  void clearHeld(NodalField& f) const
  {
    for (int i = 0; i < model.num_nodes; ++i)
    {
      for (int axis = 0; axis < 3; ++axis)
      {
        if (held[i] >> axis & 1) f[i][axis] = 0;
      }
    }
  }
};
constexpr Case LINEAR{"linear", Element::LINEAR, RotationRule::FROM_CORNERS},
    QUADRATIC{"quadratic", Element::QUADRATIC, RotationRule::FROM_CORNERS},
    FOUR{"quadratic_four", Element::QUADRATIC, RotationRule::FOUR_POINTS},
    MEAN{"quadratic_mean", Element::QUADRATIC, RotationRule::FROM_CORNERS, Dilatation::MEAN};
constexpr Case aggregated(Case c)
{
  c.factored = false;
  return c;
}
const auto name = [](const auto& p) { return p.param.name + std::string(p.param.factored ? "" : "_aggregated"); };
INSTANTIATE_TEST_SUITE_P(Elements, Multigrid,
                         testing::Values(LINEAR, QUADRATIC, FOUR, MEAN, aggregated(LINEAR), aggregated(QUADRATIC),
                                         aggregated(FOUR), aggregated(MEAN)),
                         name);
/** On the same body. */
class Direct : public Multigrid
{
};
INSTANTIATE_TEST_SUITE_P(Elements, Direct, testing::Values(LINEAR, QUADRATIC, FOUR, MEAN), name);

TEST_P(Multigrid, IsSymmetricAndPositive)
{
  const MatrixFreeSystem<Rotations> system(model, partition, rotations, 1, 4e-4);
  ASSERT_TRUE(solver.prepare(system, model, partition, held, 0));
  ASSERT_TRUE(multigrid.prepare(model, rotations, held, 1, 4e-4, solver.inverse()));
  for (unsigned seed = 0; seed < 5; ++seed)
  {
    NodalField a = test::randomField(model.num_nodes, seed), b = test::randomField(model.num_nodes, seed + 100);
    NodalField za(model.num_nodes), zb(model.num_nodes);
    multigrid.apply(a, za);
    multigrid.apply(b, zb);
    NodalField masked = za;
    clearHeld(masked);
    EXPECT_EQ((masked.matrix() - za.matrix()).norm(), 0);  // held components stay
    const double ab = a.matrix().cwiseProduct(zb.matrix()).sum(), ba = b.matrix().cwiseProduct(za.matrix()).sum();
    const double scale =
        std::sqrt(a.matrix().cwiseProduct(za.matrix()).sum() * b.matrix().cwiseProduct(zb.matrix()).sum());
    EXPECT_GT(scale, 0);
    EXPECT_NEAR(ab, ba, 1e-5 * scale);  // the linear elements' system is in single precision
  }
}

TEST_P(Multigrid, SolvesTheSameInFarFewerIterations)
{
  NodalField b = test::randomField(model.num_nodes, 3), u(model.num_nodes), expected(model.num_nodes);
  for (const auto& [alpha, beta] : {std::pair{1.0, 4e-4}, {1.0, 1e-2}, {0.0, 1.0}})
  {
    const MatrixFreeSystem<Rotations> system(model, partition, rotations, alpha, beta);
    ASSERT_TRUE(solver.prepare(system, model, partition, held, 0));
    expected.setZero();
    const SolveReport plain = solver.solve(system, partition, b, expected, 1e-10, 10000);
    ASSERT_TRUE(plain.converged);
    ASSERT_TRUE(multigrid.prepare(model, rotations, held, alpha, beta, solver.inverse()));
    u.setZero();
    const SolveReport report = solver.solve(system, partition, b, u, 1e-10, 10000, &multigrid);
    EXPECT_TRUE(report.converged);
    EXPECT_LE(report.residual, 1e-10);
    EXPECT_LT((u.matrix() - expected.matrix()).norm(), 1e-7 * expected.matrix().norm());
    EXPECT_LT(4 * report.iterations, plain.iterations);
  }
}

TEST_P(Multigrid, TakesFewerIterationsForShorterSteps)
{
  // From a system of stiffness to one of mass, which the smoother lumps as long as it is small.
  const NodalField b = test::randomField(model.num_nodes, 3);
  NodalField u(model.num_nodes);
  int before = 100;
  for (double beta = 4e-4; beta > 1e-9; beta /= 2)
  {
    const MatrixFreeSystem<Rotations> system(model, partition, rotations, 1, beta);
    ASSERT_TRUE(solver.prepare(system, model, partition, held, 0));
    ASSERT_TRUE(multigrid.prepare(model, rotations, held, 1, beta, solver.inverse()));
    u.setZero();
    const SolveReport report = solver.solve(system, partition, b, u, 1e-4, 1000, &multigrid);
    EXPECT_TRUE(report.converged);
    EXPECT_LE(report.iterations, 1.3 * before) << beta;
    before = report.iterations;
  }
  EXPECT_LE(before, 12);
}

TEST_P(Multigrid, SeesASmallSoftPartInWhichTheMassPrevails)
{
  std::vector<Material> materials(model.num_tets, material());
  for (int t = 0; t < model.num_tets; ++t)
  {
    Vector3d centre = Vector3d::Zero();
    for (int a = 0; a < CORNERS; ++a) centre += model.rest[model.nodesOf(model.tet_of_mesh_tet[t])[a]] / CORNERS;
    if (centre.z() > 0.9) materials[t].young /= 1000;
  }
  setMaterials(model, materials);
  constexpr double BETA = 2.5e-5;
  const MatrixFreeSystem<Rotations> system(model, partition, rotations, 1, BETA);
  ASSERT_TRUE(solver.prepare(system, model, partition, held, 0));
  ASSERT_TRUE(multigrid.prepare(model, rotations, held, 1, BETA, solver.inverse()));
  const NodalField b = test::randomField(model.num_nodes, 3);
  NodalField u(model.num_nodes);
  const SolveReport report = solver.solve(system, partition, b, u, 1e-6, 1000, &multigrid);
  EXPECT_TRUE(report.converged);
  const int slow = GetParam().factored ? 40 : 45;
  EXPECT_LE(report.iterations, GetParam().dilatation == Dilatation::MEAN || rotations.points > 1 ? slow : 22);
}

TEST_P(Multigrid, SolvesAsWellWhateverTheUnits)
{
  const MatrixFreeSystem<Rotations> system(model, partition, rotations, 1, 4e-4);
  ASSERT_TRUE(solver.prepare(system, model, partition, held, 0));
  ASSERT_TRUE(multigrid.prepare(model, rotations, held, 1, 4e-4, solver.inverse()));
  const NodalField b = test::randomField(model.num_nodes, 3);
  NodalField expected(model.num_nodes), u(model.num_nodes), scaled(model.num_nodes);
  const int iterations = solver.solve(system, partition, b, expected, 1e-10, 10000, &multigrid).iterations;
  // The squares of these are no single precision numbers.
  for (const double scale : {1e17, 3e17, 1e18, 3e18, 1e19, 1e25, 1e-19, 1e-25, 1.0})
  {
    scaled.matrix() = scale * b.matrix();
    u.setZero();
    const SolveReport report = solver.solve(system, partition, scaled, u, 1e-10, 10000, &multigrid);
    EXPECT_TRUE(report.converged);
    EXPECT_NEAR(report.iterations, iterations, 1) << scale;
    EXPECT_LT((u.matrix() / scale - expected.matrix()).norm(), 1e-7 * expected.matrix().norm());
  }
}

TEST_P(Multigrid, FollowsANewMaterial)
{
  const MatrixFreeSystem<Rotations> system(model, partition, rotations, 0, 1);
  NodalField b = test::randomField(model.num_nodes, 3), u(model.num_nodes);
  const auto iterations = [&] {
    EXPECT_TRUE(solver.prepare(system, model, partition, held, 0));
    EXPECT_TRUE(multigrid.prepare(model, rotations, held, 0, 1, solver.inverse()));
    u.setZero();
    return solver.solve(system, partition, b, u, 1e-8, 10000, &multigrid).iterations;
  };
  const int before = iterations();
  std::vector<Material> materials(model.num_tets, material());
  for (std::size_t k = 0; k < materials.size() / 2; ++k) materials[k].young = 2e4;
  setMaterials(model, materials);
  const int stale = iterations();
  multigrid.forget();
  const int after = iterations();
  EXPECT_LT(after, stale);
  EXPECT_LT(after, 3 * before);

  // Nothing is left of the material before: it is as one newly made, also where the largest eigenvalue is another.
  setMaterials(model, std::vector<Material>(model.num_tets, Material{2e6, 0.0, 500}));
  multigrid.forget();
  iterations();
  PMultigrid anew(model, partition, GetParam().factored);
  ASSERT_TRUE(anew.prepare(model, rotations, held, 0, 1, solver.inverse()));
  NodalField z(model.num_nodes), of_anew(model.num_nodes);
  multigrid.apply(b, z);
  anew.apply(b, of_anew);
  EXPECT_EQ((z.matrix() - of_anew.matrix()).norm(), 0);
}

/** Counts its products in double precision. */
class CountedSystem final : public SystemOperator
{
public:
  explicit CountedSystem(const SystemOperator& own) : own_(own) {}
  void product(const NodalField& u, NodalField& out) const override
  {
    ++products;
    own_.product(u, out);
  }
  void diagonal(AlignedVector<double>& blocks) const override { own_.diagonal(blocks); }
  mutable int products = 0;

private:
  const SystemOperator& own_;
};

Vector3d inSingle(const Vector3d& a)
{
  // GCC 12 takes two numbers there and back at once as if nothing came of it, unless it has to store them.
  volatile float x = static_cast<float>(a.x()), y = static_cast<float>(a.y()), z = static_cast<float>(a.z());
  return {x, y, z};
}

TEST_P(Multigrid, ProductsAreThoseOfTheFieldInSinglePrecision)
{
  // Large beside what strains it, which is little more than its rounding: of that nothing may be left.
  const Vector3d translation(96, -64, 40);
  const int n = model.num_nodes;
  const double to_single = std::numeric_limits<float>::epsilon() / 2;
  for (const auto& [alpha, beta] : {std::pair{0.0, 1.0}, {1.0, 4e-4}, {1.0, 1e-2}, {1.0, 1e-9}})
  {
    const MatrixFreeSystem<Rotations> system(model, partition, rotations, alpha, beta);
    ASSERT_TRUE(solver.prepare(system, model, partition, held, 0));
    ASSERT_TRUE(multigrid.prepare(model, rotations, held, alpha, beta, solver.inverse()));
    // There are no single precision products of linear elements; of four rotations there is only the mean.
    const bool has = model.quadratic() && GetParam().rule != RotationRule::FOUR_POINTS;
    EXPECT_EQ(multigrid.hasProduct(1e-4), has && alpha > 0);
    EXPECT_FALSE(multigrid.hasProduct(1e-10));  // for which its rounding is too much
    if (!has) continue;
    for (const double size : {1.0, 1e-4, 1e-20, 1e15})
    {
      for (const Vector3d& moved : {Vector3d(0, 0, 0), translation})
      {
        if (moved.norm() > 0 && (size > 1 || size < 1e-6)) continue;  // of which nothing would be left
        SCOPED_TRACE(testing::Message() << alpha << " M + " << beta << " K, " << size << ", " << moved.x());
        NodalField u = test::randomField(n, 5);
        u.matrix() *= size;
        for (int i = 0; i < n; ++i) u[i] += moved;
        const bool one_rests = moved.norm() == 0;
        if (one_rests) u[n - 1].setZero();
        NodalField rounded(n), out(n), expected(n), strain(n), stress(n), inertia(n);
        multigrid.product(u, rounded, out);
        const Vector3d about = inSingle(u[0]);
        for (int i = 0; i < n; ++i)
        {
          ASSERT_EQ(rounded[i], about + inSingle(u[i] - about));
          strain[i] = rounded[i] - about;
        }
        EXPECT_EQ(rounded[n - 1].norm() == 0, one_rests);
        const double change = (rounded.matrix() - u.matrix()).norm();
        EXPECT_GT(change, 0.1 * to_single * strain.matrix().norm());
        EXPECT_LE(change, to_single * strain.matrix().norm());
        system.product(rounded, expected);
        systemProduct(model, partition, rotations, 0, beta, strain, stress);
        systemProduct(model, partition, rotations, alpha, 0, strain, inertia);
        EXPECT_LT((out.matrix() - expected.matrix()).cwiseAbs().maxCoeff(),
                  1e-6 * (stress.matrix().cwiseAbs().maxCoeff() + inertia.matrix().cwiseAbs().maxCoeff()));
        EXPECT_EQ(out.matrix().row(3).norm(), 0);

        // In place; and whatever was done in between, which the product does not change either.
        NodalField z(n), again(n), improved(n), in_place = u;
        multigrid.apply(expected, z);
        multigrid.improve(expected, 0, 2, improved);
        multigrid.product(in_place, in_place, again);
        EXPECT_EQ((again.matrix() - out.matrix()).cwiseAbs().maxCoeff(), 0);
        EXPECT_EQ((in_place.matrix() - rounded.matrix()).cwiseAbs().maxCoeff(), 0);
        NodalField z_again(n), improved_again(n);
        multigrid.apply(expected, z_again);
        multigrid.improve(expected, 0, 2, improved_again);
        EXPECT_EQ((z_again.matrix() - z.matrix()).cwiseAbs().maxCoeff(), 0);
        EXPECT_EQ((improved_again.matrix() - improved.matrix()).cwiseAbs().maxCoeff(), 0);
      }
    }
  }
}

class RoughStart : public Multigrid
{
protected:
  const double alpha = 1, beta = 4e-4;
  const int n = model.num_nodes;
  const MatrixFreeSystem<Rotations> own{model, partition, rotations, alpha, beta};
  const CountedSystem system{own};

  void SetUp() override
  {
    ASSERT_TRUE(solver.prepare(system, model, partition, held, 0));
    ASSERT_TRUE(multigrid.prepare(model, rotations, held, alpha, beta, solver.inverse()));
  }
  NodalField random(unsigned seed, double size = 1) const
  {
    NodalField field = test::randomField(n, seed);
    field.matrix() *= size;
    clearHeld(field);
    return field;
  }
  NodalField residual(const NodalField& b, const NodalField& u) const
  {
    NodalField r(n);
    own.product(u, r);
    r.matrix() = b.matrix() - r.matrix();
    return r;
  }
  Preconditioner* rough() { return multigrid.hasProduct(1e-4) ? &multigrid : nullptr; }
  /** What is reported is of the solution that is left, in double precision. */
  void expectTruth(const SolveReport& report, const NodalField& b, const NodalField& u, double tolerance,
                   int max_iterations)
  {
    const NodalField r = residual(b, u);
    const double truth = solver.relativeNorm(partition, r, b);
    EXPECT_TRUE(u.matrix().allFinite());
    EXPECT_NEAR(report.residual, truth, 1e-6 * truth + 1e-15);
    EXPECT_EQ(report.converged, report.residual <= tolerance);
    EXPECT_TRUE(report.converged || report.iterations == max_iterations);
    EXPECT_LE(report.iterations, max_iterations);
    // Reactions are made of it: held components count too.
    EXPECT_LT((solver.residual().matrix() - r.matrix()).cwiseAbs().maxCoeff(),
              1e-12 * (b.matrix() - r.matrix()).cwiseAbs().maxCoeff());
  }
};
INSTANTIATE_TEST_SUITE_P(Elements, RoughStart, testing::Values(LINEAR, QUADRATIC, FOUR, MEAN, aggregated(QUADRATIC)),
                         name);

TEST_P(RoughStart, IsThatOfDoublePrecisionButForItsRounding)
{
  const std::array<NodalField, 3> past{random(1), random(2), random(3)};
  const NodalField b = random(4);
  for (const int count : {0, 1, 2, 3})
  {
    NodalField u(n), expected(n);
    system.products = 0;
    solver.start(system, partition, b, past, count, expected);
    const int products = system.products;
    EXPECT_EQ(products, std::min(count, 2));
    solver.start(system, partition, b, past, count, u, rough());
    EXPECT_EQ(system.products, (multigrid.hasProduct(1e-4) ? 1 : 2) * products);
    const double error = (u.matrix() - expected.matrix()).norm();
    EXPECT_LE(error, 2e-6 * expected.matrix().norm()) << count;
    EXPECT_EQ(error > 0, count > 0 && multigrid.hasProduct(1e-4));
    EXPECT_EQ(expected.matrix().norm() > 0, count > 0);
    clearHeld(expected = u);
    EXPECT_EQ((expected.matrix() - u.matrix()).norm(), 0);
  }
}

TEST_P(RoughStart, IsNotWhatIsReported)
{
  const std::array<NodalField, 3> past{random(1), random(2), random(3)};
  // Of the first one the start leaves nothing in single precision; of the second one its rounding; the third one is
  // far away.
  NodalField rounded(n), in_single(n), in_span(n), next(n);
  own.product(past[0], in_single);
  if (multigrid.hasProduct(1e-4)) multigrid.product(past[0], rounded, in_single);
  next.matrix() = 0.7 * (3 * (past[0].matrix() - past[1].matrix()) + past[2].matrix()) + 0.2 * past[0].matrix();
  own.product(next, in_span);
  struct
  {
    const NodalField b;
    int count;
    bool solved;
  } const cases[] = {{in_single, 1, true}, {in_span, 3, true}, {random(4), 3, false}};
  for (const auto& c : cases)
  {
    for (Preconditioner* preconditioner :
         {static_cast<Preconditioner*>(&multigrid), static_cast<Preconditioner*>(nullptr)})
    {
      for (const double tolerance : {1e-4, 1e-10})
      {
        for (const int most : {0, 1, 2, 5000})
        {
          SCOPED_TRACE(testing::Message() << (&c - cases) << (preconditioner ? ", multigrid, " : ", blocks, ")
                                          << tolerance << ", " << most);
          NodalField u(n);
          solver.start(system, partition, c.b, past, c.count, u, rough());
          system.products = 0;
          const SolveReport report = solver.solve(system, partition, c.b, u, tolerance, most, preconditioner);
          expectTruth(report, c.b, u, tolerance, most);
          EXPECT_TRUE(report.converged || most < 5000);
          if (!c.solved) continue;
          if (tolerance == 1e-4)
          {
            // Solved already, which one product says; of double precision it is known.
            EXPECT_TRUE(report.converged);
            EXPECT_EQ(report.iterations, 0);
            EXPECT_EQ(system.products, multigrid.hasProduct(1e-4) ? 1 : 0);
          }
          if (multigrid.hasProduct(1e-4) && most == 0)
          {
            EXPECT_GT(report.residual, 1e-9);
            EXPECT_LT(report.residual, 1e-5);
          }
        }
      }
    }
  }

  // One in double precision after it is known to the last digit again.
  NodalField u(n);
  solver.start(system, partition, in_span, past, 3, u, rough());
  solver.start(system, partition, in_span, past, 3, u);
  system.products = 0;
  const SolveReport report = solver.solve(system, partition, in_span, u, 1e-10, 5000, &multigrid);
  EXPECT_EQ(report.iterations, 0);
  EXPECT_EQ(system.products, 0);
  expectTruth(report, in_span, u, 1e-10, 5000);
}

TEST_P(RoughStart, IsUsableOrNoneBeyondTheRangeOfSinglePrecision)
{
  constexpr double TOLERANCE = 1e-8;
  const auto solve = [&](const NodalField& b, NodalField& u) {
    const SolveReport report = solver.solve(system, partition, b, u, TOLERANCE, 1000, &multigrid);
    expectTruth(report, b, u, TOLERANCE, 1000);
    EXPECT_TRUE(report.converged);
    return report.iterations;
  };
  const double sizes[] = {1e300, 1e39, 1e37, 1e34, 1e30, 1, 1e-36, 1e-42, 1e-60};
  for (const double of_b : {1.0, 1e30, 1e-42})
  {
    // Of linear elements the correction is for a residual as it is, not over its largest number.
    if (!model.quadratic() && of_b < 1e-38) continue;
    const NodalField b = random(4, of_b);
    NodalField u(n);
    const int from_nothing = solve(b, u);
    for (const double first : sizes)
    {
      for (const double second : sizes)
      {
        SCOPED_TRACE(testing::Message() << of_b << ", " << first << ", " << second);
        const std::array<NodalField, 3> past{random(1, first), random(2, second), random(3, second)};
        for (const int count : {1, 3})
        {
          solver.start(system, partition, b, past, count, u, rough());
          ASSERT_TRUE(u.matrix().allFinite());
          EXPECT_LE(solve(b, u), from_nothing + 8) << count;
        }
      }
    }
  }
}

TEST_P(RoughStart, IsNotMadeOfForcesThatAreNoNumbers)
{
  // One node's force is beyond single precision's range, and against the node's own motion: the field's work is then
  // minus infinity, which looks like that of one that does not move.
  NodalField row(n), field(n), force(n);
  double size = 0;
  for (int i = 0; i < n && size == 0; ++i)
  {
    if (held[i] != 0) continue;
    field.setZero();
    field[i].x() = 1;
    own.product(field, row);
    for (int k = 0; k < n; ++k) field[k] = row[k].array().sign();
    field[i].x() = -1e-3;
    clearHeld(field);
    own.product(field, force);
    const double largest = force[i].x();
    force[i].x() = 0;
    if (largest > 1.1 * force.matrix().cwiseAbs().maxCoeff()) size = 1.05 * std::numeric_limits<float>::max() / largest;
  }
  ASSERT_GT(size, 0);
  field.matrix() *= size;
  const NodalField small = random(1), b = random(4);
  NodalField to_field(n), u(n);
  to_field.matrix() = 2 * small.matrix() - field.matrix();
  for (const auto& past : {std::array<NodalField, 3>{field, field, field}, {small, to_field, small}})
  {
    for (const int count : {1, 2})
    {
      solver.start(system, partition, b, past, count, u, rough());
      ASSERT_TRUE(u.matrix().allFinite());
      const SolveReport report = solver.solve(system, partition, b, u, 1e-8, 1000, &multigrid);
      expectTruth(report, b, u, 1e-8, 1000);
      EXPECT_TRUE(report.converged);
    }
  }
}

TEST_P(RoughStart, IsTheSameToTheBitForAnyNumberOfThreads)
{
  const std::array<NodalField, 3> past{random(1), random(2), random(3)};
  const NodalField b = random(4);
  std::vector<NodalField> starts, solutions;
  for (const int threads : {1, 2, 3})
  {
    const Partition several(model, threads);
    ASSERT_EQ(several.threads(), threads);
    const MatrixFreeSystem<Rotations> threaded(model, several, rotations, alpha, beta);
    ConjugateGradient gradients(model, several);
    PMultigrid cycle(model, several, GetParam().factored);
    ASSERT_TRUE(gradients.prepare(threaded, model, several, held, 0));
    ASSERT_TRUE(cycle.prepare(model, rotations, held, alpha, beta, gradients.inverse()));
    NodalField u(n);
    gradients.start(threaded, several, b, past, 3, u, cycle.hasProduct(1e-4) ? &cycle : nullptr);
    starts.push_back(u);
    EXPECT_TRUE(gradients.solve(threaded, several, b, u, 1e-10, 1000, &cycle).converged);
    solutions.push_back(u);
    EXPECT_EQ((starts.back().matrix() - starts[0].matrix()).cwiseAbs().maxCoeff(), 0) << threads;
    EXPECT_EQ((solutions.back().matrix() - solutions[0].matrix()).cwiseAbs().maxCoeff(), 0) << threads;
  }
}

TEST_P(Direct, TheWholeSystemsFactorIsItsInverseAndServesTurnedOnes)
{
  DirectPreconditioner direct(model, partition.threads());
  NodalField b = test::randomField(model.num_nodes, 3), u(model.num_nodes), expected(model.num_nodes);
  const auto solve = [&](const Rotations& at, double alpha, double beta, Preconditioner* preconditioner) {
    const MatrixFreeSystem<Rotations> system(model, partition, at, alpha, beta);
    EXPECT_TRUE(solver.prepare(system, model, partition, held, 0));
    if (preconditioner)
    {
      EXPECT_TRUE(preconditioner->prepare(model, at, held, alpha, beta, solver.inverse()));
    }
    u.setZero();
    const SolveReport report = solver.solve(system, partition, b, u, 1e-10, 10000, preconditioner);
    EXPECT_TRUE(report.converged);
    EXPECT_LE(report.residual, 1e-10);
    return report.iterations;
  };
  for (const auto& [alpha, beta] : {std::pair{1.0, 4e-4}, {0.0, 1.0}})
  {
    const int plain = solve(rotations, alpha, beta, nullptr);
    expected.matrix() = u.matrix();
    const int anew = solve(rotations, alpha, beta, &direct);
    EXPECT_LE(anew, 5);
    EXPECT_LT((u.matrix() - expected.matrix()).norm(), 1e-7 * expected.matrix().norm());
    // The bar has bent a little farther.
    const Rotations farther = bent(1.52);
    const int turned = solve(farther, alpha, beta, &direct);
    EXPECT_GT(turned, anew);
    EXPECT_LT(4 * turned, plain);
    direct.forget();
    EXPECT_LE(solve(farther, alpha, beta, &direct), 5);
  }
}

TEST_P(Direct, AFactorIsOfAScrambledBodyToo)
{
  // Rotations around a node are so different that their mean is hardly one.
  const NodalField x = test::randomField(model.num_nodes, 7);
  const Rotations before = rotations;
  AlignedVector<double> turned(rotations.flags.size());
  updateRotations(model, partition, x, before, rotations, turned);
  const MatrixFreeSystem<Rotations> system(model, partition, rotations, 1, 4e-4);
  ASSERT_TRUE(solver.prepare(system, model, partition, held, 0));
  DirectPreconditioner direct(model, partition.threads());
  ASSERT_TRUE(direct.prepare(model, rotations, held, 1, 4e-4, solver.inverse()));
  NodalField b = test::randomField(model.num_nodes, 3), u(model.num_nodes);
  const SolveReport report = solver.solve(system, partition, b, u, 1e-6, 1000, &direct);
  EXPECT_TRUE(report.converged);
  EXPECT_LE(report.iterations, 20);
}

class MultigridSteps : public testing::TestWithParam<bool>
{
};
INSTANTIATE_TEST_SUITE_P(Inverses, MultigridSteps, testing::Values(true, false),
                         [](const auto& p) { return std::string(p.param ? "factored" : "aggregated"); });

TEST_P(MultigridSteps, AreTheSameAfterAReset)
{
  using Kind = Scene::Solver::Preconditioner;
  const Model model = test::boxModel(test::irregularBox({4, 4, 8}, {0.4, 0.4, 1.0}), Element::QUADRATIC, STIFF);
  const StepSettings settings{0.02, Elasticity::COROTATED, RotationRule::FROM_CORNERS, {0, 0}, {0, -9.81, 0}, {}};
  Workspace workspace(model, settings, 1);
  Supports supports;
  supports.held.assign(model.num_nodes, 0);
  supports.region.assign(model.num_nodes, {-1, -1, -1});
  supports.start = model.rest;
  HeldRegion foot;
  foot.axes = {true, true, true};
  for (int i = 0; i < model.num_nodes; ++i)
  {
    if (model.rest[i].z() > 1e-9) continue;
    foot.nodes.push_back(i);
    supports.held[i] = 7;
    supports.region[i] = {0, 0, 0};
  }
  supports.regions.push_back(foot);
  const NodalField no_force(model.num_nodes);
  const auto run = [&] {
    State state = startState(model, settings, supports, model.rest, Vector3d::Zero(), workspace);
    // Kept, as it is what steps would make, but for how.
    workspace.preconditioner = std::make_unique<PMultigrid>(model, workspace.partition, GetParam());
    const Preconditioner* own = workspace.preconditioner.get();
    workspace.preconditioner_kind = Kind::PMULTIGRID;
    bool multigrid = false;
    for (int k = 0; k < 20; ++k)
    {
      const StepReport report = implicitEulerStep(model, settings, supports, {}, no_force, state, workspace);
      multigrid = multigrid || report.preconditioner == Kind::PMULTIGRID;
    }
    EXPECT_TRUE(multigrid);
    EXPECT_EQ(workspace.preconditioner.get(), own);
    return state.x;
  };
  const NodalField first = run(), second = run();
  EXPECT_EQ((first.matrix() - second.matrix()).norm(), 0);
}

class Cholesky : public testing::TestWithParam<Element>
{
};
INSTANTIATE_TEST_SUITE_P(Elements, Cholesky, testing::Values(Element::LINEAR, Element::QUADRATIC),
                         [](const auto& p) { return std::string(test::name(p.param)); });

TEST_P(Cholesky, SolvesLikeADenseFactor)
{
  const Model model = test::boxModel(test::irregularBox({3, 3, 5}, {0.4, 0.4, 1.0}), GetParam(), STIFF);
  const Partition partition(model, 1);
  AssembledMatrix matrix(model);
  FusedAssembler(model, matrix).assemble(model, partition, restRotations(model), 1, 4e-4, matrix);
  SparseCholesky cholesky(matrix, model.rest);
  ASSERT_TRUE(cholesky.factor(matrix));
  const int n = model.num_nodes;
  Eigen::MatrixXd dense = Eigen::MatrixXd::Zero(3L * n, 3L * n);
  for (int i = 0; i < n; ++i)
  {
    for (int k = matrix.rowBegin()[i]; k < matrix.rowBegin()[i + 1]; ++k)
    {
      dense.block<3, 3>(3L * i, 3L * matrix.column()[k]) =
          Eigen::Map<const Eigen::Matrix3d>(matrix.blocks().data() + 9L * k);
    }
  }
  const NodalField b = test::randomField(n, 4);
  AlignedVector<float> right(4 * static_cast<std::size_t>(n)), left(right.size());
  for (int i = 0; i < 4 * n; ++i) right[i] = static_cast<float>(b.data()[i]);
  cholesky.solve(right.data(), left.data());
  Eigen::VectorXd flat(3L * n), solved(3L * n);
  for (int i = 0; i < 3 * n; ++i)
  {
    flat[i] = b[i / 3][i % 3];
    solved[i] = left[4 * (i / 3) + i % 3];
  }
  const Eigen::VectorXd expected = dense.llt().solve(flat);
  EXPECT_LT((solved - expected).norm(), 1e-4 * expected.norm());

  // Not positive definite: said, not solved.
  FusedAssembler(model, matrix).assemble(model, partition, restRotations(model), -1, 4e-4, matrix);
  EXPECT_FALSE(cholesky.factor(matrix));
}

TEST_P(Cholesky, IsTheSameForAnyNumberOfThreads)
{
  const Model model = test::boxModel(test::irregularBox({6, 6, 12}, {0.4, 0.4, 1.0}), GetParam(), STIFF);
  AssembledMatrix matrix(model);
  FusedAssembler(model, matrix).assemble(model, Partition(model, 1), restRotations(model), 1, 4e-4, matrix);
  SparseCholesky cholesky(matrix, model.rest);
  ASSERT_TRUE(cholesky.factor(matrix));
  const int n = model.num_nodes;
  const NodalField b = test::randomField(n, 4);
  const auto solve = [&](int threads, std::atomic<int>& parts) {
    NodalField x(n);
    cholesky.solve(
        threads,
        [&](int begin, int end, float* to) {
          ++parts;
          for (int k = begin; k < end; ++k)
          {
            for (int axis = 0; axis < 3; ++axis) *to++ = static_cast<float>(b[cholesky.order()[k]][axis]);
            *to++ = 0;
          }
        },
        [&](int begin, int end, const float* from) {
          for (int k = begin; k < end; ++k, from += 4)
          {
            x[cholesky.order()[k]] = Eigen::Map<const Eigen::Vector3f>(from).cast<double>();
          }
        });
    return x;
  };
  std::atomic<int> parts = 0, others = 0;
  const NodalField x = solve(1, parts);
  EXPECT_GE(parts, 3);  // or there is nothing to be done at the same time
  NodalField product(n);
  matrix.product(Partition(model, 1), x, product);
  EXPECT_LT((product.matrix() - b.matrix()).norm(), 1e-3 * b.matrix().norm());
  for (const int threads : {2, 3, 8})
  {
    for (int repeat = 0; repeat < 10; ++repeat)
    {
      EXPECT_EQ((solve(threads, others).matrix() - x.matrix()).cwiseAbs().maxCoeff(), 0);
    }
  }
}

}  // namespace
}  // namespace bezier_fem
