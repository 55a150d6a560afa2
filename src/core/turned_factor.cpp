#include "turned_factor.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>

namespace bezier_fem
{
namespace
{
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
      frames_(factored_frames_.size()),
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
  meanRotations(rotations, frames_);
  for (std::size_t i = 0; i < frames_.size(); i += 9)
  {
    Eigen::Map<Eigen::Matrix3f> frame(frames_.data() + i);
    frame = (frame * Eigen::Map<const Eigen::Matrix3f>(factored_frames_.data() + i).transpose()).eval();
  }
}

void TurnedFactor::clearHeld(float* field) const
{
  for (std::size_t i = 0; i < held_.size(); ++i)
  {
    for (int axis = 0; held_[i] != 0 && axis < 3; ++axis)
    {
      if (held_[i] >> axis & 1) field[4 * i + axis] = 0;
    }
  }
}

const float* TurnedFactor::solve()
{
  clearHeld(right_.data());
  for (std::size_t i = 0; i < held_.size(); ++i)
  {
    Eigen::Map<Eigen::Vector3f> v(right_.data() + 4 * i);
    v = (Eigen::Map<const Eigen::Matrix3f>(frames_.data() + 9 * i).transpose() * v).eval();
  }
  cholesky_.solve(right_.data(), left_.data());
  for (std::size_t i = 0; i < held_.size(); ++i)
  {
    Eigen::Map<Eigen::Vector3f> v(left_.data() + 4 * i);
    v = (Eigen::Map<const Eigen::Matrix3f>(frames_.data() + 9 * i) * v).eval();
  }
  clearHeld(left_.data());
  return left_.data();
}

}  // namespace bezier_fem
