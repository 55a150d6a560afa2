#include "bezier_fem/p_multigrid.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <random>

#include "kernels.h"
#include "parallel.h"
#include "turned_factor.h"

namespace bezier_fem
{
namespace
{
/** Products a smoothing; with three an iteration less is needed, and every one costs more. */
constexpr int DEGREE = 2;
/** The smoother takes care of eigenvalues down to the largest over this. */
constexpr double RANGE = 8;
/** The largest eigenvalue is estimated from below, and changes a little as the elements turn. */
constexpr double MARGIN = 1.1;

/** The linear elements on the tetrahedra of a quadratic model, at rest; or a copy of a linear one. */
std::unique_ptr<Model> linearModel(const Model& model, std::vector<int>& node_of_vertex,
                                   std::vector<std::array<int, 2>>& vertices_of)
{
  auto linear = std::make_unique<Model>(model);
  std::vector<int> vertex(model.num_nodes, -1);
  linear->ends.clear();
  linear->ids.clear();
  for (int i = 0; i < model.num_nodes; ++i)
  {
    if (model.ends[i][0] != model.ends[i][1]) continue;
    vertex[i] = static_cast<int>(node_of_vertex.size());
    node_of_vertex.push_back(i);
    linear->ends.push_back(model.ends[i]);
    linear->ids.push_back(model.ids[i]);
  }
  for (const auto& [a, b] : model.ends)
  {
    vertices_of.push_back({vertex[model.node_of_corner[a]], vertex[model.node_of_corner[b]]});
  }
  linear->num_nodes = static_cast<int>(node_of_vertex.size());
  linear->nodes_per_tet = CORNERS;
  linear->rest = NodalField(linear->num_nodes);
  for (int i = 0; i < linear->num_nodes; ++i) linear->rest[i] = model.rest[node_of_vertex[i]];
  for (int& i : linear->node_of_corner) i = i < 0 ? i : vertex[i];
  linear->tets.clear();
  for (int t = 0; t < model.num_tets; ++t)
  {
    for (int c = 0; c < CORNERS; ++c) linear->tets.push_back(vertex[model.nodesOf(t)[c]]);
  }
  linear->block_nodes.clear();
  for (int block = 0; block < model.num_blocks; ++block)
  {
    const int* nodes = model.block_nodes.data() + static_cast<std::ptrdiff_t>(block) * model.nodes_per_tet * LANES;
    for (int k = 0; k < CORNERS * LANES; ++k) linear->block_nodes.push_back(vertex[nodes[k]]);
  }
  return linear;
}
}  // namespace

PMultigrid::PMultigrid(const Model& model, const Partition& partition)
    : linear_(linearModel(model, node_of_vertex_, vertices_of_)),
      linear_rotations_(restRotations(*linear_)),
      factor_(std::make_unique<TurnedFactor>(*linear_)),
      held_vertices_(node_of_vertex_.size()),
      residual_(model.num_nodes),
      direction_(model.num_nodes),
      correction_(model.num_nodes),
      product_(partition.rows())
{
}

PMultigrid::~PMultigrid() = default;

void PMultigrid::forget()
{
  factor_->forget();
}

void PMultigrid::took(int iterations)
{
  constexpr int COST = 10;  // of a factor, in iterations
  factor_->took(iterations, COST);
}

void PMultigrid::estimateLargest(const Model& model)
{
  constexpr int ITERATIONS = 15;
  std::mt19937 random(1);
  NodalField v(model.num_nodes);
  for (int i = 0; i < model.num_nodes; ++i)
  {
    for (int axis = 0; axis < 3; ++axis)
    {
      if (!(held_[i] >> axis & 1)) v[i][axis] = static_cast<double>(random()) / 4294967296.0 - 0.5;
    }
  }
  for (int k = 0; k < ITERATIONS; ++k)
  {
    system_->product(v, product_);
    for (int i = 0; i < model.num_nodes; ++i)
    {
      const Eigen::Map<const Eigen::Matrix<double, 4, 3>> inverse(
          inverse_->data() + static_cast<std::ptrdiff_t>(kernels::INVERSE_STRIDE) * i);
      v[i] = (inverse * product_[i]).head<3>();
    }
    largest_ = v.matrix().norm();
    if (largest_ > 0) v.matrix() /= largest_;
  }
}

bool PMultigrid::prepare(const SystemOperator& system, const Model& model, const Rotations& rotations,
                         const HeldAxes& held, double alpha, double beta, const AlignedVector<double>& inverse)
{
  system_ = &system;
  inverse_ = &inverse;
  held_ = held;
  for (std::size_t k = 0; k < node_of_vertex_.size(); ++k) held_vertices_[k] = held[node_of_vertex_[k]];
  const bool same = factor_->isOf(held_vertices_, alpha, beta);
  if (!same || !factor_->valid())
  {
    linear_->block_coefficients = model.block_coefficients;
    // Of several rotations, the mean.
    constexpr std::ptrdiff_t BLOCK = 9 * LANES;
    for (std::ptrdiff_t block = 0; block < model.num_blocks; ++block)
    {
      for (std::ptrdiff_t k = 0; k < BLOCK; ++k)
      {
        double sum = 0;
        for (int q = 0; q < rotations.points; ++q)
          sum += rotations.gradients[(block * rotations.points + q) * BLOCK + k];
        linear_rotations_.gradients[block * BLOCK + k] = sum / rotations.points;
      }
    }
    if (!factor_->factor(linear_rotations_, rotations, held_vertices_, alpha, beta)) return false;
    if (model.quadratic() && !(same && largest_ > 0)) estimateLargest(model);
  }
  factor_->turn(rotations);
  return true;
}

/**
 * `products` + 1 terms of Chebyshev's iteration for the residual, from which A d = q is taken first; the residual is
 * left as it is before the last term.
 */
void PMultigrid::smooth(const Partition& partition, const double* q, NodalField& z, int products)
{
  const kernels::Table& kernel = kernels::table();
  const double top = MARGIN * largest_, bottom = top / RANGE;
  const double centre = (top + bottom) / 2, radius = (top - bottom) / 2, sigma = centre / radius;
  double rho = 1 / sigma, keep = 0, gain = 1 / centre;
  for (int k = 0;; ++k)
  {
    forEachThread(partition, [&](int t) {
      kernel.chebyshev(partition.nodeBegin(t), partition.nodeEnd(t), keep, gain, q, inverse_->data(), residual_.data(),
                       direction_.data(), z.data());
    });
    if (k == products) return;
    system_->product(direction_, product_);
    q = product_.data();
    const double next = 1 / (2 * sigma - rho);
    keep = next * rho;
    gain = 2 * next / radius;
    rho = next;
  }
}

/** z = P A_linear^-1 P^T residual_, in turned frames. */
void PMultigrid::addCorrection(NodalField& z)
{
  float* right = factor_->right();
  std::fill(right, right + 4 * node_of_vertex_.size(), 0.0f);
  for (std::size_t i = 0; i < vertices_of_.size(); ++i)
  {
    const double* r = residual_.data() + 4 * i;
    float* a = right + 4L * vertices_of_[i][0];
    float* b = right + 4L * vertices_of_[i][1];
    for (int axis = 0; axis < 3; ++axis)
    {
      const float half = held_[i] >> axis & 1 ? 0 : static_cast<float>(0.5 * r[axis]);
      a[axis] += half;
      b[axis] += half;
    }
  }
  const float* left = factor_->solve();
  for (std::size_t i = 0; i < vertices_of_.size(); ++i)
  {
    const float* a = left + 4L * vertices_of_[i][0];
    const float* b = left + 4L * vertices_of_[i][1];
    double* to = z.data() + 4 * i;
    for (int axis = 0; axis < 3; ++axis)
    {
      to[axis] = held_[i] >> axis & 1 ? 0 : 0.5 * (static_cast<double>(a[axis]) + static_cast<double>(b[axis]));
    }
  }
}

void PMultigrid::apply(const Partition& partition, const NodalField& r, NodalField& z)
{
  residual_.matrix() = r.matrix().leftCols(residual_.size());
  if (linear_->num_nodes == residual_.size())
  {
    addCorrection(z);
    return;
  }
  z.setZero();
  smooth(partition, nullptr, z, DEGREE - 1);
  system_->product(direction_, product_);
  residual_.matrix() -= product_.matrix().leftCols(residual_.size());
  addCorrection(correction_);
  z.matrix() += correction_.matrix();
  system_->product(correction_, product_);
  smooth(partition, product_.data(), z, DEGREE - 1);
}

}  // namespace bezier_fem
