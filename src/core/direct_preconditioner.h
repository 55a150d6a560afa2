#pragma once

#include "turned_inverse.h"

namespace bezier_fem
{
/** The whole system, assembled and factored: of an unchanged one, its solution to single precision. */
class DirectPreconditioner final : public Preconditioner
{
public:
  /** Keeps a reference to the model. */
  DirectPreconditioner(const Model& model, int threads);

  bool prepare(const Model& model, const Rotations& rotations, const HeldAxes& held, double alpha, double beta,
               const AlignedVector<double>& inverse) override;
  void forget() override { factor_.forget(); }
  void took(int iterations) override { factor_.took(iterations, cost_); }
  int patience() const override { return factor_.patience(cost_); }
  void apply(const NodalField& r, NodalField& z) override { factor_.apply(r, z); }

private:
  TurnedInverse factor_;
  double cost_;  // of a factor, in iterations
};

}  // namespace bezier_fem
