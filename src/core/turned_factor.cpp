#include "turned_factor.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>

namespace bezier_fem
{
namespace
{
/** Four floats in a register, by GCC's and Clang's vector extensions. */
using Node = float __attribute__((vector_size(16)));
using Mask = std::int32_t __attribute__((vector_size(16)));

/** Floats of a node's G and G^T. */
constexpr std::ptrdiff_t FRAME = 24;

const Node& nodeAt(const float* p)
{
  return *reinterpret_cast<const Node*>(p);
}

/** Columns times v. */
Node times(const float* columns, float x, float y, float z)
{
  return x * nodeAt(columns) + y * nodeAt(columns + 4) + z * nodeAt(columns + 8);
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

void scaleDiagonal(double factor, AssembledMatrix& matrix)
{
  for (int i = 0; i < matrix.rows(); ++i)
  {
    Eigen::Map<Eigen::Matrix3d>(matrix.blocks().data() + 9L * matrix.slot(i, i)).diagonal() *= factor;
  }
}
}  // namespace

TurnedFactor::TurnedFactor(const Model& model)
    : model_(model),
      partition_(model, 1),
      system_(model, partition_),
      cholesky_(system_.matrix(), model.rest),
      factored_frames_(9 * static_cast<std::size_t>(model.num_nodes)),
      present_frames_(factored_frames_.size()),
      frames_(FRAME * model.num_nodes),
      right_(4 * static_cast<std::size_t>(model.num_nodes)),
      left_(right_.size())
{
}

bool TurnedFactor::factor(const Rotations& rotations, const Rotations& frames, const HeldAxes& held, double alpha,
                          double beta)
{
  alpha_ = alpha;
  beta_ = beta;
  held_ = held;
  fewest_ = -1;
  excess_ = 0;
  meanRotations(frames, factored_frames_);
  turned_to_.clear();
  system_.assemble(rotations, alpha, beta);
  AssembledMatrix& matrix = system_.matrix();
  hold(held, matrix);
  // Where rounding makes a pivot negative (nearly incompressible bodies), a diagonal larger by about as much helps.
  double larger = 1;
  for (const double wanted : {1.0, 1 + 1e-6, 1 + 1e-5, 1 + 1e-4})
  {
    if (wanted > 1) scaleDiagonal(wanted / larger, matrix);
    larger = wanted;
    valid_ = cholesky_.factor(matrix);
    if (valid_) break;
  }
  return valid_;
}

void TurnedFactor::took(int iterations, double cost)
{
  if (fewest_ < 0) fewest_ = iterations;
  excess_ += std::max(0, iterations - fewest_);
  if (excess_ > cost) valid_ = false;
}

int TurnedFactor::patience(double cost) const
{
  if (fewest_ < 0) return std::numeric_limits<int>::max();
  return fewest_ + static_cast<int>(std::min(cost, 1e6)) - excess_ + 1;
}

void TurnedFactor::meanRotations(const Rotations& rotations, AlignedVector<float>& frames) const
{
  std::fill(frames.begin(), frames.end(), 0.0f);
  for (int t = 0; t < model_.num_tets; ++t)
  {
    Eigen::Matrix3f sum = rotations.matrix(t).cast<float>();
    for (int q = 1; q < rotations.points; ++q) sum += rotations.matrix(t, q).cast<float>();
    for (int k = 0; k < model_.nodes_per_tet; ++k)
    {
      Eigen::Map<Eigen::Matrix3f>(frames.data() + 9L * model_.nodesOf(t)[k]) += sum;
    }
  }
  for (std::size_t i = 0; i < frames.size(); i += 9)
  {
    Eigen::Map<Eigen::Matrix3f> frame(frames.data() + i);
    const float size = frame.squaredNorm();
    if (!(size > 0)) continue;
    // Towards the nearest rotation (Newton and Schulz): near enough, as any regular frame will do. The mean of very
    // different rotations needs more care.
    const Eigen::Matrix3f mean = std::sqrt(3 / size) * frame;
    frame = mean;
    for (int k = 0; k < 2; ++k) frame = (1.5f * frame - 0.5f * frame * (frame.transpose() * frame)).eval();
    if (!frame.isUnitary(0.1f)) frame = polarRotation(mean.cast<double>(), Eigen::Matrix3d::Identity()).cast<float>();
  }
}

void TurnedFactor::turn(const Rotations& rotations)
{
  if (rotations.matrices == turned_to_) return;  // linear elasticity's never turn
  turned_to_ = rotations.matrices;
  meanRotations(rotations, present_frames_);
  takeFrames(present_frames_);
}

void TurnedFactor::takeFrames(const AlignedVector<float>& present)
{
  const std::vector<int>& order = cholesky_.order();
  for (std::size_t k = 0; k < order.size(); ++k)
  {
    const int i = order[k];
    Eigen::Matrix3f G = Eigen::Map<const Eigen::Matrix3f>(present.data() + 9L * i) *
                        Eigen::Map<const Eigen::Matrix3f>(factored_frames_.data() + 9L * i).transpose();
    for (int axis = 0; axis < 3; ++axis)
    {
      if (held_[i] >> axis & 1) G.row(axis).setZero();
    }
    Eigen::Map<Eigen::Matrix<float, 4, 6>> frame(frames_.data() + FRAME * static_cast<std::ptrdiff_t>(k));
    frame.setZero();
    frame.topLeftCorner<3, 3>() = G;
    frame.topRightCorner<3, 3>() = G.transpose();
  }
}

const float* TurnedFactor::solve()
{
  // What is held may be no number there, which a zero in G does not stop.
  alignas(16) static constexpr std::int32_t FREE[8][4] = {{-1, -1, -1}, {0, -1, -1}, {-1, 0, -1}, {0, 0, -1},
                                                          {-1, -1, 0},  {0, -1, 0},  {-1, 0, 0},  {}};
  const int* order = cholesky_.order().data();
  cholesky_.solve(
      [&](int begin, int end, float* b) {
        const float* frame = frames_.data() + FRAME * begin;
        for (int k = begin; k < end; ++k, frame += FRAME, b += 3)
        {
          const Mask free = *reinterpret_cast<const Mask*>(FREE[held_[order[k]]]);
          const Node v = reinterpret_cast<Node>(reinterpret_cast<Mask>(nodeAt(right_.data() + 4L * order[k])) & free);
          const Node turned = times(frame + FRAME / 2, v[0], v[1], v[2]);
          std::memcpy(b, &turned, 3 * sizeof(float));
        }
      },
      [&](int begin, int end, const float* x) {
        const float* frame = frames_.data() + FRAME * begin;
        for (int k = begin; k < end; ++k, frame += FRAME, x += 3)
        {
          *reinterpret_cast<Node*>(left_.data() + 4L * order[k]) = times(frame, x[0], x[1], x[2]);
        }
      });
  return left_.data();
}

}  // namespace bezier_fem
