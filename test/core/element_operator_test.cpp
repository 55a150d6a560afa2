#include "bezier_fem/element_operator.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <numeric>

#include "bezier_fem/conjugate_gradient.h"
#include "bezier_fem/measures.h"
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

struct Variant
{
  const char* name;
  Element element;
  RotationRule rule;
  Dilatation dilatation = Dilatation::FULL;
};

class EveryElement : public testing::TestWithParam<Variant>
{
protected:
  Model box(const Eigen::Vector3i& cells, const Vector3d& size) const;
  Rotations rest(const Model& model) const { return restRotations(model, GetParam().rule); }
  /** Mean dilatation with something to do. */
  Material stiff() const { return {3e6, GetParam().dilatation == Dilatation::MEAN ? 0.485 : 0.45, 1100}; }
};
INSTANTIATE_TEST_SUITE_P(
    Elements, EveryElement,
    testing::Values(Variant{"linear", Element::LINEAR, RotationRule::FROM_CORNERS},
                    Variant{"quadratic", Element::QUADRATIC, RotationRule::FROM_CORNERS},
                    Variant{"quadratic_centroid", Element::QUADRATIC, RotationRule::FROM_CENTROID},
                    Variant{"quadratic_four", Element::QUADRATIC, RotationRule::FOUR_POINTS},
                    Variant{"linear_mean", Element::LINEAR, RotationRule::FROM_CORNERS, Dilatation::MEAN},
                    Variant{"quadratic_mean", Element::QUADRATIC, RotationRule::FROM_CORNERS, Dilatation::MEAN},
                    Variant{"quadratic_four_mean", Element::QUADRATIC, RotationRule::FOUR_POINTS, Dilatation::MEAN}),
    [](const auto& p) { return std::string(p.param.name); });

Model EveryElement::box(const Eigen::Vector3i& cells, const Vector3d& size) const
{
  return test::boxModel(test::irregularBox(cells, size), GetParam().element, stiff(), GetParam().dilatation);
}

/** K_IJ of one element by quadrature of the definition, integral of C(grad B_I) : grad B_J, gradients rotated. */
MatrixXd denseStiffness(const Model& model, const Rotations& rotations, int tet)
{
  const int nodes = model.nodes_per_tet;
  const double volume = model.volumes[tet], mu = lameMu(model.materials[tet]), mean_lambda = meanLambda(model, tet);
  const double lambda_at_points = lameLambda(model.materials[tet]) - mean_lambda;
  Eigen::Matrix3Xd mean = Eigen::Matrix3Xd::Zero(3, nodes);
  // Four points, exact for the products of two linear gradients.
  const double a = (5 + 3 * std::sqrt(5.0)) / 20, b = (5 - std::sqrt(5.0)) / 20;
  MatrixXd K = MatrixXd::Zero(3 * nodes, 3 * nodes);
  for (int q = 0; q < 4; ++q)
  {
    Eigen::Vector4d lambda = Eigen::Vector4d::Constant(b);
    lambda[q] = a;
    const Eigen::Matrix<double, 3, 4> r = rotations.gradient(tet, rotations.points == 4 ? q : 0);
    Eigen::Matrix3Xd grad(3, nodes);
    for (int c = 0; c < 4; ++c) grad.col(c) = nodes == 4 ? Vector3d(r.col(c)) : Vector3d(2 * lambda[c] * r.col(c));
    for (int e = 0; nodes == 10 && e < EDGES; ++e)
    {
      const auto [c, d] = EDGE_CORNERS[e];
      grad.col(CORNERS + e) = 2 * (lambda[c] * r.col(d) + lambda[d] * r.col(c));
    }
    mean += grad / 4;
    for (int I = 0; I < nodes; ++I)
    {
      for (int J = 0; J < nodes; ++J)
      {
        const Vector3d gi = grad.col(I), gj = grad.col(J);
        K.block<3, 3>(3 * I, 3 * J) += volume / 4 *
                                       (lambda_at_points * gi * gj.transpose() + mu * gj * gi.transpose() +
                                        mu * gi.dot(gj) * Matrix3d::Identity());
      }
    }
  }
  const Eigen::Map<const Eigen::VectorXd> all(mean.data(), 3L * nodes);
  return K + volume * mean_lambda * all * all.transpose();
}

/** rho V times the integral of B_I B_J / V = G(I,J)/35 (METHOD: products of binomials). */
MatrixXd denseMass(int nodes, double mass)
{
  const auto exponents = [&](int I) {
    Eigen::Vector4i e = Eigen::Vector4i::Zero();
    if (I < CORNERS)
    {
      e[I] = 2;
    }
    else
    {
      ++e[EDGE_CORNERS[I - CORNERS][0]];
      ++e[EDGE_CORNERS[I - CORNERS][1]];
    }
    return e;
  };
  const auto binomial = [](int n, int k) {
    return std::round(std::tgamma(n + 1) / std::tgamma(k + 1) / std::tgamma(n - k + 1));
  };
  MatrixXd M = MatrixXd::Zero(3 * nodes, 3 * nodes);
  for (int I = 0; I < nodes; ++I)
  {
    for (int J = 0; J < nodes; ++J)
    {
      double value = (I == J ? 2.0 : 1.0) / 20;
      if (nodes == 10)
      {
        value = 1.0 / 35 / 6;
        for (int c = 0; c < 4; ++c) value *= binomial(exponents(I)[c] + exponents(J)[c], exponents(I)[c]);
      }
      M.block<3, 3>(3 * I, 3 * J) = mass * value * Matrix3d::Identity();
    }
  }
  return M;
}

/** alpha M + beta K', assembled from dense element matrices. */
MatrixXd denseSystem(const Model& model, const Rotations& rotations, double alpha, double beta)
{
  MatrixXd A = MatrixXd::Zero(3L * model.num_nodes, 3L * model.num_nodes);
  for (int t = 0; t < model.num_tets; ++t)
  {
    const Material& m = model.materials[t];
    const MatrixXd element = alpha * denseMass(model.nodes_per_tet, m.density * model.volumes[t]) +
                             beta * denseStiffness(model, rotations, t);
    for (int I = 0; I < model.nodes_per_tet; ++I)
    {
      for (int J = 0; J < model.nodes_per_tet; ++J)
      {
        A.block<3, 3>(3L * model.nodesOf(t)[I], 3L * model.nodesOf(t)[J]) += element.block<3, 3>(3L * I, 3L * J);
      }
    }
  }
  return A;
}

MatrixXd byColumns(const Model& model, const Partition& partition, const Rotations& rotations, double alpha,
                   double beta)
{
  MatrixXd A(3L * model.num_nodes, 3L * model.num_nodes);
  NodalField unit(model.num_nodes), column(model.num_nodes);
  for (int j = 0; j < 3 * model.num_nodes; ++j)
  {
    unit.setZero();
    unit[j / 3][j % 3] = 1;
    systemProduct(model, partition, rotations, alpha, beta, unit, column);
    for (int i = 0; i < model.num_nodes; ++i) A.block<3, 1>(3L * i, j) = column[i];
  }
  return A;
}

/** Some state with every element rotated and deformed. */
struct Bent
{
  Bent(const Model& model, const Partition& partition, RotationRule rule)
      : x(model.rest), rotations(restRotations(model, rule))
  {
    const NodalField noise = test::randomField(model.num_nodes, 5);
    for (int i = 0; i < model.num_nodes; ++i)
    {
      const Vector3d X = model.rest[i];
      x[i] = Eigen::AngleAxisd(X.z(), Vector3d(1, 1, 0).normalized()) * X + 0.03 * noise[i];
    }
    turn(model, partition);
  }
  /** Makes the rotations those of x. */
  void turn(const Model& model, const Partition& partition)
  {
    AlignedVector<double> turned(rotations.flags.size());
    const Rotations before = rotations;
    updateRotations(model, partition, x, before, rotations, turned);
  }
  NodalField x;
  Rotations rotations;
};

/** How far systemDiagonal() is from the blocks of the reference, relative to each. */
double diagonalError(const Model& model, const Partition& partition, const Rotations& rotations, double alpha,
                     double beta, const MatrixXd& reference)
{
  AlignedVector<double> blocks(static_cast<std::size_t>(model.num_nodes) * kernels::DIAGONAL_STRIDE);
  systemDiagonal(model, partition, rotations, alpha, beta, blocks);
  double largest = 0;
  for (int i = 0; i < model.num_nodes; ++i)
  {
    const double* d = blocks.data() + static_cast<std::ptrdiff_t>(kernels::DIAGONAL_STRIDE) * i;
    Matrix3d block;
    block << d[0], d[4], d[5], d[4], d[1], d[6], d[5], d[6], d[2];
    const Matrix3d expected = reference.block<3, 3>(3L * i, 3L * i);
    const double error = (block - expected).norm() / expected.norm();
    EXPECT_TRUE(std::isfinite(error));
    largest = std::max(largest, error);
  }
  return largest;
}

TEST_P(EveryElement, OperatorEqualsItsDenseReference)
{
  // Elements that are alone, and some in pairs beside those.
  for (const bool pairs : {false, true})
  {
    SCOPED_TRACE(pairs);
    const Model model = box(pairs ? Eigen::Vector3i(2, 1, 4) : Eigen::Vector3i(2, 1, 2), {0.5, 0.3, 0.6});
    const auto count = [&](kernels::Pairing pairing) {
      return std::count(model.block_pairing.begin(), model.block_pairing.end(), pairing);
    };
    ASSERT_EQ(count(kernels::SECOND), pairs ? 1 : 0);
    ASSERT_GT(count(kernels::ALONE), 0);
    const Partition partition(model, 1);
    const Bent bent(model, partition, GetParam().rule);
    const MatrixXd reference = denseSystem(model, bent.rotations, 1.5, 0.02);
    const MatrixXd A = byColumns(model, partition, bent.rotations, 1.5, 0.02);
    EXPECT_EQ(model.block_mean.empty(), !model.quadratic() || GetParam().dilatation == Dilatation::FULL);
    EXPECT_LT((A - reference).norm(), 1e-13 * reference.norm());
    EXPECT_LT((A - A.transpose()).norm(), 1e-14 * reference.norm());
    EXPECT_LT(diagonalError(model, partition, bent.rotations, 1.5, 0.02, reference), 1e-6);
    EXPECT_GT(diagonalError(model, partition, bent.rotations, 1.5, 0.02, reference), 1e-9);  // in single precision
  }
}

TEST_P(EveryElement, DiagonalBlocksAreDefiniteHoweverIncompressible)
{
  for (const double poisson : {-0.99, 0.0, 0.4999, 0.49994, 0.49996, 0.499999})
  {
    SCOPED_TRACE(poisson);
    const Model model = test::boxModel(test::irregularBox({2, 1, 2}, {0.5, 0.3, 0.6}), GetParam().element,
                                       {3e6, poisson, 1100}, GetParam().dilatation);
    const Partition partition(model, 1);
    const Bent bent(model, partition, GetParam().rule);
    const HeldAxes held(model.num_nodes, 0);
    ConjugateGradient solver(model, partition);
    for (const double alpha : {0.0, 1.0})
    {
      const MatrixFreeSystem<Rotations> system(model, partition, bent.rotations, alpha, 0.02);
      const MatrixXd reference = denseSystem(model, bent.rotations, alpha, 0.02);
      EXPECT_LT(diagonalError(model, partition, bent.rotations, alpha, 0.02, reference),
                poisson > 0.49995 ? 1e-12 : 1e-6);
      EXPECT_TRUE(solver.prepare(system, model, partition, held, 0));
      for (int i = 0; i < model.num_nodes; ++i)
      {
        const double* d = solver.inverse().data() + static_cast<std::ptrdiff_t>(kernels::DIAGONAL_STRIDE) * i;
        Matrix3d inverse;
        inverse << d[0], d[4], d[5], d[4], d[1], d[6], d[5], d[6], d[2];
        const Matrix3d product = inverse * reference.block<3, 3>(3L * i, 3L * i);
        EXPECT_LT((product - Matrix3d::Identity()).norm(), 1e-2);
      }
    }
  }
}

TEST_P(EveryElement, DiagonalBlocksAreRightInAnyUnits)
{
  // A body of atoms, one of stars, and materials to go with them or not.
  for (const double size : {1e-12, 1e-6, 1.0, 1e6, 1e12})
  {
    for (const double young : {1e-15, 1.0, 1e15})
    {
      for (const double density : {1e-15, 1.0, 1e15})
      {
        const Model model = test::boxModel(test::irregularBox({2, 1, 2}, Vector3d(0.5, 0.3, 0.6) * size),
                                           GetParam().element, {young, 0.45, density}, GetParam().dilatation);
        const Partition partition(model, 1);
        const Rotations rotations = rest(model);
        for (const double h : {1e-9, 0.01, 1e3})
        {
          const MatrixXd reference = denseSystem(model, rotations, 1, h * h);
          EXPECT_LT(diagonalError(model, partition, rotations, 1, h * h, reference), 1e-6)
              << size << " m, " << young << " Pa, " << density << " kg/m^3, " << h << " s";
        }
        EXPECT_LT(diagonalError(model, partition, rotations, 1, 0, denseSystem(model, rotations, 1, 0)), 1e-6);
        EXPECT_LT(diagonalError(model, partition, rotations, 0, 1, denseSystem(model, rotations, 0, 1)), 1e-6);
      }
    }
  }
}

TEST_P(EveryElement, EveryInstructionSetAndThreadCountAgrees)
{
  const Model model = box({3, 3, 5}, {0.5, 0.3, 0.6});
  const Partition one(model, 1);
  const Bent bent(model, one, GetParam().rule);
  const NodalField u = test::randomField(model.num_nodes, 8);
  NodalField expected(model.num_nodes);
  systemProduct(model, one, bent.rotations, 2, 0.3, u, expected);
  NodalField force_reference(model.num_nodes);
  elasticForce(model, one, bent.rotations, bent.x, force_reference);
  const Rotations unturned = rest(model);
  NodalField force_unturned(model.num_nodes);
  elasticForce(model, one, unturned, bent.x, force_unturned);
  const double work = turnWork(model, one, unturned, bent.rotations, bent.x, u);
  const double scale = force_unturned.matrix().norm() * u.matrix().norm();
  EXPECT_NEAR(work, (force_reference.matrix() - force_unturned.matrix()).cwiseProduct(u.matrix()).sum(), 1e-14 * scale);
  EXPECT_GT(std::abs(work), 1e-4 * scale);
  for (const int threads : {2, 3, 7})
  {
    const Partition partition(model, threads);
    ASSERT_EQ(partition.threads(), threads);
    EXPECT_EQ(turnWork(model, partition, unturned, bent.rotations, bent.x, u), work);
    NodalField product(model.num_nodes), again(model.num_nodes);
    systemProduct(model, partition, bent.rotations, 2, 0.3, u, product);
    const auto difference = product.matrix() - expected.matrix();
    EXPECT_EQ(difference.norm(), 0);
    systemProduct(model, partition, bent.rotations, 2, 0.3, u, again);
    EXPECT_EQ((again.matrix() - product.matrix()).norm(), 0);
    AlignedVector<double> diagonal(static_cast<std::size_t>(kernels::DIAGONAL_STRIDE) * model.num_nodes);
    AlignedVector<double> by_one(diagonal.size());
    systemDiagonal(model, partition, bent.rotations, 2, 0.3, diagonal);
    systemDiagonal(model, one, bent.rotations, 2, 0.3, by_one);
    EXPECT_EQ(diagonal, by_one);
  }
  AlignedVector<double> diagonal_reference;
  int sets = 0;
  for (const char* name : {"portable", "avx2", "avx512"})
  {
    const kernels::Table* table = kernels::tableByName(name);
    if (!table) continue;
    ++sets;
    const kernels::Elements elements = elementsOf(model, bent.rotations.points);
    NodalField product(model.num_nodes), force(model.num_nodes);
    const kernels::NodeShares lists = sharesOf(model);
    AlignedVector<double> shares(2 * kernels::SHARES * (kernels::ZERO_ROWS + model.nodes_per_tet * model.num_blocks));
    table->add_product(elements, 0, model.num_blocks, bent.rotations.gradients.data(), 2, 0.3, u.data(),
                       shares.data() + kernels::ZERO_ROWS * kernels::SHARES);
    table->sum_shares(lists, 0, model.num_nodes, shares.data(), product.data());
    EXPECT_LT((product.matrix() - expected.matrix()).norm(), 1e-14 * expected.matrix().norm()) << name;
    table->add_force(elements, 0, model.num_blocks, bent.rotations.gradients.data(), bent.x.data(),
                     shares.data() + kernels::ZERO_ROWS * kernels::SHARES);
    table->sum_shares(lists, 0, model.num_nodes, shares.data(), force.data());
    EXPECT_LT((force.matrix() - force_reference.matrix()).norm(), 1e-13 * force_reference.matrix().norm()) << name;
    AlignedVector<double> sums(model.num_blocks);
    table->turn_work(elements, 0, model.num_blocks, unturned.gradients.data(), bent.rotations.gradients.data(),
                     bent.x.data(), u.data(), sums.data());
    EXPECT_NEAR(std::accumulate(sums.begin(), sums.end(), 0.0), work, 1e-14 * scale) << name;

    AlignedVector<double> diagonal(static_cast<std::size_t>(kernels::DIAGONAL_STRIDE) * model.num_nodes, 0.0);
    std::fill(shares.begin(), shares.end(), 0.0);
    table->add_diagonal(elements, 0, model.num_blocks, bent.rotations.gradients.data(), 2, 0.3,
                        shares.data() + 2 * kernels::ZERO_ROWS * kernels::SHARES);
    table->sum_diagonals(lists, 0, model.num_nodes, shares.data(), diagonal.data());
    if (diagonal_reference.empty()) diagonal_reference = diagonal;
    AlignedVector<double> single(diagonal.size(), 0.0);
    AlignedVector<float> single_shares(shares.size());
    table->add_single_diagonal(elements, 0, model.num_blocks, bent.rotations.gradients.data(), 2e-6, 0.3e-6,
                               single_shares.data() + 2 * kernels::ZERO_ROWS * kernels::SHARES);
    table->sum_single_diagonals(lists, 0, model.num_nodes, single_shares.data(), 1e6, single.data());
    for (std::size_t k = 0; k < diagonal.size(); ++k)
    {
      ASSERT_NEAR(diagonal[k], diagonal_reference[k], 1e-13 * std::abs(diagonal_reference[k - k % 8])) << name;
      ASSERT_NEAR(single[k], diagonal_reference[k], 3e-6 * std::abs(diagonal_reference[k - k % 8])) << name;
    }
    Rotations rotations = rest(model);
    AlignedVector<double> turned(rotations.flags.size());
    const Rotations start = rest(model);
    const kernels::Gradient gradient = start.points == 4                           ? kernels::Gradient::AT_FOUR_POINTS
                                       : start.rule == RotationRule::FROM_CENTROID ? kernels::Gradient::AT_CENTROID
                                                                                   : kernels::Gradient::OF_CORNERS;
    table->update_rotations(elements, gradient, 0, model.num_blocks, model.block_gradients.data(), bent.x.data(),
                            start.matrices.data(), rotations.matrices.data(), rotations.gradients.data(), turned.data(),
                            rotations.flags.data());
    int compared = 0;
    for (std::size_t slot = 0; slot < rotations.flags.size(); ++slot)
    {
      if (!(rotations.flags[slot] & kernels::UNIQUE)) continue;
      ++compared;
      for (std::size_t k = 0; k < 9; ++k)
      {
        const std::size_t at = (slot / LANES * 9 + k) * LANES + slot % LANES;
        ASSERT_NEAR(rotations.matrices[at], bent.rotations.matrices[at], 1e-12) << name;
      }
    }
    EXPECT_GT(compared, model.num_tets / 2);
  }
  EXPECT_GE(sets, 1);
}

TEST_P(EveryElement, OneElementHasSixRigidModes)
{
  TetMesh mesh;
  mesh.corners.resize(3, 4);
  mesh.corners << 0, 1, 0.2, 0.1, 0, 0.1, 0.9, 0.3, 0, 0.2, -0.1, 1.1;
  mesh.tets.resize(4, 1);
  mesh.tets << 0, 1, 2, 3;
  mesh.corner_ids = {1, 2, 3, 4};
  const Model model = test::boxModel(mesh, GetParam().element, stiff(), GetParam().dilatation);
  const Partition partition(model, 1);
  const Bent bent(model, partition, GetParam().rule);
  const Eigen::SelfAdjointEigenSolver<MatrixXd> eigen(byColumns(model, partition, bent.rotations, 0, 1));
  const auto& values = eigen.eigenvalues();
  EXPECT_LT(values.head<6>().cwiseAbs().maxCoeff(), 1e-12 * values.tail<1>()[0]);
  EXPECT_GT(values[6], 1e-4 * values.tail<1>()[0]);

  // Its largest eigenvalue against its mass is what explicit steps are bounded by.
  const Eigen::GeneralizedSelfAdjointEigenSolver<MatrixXd> against_mass(byColumns(model, partition, rest(model), 0, 1),
                                                                        byColumns(model, partition, rest(model), 1, 0));
  const double largest = against_mass.eigenvalues().maxCoeff();
  EXPECT_NEAR(SpectralBound(model, partition).corotated(), largest, 1e-9 * largest);
}

TEST_P(EveryElement, RigidMotionGivesNoForce)
{
  const Model model = box({3, 2, 3}, {0.5, 0.3, 0.6});
  const Partition partition(model, 1);
  std::mt19937 random(11);
  AlignedVector<double> turned(rest(model).flags.size());
  // The force that a strain of one would give.
  NodalField stretched = model.rest, force(model.num_nodes);
  stretched.matrix() *= 2;
  elasticForce(model, partition, restRotations(model), stretched, force);
  const double scale = force.matrix().cwiseAbs().maxCoeff();
  for (int k = 0; k < 20; ++k)
  {
    const Matrix3d R = test::randomRotation(random);
    NodalField x = model.rest;
    x.matrix().topRows<3>() = (R * model.rest.matrix().topRows<3>()).colwise() + Vector3d(3, -2, 1);
    Rotations rotations = rest(model);
    updateRotations(model, partition, x, rest(model), rotations, turned);
    elasticForce(model, partition, rotations, x, force);
    EXPECT_LT(force.matrix().cwiseAbs().maxCoeff(), 1e-13 * scale);
    EXPECT_LT(elasticEnergy(model, rotations, x), 1e-20 * scale);
  }
}

TEST_P(EveryElement, PatchTest)
{
  // A linear displacement field gives constant stress and no force inside, on an irregular mesh.
  const Model model = box({3, 3, 3}, {1, 1, 1});
  const Partition partition(model, 1);
  Matrix3d gradient;
  gradient << 0.01, 0.002, -0.003, 0.004, -0.02, 0.005, 0.006, -0.007, 0.015;
  NodalField x = model.rest;
  x.matrix().topRows<3>() += gradient * model.rest.matrix().topRows<3>();
  const Rotations rotations = rest(model);
  const Matrix3d strain = (gradient + gradient.transpose()) / 2;
  const Matrix3d s = lameLambda(stiff()) * strain.trace() * Matrix3d::Identity() + 2 * lameMu(stiff()) * strain;
  const Stress expected = (Stress() << s(0, 0), s(1, 1), s(2, 2), s(0, 1), s(1, 2), s(0, 2)).finished();
  const auto stress = nodalStress(model, rotations, x);
  EXPECT_LT((stress.colwise() - expected).cwiseAbs().maxCoeff(), 1e-11 * s.norm());

  NodalField force(model.num_nodes);
  elasticForce(model, partition, rotations, x, force);
  const double scale = force.matrix().cwiseAbs().maxCoeff();
  int inside = 0;
  for (int i = 0; i < model.num_nodes; ++i)
  {
    const Vector3d X = model.rest[i];
    if (X.minCoeff() < 1e-9 || X.maxCoeff() > 1 - 1e-9) continue;
    ++inside;
    EXPECT_LT(force[i].norm(), 1e-12 * scale);
  }
  EXPECT_GT(inside, 7);
  EXPECT_NEAR(elasticEnergy(model, rotations, x), 0.5 * s.cwiseProduct(strain).sum(), 1e-12 * s.norm());
}

TEST_P(EveryElement, ForceIsTheGradientOfTheEnergyWithRotationsHeld)
{
  const Model model = box({2, 2, 2}, {1, 1, 1});
  const Partition partition(model, 1);
  const Bent bent(model, partition, GetParam().rule);
  NodalField force(model.num_nodes);
  elasticForce(model, partition, bent.rotations, bent.x, force);
  const NodalField direction = test::randomField(model.num_nodes, 12);
  NodalField forward = bent.x, back = bent.x;
  forward.matrix() += 1e-3 * direction.matrix();
  back.matrix() -= 1e-3 * direction.matrix();
  // The energy is quadratic: the central difference is exact.
  const double slope =
      (elasticEnergy(model, bent.rotations, forward) - elasticEnergy(model, bent.rotations, back)) / 2e-3;
  const double work = force.matrix().cwiseProduct(direction.matrix()).sum();
  EXPECT_NEAR(slope, work, 1e-9 * std::abs(work));
}

TEST_P(EveryElement, ForceOfEnoughRotationsIsTheGradientOfTheEnergy)
{
  // Of an energy in which the rotations follow: one rotation is enough where F is constant, four where it is linear.
  // Such a force does no work on a rotation of the body, so angular momentum is kept.
  const Model model = box({2, 2, 2}, {1, 1, 1});
  const Partition partition(model, 1);
  Bent bent(model, partition, GetParam().rule), forward = bent, back = bent;
  ASSERT_EQ(bent.rotations.inverted(model.num_tets), 0);
  NodalField force(model.num_nodes);
  elasticForce(model, partition, bent.rotations, bent.x, force);
  const NodalField direction = test::randomField(model.num_nodes, 12);
  const double h = 1e-5;
  forward.x.matrix() += h * direction.matrix();
  back.x.matrix() -= h * direction.matrix();
  forward.turn(model, partition);
  back.turn(model, partition);
  const double slope =
      (elasticEnergy(model, forward.rotations, forward.x) - elasticEnergy(model, back.rotations, back.x)) / (2 * h);
  const double work = force.matrix().cwiseProduct(direction.matrix()).sum();
  Vector3d torque = Vector3d::Zero();
  double scale = 0;
  for (int i = 0; i < model.num_nodes; ++i)
  {
    torque += bent.x[i].cross(force[i]);
    scale += bent.x[i].norm() * force[i].norm();
  }
  const bool enough = !model.quadratic() || bent.rotations.points == 4;
  if (enough)
  {
    EXPECT_NEAR(slope, work, 1e-6 * std::abs(work));
    EXPECT_LT(torque.norm(), 1e-13 * scale);
  }
  else
  {
    EXPECT_GT(std::abs(slope - work), 1e-4 * std::abs(work));
    EXPECT_GT(torque.norm(), 1e-6 * scale);
  }
}

TEST_P(EveryElement, MassGivesKineticEnergyMomentumAndWeight)
{
  const Model model = box({2, 2, 2}, {1, 2, 1});
  const Partition partition(model, 1);
  EXPECT_NEAR(model.volume(), 2, 1e-12);
  EXPECT_NEAR(model.mass(), 2 * stiff().density, 1e-9);
  const NodalField v = test::randomField(model.num_nodes, 13);
  NodalField product(model.num_nodes);
  systemProduct(model, partition, restRotations(model), 1, 0, v, product);
  EXPECT_NEAR(kineticEnergy(model, v), product.matrix().cwiseProduct(v.matrix()).sum() / 2, 1e-9);
  NodalField ones(model.num_nodes);
  ones.matrix().row(1).setOnes();
  systemProduct(model, partition, restRotations(model), 1, 0, ones, product);
  for (int i = 0; i < model.num_nodes; ++i) EXPECT_NEAR(product[i].y(), model.node_mass[i], 1e-12 * model.mass());
  EXPECT_NEAR(gravityEnergy(model, {0, 0, -9.81}, model.rest), model.mass() * 9.81 * 0.5, 0.02 * model.mass() * 9.81);
}

TEST_P(EveryElement, FarFromTheOriginIsNoDifferent)
{
  const Model model = box({2, 2, 2}, {1, 1, 1});
  const Partition partition(model, 1);
  const Bent bent(model, partition, GetParam().rule);
  NodalField here(model.num_nodes), there(model.num_nodes), moved = bent.x;
  elasticForce(model, partition, bent.rotations, bent.x, here);
  moved.matrix().topRows<3>().colwise() += Vector3d(1e4, -1e4, 1e4);
  elasticForce(model, partition, bent.rotations, moved, there);
  EXPECT_LT((here.matrix() - there.matrix()).norm(), 1e-10 * here.matrix().norm());
}

}  // namespace
}  // namespace bezier_fem
