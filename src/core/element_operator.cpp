#include "bezier_fem/element_operator.h"

#include <numeric>

#include "element_loop.h"

namespace bezier_fem
{
void elasticForce(const Model& model, const Partition& partition, const Rotations& rotations, const NodalField& x,
                  NodalField& out)
{
  accumulate(model, partition, rotations.points, out.data(),
             [&](const kernels::Elements& elements, int begin, int end, double* shares) {
               kernels::table().add_force(elements, begin, end, rotations.gradients.data(), x.data(), shares);
             });
}

double elasticWork(const Model& model, const Partition& partition, const Rotations& rotations, const NodalField& x,
                   const NodalField& d)
{
  double* sums = partition.shares() + kernels::ZERO_ROWS * kernels::SHARES;  // of shares there are more
  forEachPiece(partition, [&](int t) {
    kernels::table().force_work(elementsOf(model, rotations.points), partition.blockBegin(t), partition.blockEnd(t),
                                rotations.gradients.data(), x.data(), d.data(), sums);
  });
  return std::accumulate(sums, sums + model.num_blocks, 0.0);
}

void systemProduct(const Model& model, const Partition& partition, const Rotations& rotations, double alpha,
                   double beta, const NodalField& u, NodalField& out)
{
  accumulate(model, partition, rotations.points, out.data(),
             [&](const kernels::Elements& elements, int begin, int end, double* shares) {
               kernels::table().add_product(elements, begin, end, rotations.gradients.data(), alpha, beta, u.data(),
                                            shares);
             });
}

void systemDiagonal(const Model& model, const Partition& partition, const Rotations& rotations, double alpha,
                    double beta, AlignedVector<double>& blocks)
{
  accumulateDiagonal(model, partition, rotations.points, blocks.data(),
                     [&](const kernels::Elements& elements, int begin, int end, double* shares) {
                       kernels::table().add_diagonal(elements, begin, end, rotations.gradients.data(), alpha, beta,
                                                     shares);
                     });
}

}  // namespace bezier_fem
