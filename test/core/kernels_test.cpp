// The inner loops of every instruction set that this machine has, in ranges, against double precision. What they have
// not to leave as it was is not a number before.

#include "kernels.h"
#include "element_loop.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <cstring>
#include <limits>
#include <numeric>
#include <random>

#include "bezier_fem/element_operator.h"
#include "bezier_fem/green_strain.h"
#include "core/bar.h"

namespace bezier_fem
{
namespace
{
using Eigen::Vector3d;

constexpr double ALPHA = 1.5, BETA = 2e-4;
/** Relative, of sums of tens of numbers in single precision. */
constexpr double SINGLE = 2e-6;

std::vector<const kernels::Table*> tables()
{
  std::vector<const kernels::Table*> result;
  for (const char* name : {"portable", "avx2", "avx512"})
  {
    if (const kernels::Table* table = kernels::tableByName(name)) result.push_back(table);
  }
  return result;
}

/** Each with and without the mass as a part of products. */
std::vector<std::pair<const kernels::Table*, bool>> tablesAndMasses()
{
  std::vector<std::pair<const kernels::Table*, bool>> result;
  for (const kernels::Table* table : tables())
  {
    for (const bool mass : {true, false}) result.emplace_back(table, mass);
  }
  return result;
}

struct Variant
{
  const char* name;
  Element element;
  RotationRule rule;
  Dilatation dilatation = Dilatation::FULL;
};

/** A body of a last block that is not full, bent and noisy. */
class Kernels : public testing::TestWithParam<Variant>
{
protected:
  Model model = test::boxModel(test::irregularBox({3, 3, 3}, {0.4, 0.5, 0.6}), GetParam().element, {3e6, 0.485, 1100},
                               GetParam().dilatation);
  Partition partition{model, 1};
  NodalField x = bent();
  Rotations rotations = rotationsOf(x);
  kernels::NodeShares lists = sharesOf(model);

  NodalField bent() const
  {
    NodalField result = model.rest;
    result.matrix() += 0.01 * test::randomField(model.num_nodes, 5).matrix();
    for (int i = 0; i < model.num_nodes; ++i)
    {
      const Vector3d X = result[i];
      result[i] = Eigen::AngleAxisd(X.z(), Vector3d(1, 1, 0.5).normalized()) * X;
    }
    return result;
  }
  Rotations rotationsOf(const NodalField& positions) const
  {
    const Rotations before = restRotations(model, GetParam().rule);
    Rotations result = before;
    AlignedVector<double> turned(result.flags.size());
    updateRotations(model, partition, positions, before, result, turned);
    return result;
  }

  /** Runs loop(begin, end, first row of shares) on the blocks, in two ranges. */
  template <class Scalar, class Loop>
  AlignedVector<Scalar> shares(int rows_a_node, const Loop& loop) const
  {
    const std::ptrdiff_t zeros = rows_a_node * kernels::ZERO_ROWS * kernels::SHARES;
    const std::ptrdiff_t block = rows_a_node * kernels::SHARES * model.nodes_per_tet;
    AlignedVector<Scalar> result(zeros + model.num_blocks * block, std::numeric_limits<Scalar>::quiet_NaN());
    std::fill_n(result.begin(), zeros, Scalar{0});
    int some = 3;
    if (model.block_pairing[some] == kernels::SECOND) ++some;
    loop(0, some, result.data() + zeros);
    for (std::ptrdiff_t k = zeros + some * block; k < static_cast<std::ptrdiff_t>(result.size()); ++k)
    {
      EXPECT_TRUE(std::isnan(result[k])) << "shares of blocks that were not asked for";
    }
    loop(some, model.num_blocks, result.data() + zeros);
    return result;
  }
  /** Of those that are summed up; of others there are none. */
  template <class Scalar>
  void expectFourthNumbersZero(const AlignedVector<Scalar>& shares, int rows_a_node = 1) const
  {
    for (const int slot : model.share_slots)
    {
      const Scalar* share = shares.data() + static_cast<std::ptrdiff_t>(rows_a_node) * slot;
      for (int k = 0; k < 4 * rows_a_node; ++k)
      {
        if (k % 4 == 3)
        {
          ASSERT_EQ(share[k], 0) << "share " << slot / 4;
        }
        ASSERT_FALSE(std::isnan(share[k])) << "share " << slot / 4;
      }
    }
  }
};
const auto name = [](const auto& p) { return std::string(p.param.name); };

// Doubles -----------------------------------------------------------------------------------------------------------

class DoubleKernels : public Kernels
{
};
INSTANTIATE_TEST_SUITE_P(
    Elements, DoubleKernels,
    testing::Values(Variant{"linear", Element::LINEAR, RotationRule::FROM_CORNERS},
                    Variant{"quadratic", Element::QUADRATIC, RotationRule::FROM_CORNERS},
                    Variant{"quadratic_four", Element::QUADRATIC, RotationRule::FOUR_POINTS},
                    Variant{"quadratic_mean", Element::QUADRATIC, RotationRule::FROM_CORNERS, Dilatation::MEAN},
                    Variant{"quadratic_four_mean", Element::QUADRATIC, RotationRule::FOUR_POINTS, Dilatation::MEAN}),
    name);

TEST_P(DoubleKernels, LeaveFourthNumbersZero)
{
  const NodalField u = test::randomField(model.num_nodes, 8);
  const kernels::Elements elements = elementsOf(model, rotations.points), one = elementsOf(model, 1);
  const double *rotated = rotations.gradients.data(), *rest = model.block_gradients.data();
  GreenTangent tangent(model);
  linearise(model, partition, x, Projection::NONE, tangent);
  for (const kernels::Table* table : tables())
  {
    SCOPED_TRACE(table->name);
    const kernels::GreenTable& green = model.quadratic() ? table->green_quadratic : table->green_linear;
    const auto check = [&](int rows_a_node, const auto& loop) {
      expectFourthNumbersZero(shares<double>(rows_a_node, loop), rows_a_node);
    };
    check(1, [&](int begin, int end, double* to) {
      table->add_product(elements, begin, end, rotated, ALPHA, BETA, u.data(), to);
    });
    check(1, [&](int begin, int end, double* to) { table->add_force(elements, begin, end, rotated, x.data(), to); });
    check(2,
          [&](int begin, int end, double* to) { table->add_diagonal(elements, begin, end, rotated, ALPHA, BETA, to); });
    const auto single_diagonal = [&](int begin, int end, float* to) {
      table->add_single_diagonal(elements, begin, end, rotated, ALPHA, BETA, to);
    };
    expectFourthNumbersZero(shares<float>(2, single_diagonal), 2);
    check(1, [&](int begin, int end, double* to) { green.add_force(one, begin, end, rest, x.data(), to); });
    check(1, [&](int begin, int end, double* to) {
      green.add_product(one, begin, end, rest, tangent.blocks.data(), ALPHA, BETA, u.data(), to);
    });
    check(2, [&](int begin, int end, double* to) {
      green.add_diagonal(one, begin, end, rest, tangent.blocks.data(), ALPHA, BETA, to);
    });
  }
}

TEST_P(DoubleKernels, RotationsDoNotDependOnThoseMadeAtTheSameTime)
{
  // Some converge at once, others take their time.
  NodalField strained = x;
  for (int i = 0; i < model.num_nodes; i += 5) strained[i] *= 1.5;
  const kernels::Gradient gradient =
      rotations.points == 4 ? kernels::Gradient::AT_FOUR_POINTS : kernels::Gradient::OF_CORNERS;
  const Rotations rest = restRotations(model, GetParam().rule);
  for (const kernels::Table* table : tables())
  {
    SCOPED_TRACE(table->name);
    const auto update = [&](int blocks_at_a_time) {
      Rotations result = rest;
      AlignedVector<double> turned(rest.flags.size());
      for (int begin = 0; begin < model.num_blocks; begin += blocks_at_a_time)
      {
        table->update_rotations(elementsOf(model, rest.points), gradient, begin,
                                std::min(begin + blocks_at_a_time, model.num_blocks), model.block_gradients.data(),
                                strained.data(), rest.matrices.data(), result.matrices.data(), result.gradients.data(),
                                turned.data(), result.flags.data());
      }
      return result;
    };
    const Rotations together = update(model.num_blocks);
    EXPECT_NE(together.matrices, rest.matrices);
    for (const int blocks : {1, 2, 3})
    {
      const Rotations parts = update(blocks);
      EXPECT_EQ(parts.matrices, together.matrices);
      EXPECT_EQ(parts.gradients, together.gradients);
      EXPECT_EQ(parts.flags, together.flags);
    }
  }
}

/** 3x3 blocks of nodes, of more than one chunk, of which the last register is not full. */
class BlockKernels : public testing::Test
{
protected:
  static constexpr int COUNT = Partition::CHUNK + 131;
  std::vector<Eigen::Matrix3d> matrices = random();
  std::vector<unsigned char> held = someHeld();
  NodalField r = test::randomField(COUNT, 21), b = test::randomField(COUNT, 22);

  static std::vector<Eigen::Matrix3d> random()
  {
    std::vector<Eigen::Matrix3d> result;
    const NodalField numbers = test::randomField(3 * COUNT, 20);
    for (int i = 0; i < COUNT; ++i)
    {
      Eigen::Matrix3d m;
      for (int k = 0; k < 3; ++k) m.col(k) = numbers[3 * i + k];
      // Of many sizes: units are anybody's.
      result.emplace_back(std::pow(10.0, i % 41 - 20) * (m * m.transpose() + 0.1 * Eigen::Matrix3d::Identity()));
    }
    return result;
  }
  /** Every combination of axes. */
  static std::vector<unsigned char> someHeld()
  {
    std::vector<unsigned char> result(COUNT, 0);
    for (int i = 0; i < COUNT; i += 3) result[i] = static_cast<unsigned char>(i / 3 % 8);
    return result;
  }
  static AlignedVector<double> packed(const std::vector<Eigen::Matrix3d>& from)
  {
    AlignedVector<double> result;
    for (const Eigen::Matrix3d& m : from)
    {
      result.insert(result.end(), {m(0, 0), m(1, 1), m(2, 2), 0, m(0, 1), m(0, 2), m(1, 2), 0});
    }
    return result;
  }
  Eigen::Matrix3d inverse(int i) const
  {
    Eigen::Matrix3d mask = Eigen::Matrix3d::Zero();
    for (int axis = 0; axis < 3; ++axis) mask(axis, axis) = held[i] >> axis & 1 ? 0 : 1;
    const Eigen::Matrix3d free = mask * matrices[i] * mask + (Eigen::Matrix3d::Identity() - mask);
    return mask * free.inverse() * mask;
  }
  /** In two ranges, as chunks are. */
  template <class Loop>
  static double overNodes(const Loop& loop)
  {
    return loop(0, Partition::CHUNK) + loop(Partition::CHUNK, COUNT);
  }
};

TEST_F(BlockKernels, InvertWhatIsFree)
{
  std::vector<double> mass(COUNT);
  std::vector<Eigen::Matrix3d> inverses;
  double load = 0;
  for (int i = 0; i < COUNT; ++i)
  {
    mass[i] = 1e-5 * (1 + i % 7) * std::sqrt(matrices[i](0, 0));
    inverses.push_back(inverse(i));
    load += mass[i] * mass[i] * inverses.back().trace() / 3;
  }
  const AlignedVector<double> expected = packed(inverses);
  for (const kernels::Table* table : tables())
  {
    SCOPED_TRACE(table->name);
    AlignedVector<double> blocks = packed(matrices);
    bool definite = true;
    const double sum = overNodes([&](int begin, int end) {
      return table->invert_blocks(begin, end, held.data(), mass.data(), blocks.data(), &definite);
    });
    EXPECT_TRUE(definite);
    EXPECT_NEAR(sum, load, 1e-12 * load);
    for (int i = 0; i < COUNT; ++i)
    {
      for (int k = 0; k < kernels::DIAGONAL_STRIDE; ++k)
      {
        const double found = blocks[kernels::DIAGONAL_STRIDE * i + k];
        const double tolerance = expected[kernels::DIAGONAL_STRIDE * i + k] == 0 ? 0 : 1e-12 * inverses[i].norm();
        ASSERT_NEAR(found, expected[kernels::DIAGONAL_STRIDE * i + k], tolerance) << "node " << i;
      }
    }
  }
}

TEST_F(BlockKernels, TellBlocksThatAreNotPositiveDefinite)
{
  const std::vector<double> mass(COUNT, 1.0);
  const std::vector<Eigen::Vector3d> diagonals{
      {-1, 2, 2}, {1, -2, 2}, {1, 2, -2}, {0, 1, 1}, {1, std::numeric_limits<double>::quiet_NaN(), 1}};
  for (const kernels::Table* table : tables())
  {
    SCOPED_TRACE(table->name);
    for (const int node : {1, COUNT - 1})
    {
      for (const Eigen::Vector3d& diagonal : diagonals)
      {
        std::vector<Eigen::Matrix3d> with = matrices;
        with[node] = diagonal.asDiagonal();
        // Nor does it matter where it is held.
        for (const int axes : {0, 7})
        {
          AlignedVector<double> blocks = packed(with);
          held[node] = static_cast<unsigned char>(axes);
          bool definite = true;
          table->invert_blocks(0, COUNT, held.data(), mass.data(), blocks.data(), &definite);
          EXPECT_EQ(definite, axes == 7) << diagonal.transpose();
        }
      }
    }
  }
}

TEST_F(BlockKernels, VectorOperationsAreTheirFormulas)
{
  // Values of one size.
  for (Eigen::Matrix3d& m : matrices) m /= m.norm();
  const AlignedVector<double> blocks = packed(matrices);
  const double unknown = std::numeric_limits<double>::quiet_NaN();
  const auto times = [&](const NodalField& of) {
    NodalField result(COUNT);
    for (int i = 0; i < COUNT; ++i) result[i] = matrices[i] * of[i];
    return result;
  };
  const auto dot = [](const NodalField& a, const NodalField& c) { return a.matrix().cwiseProduct(c.matrix()).sum(); };
  const auto distance = [](const NodalField& a, const NodalField& c) {
    return (a.matrix() - c.matrix()).cwiseAbs().maxCoeff();
  };
  const NodalField q = test::randomField(COUNT, 23), p = test::randomField(COUNT, 24);
  NodalField difference(COUNT), advanced = r;
  difference.matrix() = b.matrix() - q.matrix();
  advanced.matrix() -= 0.3 * q.matrix();
  for (const kernels::Table* table : tables())
  {
    SCOPED_TRACE(table->name);
    NodalField z(COUNT), found(COUNT), x = b, rest = r;
    z.matrix().setConstant(unknown);
    found.matrix().setConstant(unknown);
    overNodes([&](int begin, int end) {
      table->times_inverse(begin, end, blocks.data(), r.data(), z.data());
      return 0;
    });
    EXPECT_LT(distance(z, times(r)), 1e-14);
    EXPECT_NEAR(overNodes([&](int begin, int end) { return table->norm2(begin, end, blocks.data(), r.data()); }),
                dot(r, times(r)), 1e-12);
    EXPECT_NEAR(overNodes([&](int begin, int end) {
                  return table->residual(begin, end, b.data(), q.data(), blocks.data(), found.data());
                }),
                dot(difference, times(difference)), 1e-12);
    EXPECT_EQ(distance(found, difference), 0);
    z.matrix().setConstant(unknown);
    EXPECT_NEAR(overNodes([&](int begin, int end) {
                  return table->advance(begin, end, 0.3, p.data(), q.data(), blocks.data(), x.data(), rest.data(),
                                        z.data());
                }),
                dot(advanced, times(advanced)), 1e-12);
    EXPECT_LT(distance(rest, advanced), 1e-15);
    EXPECT_LT(distance(z, times(advanced)), 1e-14);
    x.matrix() -= 0.3 * p.matrix();
    EXPECT_LT(distance(x, b), 1e-15);
  }
}

// Single precision --------------------------------------------------------------------------------------------------

class SingleKernels : public Kernels
{
protected:
  using Floats = AlignedVector<float>;

  SingleKernels()
      : rotated(floats(rotations.gradients)),
        coefficients(model.block_coefficients.size()),
        mean(floats(model.block_mean))
  {
    for (std::size_t k = 0; k < coefficients.size(); ++k)
    {
      const bool density = k / LANES % 3 == 2;
      coefficients[k] = static_cast<float>((density ? ALPHA : BETA) * model.block_coefficients[k]);
    }
    for (float& value : mean) value *= static_cast<float>(BETA);
    for (int block = 0; block < model.num_blocks; ++block)
    {
      const int* own = model.block_offsets.data() + static_cast<std::ptrdiff_t>(block) * model.nodes_per_tet * LANES;
      corner_offsets.insert(corner_offsets.end(), own, own + CORNERS * LANES);
    }
  }

  static Floats floats(const AlignedVector<double>& from) { return {from.begin(), from.end()}; }
  /** Whole groups of nodes, the last ones zero. */
  Floats floats(const NodalField& from) const
  {
    Floats result(4 * padded(), 0.0f);
    std::copy_n(from.data(), 4L * model.num_nodes, result.begin());
    return result;
  }
  std::size_t padded() const
  {
    constexpr std::size_t GROUP = kernels::NODE_GROUP;
    return (model.num_nodes + GROUP - 1) / GROUP * GROUP;
  }
  Floats unknown() const { return Floats(4 * padded(), std::numeric_limits<float>::quiet_NaN()); }
  NodalField random(unsigned seed) const
  {
    NodalField result = test::randomField(model.num_nodes, seed);
    result.matrix() = result.matrix().cast<float>().cast<double>();
    return result;
  }
  /** (alpha M + beta K') u, or beta K' u, in double precision. */
  NodalField product(const NodalField& u, bool mass = true) const
  {
    NodalField result(model.num_nodes);
    systemProduct(model, partition, rotations, mass ? ALPHA : 0, BETA, u, result);
    return result;
  }
  kernels::SingleElements elements(bool mass) const
  {
    return {model.block_offsets.data(),
            corner_offsets.data(),
            model.block_pairing.data(),
            rotated.data(),
            coefficients.data(),
            mean.empty() ? nullptr : mean.data(),
            mass};
  }
  Floats productShares(const kernels::Table& table, const Floats& u, bool mass = true) const
  {
    return shares<float>(
        1, [&](int begin, int end, float* to) { table.single_product(elements(mass), begin, end, u.data(), to); });
  }
  /** A number a node, up to whole groups. */
  Floats masses() const
  {
    Floats result(model.num_nodes + kernels::NODE_GROUP);
    for (int i = 0; i < model.num_nodes; ++i) result[i] = static_cast<float>(1 + i % 7);
    return result;
  }
  /** r - mass d */
  NodalField without(const NodalField& r, const Floats& mass, const NodalField& d) const
  {
    NodalField result = r;
    for (int i = 0; i < model.num_nodes; ++i) result[i] -= mass[i] * d[i];
    return result;
  }
  /** Runs loop(begin, end) on the nodes, in two ranges as chunks are. */
  template <class Loop>
  double overNodes(const Loop& loop) const
  {
    static_assert(Partition::CHUNK % kernels::NODE_GROUP == 0, "");
    EXPECT_GT(model.num_nodes, Partition::CHUNK);
    EXPECT_NE(model.num_nodes % kernels::NODE_GROUP, 0);
    return loop(0, Partition::CHUNK) + loop(Partition::CHUNK, model.num_nodes);
  }
  void expectNear(const Floats& values, const NodalField& expected) const
  {
    const Eigen::Map<const Eigen::Matrix4Xf> found(values.data(), 4, model.num_nodes);
    EXPECT_TRUE(found.allFinite());
    EXPECT_TRUE((found.row(3).array() == 0).all());
    const double scale = expected.matrix().cwiseAbs().maxCoeff();
    EXPECT_LT((found.cast<double>() - expected.matrix()).cwiseAbs().maxCoeff(), SINGLE * scale);
  }
  static double dot(const NodalField& a, const NodalField& b) { return a.matrix().cwiseProduct(b.matrix()).sum(); }
  static double size(const NodalField& a, const NodalField& b) { return a.matrix().norm() * b.matrix().norm(); }

  /** Random symmetric positive definite blocks, as kernels.h lays them out, and their products. */
  struct Blocks
  {
    std::vector<Eigen::Matrix3d> blocks;
    Floats floats;
    NodalField operator*(const NodalField& r) const
    {
      NodalField result(r.size());
      for (int i = 0; i < r.size(); ++i) result[i] = blocks[i] * r[i];
      return result;
    }
  };
  Blocks blocks() const
  {
    constexpr int GROUP = kernels::INVERSE_GROUP;
    Blocks result;
    result.floats.assign(12 * padded(), 0.0f);
    const NodalField numbers = test::randomField(3 * model.num_nodes, 20);
    for (int i = 0; i < model.num_nodes; ++i)
    {
      Eigen::Matrix3d m;
      for (int k = 0; k < 3; ++k) m.col(k) = numbers[3 * i + k];
      m = (m * m.transpose() + Eigen::Matrix3d::Identity()).eval();
      for (int k = 0; k < 9; ++k)
      {
        const int row = k % 3, column = k / 3;
        float& to = result.floats[i / GROUP * 12 * GROUP + 4 * GROUP * column + i % GROUP * 4 + row];
        to = static_cast<float>(m(row, column));
        m(row, column) = to;
      }
      result.blocks.push_back(m);
    }
    return result;
  }

  Floats rotated, coefficients, mean;
  AlignedVector<int> corner_offsets;  // of fields of all nodes
};
INSTANTIATE_TEST_SUITE_P(Elements, SingleKernels,
                         testing::Values(Variant{"quadratic", Element::QUADRATIC, RotationRule::FROM_CORNERS},
                                         Variant{"quadratic_mean", Element::QUADRATIC, RotationRule::FROM_CORNERS,
                                                 Dilatation::MEAN}),
                         name);

TEST_P(SingleKernels, ProductIsThatOfDoubles)
{
  const NodalField u = random(1), p = random(2);
  for (const auto& [table, mass] : tablesAndMasses())
  {
    SCOPED_TRACE(table->name + std::string(mass ? ", mass" : ""));
    const NodalField expected = product(u, mass);
    const Floats all_shares = productShares(*table, floats(u), mass);
    expectFourthNumbersZero(all_shares);
    Floats q = unknown();
    const Floats with = floats(p);
    const double sum = overNodes([&](int begin, int end) {
      return table->single_sum(lists, begin, end, all_shares.data(), with.data(), q.data());
    });
    expectNear(q, expected);
    EXPECT_NEAR(sum, dot(p, expected), SINGLE * size(p, expected));
  }
}

TEST_P(SingleKernels, ProlongedProductIsThatOfWhatLinearElementsSayOfEdges)
{
  // Corners are read from a field of all nodes, whose edges are not to be looked at.
  NodalField corners = random(3), prolonged(model.num_nodes);
  for (int i = 0; i < model.num_nodes; ++i)
  {
    const auto [a, b] = model.ends[i];
    prolonged[i] = (corners[model.node_of_corner[a]] + corners[model.node_of_corner[b]]) / 2;
    if (a != b) corners[i].setConstant(std::numeric_limits<double>::quiet_NaN());
  }
  const Floats from = floats(corners);
  for (const auto& [table, mass] : tablesAndMasses())
  {
    SCOPED_TRACE(table->name + std::string(mass ? ", mass" : ""));
    const NodalField expected = product(prolonged, mass);
    const Floats all_shares = shares<float>(1, [&, table = table, mass = mass](int begin, int end, float* to) {
      table->prolonged_product(elements(mass), begin, end, from.data(), to);
    });
    expectFourthNumbersZero(all_shares);
    Floats q = unknown();
    const Floats with = floats(prolonged);
    overNodes([&](int begin, int end) {
      return table->single_sum(lists, begin, end, all_shares.data(), with.data(), q.data());
    });
    expectNear(q, expected);
  }
}

TEST_P(SingleKernels, SubtractSharesAndChebyshevAreTheirFormulas)
{
  const NodalField u = random(1), r = random(4), d = random(5), z = random(6);
  NodalField residual(model.num_nodes), direction(model.num_nodes), solution(model.num_nodes);
  residual.matrix() = r.matrix() - product(u).matrix();
  const Floats mass = masses();
  const Blocks inverse = blocks();
  constexpr float KEEP = 0.375f, GAIN = 1.25f;
  for (const kernels::Table* table : tables())
  {
    SCOPED_TRACE(table->name);
    const Floats all_shares = productShares(*table, floats(u));
    Floats left = floats(r);
    overNodes([&](int begin, int end) {
      table->subtract_shares(lists, begin, end, all_shares.data(), left.data());
      return 0;
    });
    expectNear(left, residual);
    for (const float keep : {KEEP, 0.0f})
    {
      direction.matrix() = GAIN * (inverse * residual).matrix();
      if (keep != 0) direction.matrix() += keep * d.matrix();
      solution.matrix() = z.matrix() + direction.matrix();
      Floats own_r = floats(r), own_d = keep == 0 ? unknown() : floats(d), own_z = floats(z);
      overNodes([&](int begin, int end) {
        table->single_chebyshev(lists, begin, end, keep, GAIN, all_shares.data(), inverse.floats.data(), mass.data(),
                                own_r.data(), own_d.data(), own_z.data());
        return 0;
      });
      expectNear(own_r, without(residual, mass, direction));
      expectNear(own_d, direction);
      expectNear(own_z, solution);
    }
  }
}

TEST_P(SingleKernels, ProlongedChebyshevAddsTheProlongedAndItsFirstTerm)
{
  // Two corners of each node, as an edge has them, out of a field of corners.
  const NodalField u = random(1), r = random(4), c = random(5), z = random(6);
  std::vector<int> ends;
  NodalField prolonged(model.num_nodes), residual(model.num_nodes), direction(model.num_nodes);
  for (int i = 0; i < model.num_nodes; ++i)
  {
    const auto [a, b] = model.ends[i];
    ends.push_back(model.node_of_corner[a]);
    ends.push_back(model.node_of_corner[b]);
    prolonged[i] = (c[ends[2 * i]] + c[ends[2 * i + 1]]) / 2;
  }
  ends.resize(2 * (ends.size() / 2 + kernels::NODE_GROUP));
  const Floats mass = masses(), corners = floats(c);
  const Blocks inverse = blocks();
  constexpr float GAIN = 1.25f;
  residual.matrix() = r.matrix() - product(u).matrix();
  residual = without(residual, mass, prolonged);
  direction.matrix() = GAIN * (inverse * residual).matrix();
  for (const kernels::Table* table : tables())
  {
    SCOPED_TRACE(table->name);
    const Floats all_shares = productShares(*table, floats(u));
    Floats own_r = floats(r), own_d = unknown(), own_z = floats(z);
    overNodes([&](int begin, int end) {
      table->prolonged_chebyshev(lists, begin, end, GAIN, all_shares.data(), inverse.floats.data(), mass.data(),
                                 ends.data(), corners.data(), own_r.data(), own_d.data(), own_z.data());
      return 0;
    });
    expectNear(own_r, without(residual, mass, direction));
    expectNear(own_d, direction);
    NodalField solution(model.num_nodes);
    solution.matrix() = z.matrix() + prolonged.matrix() + direction.matrix();
    expectNear(own_z, solution);
  }
}

TEST_P(SingleKernels, VectorOperationsAreTheirFormulas)
{
  const NodalField x0 = random(7), p = random(8), q = random(9), r = random(10);
  const Floats mass = masses();
  const Blocks inverse = blocks();
  constexpr float LENGTH = 0.625f, GAIN = 1.25f, KEEP = 0.375f;
  NodalField solution(model.num_nodes), residual(model.num_nodes), first(model.num_nodes), search(model.num_nodes);
  solution.matrix() = x0.matrix() + LENGTH * p.matrix();
  residual.matrix() = r.matrix() - LENGTH * q.matrix();
  const NodalField preconditioned = inverse * residual;
  first.matrix() = GAIN * preconditioned.matrix();
  search.matrix() = q.matrix() + KEEP * p.matrix();
  const Floats single_p = floats(p), single_q = floats(q);
  for (const kernels::Table* table : tables())
  {
    SCOPED_TRACE(table->name);
    Floats own_x = floats(x0), own_r = floats(r), own_s = unknown(), own_d = unknown(), own_z = unknown();
    const double norm2 = overNodes([&](int begin, int end) {
      return table->single_advance(begin, end, LENGTH, GAIN, single_p.data(), single_q.data(), inverse.floats.data(),
                                   mass.data(), own_x.data(), own_r.data(), own_s.data(), own_d.data(), own_z.data());
    });
    expectNear(own_x, solution);
    expectNear(own_r, residual);
    expectNear(own_s, without(residual, mass, first));
    expectNear(own_d, first);
    expectNear(own_z, first);
    EXPECT_NEAR(norm2, dot(residual, preconditioned), SINGLE * size(residual, preconditioned));

    EXPECT_NEAR(
        overNodes([&](int begin, int end) { return table->single_dot(begin, end, single_p.data(), single_q.data()); }),
        dot(p, q), SINGLE * size(p, q));
    Floats own_p = single_p;
    overNodes([&](int begin, int end) {
      table->single_redirect(begin, end, KEEP, single_q.data(), own_p.data());
      return 0;
    });
    expectNear(own_p, search);
  }
}

/** Rows of 3x3 blocks in groups of nodes, as an assembled matrix has them: of other lengths, some of none. */
class RowKernels : public testing::TestWithParam<int>
{
protected:
  using Floats = AlignedVector<float>;
  static constexpr int GROUP = kernels::INVERSE_GROUP;
  static constexpr float UNKNOWN = std::numeric_limits<float>::quiet_NaN();
  struct Block
  {
    int row, column;
    Eigen::Matrix3f matrix;
  };

  const int n = GetParam();
  const int padded = (n + GROUP - 1) / GROUP * GROUP;
  std::mt19937 random{5};
  std::vector<Block> blocks;
  std::vector<int> begin{0}, columns;
  Floats numbers;

  RowKernels()
  {
    std::vector<std::vector<Block>> rows(padded);
    for (int i = 0; i < n; ++i)
    {
      for (int count = static_cast<int>(random() % 9); count > 0; --count)
      {
        rows[i].push_back({i, static_cast<int>(random() % n), Eigen::Matrix3f::NullaryExpr([&] { return number(); })});
      }
      blocks.insert(blocks.end(), rows[i].begin(), rows[i].end());
    }
    for (int first = 0; first < padded; first += GROUP)
    {
      std::size_t most = 0;
      for (int k = 0; k < GROUP; ++k) most = std::max(most, rows[first + k].size());
      for (std::size_t step = 0; step < most; ++step)
      {
        const std::size_t from = numbers.size();
        numbers.resize(from + 12 * GROUP, 0.0f);
        for (int k = 0; k < GROUP; ++k)
        {
          const std::vector<Block>& row = rows[first + k];
          columns.push_back(step < row.size() ? row[step].column : first);
          if (step < row.size()) put(row[step].matrix, k, numbers.data() + from);
        }
      }
      begin.push_back(begin.back() + static_cast<int>(most));
    }
  }

  float number() { return std::uniform_real_distribution<float>(-1, 1)(random); }
  static void put(const Eigen::Matrix3f& m, int k, float* group)
  {
    for (int c = 0; c < 9; ++c) group[(c / 3 * GROUP + k) * 4 + c % 3] = m(c % 3, c / 3);
  }
  /** 4 a node; beyond the last node zero. @param fourth  what x, y, z are followed by */
  Floats field(float fourth = 0)
  {
    Floats result(4 * static_cast<std::size_t>(padded), 0.0f);
    for (int i = 0; i < n; ++i)
    {
      for (int axis = 0; axis < 3; ++axis) result[4 * i + axis] = number();
      result[4 * i + 3] = fourth;
    }
    return result;
  }
  static Eigen::Map<const Eigen::Vector3f> at(const Floats& field, int i)
  {
    return Eigen::Map<const Eigen::Vector3f>(field.data() + 4L * i);
  }
  Floats unknown() const { return Floats(4 * static_cast<std::size_t>(padded), UNKNOWN); }

  /** The ranges of whole groups that there are: all, and from each on to the one in the middle and to the end. */
  std::vector<std::pair<int, int>> ranges() const
  {
    std::vector<std::pair<int, int>> result{{0, padded}, {0, 0}};
    for (const int from : {GROUP, padded / GROUP / 2 * GROUP, padded - GROUP})
    {
      for (const int to : {padded / GROUP * 3 / 4 * GROUP, padded})
      {
        if (from < to) result.emplace_back(from, to);
      }
    }
    return result;
  }
  /** What lies outside a range is as it was; inside, three numbers a node are near, and the fourth is zero. */
  void expectOnly(const std::pair<int, int>& range, const Floats& found, const Floats& before,
                  const Eigen::Matrix3Xd& expected, const Eigen::Matrix3Xd& sizes) const
  {
    for (int i = 0; i < padded; ++i)
    {
      const bool inside = i >= range.first && i < range.second;
      for (int axis = 0; axis < 4; ++axis)
      {
        const float value = found[4 * i + axis];
        if (!inside)
        {
          ASSERT_EQ(std::memcmp(&value, &before[4 * i + axis], sizeof value), 0) << "node " << i;
        }
        else if (axis == 3 || i >= n)
        {
          ASSERT_EQ(value, 0) << "node " << i;
        }
        else
        {
          ASSERT_NEAR(value, expected(axis, i), SINGLE * sizes(axis, i)) << "node " << i;
        }
      }
    }
  }
};
INSTANTIATE_TEST_SUITE_P(Rows, RowKernels, testing::Values(1, 2, 3, 4, 5, 8, 37, 131),
                         testing::PrintToStringParamName());

TEST_P(RowKernels, ResidualIsThatOfDoubles)
{
  const Floats b = field(), x = field(UNKNOWN);
  Eigen::Matrix3Xd expected(3, n), sizes(3, n);
  for (int i = 0; i < n; ++i) expected.col(i) = at(b, i).cast<double>();
  sizes = expected.cwiseAbs();
  for (const Block& block : blocks)
  {
    const Eigen::Matrix3d m = block.matrix.cast<double>();
    const Vector3d v = at(x, block.column).cast<double>();
    expected.col(block.row) -= m * v;
    sizes.col(block.row) += m.cwiseAbs() * v.cwiseAbs();
  }
  const kernels::SingleRows rows{begin.data(), columns.data(), numbers.data()};
  for (const kernels::Table* table : tables())
  {
    SCOPED_TRACE(table->name);
    for (const auto& range : ranges())
    {
      SCOPED_TRACE(testing::Message() << range.first << " to " << range.second);
      Floats apart = unknown(), same = b;
      table->rows_residual(rows, range.first, range.second, b.data(), x.data(), apart.data());
      expectOnly(range, apart, unknown(), expected, sizes);
      table->rows_residual(rows, range.first, range.second, same.data(), x.data(), same.data());
      expectOnly(range, same, b, expected, sizes);
    }
  }
}

TEST_P(RowKernels, SmoothIsItsFormula)
{
  constexpr float GAIN = 1.25f;
  std::vector<Eigen::Matrix3f> inverses;
  Floats packed(12 * static_cast<std::size_t>(padded), 0.0f);
  for (int i = 0; i < n; ++i)
  {
    inverses.emplace_back(Eigen::Matrix3f::NullaryExpr([&] { return number(); }));
    put(inverses[i], i % GROUP, packed.data() + 12L * (i / GROUP * GROUP));
  }
  const Floats r = field(UNKNOWN), d = field(), z = field();
  for (const float keep : {0.375f, 0.0f})
  {
    Eigen::Matrix3Xd term(3, n), sum(3, n), sizes(3, n), sum_sizes(3, n);
    for (int i = 0; i < n; ++i)
    {
      const Eigen::Matrix3d m = GAIN * inverses[i].cast<double>();
      const Vector3d residual = at(r, i).cast<double>(), kept = keep * at(d, i).cast<double>();
      const Vector3d before = at(z, i).cast<double>();
      term.col(i) = m * residual + kept;
      sizes.col(i) = m.cwiseAbs() * residual.cwiseAbs() + kept.cwiseAbs();
      sum.col(i) = before + term.col(i);
      sum_sizes.col(i) = before.cwiseAbs() + sizes.col(i);
    }
    for (const kernels::Table* table : tables())
    {
      SCOPED_TRACE(table->name);
      for (const auto& range : ranges())
      {
        SCOPED_TRACE(testing::Message() << "keep " << keep << ", " << range.first << " to " << range.second);
        // Where nothing is kept, it may be anything.
        const Floats last = keep == 0 ? unknown() : d;
        Floats next = unknown(), solution = z;
        table->single_smooth(range.first, range.second, keep, GAIN, packed.data(), r.data(), last.data(), next.data(),
                             solution.data());
        expectOnly(range, next, unknown(), term, sizes);
        expectOnly(range, solution, z, sum, sum_sizes);
      }
    }
  }
}

TEST(PanelKernels, AreProductsWithAMatrixAndItsTranspose)
{
  std::mt19937 random(3);
  std::uniform_real_distribution<float> uniform(-1, 1);
  const auto numbers = [&](int count) {
    AlignedVector<float> result(count);
    for (float& value : result) value = uniform(random);
    return result;
  };
  for (const int rows : {LANES, 2 * LANES, 3 * LANES, 4 * LANES, 5 * LANES, 9 * LANES})
  {
    for (const int columns : {1, 2, 3, 4, 5, 6, 9, 72})
    {
      AlignedVector<float> panel = numbers(rows * columns);
      const AlignedVector<float> x = numbers(columns), t = numbers(rows);
      for (int j = 0; j < columns; ++j) std::fill_n(panel.begin() + j * rows, std::min(j, rows), 0.0f);
      const Eigen::MatrixXd L = Eigen::Map<const Eigen::MatrixXf>(panel.data(), rows, columns).cast<double>();
      const Eigen::VectorXd by_x = Eigen::Map<const Eigen::VectorXf>(x.data(), columns).cast<double>();
      const Eigen::VectorXd by_t = Eigen::Map<const Eigen::VectorXf>(t.data(), rows).cast<double>();
      const Eigen::VectorXd product = L * by_x, transposed = L.transpose() * by_t;
      for (const kernels::Table* table : tables())
      {
        SCOPED_TRACE(table->name);
        const float unknown = std::numeric_limits<float>::quiet_NaN();
        AlignedVector<float> y(rows, unknown), z(columns, unknown);
        table->panel_product(rows, columns, panel.data(), x.data(), y.data());
        table->panel_transpose_product(rows, columns, panel.data(), t.data(), z.data());
        for (int i = 0; i < rows; ++i) ASSERT_NEAR(y[i], product[i], SINGLE * L.row(i).norm() * by_x.norm());
        for (int j = 0; j < columns; ++j) ASSERT_NEAR(z[j], transposed[j], SINGLE * L.col(j).norm() * by_t.norm());
      }
    }
  }
}

}  // namespace
}  // namespace bezier_fem
