#include "direct_preconditioner.h"

namespace bezier_fem
{
DirectPreconditioner::DirectPreconditioner(const Model& model, int threads)
    : factor_(model, threads, TurnedInverse::Form::FACTOR)
{
  // A solve finds part of the factor in cache.
  cost_ = 4 * factor_.inverse().makingTime() / factor_.inverse().solvingTime();
}

bool DirectPreconditioner::prepare(const Model& /*model*/, const Rotations& rotations, const HeldAxes& held,
                                   double alpha, double beta, const AlignedVector<double>& /*inverse*/)
{
  if (!(factor_.valid() && factor_.isOf(held, alpha, beta)) && !factor_.make(rotations, rotations, held, alpha, beta))
  {
    return false;
  }
  factor_.turn(rotations);
  return true;
}

}  // namespace bezier_fem
