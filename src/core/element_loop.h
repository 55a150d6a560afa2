#pragma once

#include <algorithm>
#include <cstddef>

#include "bezier_fem/model.h"
#include "bezier_fem/partition.h"
#include "kernels.h"
#include "parallel.h"

namespace bezier_fem
{
inline const double* meanOf(const Model& model)
{
  return model.block_mean.empty() ? nullptr : model.block_mean.data();
}

/** @param points  rotations an element */
inline kernels::Elements elementsOf(const Model& model, int points)
{
  return {model.nodes_per_tet,
          points,
          model.block_offsets.data(),
          model.block_pairing.data(),
          model.block_coefficients.data(),
          meanOf(model)};
}

inline kernels::NodeShares sharesOf(const Model& model)
{
  return {model.share_begin.data(), model.share_slots.data()};
}

/** Runs loop(elements, begin, end, shares) on blocks of elements, then sums the shares up to out. */
template <class Loop>
void accumulate(const Model& model, const Partition& partition, int points, double* out, const Loop& loop)
{
  forEachPiece(partition, [&](int t) {
    loop(elementsOf(model, points), partition.blockBegin(t), partition.blockEnd(t),
         partition.shares() + kernels::ZERO_ROWS * kernels::SHARES);
  });
  forEachPiece(partition, [&](int t) {
    kernels::table().sum_shares(sharesOf(model), partition.nodeBegin(t), partition.nodeEnd(t), partition.shares(), out);
  });
}

/** The same of diagonal blocks, DIAGONAL_STRIDE doubles a node. */
template <class Loop>
void accumulateDiagonal(const Model& model, const Partition& partition, int points, double* out, const Loop& loop)
{
  forEachPiece(partition, [&](int t) {
    loop(elementsOf(model, points), partition.blockBegin(t), partition.blockEnd(t),
         partition.shares() + 2 * kernels::ZERO_ROWS * kernels::SHARES);
  });
  forEachPiece(partition, [&](int t) {
    kernels::table().sum_diagonals(sharesOf(model), partition.nodeBegin(t), partition.nodeEnd(t), partition.shares(),
                                   out);
  });
}

/** The same of shares in single precision, whose sums are multiplied by a factor. */
template <class Loop>
void accumulateSingleDiagonal(const Model& model, const Partition& partition, int points, double factor, double* out,
                              const Loop& loop)
{
  // In the memory of the others: what is warm in the caches stays so.
  auto* shares = reinterpret_cast<float*>(partition.shares());
  forEachPiece(partition, [&](int t) {
    loop(elementsOf(model, points), partition.blockBegin(t), partition.blockEnd(t),
         shares + 2 * kernels::ZERO_ROWS * kernels::SHARES);
  });
  forEachPiece(partition, [&](int t) {
    kernels::table().sum_single_diagonals(sharesOf(model), partition.nodeBegin(t), partition.nodeEnd(t), shares, factor,
                                          out);
  });
}

}  // namespace bezier_fem
