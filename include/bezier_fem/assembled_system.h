#pragma once

#include <memory>

#include "bezier_fem/assembled_matrix.h"
#include "bezier_fem/system_operator.h"

namespace bezier_fem
{
struct GreenTangent;

/** The operator as an assembled matrix. */
class AssembledSystem final : public SystemOperator
{
public:
  /** Keeps references to its arguments. */
  AssembledSystem(const Model& model, const Partition& partition);
  ~AssembledSystem() override;

  void assemble(const Rotations& rotations, double alpha, double beta);
  void assemble(const GreenTangent& tangent, double alpha, double beta);
  /** What was assembled last; may be changed until the next time. */
  AssembledMatrix& matrix() { return matrix_; }

  void product(const NodalField& u, NodalField& out) const override { matrix_.product(partition_, u, out); }
  void diagonal(AlignedVector<double>& blocks) const override { matrix_.diagonal(blocks); }

private:
  /** Element matrices of no particular form, column by column. */
  struct ByProducts;

  const Model& model_;
  const Partition& partition_;
  AssembledMatrix matrix_;
  std::unique_ptr<FusedAssembler> fused_;    // made where there is one rotation an element
  std::unique_ptr<ByProducts> by_products_;  // made for everything else
};

}  // namespace bezier_fem
