#pragma once

#include <vector>

#include "bezier_fem/model.h"
#include "bezier_fem/nodal_field.h"

namespace bezier_fem
{
/**
 * How a model's elements and nodes are shared among threads: contiguous ranges, one a thread. An element loop that adds
 * to nodes writes rows of its own: a node that an earlier thread's elements have too gets a ghost row after the last
 * node, and foldGhosts() adds those up in a fixed order. Results are therefore the same in every run with the same
 * number of threads.
 */
class Partition
{
public:
  Partition(const Model& model, int threads);

  int threads() const { return static_cast<int>(block_begin_.size()) - 1; }
  int blockBegin(int thread) const { return block_begin_[thread]; }
  int blockEnd(int thread) const { return block_begin_[thread + 1]; }
  int nodeBegin(int thread) const { return node_begin_[thread]; }
  int nodeEnd(int thread) const { return node_begin_[thread + 1]; }

  /** Rows of a field that element loops add to: nodes and ghosts. */
  int rows() const { return num_nodes_ + static_cast<int>(ghost_of_.size()); }
  /** [block][node][LANES], like Model::block_nodes with ghost rows in place of shared nodes. */
  const int* scatter() const { return scatter_.data(); }
  /** Adds every ghost row to its node; `stride` doubles a row. */
  void foldGhosts(double* field, int stride) const;

private:
  int num_nodes_;
  std::vector<int> block_begin_, node_begin_;  // threads + 1
  AlignedVector<int> scatter_;
  std::vector<int> ghost_of_;  // node of each ghost row
};

}  // namespace bezier_fem
