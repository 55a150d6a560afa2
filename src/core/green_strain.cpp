#include "bezier_fem/green_strain.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "element_loop.h"

namespace bezier_fem
{
namespace
{
constexpr double SMALLEST_VOLUME_RATIO = 1e-3;

const kernels::GreenTable& kernel(const Model& model)
{
  return model.quadratic() ? kernels::table().green_quadratic : kernels::table().green_linear;
}
}  // namespace

void greenForce(const Model& model, const Partition& partition, const NodalField& x, NodalField& out)
{
  accumulate(model, partition, 1, out.data(),
             [&](const kernels::Elements& elements, int begin, int end, double* shares) {
               kernel(model).add_force(elements, begin, end, model.block_gradients.data(), x.data(), shares);
             });
}

double greenEnergy(const Model& model, const NodalField& x)
{
  return kernel(model).energy(elementsOf(model, 1), 0, model.num_blocks, model.block_gradients.data(), x.data());
}

GreenTangent::GreenTangent(const Model& model)
    : blocks(static_cast<std::size_t>(model.num_blocks) * LANES *
             (model.quadratic() ? kernels::QUADRATIC_TANGENT : kernels::LINEAR_TANGENT))
{
}

void linearise(const Model& model, const Partition& partition, const NodalField& x, Projection projection,
               GreenTangent& tangent)
{
  forEachPiece(partition, [&](int t) {
    kernel(model).linearise(elementsOf(model, 1), partition.blockBegin(t), partition.blockEnd(t),
                            model.block_gradients.data(), x.data(), projection == Projection::POSITIVE_STRESS,
                            tangent.blocks.data());
  });
}

void systemProduct(const Model& model, const Partition& partition, const GreenTangent& tangent, double alpha,
                   double beta, const NodalField& u, NodalField& out)
{
  accumulate(model, partition, 1, out.data(),
             [&](const kernels::Elements& elements, int begin, int end, double* shares) {
               kernel(model).add_product(elements, begin, end, model.block_gradients.data(), tangent.blocks.data(),
                                         alpha, beta, u.data(), shares);
             });
}

void systemDiagonal(const Model& model, const Partition& partition, const GreenTangent& tangent, double alpha,
                    double beta, AlignedVector<double>& blocks)
{
  accumulateDiagonal(model, partition, 1, blocks.data(),
                     [&](const kernels::Elements& elements, int begin, int end, double* shares) {
                       kernel(model).add_diagonal(elements, begin, end, model.block_gradients.data(),
                                                  tangent.blocks.data(), alpha, beta, shares);
                     });
}

Stress greenStressAt(const Model& model, const NodalField& x, const MaterialPoint& point)
{
  const Material& material = model.materials[point.tet];
  const Eigen::Matrix3d F = deformationGradient(model, x, point);
  const Eigen::Matrix3d E = (F.transpose() * F - Eigen::Matrix3d::Identity()) / 2;
  const Eigen::Matrix3d S = lameLambda(material) * E.trace() * Eigen::Matrix3d::Identity() + 2 * lameMu(material) * E;
  const double det = F.determinant();
  const Eigen::Matrix3d s = F * S * F.transpose() / std::copysign(std::max(std::abs(det), SMALLEST_VOLUME_RATIO), det);
  return (Stress() << s(0, 0), s(1, 1), s(2, 2), s(0, 1), s(1, 2), s(0, 2)).finished();
}

Eigen::Matrix<double, 6, Eigen::Dynamic> greenNodalStress(const Model& model, const NodalField& x)
{
  Eigen::Matrix<double, 6, Eigen::Dynamic> sum = Eigen::Matrix<double, 6, Eigen::Dynamic>::Zero(6, model.num_nodes);
  Eigen::VectorXd count = Eigen::VectorXd::Zero(model.num_nodes);
  for (int t = 0; t < model.num_tets; ++t)
  {
    for (int k = 0; k < model.nodes_per_tet; ++k)
    {
      Eigen::Vector4d lambda = Eigen::Vector4d::Unit(k % CORNERS);
      if (k >= CORNERS)
      {
        const auto [a, b] = EDGE_CORNERS[k - CORNERS];
        lambda = (Eigen::Vector4d::Unit(a) + Eigen::Vector4d::Unit(b)) / 2;
      }
      sum.col(model.nodesOf(t)[k]) += greenStressAt(model, x, {t, lambda});
      count[model.nodesOf(t)[k]] += 1;
    }
  }
  return sum * count.cwiseInverse().asDiagonal();
}

}  // namespace bezier_fem
