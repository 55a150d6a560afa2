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
inline kernels::Elements elementsOf(const Model& model, const Partition& partition, int points)
{
  return {model.nodes_per_tet, points, model.block_nodes.data(), partition.scatter(), model.block_coefficients.data(),
          meanOf(model)};
}

/** Clears partition.rows() rows of `stride` doubles, runs loop(elements, begin, end) on blocks, adds the ghosts. */
template <class Loop>
void accumulate(const Model& model, const Partition& partition, int points, double* out, int stride, const Loop& loop)
{
  std::fill_n(out, static_cast<std::ptrdiff_t>(stride) * partition.rows(), 0.0);
  forEachThread(partition, [&](int t) {
    loop(elementsOf(model, partition, points), partition.blockBegin(t), partition.blockEnd(t));
  });
  partition.foldGhosts(out, stride);
}

}  // namespace bezier_fem
