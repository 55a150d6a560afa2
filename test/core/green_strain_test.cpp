#include "bezier_fem/green_strain.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <functional>

#include "bezier_fem/element_operator.h"
#include "bezier_fem/stable_step.h"
#include "core/bar.h"
#include "element_loop.h"
#include "kernels.h"

namespace bezier_fem
{
namespace
{
using Eigen::Matrix3d;
using Eigen::MatrixXd;
using Eigen::Vector3d;
using Eigen::VectorXd;

constexpr Material STIFF{3e6, 0.45, 1100};

class GreenStrain : public testing::TestWithParam<Element>
{
protected:
  Model model = test::boxModel(test::irregularBox({2, 2, 3}, {0.4, 0.4, 0.6}), GetParam(), STIFF);
  Partition partition{model, 1};

  /** Bent and twisted, strained by up to 40 %, and noisy. */
  NodalField bent(double noise = 0.01) const
  {
    NodalField x = model.rest;
    x.matrix() += noise * test::randomField(model.num_nodes, 5).matrix();
    for (int i = 0; i < model.num_nodes; ++i)
    {
      const Vector3d X = x[i];
      x[i] = Eigen::AngleAxisd(X.z(), Vector3d(1, 1, 0.5).normalized()) * X;
    }
    return x;
  }
  /** Pulled apart so far that no principal stress is negative anywhere. */
  NodalField pulled() const
  {
    NodalField x = bent(0.005);
    x.matrix() *= 1.5;
    return x;
  }
  NodalField force(const NodalField& x) const
  {
    NodalField f(model.num_nodes);
    greenForce(model, partition, x, f);
    return f;
  }
  GreenTangent tangent(const NodalField& x, Projection projection) const
  {
    GreenTangent result(model);
    linearise(model, partition, x, projection, result);
    return result;
  }
  MatrixXd dense(const GreenTangent& t, double alpha, double beta) const
  {
    return byColumns([&](const NodalField& unit, NodalField& column) {
      systemProduct(model, partition, t, alpha, beta, unit, column);
    });
  }
  MatrixXd byColumns(const std::function<void(const NodalField&, NodalField&)>& product) const
  {
    MatrixXd A(3L * model.num_nodes, 3L * model.num_nodes);
    NodalField unit(model.num_nodes), column(model.num_nodes);
    for (int j = 0; j < 3 * model.num_nodes; ++j)
    {
      unit.setZero();
      unit[j / 3][j % 3] = 1;
      product(unit, column);
      for (int i = 0; i < model.num_nodes; ++i) A.block<3, 1>(3L * i, j) = column[i];
    }
    return A;
  }
};
INSTANTIATE_TEST_SUITE_P(Elements, GreenStrain, testing::Values(Element::LINEAR, Element::QUADRATIC),
                         [](const auto& p) { return std::string(test::name(p.param)); });

/** Gauss-Legendre rule of six points on [0, 1], from the eigenvalues of its Jacobi matrix (Golub and Welsch 1969). */
void gauss(VectorXd& points, VectorXd& weights)
{
  constexpr int N = 6;
  MatrixXd jacobi = MatrixXd::Zero(N, N);
  for (int k = 1; k < N; ++k) jacobi(k, k - 1) = jacobi(k - 1, k) = k / std::sqrt(4.0 * k * k - 1);
  const Eigen::SelfAdjointEigenSolver<MatrixXd> eigen(jacobi);
  points = (eigen.eigenvalues().array() + 1) / 2;
  weights = eigen.eigenvectors().row(0).array().square();
}

TEST_P(GreenStrain, EnergyAndForceAreTheExactIntegrals)
{
  // Against a product rule on the cube, folded onto the tetrahedron, exact for degree nine.
  VectorXd point, weight;
  gauss(point, weight);
  const NodalField x = bent(0.05);
  double energy = 0;
  NodalField expected(model.num_nodes);
  for (int t = 0; t < model.num_tets; ++t)
  {
    Eigen::Matrix<double, 3, 4> g;
    g.rightCols<3>() = model.gradients.middleCols<3>(3L * t);
    g.col(0) = -g.rightCols<3>().rowwise().sum();
    for (int i = 0; i < point.size(); ++i)
    {
      for (int j = 0; j < point.size(); ++j)
      {
        for (int k = 0; k < point.size(); ++k)
        {
          const double a = point[i], b = point[j] * (1 - a), c = point[k] * (1 - a - b);
          const double w = 6 * model.volumes[t] * weight[i] * weight[j] * weight[k] * (1 - a) * (1 - a - b);
          const Eigen::Vector4d lambda(1 - a - b - c, a, b, c);
          const Matrix3d F = deformationGradient(model, x, {t, lambda});
          const Matrix3d E = (F.transpose() * F - Matrix3d::Identity()) / 2;
          const Matrix3d S = lameLambda(STIFF) * E.trace() * Matrix3d::Identity() + 2 * lameMu(STIFF) * E;
          energy += w / 2 * E.cwiseProduct(S).sum();
          for (int n = 0; n < model.nodes_per_tet; ++n)
          {
            Vector3d grad = g.col(n % 4);
            if (model.quadratic() && n < CORNERS) grad *= 2 * lambda[n];
            if (n >= CORNERS)
            {
              const auto [p, q] = EDGE_CORNERS[n - CORNERS];
              grad = 2 * (lambda[p] * g.col(q) + lambda[q] * g.col(p));
            }
            expected[model.nodesOf(t)[n]] += w * F * S * grad;
          }
        }
      }
    }
  }
  EXPECT_NEAR(greenEnergy(model, x), energy, 1e-12 * energy);
  EXPECT_LT((force(x).matrix() - expected.matrix()).norm(), 1e-12 * expected.matrix().norm());
}

TEST_P(GreenStrain, ForceIsTheGradientOfTheEnergy)
{
  const NodalField x = bent(0.05), direction = test::randomField(model.num_nodes, 12);
  const auto energy = [&](double s) {
    NodalField moved = x;
    moved.matrix() += s * direction.matrix();
    return greenEnergy(model, moved);
  };
  // The energy is a polynomial of degree four: the five-point difference is exact, at any step.
  const double h = 0.02;
  const double slope = (8 * (energy(h) - energy(-h)) - (energy(2 * h) - energy(-2 * h))) / (12 * h);
  const double work = force(x).matrix().cwiseProduct(direction.matrix()).sum();
  EXPECT_NEAR(slope, work, 1e-10 * std::abs(work));
}

TEST_P(GreenStrain, TangentIsTheDerivativeOfTheForce)
{
  const NodalField u = test::randomField(model.num_nodes, 13);
  for (const bool tension : {false, true})
  {
    const NodalField x = tension ? pulled() : bent(0.05);
    // The force is a cubic polynomial: the five-point difference is exact.
    const double h = 0.02;
    NodalField slope(model.num_nodes), product(model.num_nodes), projected(model.num_nodes);
    for (const auto& [shift, factor] : {std::pair{1, 8.0}, {-1, -8.0}, {2, -1.0}, {-2, 1.0}})
    {
      NodalField moved = x;
      moved.matrix() += shift * h * u.matrix();
      slope.matrix() += factor / (12 * h) * force(moved).matrix();
    }
    systemProduct(model, partition, tangent(x, Projection::NONE), 0, 1, u, product);
    EXPECT_LT((product.matrix() - slope.matrix()).norm(), 1e-10 * slope.matrix().norm());
    systemProduct(model, partition, tangent(x, Projection::POSITIVE_STRESS), 0, 1, u, projected);
    const double apart = (projected.matrix() - slope.matrix()).norm() / slope.matrix().norm();
    if (tension)
    {
      EXPECT_LT(apart, 1e-10);  // the rule of the projection is exact too
    }
    else
    {
      EXPECT_GT(apart, 1e-3);
    }
  }
}

TEST_P(GreenStrain, AtRestTheTangentIsTheStiffnessOfSmallStrain)
{
  const NodalField u = test::randomField(model.num_nodes, 14);
  NodalField expected(model.num_nodes), product(model.num_nodes);
  systemProduct(model, partition, restRotations(model), 1.5, 0.3, u, expected);
  for (const Projection projection : {Projection::NONE, Projection::POSITIVE_STRESS})
  {
    systemProduct(model, partition, tangent(model.rest, projection), 1.5, 0.3, u, product);
    EXPECT_LT((product.matrix() - expected.matrix()).norm(), 1e-12 * expected.matrix().norm());
  }
  // And the forces meet, the quicker the smaller the strain.
  for (const double size : {1e-3, 1e-5})
  {
    NodalField x = model.rest, small(model.num_nodes);
    x.matrix() += size * u.matrix();
    elasticForce(model, partition, restRotations(model), x, small);
    EXPECT_LT((force(x).matrix() - small.matrix()).norm(), 100 * size * small.matrix().norm());
  }
}

TEST_P(GreenStrain, DiagonalAndSymmetryOfTheTangent)
{
  AlignedVector<double> blocks(static_cast<std::size_t>(model.num_nodes) * kernels::DIAGONAL_STRIDE);
  for (const Projection projection : {Projection::NONE, Projection::POSITIVE_STRESS})
  {
    const GreenTangent t = tangent(bent(0.05), projection);
    const MatrixXd A = dense(t, 1.5, 0.02);
    EXPECT_LT((A - A.transpose()).norm(), 1e-14 * A.norm());
    systemDiagonal(model, partition, t, 1.5, 0.02, blocks);
    for (int i = 0; i < model.num_nodes; ++i)
    {
      const double* d = blocks.data() + static_cast<std::ptrdiff_t>(kernels::DIAGONAL_STRIDE) * i;
      Matrix3d block;
      block << d[0], d[4], d[5], d[4], d[1], d[6], d[5], d[6], d[2];
      const Matrix3d expected = A.block<3, 3>(3L * i, 3L * i);
      EXPECT_LT((block - expected).norm(), 1e-12 * expected.norm());
    }
  }
}

TEST_P(GreenStrain, ProjectedTangentIsPositiveSemidefiniteInEveryState)
{
  std::vector<NodalField> states{model.rest, bent(0.01), bent(0.1)};
  for (unsigned seed = 20; seed < 23; ++seed) states.push_back(test::randomField(model.num_nodes, seed));
  NodalField squeezed = model.rest, mirrored = model.rest, flat = model.rest, point = model.rest;
  squeezed.matrix() *= 0.4;
  mirrored.matrix().row(0) *= -1;
  flat.matrix().row(2).setZero();
  point.setZero();
  states.insert(states.end(), {squeezed, mirrored, flat, point});
  bool was_needed = false;
  for (const NodalField& x : states)
  {
    const Eigen::SelfAdjointEigenSolver<MatrixXd> plain(dense(tangent(x, Projection::NONE), 0, 1));
    const Eigen::SelfAdjointEigenSolver<MatrixXd> projected(dense(tangent(x, Projection::POSITIVE_STRESS), 0, 1));
    const double largest = std::max(projected.eigenvalues().maxCoeff(), plain.eigenvalues().cwiseAbs().maxCoeff());
    EXPECT_GT(projected.eigenvalues().minCoeff(), -1e-13 * largest);
    was_needed = was_needed || plain.eigenvalues().minCoeff() < -0.01 * largest;
  }
  EXPECT_TRUE(was_needed);
}

TEST_P(GreenStrain, IsTheSameInEveryFrame)
{
  const NodalField x = bent(0.05), f = force(x);
  const double energy = greenEnergy(model, x), scale = f.matrix().cwiseAbs().maxCoeff();
  std::mt19937 random(11);
  for (int k = 0; k < 10; ++k)
  {
    const Matrix3d R = test::randomRotation(random);
    const auto moved = [&](const NodalField& from) {
      NodalField to = from;
      to.matrix().topRows<3>() = (R * from.matrix().topRows<3>()).colwise() + Vector3d(3, -2, 1);
      return to;
    };
    EXPECT_LT(force(moved(model.rest)).matrix().cwiseAbs().maxCoeff(), 1e-12 * scale);
    EXPECT_LT(std::abs(greenEnergy(model, moved(model.rest))), 1e-20 * energy);
    NodalField turned = f;
    turned.matrix().topRows<3>() = R * f.matrix().topRows<3>();
    EXPECT_LT((force(moved(x)).matrix() - turned.matrix()).norm(), 1e-12 * f.matrix().norm());
    EXPECT_NEAR(greenEnergy(model, moved(x)), energy, 1e-12 * energy);
  }
  // No force and no torque in all.
  Vector3d sum = Vector3d::Zero(), torque = Vector3d::Zero();
  for (int i = 0; i < model.num_nodes; ++i)
  {
    sum += f[i];
    torque += Vector3d(x[i]).cross(Vector3d(f[i]));
  }
  EXPECT_LT(sum.norm(), 1e-12 * scale);
  EXPECT_LT(torque.norm(), 1e-12 * scale);
}

TEST_P(GreenStrain, PatchTest)
{
  // A homogeneous deformation, large: no force inside, and the stress and the energy of the closed form.
  const Model cube = test::boxModel(test::irregularBox({3, 3, 3}, {1, 1, 1}), GetParam(), STIFF);
  const Partition one(cube, 1);
  Matrix3d F;
  F << 1.3, 0.2, -0.1, 0.1, 0.8, 0.2, 0.05, -0.2, 1.1;
  NodalField x = cube.rest, f(cube.num_nodes);
  x.matrix().topRows<3>() = F * cube.rest.matrix().topRows<3>();
  greenForce(cube, one, x, f);
  const double scale = f.matrix().cwiseAbs().maxCoeff();
  int inside = 0;
  for (int i = 0; i < cube.num_nodes; ++i)
  {
    const Vector3d X = cube.rest[i];
    if (X.minCoeff() < 1e-9 || X.maxCoeff() > 1 - 1e-9) continue;
    ++inside;
    EXPECT_LT(f[i].norm(), 1e-12 * scale);
  }
  EXPECT_GT(inside, 7);
  const Matrix3d E = (F.transpose() * F - Matrix3d::Identity()) / 2;
  const Matrix3d S = lameLambda(STIFF) * E.trace() * Matrix3d::Identity() + 2 * lameMu(STIFF) * E;
  EXPECT_NEAR(greenEnergy(cube, x), E.cwiseProduct(S).sum() / 2, 1e-11 * S.norm());
  const Matrix3d s = F * S * F.transpose() / F.determinant();
  const Stress expected = (Stress() << s(0, 0), s(1, 1), s(2, 2), s(0, 1), s(1, 2), s(0, 2)).finished();
  EXPECT_LT((greenNodalStress(cube, x).colwise() - expected).cwiseAbs().maxCoeff(), 1e-11 * s.norm());
  // Collapsed to a plane: finite.
  x.matrix().row(1).setZero();
  EXPECT_TRUE(greenNodalStress(cube, x).allFinite());
}

TEST_P(GreenStrain, EveryInstructionSetAndThreadCountAgrees)
{
  const Model larger = test::boxModel(test::irregularBox({3, 3, 5}, {0.5, 0.3, 0.6}), GetParam(), STIFF);
  const Partition one(larger, 1);
  NodalField x = larger.rest;
  x.matrix() += 0.02 * test::randomField(larger.num_nodes, 5).matrix();
  const NodalField u = test::randomField(larger.num_nodes, 8);
  struct Result
  {
    double energy;
    NodalField force, product;
    AlignedVector<double> diagonal;
  };
  const auto compute = [&](const kernels::Table& table, bool projected) {
    const kernels::GreenTable& green = larger.quadratic() ? table.green_quadratic : table.green_linear;
    const kernels::Elements elements = elementsOf(larger, 1);
    const double* rest = larger.block_gradients.data();
    Result r{0, NodalField(larger.num_nodes), NodalField(larger.num_nodes), {}};
    r.diagonal.resize(static_cast<std::size_t>(kernels::DIAGONAL_STRIDE) * larger.num_nodes);
    GreenTangent t(larger);
    r.energy = green.energy(elements, 0, larger.num_blocks, rest, x.data());
    const kernels::NodeShares lists = sharesOf(larger);
    AlignedVector<double> shares(2 * kernels::SHARES * (kernels::ZERO_ROWS + larger.nodes_per_tet * larger.num_blocks));
    green.add_force(elements, 0, larger.num_blocks, rest, x.data(),
                    shares.data() + kernels::ZERO_ROWS * kernels::SHARES);
    table.sum_shares(lists, 0, larger.num_nodes, shares.data(), r.force.data());
    green.linearise(elements, 0, larger.num_blocks, rest, x.data(), projected, t.blocks.data());
    green.add_product(elements, 0, larger.num_blocks, rest, t.blocks.data(), 2, 0.3, u.data(),
                      shares.data() + kernels::ZERO_ROWS * kernels::SHARES);
    table.sum_shares(lists, 0, larger.num_nodes, shares.data(), r.product.data());
    std::fill(shares.begin(), shares.end(), 0.0);
    green.add_diagonal(elements, 0, larger.num_blocks, rest, t.blocks.data(), 2, 0.3,
                       shares.data() + 2 * kernels::ZERO_ROWS * kernels::SHARES);
    table.sum_diagonals(lists, 0, larger.num_nodes, shares.data(), r.diagonal.data());
    return r;
  };
  const auto distance = [](const NodalField& a, const NodalField& b) {
    return (a.matrix() - b.matrix()).norm() / b.matrix().norm();
  };
  for (const bool projected : {false, true})
  {
    const Result expected = compute(*kernels::tableByName("portable"), projected);
    for (const char* name : {"avx2", "avx512"})
    {
      const kernels::Table* table = kernels::tableByName(name);
      if (!table) continue;
      const Result r = compute(*table, projected);
      EXPECT_NEAR(r.energy, expected.energy, 1e-13 * expected.energy) << name;
      EXPECT_LT(distance(r.force, expected.force), 1e-13) << name;
      EXPECT_LT(distance(r.product, expected.product), 1e-13) << name;
      for (std::size_t k = 0; k < r.diagonal.size(); ++k)
      {
        ASSERT_NEAR(r.diagonal[k], expected.diagonal[k], 1e-12 * std::abs(expected.diagonal[k - k % 8])) << name;
      }
    }
    for (const int threads : {2, 3, 7})
    {
      const Partition several(larger, threads);
      NodalField f(larger.num_nodes), product(larger.num_nodes);
      GreenTangent t(larger);
      greenForce(larger, several, x, f);
      linearise(larger, several, x, projected ? Projection::POSITIVE_STRESS : Projection::NONE, t);
      systemProduct(larger, several, t, 2, 0.3, u, product);
      EXPECT_LT(distance(f, expected.force), 1e-13);
      EXPECT_LT(distance(product, expected.product), 1e-13);
    }
  }
}

/** The largest eigenvalue of M^-1 K. */
double largestEigenvalue(const MatrixXd& K, const MatrixXd& M)
{
  return Eigen::GeneralizedSelfAdjointEigenSolver<MatrixXd>(K, M, Eigen::EigenvaluesOnly).eigenvalues().maxCoeff();
}

TEST_P(GreenStrain, SpectralBoundIsAboveTheLargestEigenvalueAndNotFar)
{
  for (const Material material : {STIFF, Material{2e5, 0.0, 500}, Material{2e5, -0.3, 500}})
  {
    setMaterials(model, std::vector<Material>(model.num_tets, material));
    const SpectralBound bound(model, partition);
    const MatrixXd M = dense(tangent(model.rest, Projection::NONE), 1, 0);
    const double at_rest = largestEigenvalue(dense(tangent(model.rest, Projection::NONE), 0, 1), M);
    EXPECT_NEAR(bound.green(model, partition, model.rest), bound.corotated(), 1e-9 * at_rest);
    NodalField turned = bent(0.02);
    Rotations rotations = restRotations(model);
    AlignedVector<double> angles(static_cast<std::size_t>(model.num_blocks) * LANES);
    updateRotations(model, partition, turned, restRotations(model), rotations, angles);
    const double corotated = largestEigenvalue(byColumns([&](const NodalField& unit, NodalField& column) {
                                                 systemProduct(model, partition, rotations, 0, 1, unit, column);
                                               }),
                                               M);
    EXPECT_GE(bound.corotated(), corotated);
    // Most of the distance is the elements' own eigenvalues against the body's, at rest too.
    for (const NodalField& x : {model.rest, bent(0.005), pulled()})
    {
      const double limit = bound.green(model, partition, x);
      const double plain = largestEigenvalue(dense(tangent(x, Projection::NONE), 0, 1), M);
      EXPECT_GE(limit, plain);
      EXPECT_GE(limit, largestEigenvalue(dense(tangent(x, Projection::POSITIVE_STRESS), 0, 1), M));
      EXPECT_GT(stableStep(limit, {0, 0}), 0.42 * stableStep(plain, {0, 0}));
    }
    for (const NodalField& x : {bent(0.05), test::randomField(model.num_nodes, 30)})
    {
      EXPECT_GE(bound.green(model, partition, x),
                largestEigenvalue(dense(tangent(x, Projection::POSITIVE_STRESS), 0, 1), M));
    }
  }
}

TEST_P(GreenStrain, ExplicitStepsStayBoundedBelowTheStableStepAndNotAbove)
{
  // The step is that of the body's own largest eigenvalue at the start; the bound's is shorter.
  const SpectralBound bound(model, partition);
  const MatrixXd M = dense(tangent(model.rest, Projection::NONE), 1, 0);
  const Eigen::LLT<MatrixXd> factor(M);
  const double largest = largestEigenvalue(dense(tangent(model.rest, Projection::NONE), 0, 1), M);
  for (const Scene::Damping& damping : {Scene::Damping{0, 0}, Scene::Damping{20, 1e-4}})
  {
    EXPECT_LE(stableStep(bound.corotated(), damping), stableStep(largest, damping));
    const auto run = [&](double dt) {
      NodalField x = model.rest;
      x.matrix() += 1e-6 * test::randomField(model.num_nodes, 3).matrix();
      const double start = greenEnergy(model, x);
      VectorXd v = VectorXd::Zero(3L * model.num_nodes);
      double energy = start;
      for (int k = 0; k < 1000 && energy < 1e3 * start; ++k)
      {
        NodalField velocity(model.num_nodes), rate(model.num_nodes);
        for (int i = 0; i < model.num_nodes; ++i) velocity[i] = v.segment<3>(3L * i);
        systemProduct(model, partition, tangent(x, Projection::NONE), damping.mass, damping.stiffness, velocity, rate);
        const NodalField f = force(x);
        VectorXd rhs(v.size());
        for (int i = 0; i < model.num_nodes; ++i) rhs.segment<3>(3L * i) = -f[i] - rate[i];
        v += dt * factor.solve(rhs);
        for (int i = 0; i < model.num_nodes; ++i) x[i] += dt * v.segment<3>(3L * i);
        energy = greenEnergy(model, x) + v.dot(M * v) / 2;
      }
      return energy / start;
    };
    EXPECT_LT(run(0.95 * stableStep(bound.corotated(), damping)), 100);
    EXPECT_LT(run(0.95 * stableStep(largest, damping)), 100);
    EXPECT_GT(run(1.05 * stableStep(largest, damping)), 1000);
  }
}

}  // namespace
}  // namespace bezier_fem
