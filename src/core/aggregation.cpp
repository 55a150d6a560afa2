#include "aggregation.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <functional>
#include <iterator>
#include <numeric>
#include <random>
#include <tuple>

#include "bezier_fem/rotation.h"
#include "kernels.h"
#include "parallel.h"

namespace bezier_fem
{
namespace
{
/**
 * Corrections by the aggregates in a solve, with smoothing before, between and after. With one, a time step of
 * quadratic elements takes about a fifth more iterations; with three, no fewer.
 */
constexpr int CORRECTIONS = 2;
/** Chebyshev's terms in a smoothing, for eigenvalues down to the largest over RANGE. */
constexpr int DEGREE = 3;
constexpr double RANGE = 20;
/** The largest eigenvalue is estimated from below. */
constexpr double MARGIN = 1.1;
/**
 * Rigid bodies that fit together badly are stiffer than the body: the correction is too short by about this
 * (Braess 1995, "Towards algebraic multigrid for elliptic problems of second order"). Below 2 the cycle converges.
 */
constexpr float OVERCORRECTION = 1.5F;
/**
 * In the aggregates' system the nodes' own blocks are larger by this. Where a rigid motion or bending of the body meets
 * hardly any resistance beside what parts of it do, what single precision leaves of its residual is rounding, and the
 * correction by it would be without bounds: the cycle would not be positive any more.
 */
constexpr double ROUNDING = 3e-7;

/**
 * A connection of two nodes is strong where its block is at least so much of the geometric mean of their own. In one
 * material all are (bunny, armadillo, bar, also nearly incompressible); from one to another a thousand times as stiff
 * none is.
 */
constexpr double STRONG = 0.02;

constexpr int NONE = -1;
constexpr int GROUP = kernels::NODE_GROUP;

/** Four floats in a register, by GCC's and Clang's vector extensions. */
using Node = float __attribute__((vector_size(16)));
Node& nodeAt(AlignedVector<float>& field, std::ptrdiff_t i)
{
  return *reinterpret_cast<Node*>(field.data() + 4 * i);
}

using Block = Eigen::Map<const Eigen::Matrix3d>;

}  // namespace

/**
 * The aggregates (Vanek, Mandel and Brezina 1996, "Algebraic multigrid by smoothed aggregation for second and fourth
 * order elliptic problems", algorithm 5.1): whole neighbourhoods by strong connections that do not touch, to which
 * nodes in between are added where they have most neighbours.
 */
class Aggregation::Sets
{
public:
  explicit Sets(const AssembledMatrix& pattern) : pattern_(pattern), of_(pattern.rows(), NONE)
  {
    own_.reserve(of_.size());
    for (int i = 0; i < pattern.rows(); ++i) own_.push_back(norm(pattern.slot(i, i)));
    for (int i = 0; i < pattern.rows(); ++i)
    {
      bool apart = true;
      forEachNeighbour(i, [&](int j) { apart = apart && of_[j] == NONE; });
      if (!apart) continue;
      forEachNeighbour(i, [&](int j) { of_[j] = count_; });
      ++count_;
    }
    join();
  }

  int count() const { return count_; }
  int of(int node) const { return of_[node]; }

  /** Set by set; in one of them nodes with like length of row together, which pad each other less. */
  std::vector<int> order() const
  {
    const auto key = [&](int i) { return std::tuple(of_[i], pattern_.rowBegin()[i] - pattern_.rowBegin()[i + 1], i); };
    std::vector<int> order(of_.size());
    std::iota(order.begin(), order.end(), 0);
    std::sort(order.begin(), order.end(), [&](int a, int b) { return key(a) < key(b); });
    return order;
  }

  /** The mean position of each, twice. */
  NodalField centres(const NodalField& positions) const
  {
    NodalField centres(2 * count_);
    std::vector<int> sizes(count_, 0);
    for (std::size_t i = 0; i < of_.size(); ++i)
    {
      centres[2 * of_[i]] += positions[static_cast<int>(i)];
      ++sizes[of_[i]];
    }
    for (int a = 0; a < count_; ++a) centres[2 * a + 1] = centres[2 * a] /= sizes[a];
    return centres;
  }

  /** Of two nodes each; zero. */
  AssembledMatrix matrix() const
  {
    std::vector<std::vector<int>> rows(count_);
    for (std::size_t i = 0; i < of_.size(); ++i)
    {
      const auto first = pattern_.column().begin() + pattern_.rowBegin()[i];
      const auto end = pattern_.column().begin() + pattern_.rowBegin()[i + 1];
      std::transform(first, end, std::back_inserter(rows[of_[i]]), [&](int j) { return of_[j]; });
    }
    std::vector<int> begin{0}, column;
    for (std::vector<int>& row : rows)
    {
      std::sort(row.begin(), row.end());
      row.erase(std::unique(row.begin(), row.end()), row.end());
      for (int half = 0; half < 2; ++half)
      {
        for (const int a : row) column.insert(column.end(), {2 * a, 2 * a + 1});
        begin.push_back(static_cast<int>(column.size()));
      }
    }
    return {std::move(begin), std::move(column)};
  }

private:
  double norm(int slot) const { return Block(pattern_.blocks().data() + 9L * slot).norm(); }

  /** Of strong connections, and itself. */
  template <class F>
  void forEachNeighbour(int i, const F& f) const
  {
    for (int k = pattern_.rowBegin()[i]; k < pattern_.rowBegin()[i + 1]; ++k)
    {
      const int j = pattern_.column()[k];
      if (i == j || norm(k) >= STRONG * std::sqrt(own_[i] * own_[j])) f(j);
    }
  }

  /** Each node that is in none has a neighbour that is, or it would have founded one. */
  void join()
  {
    const std::vector<int> first = of_;
    std::vector<int> touches(count_, 0);
    for (std::size_t i = 0; i < first.size(); ++i)
    {
      if (first[i] != NONE) continue;
      int& best = of_[i];
      forEachNeighbour(static_cast<int>(i), [&](int j) {
        if (first[j] == NONE) return;
        ++touches[first[j]];
        if (best == NONE || touches[first[j]] > touches[best]) best = first[j];
      });
      forEachNeighbour(static_cast<int>(i), [&](int j) {
        if (first[j] != NONE) touches[first[j]] = 0;
      });
    }
  }

  const AssembledMatrix& pattern_;
  std::vector<double> own_;  // norms of the nodes' own blocks
  std::vector<int> of_;
  int count_ = 0;
};

Aggregation::Aggregation(const AssembledMatrix& pattern, const NodalField& positions)
    : Aggregation(pattern, positions, Sets(pattern))
{
}

Aggregation::Aggregation(const AssembledMatrix& pattern, const NodalField& positions, const Sets& sets)
    : positions_(positions),
      order_(sets.order()),
      position_(order_.size()),
      begin_(sets.count() + 1),
      centres_(sets.centres(positions)),
      coarse_(sets.matrix()),
      cholesky_(coarse_, centres_)
{
  for (std::size_t k = 0; k < order_.size(); ++k)
  {
    position_[order_[k]] = static_cast<int>(k);
    aggregate_of_.push_back(sets.of(order_[k]));
    ++begin_[aggregate_of_[k] + 1];
  }
  std::partial_sum(begin_.begin(), begin_.end(), begin_.begin());
  makeRows(pattern);
  const std::size_t rows = GROUP * (steps_.size() - 1);
  blocks_.resize(12 * slots_.size());
  inverse_.resize(12 * rows);
  modes_.resize(4 * MODES * order_.size());
  for (AlignedVector<float>* field : {&residual_, &last_, &next_, &solution_}) field->resize(4 * rows);
  moves_.resize(4 * static_cast<std::size_t>(centres_.size()));
}

void Aggregation::makeRows(const AssembledMatrix& pattern)
{
  const int n = pattern.rows();
  const auto begin = [&](int k) { return pattern.rowBegin()[order_[k]]; };
  const auto length = [&](int k) { return k < n ? pattern.rowBegin()[order_[k] + 1] - begin(k) : 0; };
  steps_.push_back(0);
  for (int first = 0; first < n; first += GROUP)
  {
    int most = 0;
    for (int k = first; k < first + GROUP; ++k) most = std::max(most, length(k));
    for (int step = 0; step < most; ++step)
    {
      for (int k = first; k < first + GROUP; ++k)
      {
        const bool there = step < length(k);
        slots_.push_back(there ? begin(k) + step : NONE);
        columns_.push_back(there ? position_[pattern.column()[begin(k) + step]] : first);
      }
    }
    steps_.push_back(steps_.back() + most);
  }
}

bool Aggregation::make(const AssembledMatrix& matrix, const HeldAxes& held, const float* frames)
{
  takeMatrix(matrix);
  estimateLargest();
  makeModes(held, frames);
  makeCoarse(matrix);
  return cholesky_.factor(coarse_);
}

void Aggregation::takeMatrix(const AssembledMatrix& matrix)
{
  const auto put = [](const double* block, std::size_t k, AlignedVector<float>& to) {
    float* first = to.data() + k / GROUP * 12 * GROUP + k % GROUP * 4;
    for (int c = 0; c < 9; ++c) first[c / 3 * 4 * GROUP + c % 3] = static_cast<float>(block[c]);
  };
  const double* blocks = matrix.blocks().data();
  for (std::size_t k = 0; k < slots_.size(); ++k)
  {
    if (slots_[k] != NONE) put(blocks + 9L * slots_[k], k, blocks_);
  }
  for (std::size_t k = 0; k < order_.size(); ++k)
  {
    const Eigen::Matrix3d inverse = Block(blocks + 9L * matrix.slot(order_[k], order_[k])).inverse();
    put(inverse.data(), k, inverse_);
  }
}

/** By power iteration. */
void Aggregation::estimateLargest()
{
  constexpr int ITERATIONS = 15;
  const int rows = static_cast<int>(residual_.size()) / 4;
  std::mt19937 random(1);
  for (std::size_t k = 0; k < 4 * order_.size(); ++k)
  {
    last_[k] = k % 4 == 3 ? 0.0F : static_cast<float>(random()) / 4294967296.0F - 0.5F;
  }
  for (int k = 0; k < ITERATIONS; ++k)
  {
    std::fill(residual_.begin(), residual_.end(), 0.0F);
    takeOff(0, rows);
    addTerm(0, rows, 0, -1);
    Eigen::Map<Eigen::VectorXf> v(next_.data(), static_cast<Eigen::Index>(next_.size()));
    largest_ = v.norm();
    if (largest_ > 0) v /= static_cast<float>(largest_);
    std::swap(last_, next_);
  }
}

void Aggregation::makeModes(const HeldAxes& held, const float* frames)
{
  constexpr double DEPENDENT = 1e-3;  // of the largest: a mode of which the others leave so little
  for (int a = 0; a < aggregates(); ++a)
  {
    const int begin = begin_[a], count = begin_[a + 1] - begin;
    Eigen::Matrix3d turns = Eigen::Matrix3d::Zero();
    double size = 0;
    for (int k = begin; k < begin + count; ++k)
    {
      const Eigen::Map<const Eigen::Matrix<float, 4, 3>> frame(frames + 12L * k);
      turns += frame.topRows<3>().cast<double>();
      size = std::max(size, (positions_[order_[k]] - centres_[2 * a]).norm());
    }
    const Eigen::Matrix3d turn = polarRotation(turns, Eigen::Matrix3d::Identity()) / (size > 0 ? size : 1);
    Eigen::MatrixXd modes(3 * count, MODES);
    for (int k = 0; k < count; ++k)
    {
      const int node = order_[begin + k];
      const Eigen::Vector3d arm = turn * (positions_[node] - centres_[2 * a]);
      for (int axis = 0; axis < 3; ++axis)
      {
        modes.block<3, 1>(3L * k, axis) = Eigen::Vector3d::Unit(axis);
        modes.block<3, 1>(3L * k, 3 + axis) = Eigen::Vector3d::Unit(axis).cross(arm);
      }
      for (int axis = 0; axis < 3; ++axis)
      {
        if (held[node] >> axis & 1) modes.row(3L * k + axis).setZero();
      }
    }
    // Few nodes, or nodes in a line, or held ones have fewer modes.
    Eigen::ColPivHouseholderQR<Eigen::MatrixXd> qr(modes);
    qr.setThreshold(DEPENDENT);
    const Eigen::Index rank = qr.rank();
    modes.setZero();
    modes.leftCols(rank) = qr.householderQ() * Eigen::MatrixXd::Identity(modes.rows(), rank);
    for (int k = 0; k < count; ++k)
    {
      Eigen::Map<Eigen::Matrix<float, 4, MODES>> to(modes_.data() + 4L * MODES * (begin + k));
      to.topRows<3>() = modes.middleRows<3>(3L * k).cast<float>();
      // The others' rounding
      for (int axis = 0; axis < 3; ++axis)
      {
        if (held[order_[begin + k]] >> axis & 1) to.row(axis).setZero();
      }
    }
  }
}

Eigen::Matrix<double, 3, Aggregation::MODES> Aggregation::modesAt(int node) const
{
  return Eigen::Map<const Eigen::Matrix<float, 4, MODES>>(modes_.data() + 4L * MODES * node)
      .topRows<3>()
      .cast<double>();
}

void Aggregation::makeCoarse(const AssembledMatrix& matrix)
{
  std::fill(coarse_.blocks().begin(), coarse_.blocks().end(), 0.0);
  double* blocks = coarse_.blocks().data();
  for (int k = 0; k < matrix.rows(); ++k)
  {
    const Eigen::Matrix<double, MODES, 3> own = modesAt(k).transpose();
    for (int slot = matrix.rowBegin()[order_[k]]; slot < matrix.rowBegin()[order_[k] + 1]; ++slot)
    {
      const int other = position_[matrix.column()[slot]];
      const int a = 2 * aggregate_of_[k], b = 2 * aggregate_of_[other];
      const double share = other == k ? 1 + ROUNDING : 1;
      const Eigen::Matrix<double, MODES, MODES> part =
          own * (share * Block(matrix.blocks().data() + 9L * slot)) * modesAt(other);
      const int place[2] = {coarse_.slot(a, b), coarse_.slot(a + 1, b)};
      for (int i = 0; i < 2; ++i)
      {
        for (int j = 0; j < 2; ++j)
        {
          Eigen::Map<Eigen::Matrix3d>(blocks + 9L * (place[i] + j)) += part.block<3, 3>(3L * i, 3L * j);
        }
      }
    }
  }
  // Of modes that are not there
  for (int a = 0; a < coarse_.rows(); ++a)
  {
    Eigen::Map<Eigen::Matrix3d> block(blocks + 9L * coarse_.slot(a, a));
    for (int axis = 0; axis < 3; ++axis)
    {
      if (block(axis, axis) == 0) block(axis, axis) = 1;
    }
  }
}

/** Calls f(begin, end) for ranges of whole groups of rows. */
template <class F>
void Aggregation::forEachRange(int threads, const F& f) const
{
  constexpr long PIECES = 4;  // of a thread
  const long pieces = threads == 1 ? 1 : PIECES * threads, groups = static_cast<long>(steps_.size()) - 1;
  forEachPiece(threads, static_cast<int>(pieces), [&](int piece) {
    f(static_cast<int>(groups * piece / pieces) * GROUP, static_cast<int>(groups * (piece + 1) / pieces) * GROUP);
  });
}

/** residual -= A last */
void Aggregation::takeOff(int begin, int end)
{
  kernels::table().rows_residual({steps_.data(), columns_.data(), blocks_.data()}, begin, end, residual_.data(),
                                 last_.data(), residual_.data());
}

/** next = keep last + gain B^-1 residual, solution += next */
void Aggregation::addTerm(int begin, int end, double keep, double gain)
{
  kernels::table().single_smooth(begin, end, static_cast<float>(keep), static_cast<float>(gain), inverse_.data(),
                                 residual_.data(), last_.data(), next_.data(), solution_.data());
}

/** Chebyshev's iteration. @param residual  of rows [begin, end), to be made for the first term */
template <class F>
void Aggregation::smooth(int threads, const F& residual)
{
  const double radius = MARGIN * largest_ * (1 - 1 / RANGE) / 2, centre = MARGIN * largest_ - radius;
  const double sigma = centre / radius;
  double keep = 0, gain = 1 / centre, rho = 1 / sigma;
  for (int k = 0; k < DEGREE; ++k)
  {
    forEachRange(threads, [&](int begin, int end) {
      if (k == 0)
      {
        residual(begin, end);
      }
      else
      {
        takeOff(begin, end);
      }
      addTerm(begin, end, keep, gain);
    });
    std::swap(last_, next_);
    const double next = 1 / (2 * sigma - rho);
    keep = next * rho;
    gain = 2 * next / radius;
    rho = next;
  }
}

/** Leaves what it adds to the solution in last_. */
void Aggregation::correct(int threads)
{
  const std::vector<int>& order = cholesky_.order();
  const auto modes = [&](int node, int mode) { return 4L * (static_cast<long>(node) * MODES + mode); };
  const auto restrict = [&](int begin, int end, float* b) {
    for (int k = begin; k < end; ++k, b += 4)
    {
      const int a = order[k] / 2, mode = order[k] % 2 * 3;
      Node sum[3] = {};
      for (int i = begin_[a]; i < begin_[a + 1]; ++i)
      {
        for (int m = 0; m < 3; ++m) sum[m] += nodeAt(residual_, i) * nodeAt(modes_, modes(i, mode + m) / 4);
      }
      for (int m = 0; m < 3; ++m) b[m] = sum[m][0] + sum[m][1] + sum[m][2];
    }
  };
  const auto keep = [&](int begin, int end, const float* x) {
    for (int k = begin; k < end; ++k, x += 4) std::copy_n(x, 3, moves_.data() + 4L * order[k]);
  };
  cholesky_.solve(threads, std::ref(restrict), std::ref(keep));
  forEachRange(threads, [&](int begin, int end) {
    for (int k = begin; k < std::min(end, static_cast<int>(order_.size())); ++k)
    {
      Node sum = {};
      for (int m = 0; m < MODES; ++m)
      {
        sum += moves_[8L * aggregate_of_[k] + m / 3 * 4 + m % 3] * nodeAt(modes_, modes(k, m) / 4);
      }
      nodeAt(last_, k) = OVERCORRECTION * sum;
      nodeAt(solution_, k) += nodeAt(last_, k);
    }
  });
}

void Aggregation::solve(int threads, const Read& read, const Write& write)
{
  const int n = static_cast<int>(order_.size());
  smooth(threads, [&](int begin, int end) {
    read(begin, std::min(end, n), residual_.data() + 4L * begin);
    std::fill(solution_.begin() + 4L * begin, solution_.begin() + 4L * end, 0.0F);
  });
  const auto rest = [&](int begin, int end) { takeOff(begin, end); };
  for (int k = 0; k < CORRECTIONS; ++k)
  {
    forEachRange(threads, rest);
    correct(threads);
    smooth(threads, rest);
  }
  forEachRange(threads, [&](int begin, int end) { write(begin, std::min(end, n), solution_.data() + 4L * begin); });
}

double Aggregation::makingTime() const
{
  return 1.3e-7 * static_cast<double>(slots_.size()) + cholesky_.makingTime();
}

double Aggregation::solvingTime() const
{
  constexpr int PRODUCTS = (CORRECTIONS + 1) * DEGREE - 1 + CORRECTIONS;
  return 1.2e-10 * PRODUCTS * static_cast<double>(blocks_.size()) + CORRECTIONS * cholesky_.solvingTime();
}

}  // namespace bezier_fem
