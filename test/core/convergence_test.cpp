// Laws of convergence: what the a-priori error estimates promise for smooth solutions (Ciarlet 1978, Theorem 3.2.5).

#include <gtest/gtest.h>

#include "core/bar.h"
#include "core/manufactured.h"

namespace bezier_fem
{
namespace
{
TEST(Quadrature, IsExactUpToItsDegree)
{
  // integral of lambda^e = 6 V e! / (|e| + 3)!
  const auto rule = test::tetRule(5);
  for (const Eigen::Vector4i& e :
       {Eigen::Vector4i(0, 0, 0, 0), Eigen::Vector4i(7, 0, 0, 0), Eigen::Vector4i(0, 0, 0, 7),
        Eigen::Vector4i(2, 1, 3, 1), Eigen::Vector4i(0, 4, 0, 3)})
  {
    double sum = 0, expected = 6 / std::tgamma(e.sum() + 4);
    for (const auto& [lambda, weight] : rule)
    {
      double product = weight;
      for (int c = 0; c < 4; ++c) product *= std::pow(lambda[c], e[c]);
      sum += product;
    }
    for (int c = 0; c < 4; ++c) expected *= std::tgamma(e[c] + 1);
    EXPECT_NEAR(sum, expected, 1e-14);
  }
}

TEST(ManufacturedSolution, IsInEquilibrium)
{
  const test::Waves waves;
  const Material material{2e5, 0.34, 500};
  const Eigen::Vector3d X(0.3, 0.7, 0.2);
  constexpr double H = 1e-5;
  Eigen::Vector3d divergence = Eigen::Vector3d::Zero();
  for (int j = 0; j < 3; ++j)
  {
    const Eigen::Vector3d step = H * Eigen::Vector3d::Unit(j);
    divergence += (waves.stress(X + step, material) - waves.stress(X - step, material)).col(j) / (2 * H);
  }
  const Eigen::Vector3d force = waves.bodyForce(X, material);
  EXPECT_LT((divergence + force).norm(), 1e-7 * force.norm());
}

class Convergence : public testing::TestWithParam<Element>
{
};
INSTANTIATE_TEST_SUITE_P(Elements, Convergence, testing::Values(Element::LINEAR, Element::QUADRATIC),
                         [](const auto& p) { return std::string(test::name(p.param)); });

TEST_P(Convergence, HasTheOrderOfTheElement)
{
  const bool quadratic = GetParam() == Element::QUADRATIC;
  const auto errors = [&](int n) {
    return test::solveWaves(test::boxModel(test::irregularBox({n, n, n}, {1, 1, 1}), GetParam()));
  };
  const int n = quadratic ? 5 : 9;
  const test::FieldErrors coarse = errors(n), fine = errors(2 * n);
  EXPECT_GT(std::log2(coarse.displacement / fine.displacement), quadratic ? 2.8 : 1.85);
  EXPECT_GT(std::log2(coarse.stress / fine.stress), quadratic ? 1.85 : 0.93);
  EXPECT_LT(fine.displacement, quadratic ? 1e-3 : 0.02);
  EXPECT_LT(fine.stress, quadratic ? 0.01 : 0.15);
}

TEST(NearIncompressibility, KelvinsSolutionIsAnEquilibriumOfItsMaterial)
{
  const test::Kelvin kelvin{{2e5, 0.34, 500}};
  const Eigen::Vector3d X(0.3, 0.7, 0.2);
  constexpr double H = 1e-5;
  Eigen::Vector3d divergence = Eigen::Vector3d::Zero();
  Eigen::Matrix3d gradient;
  for (int j = 0; j < 3; ++j)
  {
    const Eigen::Vector3d step = H * Eigen::Vector3d::Unit(j);
    divergence += (kelvin.stress(X + step) - kelvin.stress(X - step)).col(j) / (2 * H);
    gradient.col(j) = (kelvin.displacement(X + step) - kelvin.displacement(X - step)) / (2 * H);
  }
  const Eigen::Matrix3d stress = kelvin.stress(X);
  EXPECT_LT(divergence.norm(), 1e-7 * stress.norm());
  const Eigen::Matrix3d expected = lameLambda(kelvin.material) * gradient.trace() * Eigen::Matrix3d::Identity() +
                                   lameMu(kelvin.material) * (gradient + gradient.transpose());
  EXPECT_LT((stress - expected).norm(), 1e-7 * stress.norm());
}

TEST(NearIncompressibility, MeanDilatationDoesNotLock)
{
  const auto errors = [&](Element element, Dilatation dilatation, double poisson, int n) {
    return test::solveKelvin(
        test::boxModel(test::irregularBox({n, n, n}, {1, 1, 1}), element, {2e5, poisson, 500}, dilatation));
  };
  // Where there is nothing to cure, there is no difference.
  EXPECT_EQ(errors(Element::QUADRATIC, Dilatation::MEAN, 0.3, 4).displacement,
            errors(Element::QUADRATIC, Dilatation::FULL, 0.3, 4).displacement);
  const test::FieldErrors easy = errors(Element::QUADRATIC, Dilatation::FULL, LOCKING_POISSON, 4);
  EXPECT_EQ(errors(Element::QUADRATIC, Dilatation::AUTO, LOCKING_POISSON, 4).displacement, easy.displacement);
  EXPECT_EQ(errors(Element::QUADRATIC, Dilatation::AUTO, 0.4999, 4).displacement,
            errors(Element::QUADRATIC, Dilatation::MEAN, 0.4999, 4).displacement);

  const test::FieldErrors linear = errors(Element::LINEAR, Dilatation::MEAN, 0.4999, 8);
  const test::FieldErrors full = errors(Element::QUADRATIC, Dilatation::FULL, 0.4999, 4);
  const test::FieldErrors mean = errors(Element::QUADRATIC, Dilatation::MEAN, 0.4999, 4);
  EXPECT_GT(linear.displacement, 0.3);
  EXPECT_GT(full.displacement, 4 * mean.displacement);
  EXPECT_GT(full.shown_stress, 10 * mean.shown_stress);
  EXPECT_LT(mean.displacement, 1.2 * easy.displacement);
  EXPECT_LT(mean.stress, easy.stress);
  EXPECT_LT(mean.shown_stress, easy.shown_stress);
  // It converges.
  const test::FieldErrors coarse = errors(Element::QUADRATIC, Dilatation::MEAN, 0.4999, 2);
  EXPECT_GT(std::log2(coarse.displacement / mean.displacement), 1.9);
  EXPECT_GT(std::log2(coarse.stress / mean.stress), 0.8);
}

}  // namespace
}  // namespace bezier_fem
