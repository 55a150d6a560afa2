// The cycle over aggregates as an approximate inverse: by its spectrum where that can be computed, and by what
// conjugate gradients make of it.

#include "aggregation.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <cstring>
#include <functional>
#include <limits>

#include "bezier_fem/assembled_system.h"
#include "bezier_fem/refine.h"
#include "core/bar.h"

namespace bezier_fem
{
namespace
{
using Eigen::Matrix3d;
using Eigen::Vector3d;

using BlockMap = Eigen::Map<Matrix3d>;
using ConstBlockMap = Eigen::Map<const Matrix3d>;
using Inside = std::function<int(const Vector3d&)>;

constexpr Material STIFF{2e6, 0.45, 500};
/** alpha M + beta K': of a time step of 20 ms, and static. */
constexpr std::pair<double, double> STEP{1, 4e-4}, STATIC{0, 1};

int nothing(const Vector3d& /*X*/)
{
  return 0;
}
int foot(const Vector3d& X)
{
  return X.z() < 1e-9 ? 7 : 0;
}

BlockMap blockOf(AssembledMatrix& matrix, int slot)
{
  return BlockMap(matrix.blocks().data() + 9L * slot);
}
ConstBlockMap blockOf(const AssembledMatrix& matrix, int slot)
{
  return ConstBlockMap(matrix.blocks().data() + 9L * slot);
}

/** A matrix with the nodes that it is of; rows and columns of what is held are those of the unit matrix. */
struct System
{
  NodalField positions;
  HeldAxes held;
  AssembledMatrix matrix;
  AssembledMatrix free_matrix;  // without what is held
  std::vector<Matrix3d> turns;  // of each node since rest

  System(const NodalField& at, AssembledMatrix of)
      : positions(at),
        held(at.size(), 0),
        matrix(std::move(of)),
        free_matrix(matrix),
        turns(at.size(), Matrix3d::Identity())
  {
  }
  System(const Model& model, const std::pair<double, double>& coefficients, const Inside& axes = nothing)
      : System(model, coefficients, restRotations(model), axes)
  {
  }
  System(const Model& model, const std::pair<double, double>& coefficients, const Rotations& rotations,
         const Inside& axes)
      : System(model.rest, AssembledMatrix(model))
  {
    const Partition partition(model, 1);
    AssembledSystem system(model, partition);
    system.assemble(rotations, coefficients.first, coefficients.second);
    matrix = free_matrix = system.matrix();
    for (int i = 0; i < n(); ++i) held[i] = static_cast<std::uint8_t>(axes(positions[i]));
    hold();
  }

  int n() const { return positions.size(); }

  void hold()
  {
    forEachBlock([&](int i, int j, BlockMap block) {
      for (int axis = 0; axis < 3; ++axis)
      {
        if (held[i] >> axis & 1) block.row(axis).setZero();
        if (held[j] >> axis & 1) block.col(axis).setZero();
        if (i == j && (held[i] >> axis & 1)) block(axis, axis) = 1;
      }
    });
  }
  void scale(double factor)
  {
    for (double& number : matrix.blocks()) number *= factor;
  }
  template <class F>
  void forEachBlock(const F& f)
  {
    for (int i = 0; i < n(); ++i)
    {
      for (int k = matrix.rowBegin()[i]; k < matrix.rowBegin()[i + 1]; ++k)
        f(i, matrix.column()[k], blockOf(matrix, k));
    }
  }

  bool free(int i, int axis) const { return !(held[i] >> axis & 1); }
  /** Zero where held. */
  NodalField masked(NodalField field) const
  {
    for (int i = 0; i < n(); ++i)
    {
      for (int axis = 0; axis < 3; ++axis)
      {
        if (!free(i, axis)) field[i][axis] = 0;
      }
    }
    return field;
  }
  NodalField random(unsigned seed) const { return masked(test::randomField(n(), seed)); }
  NodalField operator*(const NodalField& u) const
  {
    NodalField result(n());
    for (int i = 0; i < n(); ++i)
    {
      for (int k = matrix.rowBegin()[i]; k < matrix.rowBegin()[i + 1]; ++k)
      {
        result[i] += blockOf(matrix, k) * u[matrix.column()[k]];
      }
    }
    return result;
  }
  Eigen::MatrixXd dense() const
  {
    Eigen::MatrixXd result = Eigen::MatrixXd::Zero(3L * n(), 3L * n());
    for (int i = 0; i < n(); ++i)
    {
      for (int k = matrix.rowBegin()[i]; k < matrix.rowBegin()[i + 1]; ++k)
      {
        result.block<3, 3>(3L * i, 3L * matrix.column()[k]) = blockOf(matrix, k);
      }
    }
    return result;
  }
  bool make(Aggregation& inverse) const
  {
    AlignedVector<float> frames(12 * static_cast<std::size_t>(n()), std::numeric_limits<float>::quiet_NaN());
    for (int k = 0; k < n(); ++k)
    {
      Eigen::Map<Eigen::Matrix<float, 4, 3>>(frames.data() + 12L * k).topRows<3>() =
          turns[inverse.order()[k]].cast<float>();
    }
    return inverse.make(matrix, held, frames.data());
  }
};

/** What the inverse makes of b, 4 floats a node in the system's order. @param fourth  what x, y, z come with */
NodalField solve(Aggregation& inverse, const NodalField& b, int threads = 1, float fourth = 0)
{
  NodalField x(b.size());
  x.matrix().topRows<3>().setConstant(std::numeric_limits<double>::quiet_NaN());
  inverse.solve(
      threads,
      [&](int begin, int end, float* to) {
        for (int k = begin; k < end; ++k)
        {
          for (int axis = 0; axis < 3; ++axis) *to++ = static_cast<float>(b[inverse.order()[k]][axis]);
          *to++ = fourth;
        }
      },
      [&](int begin, int end, const float* from) {
        for (int k = begin; k < end; ++k, from += 4)
        {
          x[inverse.order()[k]] = Eigen::Map<const Eigen::Vector3f>(from).cast<double>();
        }
      });
  return x;
}

void expectSame(const NodalField& a, const NodalField& b)
{
  ASSERT_EQ(a.size(), b.size());
  EXPECT_TRUE(a.matrix().allFinite());
  EXPECT_EQ(std::memcmp(a.data(), b.data(), sizeof(double) * 4 * a.size()), 0)
      << "differ by " << (a.matrix() - b.matrix()).cwiseAbs().maxCoeff();
}

double dot(const NodalField& a, const NodalField& b)
{
  return a.matrix().cwiseProduct(b.matrix()).sum();
}

NodalField byDiagonal(const System& system, const NodalField& r)
{
  NodalField z(r.size());
  for (int i = 0; i < r.size(); ++i)
  {
    z[i] = blockOf(system.matrix, system.matrix.slot(i, i)).inverse() * r[i];
  }
  return z;
}

/** Iterations until sqrt(r^T B^-1 r), as ConjugateGradient has it, is 1e-8 of what it was. */
template <class Preconditioner>
int iterations(const System& system, const Preconditioner& preconditioner, const NodalField& b)
{
  constexpr int MOST = 5000;
  constexpr double TOLERANCE = 1e-8;
  NodalField r = b, p(b.size());
  const double target = TOLERANCE * std::sqrt(dot(b, byDiagonal(system, b)));
  double before = 1;
  for (int k = 0; k < MOST; ++k)
  {
    if (std::sqrt(dot(r, byDiagonal(system, r))) <= target) return k;
    const NodalField z = preconditioner(r);
    const double slope = dot(r, z);
    EXPECT_GT(slope, 0);
    if (!(slope > 0)) break;
    p.matrix() = z.matrix() + slope / before * p.matrix();
    if (k == 0) p = z;
    before = slope;
    const NodalField q = system * p;
    r.matrix() -= slope / dot(p, q) * q.matrix();
  }
  ADD_FAILURE() << "did not converge";
  return MOST;
}

/** A right-hand side with something in it of every length: its weight, and noise. */
NodalField load(const System& system)
{
  NodalField b = test::randomField(system.n(), 3);
  for (int i = 0; i < system.n(); ++i) b[i] = 0.1 * b[i] + Vector3d(0.3, -1, 0.2);
  return system.masked(b);
}

int iterations(const System& system, Aggregation& inverse)
{
  return iterations(
      system, [&](const NodalField& r) { return solve(inverse, r); }, load(system));
}
int iterations(const System& system)
{
  Aggregation inverse(system.free_matrix, system.positions);
  EXPECT_TRUE(system.make(inverse));
  return iterations(system, inverse);
}
int iterationsByDiagonal(const System& system)
{
  return iterations(
      system, [&](const NodalField& r) { return byDiagonal(system, r); }, load(system));
}

/** What the inverse makes of each unit vector. */
Eigen::MatrixXd dense(Aggregation& inverse, int n)
{
  Eigen::MatrixXd result(3L * n, 3L * n);
  NodalField unit(n);
  for (int k = 0; k < 3 * n; ++k)
  {
    unit.setZero();
    unit[k / 3][k % 3] = 1;
    const NodalField column = solve(inverse, unit);
    for (int i = 0; i < n; ++i) result.block<3, 1>(3L * i, k) = column[i];
  }
  return result;
}

/** Eigenvalues of M A, which are 1 where the inverse M is exact; M is checked to be symmetric, A = L L^T. */
Eigen::VectorXd spectrum(const System& system)
{
  Aggregation inverse(system.free_matrix, system.positions);
  EXPECT_TRUE(system.make(inverse));
  const Eigen::MatrixXd L = system.dense().llt().matrixL();
  const Eigen::MatrixXd product = L.transpose() * dense(inverse, system.n()) * L;
  EXPECT_LT((product - product.transpose()).cwiseAbs().maxCoeff(), 2e-3);  // of low modes, in single precision
  return Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>((product + product.transpose()) / 2, Eigen::EigenvaluesOnly)
      .eigenvalues();
}

Model bar(const Eigen::Vector3i& cells, const Material& material = STIFF)
{
  return test::boxModel(test::irregularBox(cells, {0.4, 0.4, 1.0}), Element::LINEAR, material);
}

/** Bodies side by side that do not touch. */
TetMesh together(const std::vector<TetMesh>& parts)
{
  TetMesh mesh;
  Eigen::Index corners = 0, tets = 0;
  for (const TetMesh& part : parts)
  {
    mesh.corners.conservativeResize(3, corners + part.corners.cols());
    mesh.corners.rightCols(part.corners.cols()) =
        part.corners.colwise() + Vector3d(3.0 * static_cast<double>(corners), 0, 0);
    mesh.tets.conservativeResize(4, tets + part.tets.cols());
    mesh.tets.rightCols(part.tets.cols()) = part.tets.array() + static_cast<int>(corners);
    corners += part.corners.cols();
    tets += part.tets.cols();
  }
  for (int i = 0; i < corners; ++i) mesh.corner_ids.push_back(i + 1);
  mesh.largest_id = corners;
  return mesh;
}

TetMesh tetrahedron(double size)
{
  TetMesh mesh;
  mesh.corners = size * Eigen::Matrix3Xd::Identity(3, 4);
  mesh.tets = Eigen::Vector4i(3, 0, 1, 2);
  mesh.corner_ids = {1, 2, 3, 4};
  mesh.largest_id = 4;
  return mesh;
}

/** Nodes that springs of the same stiffness in any direction hold to their neighbours, and weak ones to their place. */
System chain(int n, bool springs, const Vector3d& step)
{
  std::vector<int> begin{0}, column;
  for (int i = 0; i < n; ++i)
  {
    for (int j = std::max(0, i - 1); j < std::min(n, i + 2); ++j)
    {
      if (springs || i == j) column.push_back(j);
    }
    begin.push_back(static_cast<int>(column.size()));
  }
  NodalField positions(n);
  for (int i = 0; i < n; ++i) positions[i] = Vector3d(100, 0, 0) + i * step;
  System system(positions, AssembledMatrix(begin, column));
  for (int i = 0; i < n; ++i)
  {
    BlockMap diagonal = blockOf(system.matrix, system.matrix.slot(i, i));
    diagonal += 0.01 * Matrix3d::Identity();
    for (const int j : {i - 1, i + 1})
    {
      if (!springs || j < 0 || j >= n) continue;
      diagonal += Matrix3d::Identity();
      blockOf(system.matrix, system.matrix.slot(i, j)) -= Matrix3d::Identity();
    }
  }
  return system;
}

TEST(Aggregation, IsSymmetricPositiveDefiniteAndNearTheInverse)
{
  const auto some = [](const Vector3d& X) { return X.x() < 1e-9 ? 1 : X.z() < 0.3 ? 6 : X.z() > 0.9 ? 7 : 0; };
  const Model model = bar({3, 3, 6}), soft = bar({3, 3, 6}, test::RUBBER);
  for (const System& system :
       {System(model, STEP), System(model, STEP, foot), System(model, STATIC, foot), System(model, STATIC, some),
        System(soft, STEP), System(soft, {1, 1e-8}), System(soft, {1, 1e-2})})
  {
    const Eigen::VectorXd eigenvalues = spectrum(system);
    EXPECT_GT(eigenvalues.minCoeff(), 0.3);
    EXPECT_LT(eigenvalues.maxCoeff(), 1.15);
  }
}

TEST(Aggregation, IsTheSameForAnyNumberOfThreads)
{
  std::vector<System> systems{System(bar({7, 7, 14}), STEP, foot), System(bar({1, 1, 1}), STEP)};
  for (const int n : {1, 2, 3, 4, 5, 9}) systems.push_back(chain(n, true, Vector3d(1, 0, 0)));
  for (const System& system : systems)
  {
    Aggregation inverse(system.free_matrix, system.positions);
    ASSERT_TRUE(system.make(inverse));
    const NodalField b = system.random(4), one = solve(inverse, b);
    for (const int threads : {2, 3, 8})
    {
      for (int repeat = 0; repeat < 10; ++repeat) expectSame(solve(inverse, b, threads), one);
    }
  }
}

TEST(Aggregation, TakesFewIterationsHoweverFineTheMesh)
{
  const TetMesh coarse = test::irregularBox({3, 3, 6}, {0.4, 0.4, 1.0});
  struct
  {
    const char* name;
    Material material;
    std::pair<double, double> coefficients;
    Inside held;
    int most;
  } const cases[] = {{"soft step", test::RUBBER, STEP, nothing, 14},
                     {"stiff step", STIFF, STEP, foot, 23},
                     {"static", STIFF, STATIC, foot, 24}};
  for (const auto& c : cases)
  {
    int before = c.most;
    for (int levels = 0; levels <= 2; ++levels)
    {
      SCOPED_TRACE(testing::Message() << c.name << ", refined " << levels << " times");
      const Model model = test::boxModel(refined(coarse, levels), Element::LINEAR, c.material);
      const System system(model, c.coefficients, c.held);
      Aggregation inverse(system.free_matrix, system.positions);
      ASSERT_TRUE(system.make(inverse));
      const int taken = iterations(system, inverse);
      EXPECT_LE(taken, c.most);
      // From eight times as few nodes to these, diagonal blocks take twice as many.
      if (levels == 2)
      {
        EXPECT_LE(taken, before + 3);
      }
      before = taken;
      EXPECT_LT(10 * taken, iterationsByDiagonal(system));
      EXPECT_GT(inverse.aggregates(), system.n() / 30);
      EXPECT_LT(inverse.aggregates(), system.n() / 10);
    }
  }
}

TEST(Aggregation, TimeAndMemoryAreInProportionToTheNodes)
{
  const Model small = bar({8, 8, 16}), large = bar({16, 16, 32});
  const Aggregation few(AssembledMatrix(small), small.rest), many(AssembledMatrix(large), large.rest);
  const double nodes = static_cast<double>(large.num_nodes) / small.num_nodes;
  EXPECT_GT(nodes, 6);
  EXPECT_LT(many.makingTime(), 2 * nodes * few.makingTime());
  EXPECT_LT(many.solvingTime(), 2 * nodes * few.solvingTime());
}

TEST(Aggregation, LeavesOutWhatIsHeld)
{
  const Model model = bar({4, 4, 8});
  struct
  {
    const char* name;
    Inside held;
    int most;
  } const cases[] = {
      {"single axes",
       [](const Vector3d& X) { return (X.x() < 1e-9 ? 1 : 0) | (X.y() < 1e-9 ? 2 : 0) | (X.z() < 1e-9 ? 4 : 0); }, 16},
      {"an axis of all", [](const Vector3d& X) { return X.z() < 1e-9 ? 7 : 2; }, 17},
      {"half", [](const Vector3d& X) { return X.z() < 0.5 ? 7 : 0; }, 16},
      {"all but a few", [](const Vector3d& X) { return X.z() < 0.95 ? 7 : 0; }, 9},
      {"all but an axis", [](const Vector3d& X) { return X.z() < 1e-9 ? 7 : 5; }, 11},
      {"all kinds", [](const Vector3d& X) { return X.z() < 1e-9 ? 7 : static_cast<int>(1e3 * (X.x() + X.y())) % 8; },
       10},
      {"all", [](const Vector3d& /*X*/) { return 7; }, 0}};
  for (const auto& c : cases)
  {
    SCOPED_TRACE(c.name);
    for (const auto& coefficients : {STEP, STATIC})
    {
      const System system(model, coefficients, c.held);
      Aggregation inverse(system.free_matrix, system.positions);
      ASSERT_TRUE(system.make(inverse));
      const NodalField b = system.random(4), x = solve(inverse, b);
      EXPECT_EQ((system.masked(x).matrix() - x.matrix()).norm(), 0);
      // What is held is another system, of which the others know nothing.
      NodalField with = test::randomField(system.n(), 5);
      with.matrix() += b.matrix() - system.masked(with).matrix();
      EXPECT_EQ((system.masked(solve(inverse, with)).matrix() - x.matrix()).cwiseAbs().maxCoeff(), 0);
      EXPECT_LE(iterations(system, inverse), c.most);
    }
  }
}

TEST(Aggregation, PartsThatDoNotTouchAreSolvedAtTheSameTime)
{
  const TetMesh box = test::irregularBox({4, 4, 8}, {0.4, 0.4, 1.0});
  const int alone = iterations(System(test::boxModel(box, Element::LINEAR, STIFF), STEP));
  const Model model =
      test::boxModel(together({tetrahedron(0.1), box, tetrahedron(0.3), test::kuhnBox({1, 1, 1}, {0.2, 0.3, 0.4}), box,
                               test::kuhnBox({1, 1, 12}, {0.1, 0.1, 2.0})}),
                     Element::LINEAR, STIFF);
  const System system(model, STEP);
  Aggregation inverse(system.free_matrix, system.positions);
  ASSERT_TRUE(system.make(inverse));
  EXPECT_LE(iterations(system, inverse), alone + 12);

  // A right-hand side of one moves no other.
  const auto first = [&](int i) { return model.rest[i].x() < 2; };
  NodalField b = test::randomField(system.n(), 4);
  for (int i = 0; i < system.n(); ++i)
  {
    if (!first(i)) b[i].setZero();
  }
  const NodalField x = solve(inverse, b);
  int firsts = 0;
  for (int i = 0; i < system.n(); ++i)
  {
    firsts += first(i) ? 1 : 0;
    EXPECT_EQ(x[i].norm() > 0, first(i)) << i;
  }
  EXPECT_EQ(firsts, 4);
}

TEST(Aggregation, ASingleTetrahedronIsABody)
{
  for (const double size : {0.3, 1.0, 1e3})
  {
    const Eigen::VectorXd eigenvalues =
        spectrum(System(test::boxModel(tetrahedron(size), Element::LINEAR, STIFF), STEP));
    EXPECT_GT(eigenvalues.minCoeff(), 0.6);
    EXPECT_LT(eigenvalues.maxCoeff(), 1.1);
  }
}

TEST(Aggregation, FewNodesOrNodesInALineHaveFewerThanSixModes)
{
  for (const int n : {1, 2, 3, 4, 5, 6, 7, 20})
  {
    for (const bool springs : {true, false})
    {
      for (const Vector3d& step : {Vector3d(1, 0, 0), Vector3d(1e-6, 2e-6, 3e-6), Vector3d(0, 0, 0)})
      {
        SCOPED_TRACE(testing::Message() << n << (springs ? " with springs " : " ") << step.transpose());
        const Eigen::VectorXd eigenvalues = spectrum(chain(n, springs, step));
        EXPECT_GT(eigenvalues.minCoeff(), springs ? 0.6 : 0.99);
        EXPECT_LT(eigenvalues.maxCoeff(), springs ? 1.15 : 1.001);
      }
    }
  }
}

TEST(Aggregation, BodiesThatHardlyResistARigidMotionOrBendingAreSolved)
{
  // Beyond what single precision tells apart: make() may say so, but what it makes is to be of use.
  int made = 0;
  for (double beta = 1; beta < 1e4; beta *= 10)
  {
    const System system(bar({6, 6, 12}, test::RUBBER), {1, beta});
    Aggregation inverse(system.free_matrix, system.positions);
    if (!system.make(inverse)) continue;
    ++made;
    EXPECT_LE(iterations(system, inverse), 60) << beta;
  }
  EXPECT_GE(made, 3);
  for (const auto& [length, most] : {std::pair{20, 30}, {40, 46}, {80, 90}})
  {
    const Model thin =
        test::boxModel(test::irregularBox({3, 3, 3 * length}, {1, 1, 1.0 * length}), Element::LINEAR, STIFF);
    EXPECT_LE(iterations(System(thin, STATIC, foot)), most) << length;
  }
}

TEST(Aggregation, ATurnedBodyIsAsTheOneAtRest)
{
  const Model model = bar({4, 4, 8});
  const Partition partition(model, 1);
  const auto rotationsOf = [&](const auto& turn) {
    NodalField x = model.rest;
    for (int i = 0; i < model.num_nodes; ++i) x[i] = turn(Vector3d(x[i])) * Vector3d(model.rest[i]);
    Rotations result = restRotations(model);
    AlignedVector<double> turned(result.flags.size());
    updateRotations(model, partition, x, restRotations(model), result, turned);
    return result;
  };
  const Matrix3d Q = Eigen::AngleAxisd(2, Vector3d(1, 2, 3).normalized()).toRotationMatrix();
  const auto whole = [&](const Vector3d& /*X*/) -> const Matrix3d& { return Q; };
  const auto bent = [](const Vector3d& X) {
    return Eigen::AngleAxisd(2 * X.z(), Vector3d(1, 0.5, 0.2).normalized()).toRotationMatrix();
  };
  for (const auto& coefficients : {STEP, STATIC})
  {
    const auto held = coefficients == STATIC ? foot : nothing;
    const System rest(model, coefficients, held);
    System turned(model, coefficients, rotationsOf(whole), held);
    std::fill(turned.turns.begin(), turned.turns.end(), Q);
    Aggregation inverse(rest.free_matrix, rest.positions), of_turned(rest.free_matrix, rest.positions);
    ASSERT_TRUE(rest.make(inverse));
    ASSERT_TRUE(turned.make(of_turned));
    NodalField b = rest.random(4), turned_b = b;
    for (int i = 0; i < rest.n(); ++i) turned_b[i] = Q * b[i];
    const NodalField x = solve(inverse, b), turned_x = solve(of_turned, turned_b);
    NodalField expected = x;
    for (int i = 0; i < rest.n(); ++i) expected[i] = Q * x[i];
    // The largest eigenvalue is estimated from another random field.
    EXPECT_LT((turned_x.matrix() - expected.matrix()).norm(), 1e-2 * x.matrix().norm());
    const int at_rest = iterations(rest, inverse);
    EXPECT_LE(iterations(turned, of_turned), at_rest + 1);

    System wound(model, coefficients, rotationsOf(bent), held);
    const int unturned = iterations(wound);
    for (int i = 0; i < wound.n(); ++i) wound.turns[i] = bent(model.rest[i]);
    const int told = iterations(wound);
    EXPECT_LE(told, at_rest + 6);
    EXPECT_LT(told, unturned);
  }
}

TEST(Aggregation, UnitsAreAnybodys)
{
  for (const auto& coefficients : {STEP, STATIC})
  {
    const Model model = bar({4, 4, 8});
    const System system(model, coefficients, coefficients == STATIC ? foot : nothing);
    Aggregation inverse(system.free_matrix, system.positions);
    ASSERT_TRUE(system.make(inverse));
    const int taken = iterations(system, inverse);
    const NodalField b = system.random(4), x = solve(inverse, b);
    for (const double scale : {1e-10, 1e-5, 1e5, 1e10})
    {
      System scaled(model, {scale * coefficients.first, scale * coefficients.second},
                    coefficients == STATIC ? foot : nothing);
      ASSERT_TRUE(scaled.make(inverse));
      EXPECT_NEAR(iterations(scaled, inverse), taken, 1) << scale;
      NodalField y = solve(inverse, b);
      y.matrix() *= scale;
      EXPECT_LT((y.matrix() - x.matrix()).norm(), 1e-3 * x.matrix().norm()) << scale;
    }
    // Lengths too: the nodes' positions only say how they turn.
    System longer = system;
    longer.positions.matrix() *= 1e5;
    Aggregation of_longer(longer.free_matrix, longer.positions);
    ASSERT_TRUE(longer.make(of_longer));
    EXPECT_NEAR(iterations(longer, of_longer), taken, 1);
  }
}

TEST(Aggregation, MaterialsMayDifferAThousandTimes)
{
  const TetMesh mesh = test::irregularBox({6, 6, 12}, {0.4, 0.4, 1.0});
  const auto taken = [&](const std::function<bool(const Vector3d&)>& soft, const std::pair<double, double>& c) {
    std::vector<Material> materials(mesh.tets.cols(), STIFF);
    for (Eigen::Index t = 0; t < mesh.tets.cols(); ++t)
    {
      Vector3d centre = Vector3d::Zero();
      for (int a = 0; a < CORNERS; ++a) centre += mesh.corners.col(mesh.tets(a, t)) / CORNERS;
      if (soft(centre)) materials[t].young /= 1000;
    }
    const System system(buildModel(mesh, Element::LINEAR, materials), c, foot);
    const int result = iterations(system);
    EXPECT_LT(6 * result, iterationsByDiagonal(system));
    return result;
  };
  for (const auto& coefficients : {STEP, STATIC})
  {
    const int one = taken([](const Vector3d& /*X*/) { return false; }, coefficients);
    const int tip = taken([](const Vector3d& X) { return X.z() > 0.5; }, coefficients);
    const int root = taken([](const Vector3d& X) { return X.z() < 0.5; }, coefficients);
    const int layers = taken([](const Vector3d& X) { return static_cast<int>(X.z() * 6) % 2 == 1; }, coefficients);
    const int shell =
        taken([](const Vector3d& X) { return (X.head<2>().array() - 0.2).abs().maxCoeff() > 0.13; }, coefficients);
    for (const int each : {tip, root, layers, shell}) EXPECT_LE(each, one + 8);
  }
}

TEST(Aggregation, NothingIsLeftOfAnotherMatrix)
{
  const Model model = bar({4, 4, 8});
  const auto some = [](const Vector3d& X) { return X.z() < 0.3 ? static_cast<int>(1e3 * X.x()) % 8 : 0; };
  System turned(model, STEP, foot), negative(model, {-1e6, 0}), unknown(model, STEP);
  std::fill(turned.turns.begin(), turned.turns.end(),
            Eigen::AngleAxisd(2, Vector3d(1, 2, 3).normalized()).toRotationMatrix());
  unknown.scale(std::numeric_limits<double>::quiet_NaN());
  const System step(model, STEP), held(model, STATIC, some), other(bar({4, 4, 8}, test::RUBBER), {1, 1e-2}, foot);
  Aggregation kept(step.free_matrix, model.rest);
  const NodalField b = test::randomField(model.num_nodes, 4);
  for (const System* system : std::initializer_list<const System*>{&step, &held, &turned, &step, &negative, &other,
                                                                   &unknown, &held, &unknown, &step})
  {
    const bool made = system->make(kept);
    if (system == &negative)
    {
      EXPECT_FALSE(made);
    }
    if (system == &negative || system == &unknown) continue;
    ASSERT_TRUE(made);
    Aggregation anew(step.free_matrix, model.rest);
    ASSERT_TRUE(system->make(anew));
    expectSame(solve(kept, b), solve(anew, b));
  }
}

TEST(Aggregation, NothingIsLeftOfWhatWasNoNumber)
{
  for (const System& system : {System(bar({4, 4, 8}), STEP), System(bar({3, 3, 6}), STATIC, foot)})
  {
    Aggregation inverse(system.free_matrix, system.positions);
    ASSERT_TRUE(system.make(inverse));
    const NodalField b = system.random(4), x = solve(inverse, b);
    for (const double bad : {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity(), 1e300})
    {
      for (const int where : {0, system.n() / 2, system.n() - 1})
      {
        NodalField with = b;
        with[where][1] = bad;
        EXPECT_FALSE(solve(inverse, with).matrix().allFinite());
        expectSame(solve(inverse, b), x);
      }
    }
    // Nor is the fourth number of a node looked at.
    for (const float fourth : {1.0F, std::numeric_limits<float>::quiet_NaN()})
    {
      expectSame(solve(inverse, b, 1, fourth), x);
      expectSame(solve(inverse, b, 3, fourth), x);
    }
    // Nor does make() see it.
    NodalField with = b;
    with.matrix().topRows<3>().setConstant(std::numeric_limits<double>::quiet_NaN());
    solve(inverse, with);
    ASSERT_TRUE(system.make(inverse));
    expectSame(solve(inverse, b), x);
  }
}

}  // namespace
}  // namespace bezier_fem
