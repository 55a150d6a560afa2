#include "turned_inverse.h"

#include <Eigen/Dense>
#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numeric>

#include "aggregation.h"
#include "parallel.h"
#include "sparse_cholesky.h"

namespace bezier_fem
{
namespace
{
/** Four floats in a register, by GCC's and Clang's vector extensions. */
using Node = float __attribute__((vector_size(16)));
using Mask = std::int32_t __attribute__((vector_size(16)));

const Node& nodeAt(const float* p)
{
  return *reinterpret_cast<const Node*>(p);
}

/** A 3x3 matrix by columns; of their fourth numbers nothing is made. */
struct Columns
{
  Node c[3];

  Node operator*(const Node& v) const { return v[0] * c[0] + v[1] * c[1] + v[2] * c[2]; }
  Columns operator*(const Columns& b) const { return {*this * b.c[0], *this * b.c[1], *this * b.c[2]}; }
};
constexpr std::ptrdiff_t COLUMNS = sizeof(Columns) / sizeof(float), FRAME = 2 * COLUMNS;

Columns& columnsAt(float* p)
{
  return *reinterpret_cast<Columns*>(p);
}
const Columns& columnsAt(const float* p)
{
  return *reinterpret_cast<const Columns*>(p);
}

/** All bits set of what is not held. */
const Mask& freeOf(std::uint8_t held)
{
  static constexpr Mask FREE[8] = {{-1, -1, -1}, {0, -1, -1}, {-1, 0, -1}, {0, 0, -1},
                                   {-1, -1, 0},  {0, -1, 0},  {-1, 0, 0},  {}};
  return FREE[held];
}

/** Zero in place of what is held, also of what is no number. */
Node only(const Mask& free, const Node& v)
{
  return reinterpret_cast<Node>(reinterpret_cast<Mask>(v) & free);
}

/** The columns of a 3 x 4 matrix from its rows; their fourth numbers are not looked at. */
void transpose(const Node& a, const Node& b, const Node& c, Node& first, Node& second, Node& third, Node& fourth)
{
  const Node ab = __builtin_shufflevector(a, b, 0, 4, 1, 5), AB = __builtin_shufflevector(a, b, 2, 6, 3, 7);
  const Node cc = __builtin_shufflevector(c, c, 0, 0, 1, 1), CC = __builtin_shufflevector(c, c, 2, 2, 3, 3);
  first = __builtin_shufflevector(ab, cc, 0, 1, 4, 5);
  second = __builtin_shufflevector(ab, cc, 2, 3, 6, 7);
  third = __builtin_shufflevector(AB, CC, 0, 1, 4, 5);
  fourth = __builtin_shufflevector(AB, CC, 2, 3, 6, 7);
}

Columns transpose(const Columns& m)
{
  Columns t;
  Node none;
  transpose(m.c[0], m.c[1], m.c[2], t.c[0], t.c[1], t.c[2], none);
  return t;
}

/** Of three numbers each. */
float dot(const Node& a, const Node& b)
{
  const Node products = a * b;
  return products[0] + products[1] + products[2];
}

/** The rotation nearest to a sum of very different ones. */
Columns farRotation(const Columns& mean)
{
  Eigen::Matrix3f start;
  for (int k = 0; k < 9; ++k) start(k % 3, k / 3) = mean.c[k / 3][k % 3];
  Eigen::Matrix3f frame = start;
  for (int k = 0; k < 2; ++k) frame = (1.5f * frame - 0.5f * frame * (frame.transpose() * frame)).eval();
  if (!frame.isUnitary(0.1f)) frame = polarRotation(start.cast<double>(), Eigen::Matrix3d::Identity()).cast<float>();
  Columns rotation = {};
  for (int k = 0; k < 9; ++k) rotation.c[k / 3][k % 3] = frame(k % 3, k / 3);
  return rotation;
}

/** Towards the rotation nearest to a sum of rotations (Newton and Schulz): near enough, as any regular frame will do.
 */
Columns meanRotation(const Columns& sum)
{
  constexpr float NEAR = 0.2f;  // what is left are some hundredths
  const float scale = std::sqrt(3 / (dot(sum.c[0], sum.c[0]) + dot(sum.c[1], sum.c[1]) + dot(sum.c[2], sum.c[2])));
  const Columns mean{scale * sum.c[0], scale * sum.c[1], scale * sum.c[2]};
  const Columns square = mean * transpose(mean);
  const float squares = dot(square.c[0], square.c[0]) + dot(square.c[1], square.c[1]) + dot(square.c[2], square.c[2]);
  // |M M^T - 1|^2, as |M|^2 = 3
  if (!(squares - 3 < NEAR)) return farRotation(mean);
  const Columns cube = square * mean;
  return {1.5f * mean.c[0] - 0.5f * cube.c[0], 1.5f * mean.c[1] - 0.5f * cube.c[1],
          1.5f * mean.c[2] - 0.5f * cube.c[2]};
}

/** Rows and columns of held components become those of the unit matrix. */
void hold(const HeldAxes& held, AssembledMatrix& matrix)
{
  for (int i = 0; i < matrix.rows(); ++i)
  {
    for (int k = matrix.rowBegin()[i]; k < matrix.rowBegin()[i + 1]; ++k)
    {
      const int j = matrix.column()[k];
      if ((held[i] | held[j]) == 0) continue;
      Eigen::Map<Eigen::Matrix3d> block(matrix.blocks().data() + 9L * k);
      for (int axis = 0; axis < 3; ++axis)
      {
        if (held[i] >> axis & 1) block.row(axis).setZero();
        if (held[j] >> axis & 1) block.col(axis).setZero();
        if (i == j && (held[i] >> axis & 1)) block(axis, axis) = 1;
      }
    }
  }
}

/** @param system  set to what aggregates are to be made by */
std::unique_ptr<BlockInverse> inverseOf(TurnedInverse::Form form, const Model& model, AssembledSystem& system)
{
  if (form == TurnedInverse::Form::FACTOR) return std::make_unique<SparseCholesky>(system.matrix(), model.rest);
  system.assemble(restRotations(model), 0, 1);
  return std::make_unique<Aggregation>(system.matrix(), model.rest);
}

void scaleDiagonal(double factor, AssembledMatrix& matrix)
{
  for (int i = 0; i < matrix.rows(); ++i)
  {
    Eigen::Map<Eigen::Matrix3d>(matrix.blocks().data() + 9L * matrix.slot(i, i)).diagonal() *= factor;
  }
}
}  // namespace

TurnedInverse::TurnedInverse(const Model& model, int threads, Form form)
    : model_(model),
      partition_(model, threads),
      system_(model, partition_),
      inverse_(inverseOf(form, model, system_)),
      rotations_(COLUMNS * LANES * model.num_blocks),
      elements_begin_(model.num_nodes + 1),
      elements_(model.tets.size()),
      made_frames_(COLUMNS * model.num_nodes),
      frames_(FRAME * model.num_nodes),
      right_(4 * static_cast<std::size_t>(model.num_nodes)),
      left_(right_.size())
{
  std::vector<int> place(model.num_nodes);
  for (int k = 0; k < model.num_nodes; ++k) place[inverse_->order()[k]] = k;
  for (const int i : model.tets) ++elements_begin_[place[i] + 1];
  std::partial_sum(elements_begin_.begin(), elements_begin_.end(), elements_begin_.begin());
  std::vector<int> next(elements_begin_.begin(), elements_begin_.end() - 1);
  for (std::size_t k = 0; k < model.tets.size(); ++k)
  {
    elements_[next[place[model.tets[k]]]++] = static_cast<int>(k) / model.nodes_per_tet;
  }
}

bool TurnedInverse::make(const Rotations& rotations, const Rotations& frames, const HeldAxes& held, double alpha,
                         double beta)
{
  alpha_ = alpha;
  beta_ = beta;
  held_ = held;
  fewest_ = -1;
  excess_ = 0;
  takeRotations(frames);
  forEachNode([&](int k, const Columns& frame) { columnsAt(made_frames_.data() + COLUMNS * k) = frame; });
  turned_ = false;
  system_.assemble(rotations, alpha, beta);
  AssembledMatrix& matrix = system_.matrix();
  hold(held, matrix);
  // Where rounding makes a pivot negative (nearly incompressible bodies), a diagonal larger by about as much helps.
  double larger = 1;
  for (const double wanted : {1.0, 1 + 1e-6, 1 + 1e-5, 1 + 1e-4})
  {
    if (wanted > 1) scaleDiagonal(wanted / larger, matrix);
    larger = wanted;
    valid_ = inverse_->make(matrix, held, made_frames_.data());
    if (valid_) break;
  }
  return valid_;
}

void TurnedInverse::took(int iterations, double cost)
{
  if (fewest_ < 0) fewest_ = iterations;
  excess_ += std::max(0, iterations - fewest_);
  if (excess_ > cost) valid_ = false;
}

int TurnedInverse::patience(double cost) const
{
  if (fewest_ < 0) return std::numeric_limits<int>::max();
  return fewest_ + static_cast<int>(std::min(cost, 1e6)) - excess_ + 1;
}

/** @return  whether they are others than the last */
bool TurnedInverse::takeRotations(const Rotations& rotations)
{
  std::atomic<bool> others = false;
  forEachPiece(partition_, [&](int piece) {
    constexpr int ROW = 3 * LANES;
    Mask different = {};
    for (std::ptrdiff_t block = partition_.blockBegin(piece); block < partition_.blockEnd(piece); ++block)
    {
      const double* from = rotations.matrices.data() + block * rotations.points * 3 * ROW;
      float* to = rotations_.data() + block * LANES * COLUMNS;
      for (int lane = 0; lane < LANES; lane += 4, to += 4 * COLUMNS)
      {
        Node sum[9] = {};
        for (int q = 0; q < rotations.points; ++q)
        {
          for (int k = 0; k < 9; ++k)
          {
            using Doubles = double __attribute__((vector_size(32)));
            const auto* four = reinterpret_cast<const Doubles*>(from + (q * 9L + k) * LANES + lane);
            sum[k] += __builtin_convertvector(*four, Node);
          }
        }
        for (int column = 0; column < 3; ++column)
        {
          Node made[4];
          transpose(sum[column], sum[3 + column], sum[6 + column], made[0], made[1], made[2], made[3]);
          for (int k = 0; k < 4; ++k)
          {
            Node& last = *reinterpret_cast<Node*>(to + k * COLUMNS + 4L * column);
            different |= reinterpret_cast<Mask>(made[k]) ^ reinterpret_cast<Mask>(last);
            last = made[k];
          }
        }
      }
    }
    if ((different[0] | different[1] | different[2]) != 0) others = true;
  });
  return others;
}

/** Calls f(k, frame) with the mean rotation of each node's elements, nodes in the order of the inverse. */
template <class F>
void TurnedInverse::forEachNode(const F& f) const
{
  const int pieces = partition_.pieces();
  forEachPiece(partition_, [&](int piece) {
    for (int k = model_.num_nodes * piece / pieces; k < model_.num_nodes * (piece + 1) / pieces; ++k)
    {
      Columns sum = {};
      for (int e = elements_begin_[k]; e < elements_begin_[k + 1]; ++e)
      {
        const Columns& rotation = columnsAt(rotations_.data() + COLUMNS * elements_[e]);
        for (int column = 0; column < 3; ++column) sum.c[column] += rotation.c[column];
      }
      f(k, meanRotation(sum));
    }
  });
}

void TurnedInverse::turn(const Rotations& rotations)
{
  if (!takeRotations(rotations) && turned_) return;  // linear elasticity's never turn
  turned_ = true;
  forEachNode([&](int k, const Columns& frame) {
    Columns G = frame * transpose(columnsAt(made_frames_.data() + COLUMNS * k));
    const Mask& free = freeOf(held_[inverse_->order()[k]]);
    for (Node& column : G.c) column = only(free, column);
    columnsAt(frames_.data() + FRAME * k) = G;
    columnsAt(frames_.data() + FRAME * k + COLUMNS) = transpose(G);
  });
}

const float* TurnedInverse::solve(const Fill& fill)
{
  const int* order = inverse_->order().data();
  const auto read = [&](int begin, int end, float* b) {
    fill(order + begin, end - begin);
    const float* frame = frames_.data() + FRAME * begin + COLUMNS;
    for (int k = begin; k < end; ++k, frame += FRAME, b += 4)
    {
      const int i = order[k];
      *reinterpret_cast<Node*>(b) = columnsAt(frame) * only(freeOf(held_[i]), nodeAt(right_.data() + 4L * i));
    }
  };
  const auto write = [&](int begin, int end, const float* x) {
    const float* frame = frames_.data() + FRAME * begin;
    for (int k = begin; k < end; ++k, frame += FRAME, x += 4)
    {
      *reinterpret_cast<Node*>(left_.data() + 4L * order[k]) = columnsAt(frame) * nodeAt(x);
    }
  };
  // By reference, so that nothing is allocated.
  inverse_->solve(partition_.threads(), std::ref(read), std::ref(write));
  return left_.data();
}

void TurnedInverse::apply(const NodalField& r, NodalField& z)
{
  const auto fill = [&](const int* nodes, int count) {
    for (int k = 0; k < count; ++k) std::copy_n(r.data() + 4L * nodes[k], 3, right() + 4L * nodes[k]);
  };
  std::copy_n(solve(std::ref(fill)), 4L * z.size(), z.data());
}

}  // namespace bezier_fem
