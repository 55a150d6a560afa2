#pragma once

#include <algorithm>
#include <chrono>
#include <cmath>
#include <stdexcept>
#include <vector>

#include "bezier_fem/assembled_matrix.h"
#include "plain_product.h"

inline double milliseconds()
{
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

inline double median(std::vector<double> values)
{
  std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2), values.end());
  return values[values.size() / 2];
}

/**
 * Runs before the one that is timed. The outer caches of current processors take in what streams through them only
 * after several times.
 */
constexpr int WARM_UPS = 5;

/**
 * What everything is measured against: one product of an assembled matrix with a vector, double precision, one thread,
 * the faster of two plain ways to write it.
 */
class Yardstick
{
public:
  explicit Yardstick(const bezier_fem::AssembledMatrix& A)
      : A_(A),
        rows_(9 * A.column().size()),
        columns_(12 * A.column().size()),
        x_(3L * A.rows()),
        y_(3L * A.rows()),
        u_(A.rows()),
        v_(A.rows())
  {
    for (std::size_t b = 0; b < A.column().size(); ++b)
    {
      for (int k = 0; k < 9; ++k)
      {
        const double value = A.blocks()[9 * b + k];
        rows_[9 * b + 3 * (k % 3) + k / 3] = value;
        columns_[12 * b + 4 * (k / 3) + k % 3] = value;
      }
    }
    for (int i = 0; i < 3 * A.rows(); ++i) x_[i] = u_[i / 3][i % 3] = std::sin(i);
  }

  /** Measures once more: the last of a few products in a row. */
  void measure()
  {
    for (std::vector<double>* times : {&plain_, &padded_})
    {
      double start = 0;
      for (int k = 0; k <= WARM_UPS; ++k)
      {
        start = milliseconds();
        if (times == &plain_)
        {
          plainProduct(A_.rows(), A_.rowBegin().data(), A_.column().data(), rows_.data(), x_.data(), y_.data());
        }
        else
        {
          paddedProduct(A_.rows(), A_.rowBegin().data(), A_.column().data(), columns_.data(), u_.data(), v_.data());
        }
      }
      times->push_back(milliseconds() - start);
    }
  }
  double ms() const { return std::min(median(plain_), median(padded_)); }

  const bezier_fem::NodalField& x() const { return u_; }
  /** @throws std::runtime_error unless A x is what the yardstick had */
  void compare(const bezier_fem::NodalField& product) const
  {
    double apart = 0, largest = 0;
    for (int i = 0; i < 3 * A_.rows(); ++i)
    {
      const double value = product[i / 3][i % 3];
      apart = std::max({apart, std::abs(value - y_[i]), std::abs(value - v_[i / 3][i % 3])});
      largest = std::max(largest, std::abs(value));
    }
    if (!(apart <= 1e-9 * largest)) throw std::runtime_error("the products disagree");
  }

private:
  const bezier_fem::AssembledMatrix& A_;
  bezier_fem::AlignedVector<double> rows_, columns_;  // blocks of 9 by rows, and of 12: columns x, y, z, 0
  std::vector<double> x_, y_;
  bezier_fem::NodalField u_, v_;
  std::vector<double> plain_, padded_;
};
