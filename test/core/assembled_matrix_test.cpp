#include "bezier_fem/assembled_matrix.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <map>
#include <set>

#include "bezier_fem/element_operator.h"
#include "core/bar.h"

namespace bezier_fem
{
namespace
{
using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr double ALPHA = 1.3, BETA = 4e-4;

struct Kind
{
  const char* name;
  Element element;
  Dilatation dilatation;
};

/** A box of many materials in a state in which every element is turned, some are inverted. */
struct Body
{
  Body(const Eigen::Vector3i& cells, const Kind& kind, int threads = 1)
      : mesh(test::irregularBox(cells, {0.5, 0.3, 0.6})),
        model(buildModel(mesh, kind.element, materials(mesh, 1), kind.dilatation)),
        partition(model, threads),
        rotations(restRotations(model))
  {
    const NodalField noise = test::randomField(model.num_nodes, 5);
    NodalField x = model.rest;
    for (int i = 0; i < model.num_nodes; ++i)
    {
      const Vector3d X = model.rest[i];
      x[i] = Eigen::AngleAxisd(1 + 4 * X.z(), Vector3d(1, 1, 0).normalized()) * X + 0.1 * noise[i];
    }
    AlignedVector<double> turned(static_cast<std::size_t>(model.num_blocks) * LANES);
    updateRotations(model, partition, x, restRotations(model), rotations, turned);
  }

  static std::vector<Material> materials(const TetMesh& mesh, unsigned seed)
  {
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> uniform(0, 1);
    std::vector<Material> result;
    for (Eigen::Index t = 0; t < mesh.tets.cols(); ++t)
    {
      result.push_back(
          {std::pow(10, 4 + 4 * uniform(random)), 0.1 + 0.395 * uniform(random), 200 + 2000 * uniform(random)});
    }
    return result;
  }

  NodalField matrixFree(const NodalField& u) const
  {
    NodalField product(model.num_nodes);
    systemProduct(model, partition, rotations, ALPHA, BETA, u, product);
    return product;
  }
  ElementMatrices elementMatrices() const
  {
    ElementMatrices elements(model);
    rotatedGradientMatrices(model, partition, rotations, ALPHA, BETA, elements);
    return elements;
  }
  AssembledMatrix assembled(const ElementMatrices& elements, Traversal traversal) const
  {
    AssembledMatrix A(model);
    // What was there before must not matter.
    std::fill(A.blocks().begin(), A.blocks().end(), 1e30);
    Assembler(model, A, traversal).assemble(model, partition, elements, A);
    return A;
  }
  AssembledMatrix fused() const
  {
    AssembledMatrix A(model);
    std::fill(A.blocks().begin(), A.blocks().end(), 1e30);
    FusedAssembler(model, A).assemble(model, partition, rotations, ALPHA, BETA, A);
    return A;
  }

  TetMesh mesh;
  Model model;
  Partition partition;
  Rotations rotations;
};

Matrix3d block(const AssembledMatrix& A, int i, int j)
{
  return Eigen::Map<const Matrix3d>(A.blocks().data() + 9 * static_cast<std::ptrdiff_t>(A.slot(i, j)));
}

auto values(const AssembledMatrix& A)
{
  return Eigen::Map<const Eigen::VectorXd>(A.blocks().data(), 9 * static_cast<Eigen::Index>(A.column().size()));
}

/** The largest difference of a block, relative to the larger of the diagonal blocks of its row and column. */
double difference(const AssembledMatrix& A, const AssembledMatrix& B)
{
  double worst = 0;
  for (int i = 0; i < A.rows(); ++i)
  {
    for (int k = A.rowBegin()[i]; k < A.rowBegin()[i + 1]; ++k)
    {
      const int j = A.column()[k];
      const double scale = std::max(block(A, i, i).norm(), block(A, j, j).norm());
      worst = std::max(worst, (block(A, i, j) - block(B, i, j)).norm() / scale);
    }
  }
  return worst;
}

class AssembledMatrixTest : public testing::TestWithParam<Kind>
{
};
INSTANTIATE_TEST_SUITE_P(Elements, AssembledMatrixTest,
                         testing::Values(Kind{"linear", Element::LINEAR, Dilatation::FULL},
                                         Kind{"quadratic", Element::QUADRATIC, Dilatation::FULL},
                                         Kind{"quadratic_mean", Element::QUADRATIC, Dilatation::MEAN}),
                         [](const auto& p) { return std::string(p.param.name); });

TEST_P(AssembledMatrixTest, PatternIsThePairsThatShareATetrahedron)
{
  const Body body({3, 2, 3}, GetParam());
  std::set<std::pair<int, int>> pairs;
  for (int t = 0; t < body.model.num_tets; ++t)
  {
    const int* nodes = body.model.nodesOf(t);
    for (int I = 0; I < body.model.nodes_per_tet; ++I)
    {
      for (int J = 0; J < body.model.nodes_per_tet; ++J) pairs.emplace(nodes[I], nodes[J]);
    }
  }
  const AssembledMatrix A(body.model);
  ASSERT_EQ(A.rows(), body.model.num_nodes);
  ASSERT_EQ(A.column().size(), pairs.size());
  auto expected = pairs.begin();
  int absent = 0;
  for (int i = 0; i < A.rows(); ++i)
  {
    for (int k = A.rowBegin()[i]; k < A.rowBegin()[i + 1]; ++k, ++expected)
    {
      ASSERT_EQ(std::make_pair(i, A.column()[k]), *expected);
      ASSERT_EQ(A.slot(i, A.column()[k]), k);
    }
    for (int j = 0; j < A.rows(); ++j)
    {
      if (pairs.count({i, j})) continue;
      ++absent;
      ASSERT_EQ(A.slot(i, j), -1);
    }
  }
  EXPECT_GT(absent, 0);
}

TEST_P(AssembledMatrixTest, EveryWayToAssembleGivesTheSame)
{
  // Fewer elements than a block of lanes, and more than a chunk of neighbours.
  for (const Eigen::Vector3i& cells : {Eigen::Vector3i(1, 1, 1), Eigen::Vector3i(3, 4, 5)})
  {
    const Body body(cells, GetParam());
    const ElementMatrices elements = body.elementMatrices();
    const AssembledMatrix conventional = body.assembled(elements, Traversal::CONVENTIONAL);
    EXPECT_LT(difference(conventional, body.assembled(elements, Traversal::STORED_SLOTS)), 1e-14);
    EXPECT_LT(difference(conventional, body.assembled(elements, Traversal::MESH_ORIENTED)), 1e-14);
    EXPECT_LT(difference(conventional, body.fused()), 1e-14);
  }
}

TEST_P(AssembledMatrixTest, WarpedStiffnessEqualsRotatedGradients)
{
  const Body body({2, 3, 3}, GetParam());
  const ElementMatrices rotated = body.elementMatrices();
  ElementMatrices warped(body.model);
  warpedMatrices(body.model, body.partition, restStiffness(body.model), body.rotations, ALPHA, BETA, warped);
  for (int t = 0; t < body.model.num_tets; ++t)
  {
    const auto matrix = [&](const ElementMatrices& m) {
      return Eigen::Map<const Eigen::VectorXd>(m.blocks.data() + m.at(t, 0, 0), m.stride);
    };
    EXPECT_LT((matrix(warped) - matrix(rotated)).norm(), 3e-14 * matrix(rotated).norm()) << t;
  }
}

TEST_P(AssembledMatrixTest, ProductAndDiagonalEqualTheMatrixFreeOnes)
{
  const Body body({3, 4, 5}, GetParam());
  const NodalField u = test::randomField(body.model.num_nodes, 8);
  const NodalField expected = body.matrixFree(u);
  const AssembledMatrix assembled[]{body.assembled(body.elementMatrices(), Traversal::MESH_ORIENTED), body.fused()};
  AlignedVector<double> diagonal(8 * static_cast<std::size_t>(body.model.num_nodes));
  systemDiagonal(body.model, body.partition, body.rotations, ALPHA, BETA, diagonal);
  for (const AssembledMatrix& A : assembled)
  {
    NodalField product = test::randomField(body.model.num_nodes, 9);
    A.product(body.partition, u, product);
    AlignedVector<double> own(diagonal.size(), 1.0);
    A.diagonal(own);
    for (int i = 0; i < body.model.num_nodes; ++i)
    {
      double scale = 0;
      for (int k = A.rowBegin()[i]; k < A.rowBegin()[i + 1]; ++k) scale += block(A, i, A.column()[k]).norm();
      EXPECT_LT((product[i] - expected[i]).norm(), 1e-14 * scale);
      EXPECT_EQ(product.matrix()(3, i), 0);
      const auto row = [&](const AlignedVector<double>& d) { return Eigen::Map<const Eigen::VectorXd>(&d[8 * i], 8); };
      EXPECT_LT((row(own) - row(diagonal)).norm(), 1e-6 * row(diagonal).norm());  // in single precision
      const Eigen::Matrix3d B = block(A, i, i);
      const Eigen::Matrix<double, 8, 1> packed{B(0, 0), B(1, 1), B(2, 2), 0, B(0, 1), B(0, 2), B(1, 2), 0};
      EXPECT_EQ(row(own), packed);
    }
  }
}

TEST_P(AssembledMatrixTest, IsSymmetricToTheLastBit)
{
  const Body body({3, 2, 3}, GetParam());
  for (const AssembledMatrix& A : {body.assembled(body.elementMatrices(), Traversal::MESH_ORIENTED), body.fused()})
  {
    for (int i = 0; i < A.rows(); ++i)
    {
      for (int k = A.rowBegin()[i]; k < A.rowBegin()[i + 1]; ++k)
      {
        const int j = A.column()[k];
        const double apart = (block(A, i, j) - block(A, j, i).transpose()).norm();
        EXPECT_LE(apart, i == j ? 1e-15 * block(A, i, i).norm() : 0);
      }
    }
  }
}

TEST_P(AssembledMatrixTest, NumberOfThreadsChangesNothing)
{
  const Body one({3, 4, 5}, GetParam());
  const NodalField u = test::randomField(one.model.num_nodes, 8);
  const AssembledMatrix traversed = one.assembled(one.elementMatrices(), Traversal::MESH_ORIENTED);
  const AssembledMatrix fused = one.fused();
  NodalField expected(one.model.num_nodes);
  fused.product(one.partition, u, expected);
  for (const int threads : {2, 3, 7})
  {
    const Body many({3, 4, 5}, GetParam(), threads);
    ASSERT_EQ(many.partition.threads(), threads);
    EXPECT_TRUE(values(many.assembled(many.elementMatrices(), Traversal::MESH_ORIENTED)) == values(traversed));
    const AssembledMatrix A = many.fused();
    EXPECT_TRUE(values(A) == values(fused));
    NodalField product(many.model.num_nodes);
    A.product(many.partition, u, product);
    EXPECT_TRUE(product.matrix() == expected.matrix());
  }
}

TEST_P(AssembledMatrixTest, FollowsTheMaterialAndTheRotations)
{
  Body body({2, 2, 2}, GetParam());
  setMaterials(body.model, std::vector<Material>(body.mesh.tets.cols(), {1e5, 0.2, 500}));
  AssembledMatrix A(body.model);
  FusedAssembler fused(body.model, A);
  fused.assemble(body.model, body.partition, restRotations(body.model), 1, 1, A);
  setMaterials(body.model, Body::materials(body.mesh, 2));
  fused.assemble(body.model, body.partition, body.rotations, ALPHA, BETA, A);
  EXPECT_LT(difference(A, body.assembled(body.elementMatrices(), Traversal::CONVENTIONAL)), 1e-14);
}

// How many elements add to a block is the number around the smallest vertex, edge, face or tetrahedron that has both
// control points.
TEST_P(AssembledMatrixTest, BlocksAreSumsOverTheSmallestEntityOfBothControlPoints)
{
  const Body body({3, 3, 3}, GetParam());
  const Model& model = body.model;
  std::map<std::set<int>, int> around;  // corners of a vertex, edge, face or tetrahedron -> elements
  for (int t = 0; t < model.num_tets; ++t)
  {
    for (int subset = 1; subset < 16; ++subset)
    {
      std::set<int> corners;
      for (int a = 0; a < CORNERS; ++a)
      {
        if (subset >> a & 1) corners.insert(model.ends[model.nodesOf(t)[a]][0]);
      }
      ++around[corners];
    }
  }
  int boundary = 0, inside = 0;
  for (const auto& [corners, elements] : around)
  {
    if (corners.size() == 3) ++(elements == 1 ? boundary : inside);
    EXPECT_TRUE(corners.size() < 4 || elements == 1);
  }
  ASSERT_EQ(boundary, static_cast<int>(model.boundary.size()));
  ASSERT_EQ(boundary + 2 * inside, 4 * model.num_tets);

  ElementMatrices ones(model);
  std::fill(ones.blocks.begin(), ones.blocks.end(), 1.0);
  for (const Traversal traversal : {Traversal::CONVENTIONAL, Traversal::STORED_SLOTS, Traversal::MESH_ORIENTED})
  {
    const AssembledMatrix A = body.assembled(ones, traversal);
    std::map<std::size_t, int> blocks_of;  // by the entity's number of corners
    for (int i = 0; i < A.rows(); ++i)
    {
      for (int k = A.rowBegin()[i]; k < A.rowBegin()[i + 1]; ++k)
      {
        const auto &p = model.ends[i], &q = model.ends[A.column()[k]];
        const std::set<int> entity{p[0], p[1], q[0], q[1]};
        ++blocks_of[entity.size()];
        ASSERT_EQ(block(A, i, A.column()[k]), Matrix3d::Constant(around.at(entity)));
      }
    }
    // A vertex has one block; an edge (a,b), (a,ab), (ab,b) and their transposes and (ab,ab); a face twelve; a
    // tetrahedron its three pairs of opposite edges, twice.
    std::map<std::size_t, int> entities;
    for (const auto& entry : around) ++entities[entry.first.size()];
    EXPECT_EQ(blocks_of[1], entities[1]);
    EXPECT_EQ(blocks_of[2], entities[2] * (model.quadratic() ? 7 : 2));
    EXPECT_EQ(blocks_of[3], entities[3] * (model.quadratic() ? 12 : 0));
    EXPECT_EQ(blocks_of[4], entities[4] * (model.quadratic() ? 6 : 0));
  }
}

}  // namespace
}  // namespace bezier_fem
