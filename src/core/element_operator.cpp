#include "bezier_fem/element_operator.h"

#include "element_loop.h"

namespace bezier_fem
{
void elasticForce(const Model& model, const Partition& partition, const Rotations& rotations, const NodalField& x,
                  NodalField& out)
{
  accumulate(model, partition, rotations.points, out.data(), 4,
             [&](const kernels::Elements& elements, int begin, int end) {
               kernels::table().add_force(elements, begin, end, rotations.gradients.data(), x.data(), out.data());
             });
}

void systemProduct(const Model& model, const Partition& partition, const Rotations& rotations, double alpha,
                   double beta, const NodalField& u, NodalField& out)
{
  accumulate(model, partition, rotations.points, out.data(), 4,
             [&](const kernels::Elements& elements, int begin, int end) {
               kernels::table().add_product(elements, begin, end, rotations.gradients.data(), alpha, beta, u.data(),
                                            out.data());
             });
}

void systemDiagonal(const Model& model, const Partition& partition, const Rotations& rotations, double alpha,
                    double beta, AlignedVector<double>& blocks)
{
  accumulate(model, partition, rotations.points, blocks.data(), kernels::DIAGONAL_STRIDE,
             [&](const kernels::Elements& elements, int begin, int end) {
               kernels::table().add_diagonal(elements, begin, end, rotations.gradients.data(), alpha, beta,
                                             blocks.data());
             });
}

}  // namespace bezier_fem
