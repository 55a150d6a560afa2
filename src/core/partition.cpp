#include "bezier_fem/partition.h"

#include <algorithm>

#include "kernels.h"

namespace bezier_fem
{
Partition::Partition(const Model& model, int threads)
    : num_nodes_(model.num_nodes), threads_(std::clamp(threads, 1, model.num_blocks))
{
  constexpr int GROUP = kernels::NODE_GROUP;
  static_assert(CHUNK % GROUP == 0, "chunks are whole groups");
  constexpr int PIECES = 4;     // of a thread
  constexpr int SMALLEST = 24;  // blocks of a piece, if threads have more than one: less takes as long as claiming it
  const int pieces = threads_ == 1 ? 1 : std::clamp(model.num_blocks / SMALLEST, threads_, PIECES * threads_);
  // Nodes are numbered near their elements: as many shares as a piece's elements have belong to about its nodes.
  const auto steps = [&](int chunk) { return model.share_begin[(firstOf(chunk) + GROUP - 1) / GROUP]; };
  int chunk = 0;
  for (int t = 0; t <= pieces; ++t)
  {
    int block = static_cast<int>(static_cast<long>(model.num_blocks) * t / pieces);
    if (block < model.num_blocks && model.block_pairing[block] == kernels::SECOND) ++block;
    block_begin_.push_back(block);
    const double wanted = static_cast<double>(steps(numChunks())) * t / pieces;
    while (chunk < numChunks() && (steps(chunk) + steps(chunk + 1)) / 2.0 < wanted) ++chunk;
    chunk_begin_.push_back(t == pieces ? numChunks() : chunk);
  }
  // Diagonals have two rows a node.
  shares_.resize(2 * kernels::SHARES *
                 (kernels::ZERO_ROWS + static_cast<std::size_t>(model.num_blocks) * model.nodes_per_tet));
}

}  // namespace bezier_fem
