#pragma once

#include <numeric>
#include <vector>

#include "bezier_fem/partition.h"

namespace bezier_fem
{
/** work(data, piece) for every piece, of which there is at least one, by several threads that claim them. */
void runPieces(int threads, int pieces, void (*work)(const void*, int), const void* data);

/** Calls f(piece) for every piece, at the same time where there are several threads. */
template <class F>
void forEachPiece(int threads, int pieces, const F& f)
{
  if (threads == 1 || pieces <= 1)
  {
    for (int piece = 0; piece < pieces; ++piece) f(piece);
    return;
  }
  runPieces(
      threads, pieces, [](const void* data, int piece) { (*static_cast<const F*>(data))(piece); }, &f);
}

/** The same for every piece of the partition. */
template <class F>
void forEachPiece(const Partition& partition, const F& f)
{
  forEachPiece(partition.threads(), partition.pieces(), f);
}

/** Calls f(first, count) for every chunk of nodes, at the same time where there are several threads. */
template <class F>
void forEachChunk(const Partition& partition, const F& f)
{
  forEachPiece(partition, [&](int t) {
    for (int chunk = partition.chunkBegin(t); chunk < partition.chunkEnd(t); ++chunk)
    {
      f(partition.firstOf(chunk), partition.firstOf(chunk + 1) - partition.firstOf(chunk));
    }
  });
}

/**
 * The sum of f(begin, end) over chunks of nodes, in an order that does not depend on the threads.
 * @param partial  scratch, a number a chunk
 */
template <class F>
double sumOverNodes(const Partition& partition, std::vector<double>& partial, const F& f)
{
  forEachPiece(partition, [&](int t) {
    for (int chunk = partition.chunkBegin(t); chunk < partition.chunkEnd(t); ++chunk)
    {
      partial[chunk] = f(partition.firstOf(chunk), partition.firstOf(chunk + 1));
    }
  });
  return std::accumulate(partial.begin(), partial.end(), 0.0);
}

}  // namespace bezier_fem
