#pragma once

#include <cstddef>

/** Loops that do nothing but arithmetic, or nothing but moving numbers, once for each instruction set (kernels.h). */
struct Peak
{
  const char* name;
  int flops_double, flops_single;  // of a round: multiplications and additions, one each of a fused one
  double (*rounds_double)(long rounds);
  float (*rounds_single)(long rounds);
  /** a = b + s c, whole cache lines of 8 numbers. */
  void (*triad)(std::size_t size, double s, const double* b, const double* c, double* a);
  /** The sum of an array, whole cache lines. */
  double (*read)(std::size_t size, const double* a);
};

/** By the name of a kernels::Table. */
const Peak& peakOf(const char* name);
