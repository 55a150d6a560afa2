// The loops of peak.h for registers of WIDTH doubles. Included by one .cpp an instruction set, which defines WIDTH,
// PEAK and PEAK_NAME.
#include "peak.h"

namespace
{
/** Sums that do not wait for each other: more than the latency of an operation times those that start in a cycle. */
constexpr int SUMS = 12;

using Vec = double __attribute__((vector_size(sizeof(double) * WIDTH)));
using SingleVec = float __attribute__((vector_size(sizeof(double) * WIDTH)));

template <class V, class T>
T multiplyAdd(long rounds)
{
  V sums[SUMS];
  for (int k = 0; k < SUMS; ++k) sums[k] = V{} + static_cast<T>(k);
  const V factor = V{} + static_cast<T>(0.5), term = V{} + static_cast<T>(1);
  for (long round = 0; round < rounds; ++round)
  {
    for (V& sum : sums) sum = sum * factor + term;
  }
  V total{};
  for (const V& sum : sums) total += sum;
  return total[0];
}

void triad(std::size_t size, double s, const double* b, const double* c, double* a)
{
  for (std::size_t i = 0; i < size; i += 8)
  {
    for (std::size_t k = i; k < i + 8; k += WIDTH)
    {
      *reinterpret_cast<Vec*>(a + k) = *reinterpret_cast<const Vec*>(b + k) + s * *reinterpret_cast<const Vec*>(c + k);
    }
  }
}

/** A sum of all; size is a multiple of 8. */
double read(std::size_t size, const double* a)
{
  constexpr std::size_t ROUND = 8 * WIDTH;
  Vec sums[8] = {};
  std::size_t i = 0;
  for (; i + ROUND <= size; i += ROUND)
  {
    for (int k = 0; k < 8; ++k) sums[k] += *reinterpret_cast<const Vec*>(a + i + WIDTH * k);
  }
  for (; i < size; i += WIDTH) sums[0] += *reinterpret_cast<const Vec*>(a + i);
  Vec total{};
  for (const Vec& sum : sums) total += sum;
  double all = 0;
  for (int k = 0; k < WIDTH; ++k) all += total[k];
  return all;
}
}  // namespace

extern const Peak PEAK;
const Peak PEAK = {
    PEAK_NAME, 2 * SUMS* WIDTH, 4 * SUMS* WIDTH, multiplyAdd<Vec, double>, multiplyAdd<SingleVec, float>, triad, read};
