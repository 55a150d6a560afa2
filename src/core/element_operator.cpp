#include "bezier_fem/element_operator.h"

#include <cmath>
#include <numeric>

#include "element_loop.h"

namespace bezier_fem
{
namespace
{
/**
 * Diagonal blocks are made in single precision where no element's (lambda + 2 mu) / mu is more than this, which bounds
 * their condition numbers: an element's share is (lambda + mu) g g^T + mu |g|^2 1 or a mean of such, and a multiple of
 * 1 for the mass, and a sum of matrices is conditioned no worse than they are. So an inverse is right to a per cent at
 * the worst, which serves a preconditioner and a norm, and definite for sure.
 */
constexpr double SINGLE_CONDITION = 1e4;
}  // namespace

void elasticForce(const Model& model, const Partition& partition, const Rotations& rotations, const NodalField& x,
                  NodalField& out)
{
  accumulate(model, partition, rotations.points, out.data(),
             [&](const kernels::Elements& elements, int begin, int end, double* shares) {
               kernels::table().add_force(elements, begin, end, rotations.gradients.data(), x.data(), shares);
             });
}

double turnWork(const Model& model, const Partition& partition, const Rotations& before, const Rotations& after,
                const NodalField& x, const NodalField& d)
{
  double* sums = partition.shares() + kernels::ZERO_ROWS * kernels::SHARES;  // of shares there are more
  forEachPiece(partition, [&](int t) {
    kernels::table().turn_work(elementsOf(model, before.points), partition.blockBegin(t), partition.blockEnd(t),
                               before.gradients.data(), after.gradients.data(), x.data(), d.data(), sums);
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
  // Units are anybody's: in single precision the largest share is about 1.
  const double largest = alpha * model.largest_mass + beta * model.largest_stiffness, scale = 1 / largest;
  if (model.largest_condition <= SINGLE_CONDITION && std::isnormal(scale))
  {
    accumulateSingleDiagonal(model, partition, rotations.points, largest, blocks.data(),
                             [&](const kernels::Elements& elements, int begin, int end, float* shares) {
                               kernels::table().add_single_diagonal(elements, begin, end, rotations.gradients.data(),
                                                                    scale * alpha, scale * beta, shares);
                             });
    return;
  }
  accumulateDiagonal(model, partition, rotations.points, blocks.data(),
                     [&](const kernels::Elements& elements, int begin, int end, double* shares) {
                       kernels::table().add_diagonal(elements, begin, end, rotations.gradients.data(), alpha, beta,
                                                     shares);
                     });
}

}  // namespace bezier_fem
