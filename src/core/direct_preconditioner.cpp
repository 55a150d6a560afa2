#include "direct_preconditioner.h"

namespace bezier_fem
{
DirectPreconditioner::DirectPreconditioner(const Model& model, int threads) : factor_(model, threads)
{
  // Counted, not timed, so that a run repeats to the bit: a factor multiplies about as fast as a solve reads numbers
  // from memory, each of them twice.
  const SparseCholesky& cholesky = factor_.cholesky();
  cost_ = cholesky.work() / (2 * static_cast<double>(cholesky.size()));
}

bool DirectPreconditioner::prepare(const Model& /*model*/, const Rotations& rotations, const HeldAxes& held,
                                   double alpha, double beta, const AlignedVector<double>& /*inverse*/)
{
  if (!(factor_.valid() && factor_.isOf(held, alpha, beta)) && !factor_.factor(rotations, rotations, held, alpha, beta))
  {
    return false;
  }
  factor_.turn(rotations);
  return true;
}

}  // namespace bezier_fem
