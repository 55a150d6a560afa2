#include "bezier_fem/element_operator.h"

#include <algorithm>

#include "kernels.h"
#include "parallel.h"

namespace bezier_fem
{
namespace
{
kernels::Elements elementsOf(const Model& model, const Partition& partition, const Rotations& rotations)
{
  return {model.nodes_per_tet, rotations.points, model.block_nodes.data(), partition.scatter(),
          model.block_coefficients.data()};
}

/** Clears `rows` rows, runs the element loop, adds the ghosts. */
template <class Loop>
void accumulate(const Partition& partition, double* out, int stride, const Loop& loop)
{
  std::fill_n(out, static_cast<std::ptrdiff_t>(stride) * partition.rows(), 0.0);
  forEachThread(partition, [&](int t) { loop(partition.blockBegin(t), partition.blockEnd(t)); });
  partition.foldGhosts(out, stride);
}
}  // namespace

void elasticForce(const Model& model, const Partition& partition, const Rotations& rotations, const NodalField& x,
                  NodalField& out)
{
  accumulate(partition, out.data(), 4, [&](int begin, int end) {
    kernels::table().add_force(elementsOf(model, partition, rotations), begin, end, rotations.gradients.data(),
                               x.data(), out.data());
  });
}

void systemProduct(const Model& model, const Partition& partition, const Rotations& rotations, double alpha,
                   double beta, const NodalField& u, NodalField& out)
{
  accumulate(partition, out.data(), 4, [&](int begin, int end) {
    kernels::table().add_product(elementsOf(model, partition, rotations), begin, end, rotations.gradients.data(), alpha,
                                 beta, u.data(), out.data());
  });
}

void systemDiagonal(const Model& model, const Partition& partition, const Rotations& rotations, double alpha,
                    double beta, AlignedVector<double>& blocks)
{
  accumulate(partition, blocks.data(), kernels::DIAGONAL_STRIDE, [&](int begin, int end) {
    kernels::table().add_diagonal(elementsOf(model, partition, rotations), begin, end, rotations.gradients.data(),
                                  alpha, beta, blocks.data());
  });
}

}  // namespace bezier_fem
