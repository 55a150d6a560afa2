#pragma once

#include <algorithm>
#include <vector>

#include "bezier_fem/model.h"
#include "bezier_fem/nodal_field.h"

namespace bezier_fem
{
/**
 * How a model's elements and nodes are shared among threads: contiguous ranges, of larger bodies several a thread, so
 * that one that is held up does not hold up the others. No pair of blocks is divided, and of small bodies a range may
 * have no blocks. Nodes come in chunks, of which a range may have none, and sums over nodes are made chunk by chunk, so
 * that they are the same for any number of threads. What elements add to nodes goes to the memory here, from where it
 * is summed up node by node: one user at a time.
 */
class Partition
{
public:
  Partition(const Model& model, int threads);

  /** Nodes of a chunk: whole cache lines of any field, so that no two threads write to one. */
  static constexpr int CHUNK = 64;

  int threads() const { return threads_; }
  int pieces() const { return static_cast<int>(block_begin_.size()) - 1; }
  int blockBegin(int piece) const { return block_begin_[piece]; }
  int blockEnd(int piece) const { return block_begin_[piece + 1]; }
  int nodeBegin(int piece) const { return firstOf(chunk_begin_[piece]); }
  int nodeEnd(int piece) const { return firstOf(chunk_begin_[piece + 1]); }

  int numChunks() const { return (num_nodes_ + CHUNK - 1) / CHUNK; }
  int chunkBegin(int piece) const { return chunk_begin_[piece]; }
  int chunkEnd(int piece) const { return chunk_begin_[piece + 1]; }
  /** First node of a chunk, or the number of nodes. */
  int firstOf(int chunk) const { return std::min(num_nodes_, chunk * CHUNK); }

  /** Zeros, then room for the shares of all elements (kernels.h). */
  double* shares() const { return shares_.data(); }

private:
  int num_nodes_, threads_;
  std::vector<int> block_begin_, chunk_begin_;  // pieces + 1
  mutable AlignedVector<double> shares_;
};

}  // namespace bezier_fem
