#include "parallel.h"

#include <gtest/gtest.h>

#include <array>
#include <atomic>
#include <thread>

namespace bezier_fem
{
namespace
{
/** Jobs of changing numbers of pieces, each of which is to be worked on once, before the job returns. */
void runJobs(int jobs, int threads)
{
  constexpr int MOST = 16;
  struct Job
  {
    std::array<std::atomic<int>, MOST> visits{};
    std::atomic<bool> open = true;
    std::atomic<bool> late = false;
  };
  for (int k = 0; k < jobs; ++k)
  {
    Job job;
    const int pieces = 1 + 5 * k % MOST;
    runPieces(
        threads, pieces,
        [](const void* data, int piece) {
          auto& own = *static_cast<Job*>(const_cast<void*>(data));
          if (!own.open) own.late = true;
          ++own.visits[piece];
        },
        &job);
    job.open = false;
    for (int piece = 0; piece < MOST; ++piece)
    {
      ASSERT_EQ(job.visits[piece], piece < pieces ? 1 : 0) << "job " << k << ", piece " << piece << " of " << pieces;
    }
    ASSERT_FALSE(job.late);
  }
}

TEST(Pieces, AreWorkedOnOnceEach)
{
  for (const int threads : {2, 3, 5}) runJobs(100000, threads);
}

TEST(Pieces, OfSeveralCallersAtATimeAreWorkedOnOnceEach)
{
  std::thread other([] { runJobs(50000, 3); });
  runJobs(50000, 2);
  other.join();
}

TEST(Pieces, AreWorkedOnAfterTheThreadsHaveFallenAsleep)
{
  for (int k = 0; k < 20; ++k)
  {
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
    runJobs(3, 3);
  }
}

}  // namespace
}  // namespace bezier_fem
