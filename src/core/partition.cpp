#include "bezier_fem/partition.h"

#include <algorithm>

namespace bezier_fem
{
Partition::Partition(const Model& model, int threads) : num_nodes_(model.num_nodes), scatter_(model.block_nodes)
{
  threads = std::clamp(threads, 1, model.num_blocks);
  for (int t = 0; t <= threads; ++t)
  {
    block_begin_.push_back(static_cast<int>(static_cast<long>(model.num_blocks) * t / threads));
    // Whole cache lines (two nodes), so that no two threads write to one.
    node_begin_.push_back(t == threads ? model.num_nodes
                                       : static_cast<int>(static_cast<long>(model.num_nodes) * t / threads) & ~1);
  }
  std::vector<int> owner(model.num_nodes, -1), row(model.num_nodes, -1);
  for (int t = 0; t < threads; ++t)
  {
    const std::size_t per_block = static_cast<std::size_t>(model.nodes_per_tet) * LANES;
    std::vector<int> shared;
    for (std::size_t k = block_begin_[t] * per_block; k < block_begin_[t + 1] * per_block; ++k)
    {
      const int node = scatter_[k];
      if (owner[node] < 0) owner[node] = t;
      if (owner[node] == t) continue;
      if (row[node] < 0)
      {
        row[node] = rows();
        ghost_of_.push_back(node);
        shared.push_back(node);
      }
      scatter_[k] = row[node];
    }
    for (const int node : shared) row[node] = -1;
  }
}

void Partition::foldGhosts(double* field, int stride) const
{
  for (std::size_t g = 0; g < ghost_of_.size(); ++g)
  {
    const double* from = field + static_cast<std::ptrdiff_t>(stride) * (num_nodes_ + static_cast<int>(g));
    double* to = field + static_cast<std::ptrdiff_t>(stride) * ghost_of_[g];
    for (int k = 0; k < stride; ++k) to[k] += from[k];
  }
}

}  // namespace bezier_fem
