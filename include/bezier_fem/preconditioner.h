#pragma once

#include <cstdint>
#include <vector>

#include "bezier_fem/system_operator.h"

namespace bezier_fem
{
/** Which components of which nodes are held: bit 0, 1, 2 for x, y, z of each node. */
using HeldAxes = std::vector<std::uint8_t>;

/**
 * An approximate inverse of alpha M + beta K' on the components that are not held, for ConjugateGradient: symmetric and
 * positive definite. What is expensive in it is made for one system and serves the next ones for as long as it can.
 */
class Preconditioner
{
public:
  virtual ~Preconditioner() = default;

  /**
   * Sets the system. What was made for other values of alpha and beta or other held axes,
   * or before forget(), is made anew.
   * @param inverse  inverses of the diagonal blocks, zero where held: ConjugateGradient::inverse()
   * @return         false where the system is too ill-conditioned for single precision
   */
  virtual bool prepare(const Model& model, const Rotations& rotations, const HeldAxes& held, double alpha, double beta,
                       const AlignedVector<double>& inverse) = 0;

  /** To be called when the model's materials have changed, or when the next rotations will be far from the last. */
  virtual void forget() = 0;

  /** Tells how many iterations a solve took: when those above what a new factor gave add up to its cost, it is renewed.
   */
  virtual void took(int iterations) = 0;
  /** Iterations of one solve after which it will be renewed, so that the solve had better be begun again. */
  virtual int patience() const = 0;

  /** z = about A^-1 r on the free components, 0 on the held ones. */
  virtual void apply(const NodalField& r, NodalField& z) = 0;

  /** Whether product() can be asked, to begin with in a system that is to be solved to that tolerance. */
  virtual bool hasProduct(double /*tolerance*/) const { return false; }
  /**
   * `rounded` = u, but for a translation in single precision, out = A `rounded` too, which takes a third of the time.
   * Elements see differences of it, which are exact: so errors are relative to how the body moves within itself, and to
   * its stresses and inertia from that, not to its motion as a whole.
   * @param rounded  may be u
   */
  virtual void product(const NodalField& /*u*/, NodalField& /*rounded*/, NodalField& /*out*/) {}

  /** Whether improve() can be asked. */
  virtual bool improves() const { return false; }
  /**
   * Conjugate gradients for A e = r in single precision, which is twice as fast; then u += e. Their rounding errors are
   * relative to e: what is left of r has to be computed afresh, in double precision.
   * @param target  of sqrt(r^T B^-1 r)
   * @return        iterations
   */
  virtual int improve(const NodalField& /*r*/, double /*target*/, int /*max_iterations*/, NodalField& /*u*/)
  {
    return 0;
  }
};

}  // namespace bezier_fem
