#include "bezier_fem/assembled_system.h"

#include <algorithm>

#include "bezier_fem/green_strain.h"
#include "element_loop.h"
#include "kernels.h"
#include "parallel.h"

namespace bezier_fem
{
struct AssembledSystem::ByProducts
{
  explicit ByProducts(const Model& model, const AssembledMatrix& pattern)
      : matrices(model), assembler(model, pattern, Traversal::MESH_ORIENTED)
  {
    const int n = model.nodes_per_tet;
    alone.assign(model.num_blocks, kernels::ALONE);
    own_offsets.resize(model.block_offsets.size());
    for (std::size_t k = 0; k < own_offsets.size(); ++k)
      own_offsets[k] = static_cast<int>(4 * (k % (std::size_t{LANES} * n)));
  }

  /**
   * Fills `matrices` with the shares that add_product(elements, block, block + 1, u, shares) has of unit vectors.
   * @param points  rotations an element
   */
  template <class AddProduct>
  void fill(const Model& model, const Partition& partition, int points, const AddProduct& add_product)
  {
    const int n = model.nodes_per_tet, rows = n * LANES;
    const kernels::Elements elements{
        n, points, own_offsets.data(), alone.data(), model.block_coefficients.data(), meanOf(model)};
    double* shares = partition.shares() + kernels::ZERO_ROWS * kernels::SHARES;
    forEachPiece(partition, [&](int thread) {
      NodalField u(rows);
      for (int block = partition.blockBegin(thread); block < partition.blockEnd(thread); ++block)
      {
        for (int column = 0; column < 3 * n; ++column)
        {
          const int J = column / 3, axis = column % 3;
          for (int lane = 0; lane < LANES; ++lane) u[J * LANES + lane][axis] = 1;
          add_product(elements, block, block + 1, u.data(), shares);
          for (int lane = 0; lane < LANES; ++lane)
          {
            u[J * LANES + lane][axis] = 0;
            for (int I = 0; I <= J; ++I)
            {
              double* to = matrices.blocks.data() + matrices.at(block * LANES + lane, I, J) + 3 * axis;
              std::copy_n(shares + kernels::SHARES * (static_cast<long>(block) * n + I) + 4 * kernels::slotOf(lane), 3,
                          to);
            }
          }
        }
      }
    });
  }

  ElementMatrices matrices;
  Assembler assembler;
  std::vector<std::uint8_t> alone;
  AlignedVector<int> own_offsets;  // like Model::block_offsets, numbered within each block
};

AssembledSystem::AssembledSystem(const Model& model, const Partition& partition)
    : model_(model), partition_(partition), matrix_(model)
{
}

AssembledSystem::~AssembledSystem() = default;

void AssembledSystem::assemble(const Rotations& rotations, double alpha, double beta)
{
  if (rotations.points == 1)
  {
    if (!fused_) fused_ = std::make_unique<FusedAssembler>(model_, matrix_);
    fused_->assemble(model_, partition_, rotations, alpha, beta, matrix_);
    return;
  }
  if (!by_products_) by_products_ = std::make_unique<ByProducts>(model_, matrix_);
  by_products_->fill(model_, partition_, rotations.points,
                     [&](const kernels::Elements& elements, int begin, int end, const double* u, double* y) {
                       kernels::table().add_product(elements, begin, end, rotations.gradients.data(), alpha, beta, u,
                                                    y);
                     });
  by_products_->assembler.assemble(model_, partition_, by_products_->matrices, matrix_);
}

void AssembledSystem::assemble(const GreenTangent& tangent, double alpha, double beta)
{
  if (!by_products_) by_products_ = std::make_unique<ByProducts>(model_, matrix_);
  const kernels::GreenTable& green =
      model_.quadratic() ? kernels::table().green_quadratic : kernels::table().green_linear;
  by_products_->fill(model_, partition_, 1,
                     [&](const kernels::Elements& elements, int begin, int end, const double* u, double* y) {
                       green.add_product(elements, begin, end, model_.block_gradients.data(), tangent.blocks.data(),
                                         alpha, beta, u, y);
                     });
  by_products_->assembler.assemble(model_, partition_, by_products_->matrices, matrix_);
}

}  // namespace bezier_fem
