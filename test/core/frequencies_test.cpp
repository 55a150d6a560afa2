// The natural frequencies say whether stiffness and mass belong together, whatever basis they are written in.

#include <gtest/gtest.h>

#include <numeric>

#include "core/assembled.h"
#include "core/bar.h"
#include "core/lagrange.h"

namespace bezier_fem
{
namespace
{
using Eigen::VectorXd;

const Eigen::Vector3d SIZE(0.4, 0.4, 1.0);

/** Of the package, with everything at z < floor held. */
VectorXd packageFrequencies(const TetMesh& mesh, Element element, double floor)
{
  const Model model = test::boxModel(mesh, element);
  std::vector<int> free;
  for (int i = 0; i < 3 * model.num_nodes; ++i)
  {
    if (model.rest[i / 3].z() >= floor) free.push_back(i);
  }
  const Rotations rest = restRotations(model);
  return test::squaredFrequencies(test::part(test::assembled(model, rest, 0, 1), free),
                                  test::part(test::assembled(model, rest, 1, 0), free));
}

VectorXd lagrangeFrequencies(const TetMesh& mesh, Element element, double floor)
{
  const test::LagrangeMesh nodal = test::lagrangeMesh(mesh, element);
  const test::LagrangeSystem system = test::lagrangeSystem(nodal, test::RUBBER);
  std::vector<int> free;
  for (int i = 0; i < system.K.rows(); ++i)
  {
    if (nodal.nodes(2, i / 3) >= floor) free.push_back(i);
  }
  return test::squaredFrequencies(system.K(free, free), system.M(free, free));
}

class Frequencies : public testing::TestWithParam<Element>
{
};
INSTANTIATE_TEST_SUITE_P(Elements, Frequencies, testing::Values(Element::LINEAR, Element::QUADRATIC),
                         [](const auto& p) { return std::string(test::name(p.param)); });

TEST_P(Frequencies, AreThoseOfNodalElements)
{
  const TetMesh mesh = test::irregularBox({1, 1, 3}, SIZE);
  const VectorXd bernstein = packageFrequencies(mesh, GetParam(), 1e-9);
  const VectorXd lagrange = lagrangeFrequencies(mesh, GetParam(), 1e-9);
  ASSERT_EQ(bernstein.size(), lagrange.size());
  ASSERT_GE(bernstein.size(), 10);
  EXPECT_GT(lagrange[0], 0);
  for (int k = 0; k < bernstein.size(); ++k) EXPECT_NEAR(bernstein[k], lagrange[k], 1e-9 * lagrange[k]) << k;
}

TEST_P(Frequencies, OfAFreeBodyBeginWithSixZeros)
{
  const VectorXd values = packageFrequencies(test::irregularBox({1, 2, 2}, SIZE), GetParam(), -1);
  EXPECT_LT(values.head<6>().cwiseAbs().maxCoeff(), 1e-9 * values[6]);
  EXPECT_GT(values[6], 1);
}

TEST_P(Frequencies, FallWhenTheMeshIsRefined)
{
  // Kuhn's cells are nested, so every displacement of the coarse mesh is one of the fine (Courant's min-max principle).
  const VectorXd coarse = packageFrequencies(test::kuhnBox({1, 1, 2}, SIZE), GetParam(), 1e-9);
  const VectorXd fine = packageFrequencies(test::kuhnBox({2, 2, 4}, SIZE), GetParam(), 1e-9);
  for (int k = 0; k < coarse.size(); ++k) EXPECT_LT(fine[k], coarse[k]) << k;
}

TEST(Frequencies, OfQuadraticElementsLieBelowThoseOfLinearOnes)
{
  const TetMesh mesh = test::irregularBox({2, 1, 3}, SIZE);
  const VectorXd linear = packageFrequencies(mesh, Element::LINEAR, 1e-9);
  const VectorXd quadratic = packageFrequencies(mesh, Element::QUADRATIC, 1e-9);
  for (int k = 0; k < linear.size(); ++k) EXPECT_LT(quadratic[k], linear[k]) << k;
}

}  // namespace
}  // namespace bezier_fem
