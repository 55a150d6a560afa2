#pragma once

#include <numeric>
#include <vector>

#include "bezier_fem/partition.h"

namespace bezier_fem
{
/** Calls f(thread) for every thread of the partition, at the same time where there are several. */
template <class F>
void forEachThread(const Partition& partition, const F& f)
{
  const int threads = partition.threads();
  if (threads == 1)
  {
    f(0);
    return;
  }
#pragma omp parallel for schedule(static, 1) num_threads(threads)
  for (int t = 0; t < threads; ++t) f(t);
}

/**
 * The sum of f(begin, end) over chunks of nodes, in an order that does not depend on the threads.
 * @param partial  scratch, a number a chunk
 */
template <class F>
double sumOverNodes(const Partition& partition, std::vector<double>& partial, const F& f)
{
  forEachThread(partition, [&](int t) {
    for (int chunk = partition.chunkBegin(t); chunk < partition.chunkEnd(t); ++chunk)
    {
      partial[chunk] = f(partition.firstOf(chunk), partition.firstOf(chunk + 1));
    }
  });
  return std::accumulate(partial.begin(), partial.end(), 0.0);
}

}  // namespace bezier_fem
