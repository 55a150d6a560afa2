#include "parallel.h"

#include <array>
#include <atomic>
#include <condition_variable>
#include <mutex>
#include <thread>

namespace bezier_fem
{
namespace
{
/** Hints that this is a loop that waits. */
void pause()
{
#if defined(__x86_64__) || defined(__i386__)
  __builtin_ia32_pause();
#endif
}

/**
 * Threads that wait for work. Pieces are claimed one by one, and whoever has called works on them too: so a thread that
 * another program keeps from its core is waited for only where it has begun a piece.
 */
class Team
{
public:
  ~Team()
  {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      stop_ = true;
    }
    wake_.notify_all();
    for (std::thread& thread : threads_) thread.join();
  }

  void run(int threads, int pieces, void (*work)(const void*, int), const void* data)
  {
    const std::unique_lock<std::mutex> lock(busy_, std::try_to_lock);
    if (!lock)
    {
      // Another body's step has the team.
      for (int piece = 0; piece < pieces; ++piece) work(data, piece);
      return;
    }
    while (static_cast<int>(threads_.size()) < threads - 1) threads_.emplace_back([this] { serve(); });
    const auto number = static_cast<std::uint32_t>(claimed_.load(std::memory_order_relaxed) >> 32) + 1;
    Job& job = jobs_[number % 2];
    job.work.store(work, std::memory_order_relaxed);
    job.data.store(data, std::memory_order_relaxed);
    job.pieces.store(pieces, std::memory_order_relaxed);
    done_.store(0, std::memory_order_relaxed);
    // The first piece is the caller's.
    claimed_.store(std::uint64_t{number} << 32 | FROM_FRONT);
    if (asleep_.load() > 0)
    {
      const std::lock_guard<std::mutex> sleepers(mutex_);
      wake_.notify_all();
    }
    work(data, 0);
    const int by_others = pieces - 1 - help(number, FROM_FRONT);
    for (int spins = 0; done_.load(std::memory_order_acquire) < by_others; ++spins)
    {
      spins < SPINS ? pause() : std::this_thread::yield();
    }
  }

private:
  static constexpr int SPINS = 1000, YIELDS = 1000;
  static constexpr std::uint64_t FROM_FRONT = 1, FROM_BACK = 1 << 16;
  static constexpr std::size_t LINE = 64;  // bytes of a cache line, which travels between cores as a whole

  struct Job
  {
    std::atomic<void (*)(const void*, int)> work = nullptr;
    std::atomic<const void*> data = nullptr;
    std::atomic<int> pieces = 0;
  };

  /**
   * Works on pieces of the job until all are claimed, or until another job has begun; returns on how many. Who has
   * called takes them from the front and the others from the back, so that much of what one loop leaves in a core's
   * cache is there for the next.
   */
  int help(std::uint64_t number, std::uint64_t end)
  {
    int count = 0;
    std::uint64_t claimed = claimed_.load();
    while (claimed >> 32 == number)
    {
      // What belongs to the job is read before the claim, which fails if it was already that of the one after next.
      const Job& job = jobs_[number % 2];
      const auto work = job.work.load(std::memory_order_relaxed);
      const void* data = job.data.load(std::memory_order_relaxed);
      const int pieces = job.pieces.load(std::memory_order_relaxed);
      const auto front = static_cast<int>(claimed & 0xffff), back = static_cast<int>(claimed >> 16 & 0xffff);
      if (front + back >= pieces) break;
      if (!claimed_.compare_exchange_weak(claimed, claimed + end)) continue;
      work(data, end == FROM_FRONT ? front : pieces - 1 - back);
      ++count;
      if (end == FROM_BACK) done_.fetch_add(1, std::memory_order_release);
      claimed = claimed_.load();
    }
    return count;
  }

  void serve()
  {
    std::uint64_t last = 0;
    while (true)
    {
      std::uint64_t job = claimed_.load() >> 32;
      for (int spins = 0; job == last && spins < SPINS + YIELDS; ++spins)
      {
        spins < SPINS ? pause() : std::this_thread::yield();
        job = claimed_.load() >> 32;
      }
      if (job == last)
      {
        std::unique_lock<std::mutex> lock(mutex_);
        asleep_.fetch_add(1);
        wake_.wait(lock, [&] { return stop_ || claimed_.load() >> 32 != last; });
        asleep_.fetch_sub(1);
        if (stop_) return;
        continue;
      }
      last = job;
      help(job, FROM_BACK);
    }
  }

  std::mutex busy_;
  std::vector<std::thread> threads_;
  // 32 bits the number of the job, 16 each claimed from the back and front; beside it this job and the one before
  alignas(LINE) std::atomic<std::uint64_t> claimed_ = 0;
  std::array<Job, 2> jobs_;
  alignas(LINE) std::atomic<int> done_ = 0;  // pieces, by others than the caller

  alignas(LINE) std::mutex mutex_;
  std::condition_variable wake_;
  std::atomic<int> asleep_ = 0;
  bool stop_ = false;
};
}  // namespace

void runPieces(int threads, int pieces, void (*work)(const void*, int), const void* data)
{
  static Team team;
  team.run(threads, pieces, work, data);
}

}  // namespace bezier_fem
