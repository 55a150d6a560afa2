#include "direct_preconditioner.h"

#include <functional>

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

void DirectPreconditioner::apply(const NodalField& r, NodalField& z)
{
  const auto fill = [&](const int* nodes, int count) {
    for (int k = 0; k < count; ++k)
    {
      const std::ptrdiff_t i = 4L * nodes[k];
      for (int axis = 0; axis < 3; ++axis) factor_.right()[i + axis] = static_cast<float>(r.data()[i + axis]);
    }
  };
  const float* left = factor_.solve(std::ref(fill));
  const Eigen::Index numbers = 4L * z.size();
  Eigen::Map<Eigen::VectorXd>(z.data(), numbers) = Eigen::Map<const Eigen::VectorXf>(left, numbers).cast<double>();
}

}  // namespace bezier_fem
