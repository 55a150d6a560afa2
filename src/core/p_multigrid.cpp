#include "bezier_fem/p_multigrid.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <random>

#include "bezier_fem/assembled_matrix.h"
#include "kernels.h"
#include "parallel.h"
#include "sparse_cholesky.h"

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
      linear_partition_(*linear_, 1),
      linear_rotations_(restRotations(*linear_)),
      matrix_(std::make_unique<AssembledMatrix>(*linear_)),
      assembler_(std::make_unique<FusedAssembler>(*linear_, *matrix_)),
      cholesky_(std::make_unique<SparseCholesky>(*matrix_, linear_->rest)),
      factored_frames_(9 * node_of_vertex_.size()),
      frames_(9 * node_of_vertex_.size()),
      right_(4 * node_of_vertex_.size()),
      left_(4 * node_of_vertex_.size()),
      residual_(model.num_nodes),
      direction_(model.num_nodes),
      correction_(model.num_nodes),
      product_(partition.rows())
{
}

PMultigrid::~PMultigrid() = default;

void PMultigrid::took(int iterations)
{
  constexpr int COST = 10;  // of a factor, in iterations
  if (fewest_ < 0) fewest_ = iterations;
  excess_ += std::max(0, iterations - fewest_);
  if (excess_ > COST) factored_ = false;
}

bool PMultigrid::factor(const Model& model, const Rotations& rotations, const std::vector<std::uint8_t>& held)
{
  linear_->block_coefficients = model.block_coefficients;
  AssembledMatrix& matrix = *matrix_;
  // Of several rotations, the mean.
  constexpr std::ptrdiff_t BLOCK = 9 * LANES;
  for (std::ptrdiff_t block = 0; block < model.num_blocks; ++block)
  {
    for (std::ptrdiff_t k = 0; k < BLOCK; ++k)
    {
      double sum = 0;
      for (int q = 0; q < rotations.points; ++q) sum += rotations.gradients[(block * rotations.points + q) * BLOCK + k];
      linear_rotations_.gradients[block * BLOCK + k] = sum / rotations.points;
    }
  }
  assembler_->assemble(*linear_, linear_partition_, linear_rotations_, alpha_, beta_, matrix);
  for (int i = 0; i < linear_->num_nodes; ++i)
  {
    for (int k = matrix.rowBegin()[i]; k < matrix.rowBegin()[i + 1]; ++k)
    {
      const int j = matrix.column()[k];
      Eigen::Map<Eigen::Matrix3d> block(matrix.blocks().data() + 9L * k);
      for (int axis = 0; axis < 3; ++axis)
      {
        if (held[node_of_vertex_[i]] >> axis & 1) block.row(axis).setZero();
        if (held[node_of_vertex_[j]] >> axis & 1) block.col(axis).setZero();
        if (i == j && (held[node_of_vertex_[i]] >> axis & 1)) block(axis, axis) = 1;
      }
    }
  }
  factored_frames_ = frames_;
  fewest_ = -1;
  excess_ = 0;
  // Where rounding makes a pivot negative (nearly incompressible bodies), a diagonal larger by about as much helps.
  double larger = 1;
  for (const double wanted : {1.0, 1 + 1e-6, 1 + 1e-5, 1 + 1e-4})
  {
    for (int i = 0; i < linear_->num_nodes && wanted > 1; ++i)
    {
      for (int k = matrix.rowBegin()[i]; k < matrix.rowBegin()[i + 1]; ++k)
      {
        if (matrix.column()[k] != i) continue;
        Eigen::Map<Eigen::Matrix3d>(matrix.blocks().data() + 9L * k).diagonal() *= wanted / larger;
      }
    }
    larger = wanted;
    if (cholesky_->factor(matrix)) return true;
  }
  return false;
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

void PMultigrid::turnFrames(const Model& model, const Rotations& rotations)
{
  std::fill(frames_.begin(), frames_.end(), 0.0f);
  const int points = rotations.points;
  for (int t = 0; t < model.num_tets; ++t)
  {
    Eigen::Matrix3f sum = rotations.matrix(t).cast<float>();
    for (int q = 1; q < points; ++q) sum += rotations.matrix(t, q).cast<float>();
    for (int c = 0; c < CORNERS; ++c)
    {
      Eigen::Map<Eigen::Matrix3f>(frames_.data() + 9L * linear_->tets[static_cast<std::size_t>(t) * CORNERS + c]) +=
          sum;
    }
  }
  for (std::size_t i = 0; i < node_of_vertex_.size(); ++i)
  {
    Eigen::Map<Eigen::Matrix3f> frame(frames_.data() + 9 * i);
    const float size = frame.squaredNorm();
    if (!(size > 0)) continue;
    // Towards the nearest rotation (Newton and Schulz): near enough, as any regular frame will do.
    frame *= std::sqrt(3 / size);
    for (int k = 0; k < 2; ++k) frame = (1.5f * frame - 0.5f * frame * (frame.transpose() * frame)).eval();
  }
}

bool PMultigrid::prepare(const SystemOperator& system, const Model& model, const Rotations& rotations,
                         const std::vector<std::uint8_t>& held, double alpha, double beta,
                         const AlignedVector<double>& inverse)
{
  system_ = &system;
  inverse_ = &inverse;
  turnFrames(model, rotations);
  const bool same = alpha == alpha_ && beta == beta_ && held == held_;
  if (!factored_ || !same)
  {
    alpha_ = alpha;
    beta_ = beta;
    held_ = held;
    factored_ = factor(model, rotations, held);
    if (!factored_) return false;
    if (model.quadratic() && !(same && largest_ > 0)) estimateLargest(model);
  }
  for (std::size_t i = 0; i < node_of_vertex_.size(); ++i)
  {
    Eigen::Map<Eigen::Matrix3f> frame(frames_.data() + 9 * i);
    frame = (frame * Eigen::Map<const Eigen::Matrix3f>(factored_frames_.data() + 9 * i).transpose()).eval();
  }
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
  std::fill(right_.begin(), right_.end(), 0.0f);
  for (std::size_t i = 0; i < vertices_of_.size(); ++i)
  {
    const double* r = residual_.data() + 4 * i;
    float* a = right_.data() + 4L * vertices_of_[i][0];
    float* b = right_.data() + 4L * vertices_of_[i][1];
    for (int axis = 0; axis < 3; ++axis)
    {
      const float half = held_[i] >> axis & 1 ? 0 : static_cast<float>(0.5 * r[axis]);
      a[axis] += half;
      b[axis] += half;
    }
  }
  const auto clearHeld = [&](std::size_t vertex, Eigen::Map<Eigen::Vector3f>& v) {
    const std::uint8_t held = held_[node_of_vertex_[vertex]];
    for (int axis = 0; held != 0 && axis < 3; ++axis)
    {
      if (held >> axis & 1) v[axis] = 0;
    }
  };
  for (std::size_t k = 0; k < node_of_vertex_.size(); ++k)
  {
    Eigen::Map<Eigen::Vector3f> v(right_.data() + 4 * k);
    clearHeld(k, v);
    v = (Eigen::Map<const Eigen::Matrix3f>(frames_.data() + 9 * k).transpose() * v).eval();
  }
  cholesky_->solve(right_.data(), left_.data());
  for (std::size_t k = 0; k < node_of_vertex_.size(); ++k)
  {
    Eigen::Map<Eigen::Vector3f> v(left_.data() + 4 * k);
    v = (Eigen::Map<const Eigen::Matrix3f>(frames_.data() + 9 * k) * v).eval();
    clearHeld(k, v);
  }
  for (std::size_t i = 0; i < vertices_of_.size(); ++i)
  {
    const float* a = left_.data() + 4L * vertices_of_[i][0];
    const float* b = left_.data() + 4L * vertices_of_[i][1];
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
