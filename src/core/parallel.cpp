#include "parallel.h"

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
    // A number in between, of which nothing can be claimed: a claim of the job before fails from here on, also of one
    // who has seen it with all pieces claimed, and now sees how many there are of this one.
    const auto before = static_cast<std::uint32_t>(claimed_.load(std::memory_order_relaxed) >> 32);
    const std::uint32_t between = before + 1, job = before + 2;
    claimed_.store(std::uint64_t{between} << 32 | NONE);
    work_.store(work, std::memory_order_release);
    data_.store(data, std::memory_order_release);
    pieces_.store(pieces, std::memory_order_release);
    done_.store(0, std::memory_order_relaxed);
    claimed_.store(std::uint64_t{job} << 32);
    if (asleep_.load() > 0)
    {
      const std::lock_guard<std::mutex> sleepers(mutex_);
      wake_.notify_all();
    }
    help(job, FROM_FRONT);
    for (int spins = 0; done_.load(std::memory_order_acquire) < pieces; ++spins)
    {
      spins < SPINS ? pause() : std::this_thread::yield();
    }
  }

private:
  static constexpr int SPINS = 1000, YIELDS = 1000;
  static constexpr std::uint64_t FROM_FRONT = 1, FROM_BACK = 1 << 16;
  static constexpr std::uint64_t NONE = 0xffffffff;  // more than any job has

  /**
   * Works on pieces of the job until all are claimed, or until another job has begun. Who has called takes them from
   * the front and the others from the back, so that much of what one loop leaves in a core's cache is there for the
   * next.
   */
  void help(std::uint64_t job, std::uint64_t end)
  {
    std::uint64_t claimed = claimed_.load();
    while (claimed >> 32 == job)
    {
      // What belongs to the job is read before the claim, which fails if it was the next one's.
      const auto work = work_.load(std::memory_order_acquire);
      const void* data = data_.load(std::memory_order_acquire);
      const int pieces = pieces_.load(std::memory_order_acquire);
      const auto front = static_cast<int>(claimed & 0xffff), back = static_cast<int>(claimed >> 16 & 0xffff);
      if (front + back >= pieces) return;
      if (!claimed_.compare_exchange_weak(claimed, claimed + end)) continue;
      const int piece = end == FROM_FRONT ? front : pieces - 1 - back;
      work(data, piece);
      done_.fetch_add(1, std::memory_order_release);
      claimed = claimed_.load();
    }
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
  std::atomic<std::uint64_t> claimed_ = 0;  // 32 bits the number of the job, 16 each claimed from the back and front
  std::atomic<void (*)(const void*, int)> work_ = nullptr;
  std::atomic<const void*> data_ = nullptr;
  std::atomic<int> pieces_ = 0, done_ = 0;

  std::mutex mutex_;
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
