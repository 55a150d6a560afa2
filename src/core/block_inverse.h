#pragma once

#include <functional>
#include <vector>

#include "bezier_fem/assembled_matrix.h"
#include "bezier_fem/preconditioner.h"

namespace bezier_fem
{
/** An inverse, or an approximate one, of a symmetric positive definite matrix of 3x3 blocks, in single precision. */
class BlockInverse
{
public:
  virtual ~BlockInverse() = default;

  /**
   * @param matrix  of one pattern; rows and columns of what is held are those of the unit matrix
   * @param frames  rotation since rest of each node, in order(): 3 columns of 4 floats, of which the last is not used
   * @return        false if it is not positive definite, as far as single precision can tell
   */
  virtual bool make(const AssembledMatrix& matrix, const HeldAxes& held, const float* frames) = 0;

  /** Of rows [begin, end) in the order of this class, order()[k] of the matrix: x, y, z and a float not looked at. */
  using Read = std::function<void(int begin, int end, float* b)>;
  using Write = std::function<void(int begin, int end, const float* x)>;
  /** x = about A^-1 b by several threads, the same whatever their number: `read` fills in b, `write` is given x. */
  virtual void solve(int threads, const Read& read, const Write& write) = 0;
  virtual const std::vector<int>& order() const = 0;

  /** What make() and solve() take on one core of 2.6 GHz, about, in s: counted, so that a run repeats to the bit. */
  virtual double makingTime() const = 0;
  virtual double solvingTime() const = 0;
};

}  // namespace bezier_fem
