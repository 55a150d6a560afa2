#pragma once

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

}  // namespace bezier_fem
