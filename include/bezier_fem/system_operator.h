#pragma once

#include "bezier_fem/element_operator.h"

namespace bezier_fem
{
/**
 * alpha M + beta K of a body in one state, as a solver sees it: symmetric, and positive definite for alpha > 0.
 */
class SystemOperator
{
public:
  virtual ~SystemOperator() = default;
  /** out = (alpha M + beta K) u. */
  virtual void product(const NodalField& u, NodalField& out) const = 0;
  /** The 3x3 diagonal blocks, in the layout of systemDiagonal(). */
  virtual void diagonal(AlignedVector<double>& blocks) const = 0;
};

/** The operator without a matrix. `Linearisation` is what K depends on beside the model: rotations, for instance. */
template <class Linearisation>
class MatrixFreeSystem final : public SystemOperator
{
public:
  /** Keeps references to its arguments. */
  MatrixFreeSystem(const Model& model, const Partition& partition, const Linearisation& at, double alpha, double beta)
      : model_(model), partition_(partition), at_(at), alpha_(alpha), beta_(beta)
  {
  }
  void product(const NodalField& u, NodalField& out) const override
  {
    systemProduct(model_, partition_, at_, alpha_, beta_, u, out);
  }
  void diagonal(AlignedVector<double>& blocks) const override
  {
    systemDiagonal(model_, partition_, at_, alpha_, beta_, blocks);
  }

private:
  const Model& model_;
  const Partition& partition_;
  const Linearisation& at_;
  double alpha_, beta_;
};

}  // namespace bezier_fem
