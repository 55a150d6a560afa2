#include "bezier_fem/partition.h"

#include <algorithm>

#include "kernels.h"

namespace bezier_fem
{
Partition::Partition(const Model& model, int threads)
    : num_nodes_(model.num_nodes), threads_(std::clamp(threads, 1, model.num_blocks))
{
  static_assert(CHUNK % kernels::NODE_GROUP == 0, "chunks are whole groups");
  constexpr int PIECES = 4;  // of a thread
  const int pieces = threads_ == 1 ? 1 : std::min(PIECES * threads_, model.num_blocks);
  for (int t = 0; t <= pieces; ++t)
  {
    block_begin_.push_back(static_cast<int>(static_cast<long>(model.num_blocks) * t / pieces));
    chunk_begin_.push_back(static_cast<int>(static_cast<long>(numChunks()) * t / pieces));
  }
  // Diagonals have two rows a node.
  shares_.resize(2 * kernels::SHARES *
                 (kernels::ZERO_ROWS + static_cast<std::size_t>(model.num_blocks) * model.nodes_per_tet));
}

}  // namespace bezier_fem
