#include "bezier_fem/p_multigrid.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <functional>
#include <numeric>
#include <random>

#include "element_loop.h"
#include "kernels.h"
#include "parallel.h"
#include "turned_inverse.h"

namespace bezier_fem
{
namespace
{
/** Chebyshev's terms in a smoothing. */
constexpr int DEGREE = 3;
/** The smoother takes care of eigenvalues down to the largest over this. */
constexpr double RANGE = 30;
/**
 * Where the lumped mass is up to so much of the diagonal, root mean square over the nodes, the smoother's operator has
 * it at the nodes, which spares a fifth of its product. It takes no more iterations up to there (bunny and armadillo,
 * time steps of 1 to 20 ms); where the mass prevails, half as many again. The square makes a small part of the body in
 * which it prevails count. Lumped, a node has three to five times its mass in the diagonal.
 */
constexpr double LUMPED_SHARE = 0.25;
/**
 * Tolerance times the mass's share from which on starts are made in single precision. The stiffer a body, the more of a
 * field's rounding is strain: free ones of 2e7 Pa to 1e-4, with 3e-9, take no more iterations for it, of 2e9 Pa half as
 * many again.
 */
constexpr double ROUGH = 1e-9;
/** The largest eigenvalue is estimated from below, and changes a little as the elements turn. */
constexpr double MARGIN = 1.1;

/**
 * Vertices up to which the linear elements' system is factored, below quadratic elements and of linear ones. Around
 * here a step takes as long with the factor as with aggregates, which take up to a fifth more iterations, and of linear
 * elements three times as many.
 */
constexpr int MOST_FACTORED = 3000, MOST_LINEAR_FACTORED = 5000;

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
  // Nobody sums up shares of it; partitions look at share_begin.
  linear->share_slots = {};
  linear->block_offsets.clear();
  for (int block = 0; block < model.num_blocks; ++block)
  {
    const int* nodes = model.block_offsets.data() + static_cast<std::ptrdiff_t>(block) * model.nodes_per_tet * LANES;
    for (int k = 0; k < CORNERS * LANES; ++k) linear->block_offsets.push_back(4 * vertex[nodes[k] / 4]);
  }
  return linear;
}

constexpr std::ptrdiff_t FIRST_SHARE = kernels::ZERO_ROWS * kernels::SHARES;
}  // namespace

/** alpha M + beta K' of quadratic elements in single precision, its smoother, and conjugate gradients' vectors. */
class PMultigrid::QuadraticLevel
{
public:
  QuadraticLevel(const Model& model, const Partition& partition, const Model& linear)
      : model_(model),
        linear_(linear),
        partition_(partition),
        rotated_(model.block_gradients.size()),
        coefficients_(model.block_coefficients.size()),
        shares_(kernels::SHARES * (kernels::ZERO_ROWS + static_cast<std::size_t>(model.num_blocks) * QUADRATIC_NODES)),
        partial_(partition.numChunks())
  {
    constexpr std::size_t GROUP = kernels::NODE_GROUP;
    const std::size_t nodes = (static_cast<std::size_t>(model.num_nodes) + GROUP - 1) / GROUP * GROUP;
    inverse_.resize(12 * nodes);
    mass_.resize(nodes);
    for (AlignedVector<float>* field : {&solution, &remaining, &search, &product, &residual, &direction, &correction})
    {
      field->resize(4 * nodes);
    }
  }

  void take(const Rotations& rotations, double alpha, double beta, const AlignedVector<double>& inverse)
  {
    alpha_ = alpha;
    takeElements(rotations, alpha, beta);
    mass_share_ = std::sqrt(takeInverse(alpha, inverse) / model_.num_nodes);
    lumped_ = mass_share_ < LUMPED_SHARE;
    for (int i = 0; i < model_.num_nodes; ++i)
    {
      mass_[i] = lumped_ ? static_cast<float>(alpha * model_.node_mass[i]) : 0.0f;
    }
  }

  /**
   * Starts from the residual r over its largest number, which it returns: squares are then numbers of single precision
   * in any units, and nothing is left of what was no number.
   */
  double start(const NodalField& r)
  {
    sum([&](int begin, int end) { return r.matrix().middleCols(begin, end - begin).cwiseAbs().maxCoeff(); });
    const double largest = *std::max_element(partial_.begin(), partial_.end()), scale = largest > 0 ? largest : 1;
    forEachPiece(partition_, [&](int t) {
      const std::ptrdiff_t begin = 4L * partition_.nodeBegin(t), end = 4L * partition_.nodeEnd(t);
      for (AlignedVector<float>* field : {&solution, &search, &product})
      {
        std::fill(field->begin() + begin, field->begin() + end, 0.0f);
      }
      Eigen::Map<Eigen::VectorXf>(remaining.data() + begin, end - begin) =
          (Eigen::Map<const Eigen::VectorXd>(r.data() + begin, end - begin) / scale).cast<float>();
    });
    advance(0);
    return scale;
  }

  /** u += scale solution */
  void addTo(NodalField& u, double scale) const
  {
    forEachPiece(partition_, [&](int t) {
      const std::ptrdiff_t begin = 4L * partition_.nodeBegin(t), numbers = 4L * partition_.nodeEnd(t) - begin;
      Eigen::Map<Eigen::VectorXd>(u.data() + begin, numbers) +=
          scale * Eigen::Map<const Eigen::VectorXf>(solution.data() + begin, numbers).cast<double>();
    });
  }

  /** Root mean square over the nodes of what the lumped mass is of the diagonal. */
  double massShare() const { return mass_share_; }

  /** Preconditioner::product() */
  void roundedProduct(const NodalField& u, NodalField& rounded, NodalField& out)
  {
    const auto floats = [](AlignedVector<float>& field, int first, int nodes) {
      return Eigen::Map<Eigen::Matrix<float, 4, Eigen::Dynamic>>(field.data() + 4L * first, 4, nodes);
    };
    // Of a translation there is no stress, and its inertia is known: so it is left out of the rounding, which would
    // strain a stiff body that falls by more than anything else does. Any node tells it.
    const Eigen::Vector4f translation = u.columns(0, 1).cast<float>();
    const Eigen::Vector4d shift = translation.cast<double>(), inertia = alpha_ * shift;
    forEachChunk(partition_, [&](int first, int nodes) {
      floats(search, first, nodes) = (u.columns(first, nodes).colwise() - shift).cast<float>();
      rounded.columns(first, nodes) = floats(search, first, nodes).cast<double>().colwise() + shift;
    });
    multiply(search);
    sumProduct();
    forEachChunk(partition_, [&](int first, int nodes) {
      const Eigen::Map<const Eigen::RowVectorXd> mass(model_.node_mass.data() + first, nodes);
      out.columns(first, nodes) = floats(product, first, nodes).cast<double>() + inertia.lazyProduct(mass);
    });
  }

  /** The largest eigenvalue of B^-1 A, from below. */
  void estimateLargest(const std::vector<std::uint8_t>& held)
  {
    constexpr int ITERATIONS = 15;
    std::mt19937 random(1);
    for (std::size_t i = 0; i < direction.size(); ++i)
    {
      const std::size_t node = i / 4, axis = i % 4;
      const bool free = axis < 3 && node < held.size() && !(held[node] >> axis & 1);
      direction[i] = free ? static_cast<float>(random()) / 4294967296.0f - 0.5f : 0.0f;
    }
    for (int k = 0; k < ITERATIONS; ++k)
    {
      multiply(direction);
      std::fill(residual.begin(), residual.end(), 0.0f);
      chebyshev(0, -1);  // makes B^-1 A v of the residual -A v
      Eigen::Map<Eigen::VectorXf> v(direction.data(), static_cast<Eigen::Index>(direction.size()));
      largest_ = v.norm();
      if (largest_ > 0) v /= static_cast<float>(largest_);
    }
  }
  bool estimated() const { return largest_ > 0; }
  /** To be estimated anew: with the materials it may be another. */
  void forget() { largest_ = 0; }

  /** Leaves the shares of A u. */
  void multiply(const AlignedVector<float>& u) { multiply(u, true); }
  /** The same of the smoother's operator, without what of the mass is lumped. */
  void multiplySmoothed(const AlignedVector<float>& u) { multiply(u, !lumped_); }
  /** residual -= what the shares sum up to */
  void subtract()
  {
    forEachPiece(partition_, [&](int t) {
      kernels::table().subtract_shares(sharesOf(model_), partition_.nodeBegin(t), partition_.nodeEnd(t), shares_.data(),
                                       residual.data());
    });
  }

  /** solution += a search, remaining -= a product; then the first term for it, and remaining . B^-1 remaining. */
  double advance(double a)
  {
    return sum([&](int begin, int end) {
      return kernels::table().single_advance(begin, end, static_cast<float>(a), static_cast<float>(1 / centre()),
                                             search.data(), product.data(), inverse_.data(), mass_.data(),
                                             solution.data(), remaining.data(), residual.data(), direction.data(),
                                             correction.data());
    });
  }

  /** product = what the shares sum up to; returns search . product. */
  double sumProduct()
  {
    return sum([&](int begin, int end) {
      return kernels::table().single_sum(sharesOf(model_), begin, end, shares_.data(), search.data(), product.data());
    });
  }

  /** remaining . correction */
  double slope()
  {
    return sum([&](int begin, int end) {
      return kernels::table().single_dot(begin, end, remaining.data(), correction.data());
    });
  }

  /** search = correction + b search */
  void redirect(double b)
  {
    forEachPiece(partition_, [&](int t) {
      kernels::table().single_redirect(partition_.nodeBegin(t), partition_.nodeEnd(t), static_cast<float>(b),
                                       correction.data(), search.data());
    });
  }

  /**
   * Corrects by P c, c of the vertices, and by the first term of a smoothing after it.
   * @param ends  the two vertices of each node, up to a whole group of nodes
   */
  void correct(const float* c, const std::vector<std::array<int, 2>>& ends)
  {
    forEachPiece(partition_, [&](int t) {
      kernels::table().prolonged_product(elements(!lumped_), partition_.blockBegin(t), partition_.blockEnd(t), c,
                                         shares_.data() + FIRST_SHARE);
    });
    forEachPiece(partition_, [&](int t) {
      kernels::table().prolonged_chebyshev(sharesOf(model_), partition_.nodeBegin(t), partition_.nodeEnd(t),
                                           static_cast<float>(1 / centre()), shares_.data(), inverse_.data(),
                                           mass_.data(), ends.data()->data(), c, residual.data(), direction.data(),
                                           correction.data());
    });
  }

  /**
   * The terms of Chebyshev's iteration for the residual after the first one, DEGREE with it. Of the last one only the
   * lumped mass is taken off the residual.
   */
  void smooth()
  {
    const double radius = MARGIN * largest_ - centre(), sigma = centre() / radius;
    double rho = 1 / sigma;
    for (int k = 1; k < DEGREE; ++k)
    {
      multiplySmoothed(direction);
      const double next = 1 / (2 * sigma - rho);
      chebyshev(next * rho, 2 * next / radius);
      rho = next;
    }
  }

  // x, y, z, 0 a node, and up to a whole group of nodes of what is zero or not looked at.
  AlignedVector<float> solution, remaining, search, product;  // of conjugate gradients: x, r, p, A p
  AlignedVector<float> residual, direction, correction;       // of the cycle

private:
  double centre() const { return MARGIN * largest_ * (1 + 1 / RANGE) / 2; }

  kernels::SingleElements elements(bool mass) const
  {
    return {model_.block_offsets.data(),
            linear_.block_offsets.data(),
            model_.block_pairing.data(),
            rotated_.data(),
            coefficients_.data(),
            mean_.empty() ? nullptr : mean_.data(),
            mass};
  }

  void multiply(const AlignedVector<float>& u, bool mass)
  {
    forEachPiece(partition_, [&](int t) {
      kernels::table().single_product(elements(mass), partition_.blockBegin(t), partition_.blockEnd(t), u.data(),
                                      shares_.data() + FIRST_SHARE);
    });
  }

  void chebyshev(double keep, double gain)
  {
    forEachPiece(partition_, [&](int t) {
      kernels::table().single_chebyshev(sharesOf(model_), partition_.nodeBegin(t), partition_.nodeEnd(t),
                                        static_cast<float>(keep), static_cast<float>(gain), shares_.data(),
                                        inverse_.data(), mass_.data(), residual.data(), direction.data(),
                                        correction.data());
    });
  }

  template <class F>
  double sum(const F& f)
  {
    return sumOverNodes(partition_, partial_, f);
  }

  void takeElements(const Rotations& rotations, double alpha, double beta)
  {
    constexpr std::ptrdiff_t BLOCK = 9 * LANES;
    const auto points = static_cast<float>(rotations.points);
    mean_.resize(model_.block_mean.size());
    forEachPiece(partition_, [&](int t) {
      for (std::ptrdiff_t block = partition_.blockBegin(t); block < partition_.blockEnd(t); ++block)
      {
        const double* from = rotations.gradients.data() + block * rotations.points * BLOCK;
        float* to = rotated_.data() + block * BLOCK;
        for (std::ptrdiff_t k = 0; k < BLOCK; ++k) to[k] = static_cast<float>(from[k]);
        // Of several rotations, the mean.
        for (int q = 1; q < rotations.points; ++q)
        {
          for (std::ptrdiff_t k = 0; k < BLOCK; ++k) to[k] += static_cast<float>(from[q * BLOCK + k]);
        }
        for (std::ptrdiff_t k = 0; k < BLOCK && rotations.points > 1; ++k) to[k] /= points;

        const auto take = [](const AlignedVector<double>& numbers, double factor, std::ptrdiff_t first,
                             AlignedVector<float>& taken) {
          for (std::ptrdiff_t k = first; k < first + LANES; ++k) taken[k] = static_cast<float>(factor * numbers[k]);
        };
        const std::ptrdiff_t first = 3 * LANES * block;
        take(model_.block_coefficients, beta, first, coefficients_);
        take(model_.block_coefficients, beta, first + LANES, coefficients_);
        take(model_.block_coefficients, alpha, first + 2 * LANES, coefficients_);
        if (!mean_.empty()) take(model_.block_mean, beta, LANES * block, mean_);
      }
    });
  }

  /** Returns the sum over the nodes of the square of what the lumped mass is of the diagonal. */
  double takeInverse(double alpha, const AlignedVector<double>& inverse)
  {
    constexpr int GROUP = kernels::NODE_GROUP;
    constexpr std::array<int, 12> PLACE{0, 4, 5, 3, 4, 1, 6, 3, 5, 6, 2, 3};  // of columns' numbers in a block
    return sum([&](int begin, int end) {
      double share = 0;
      for (std::ptrdiff_t i = begin; i < end; ++i)
      {
        const double* from = inverse.data() + kernels::DIAGONAL_STRIDE * i;
        float* to = inverse_.data() + i / GROUP * 12 * GROUP + i % GROUP * 4;
        for (int k = 0; k < 12; ++k) to[4 * GROUP * (k / 4) + k % 4] = static_cast<float>(from[PLACE[k]]);
        const double own = alpha * model_.node_mass[i] * (from[0] + from[1] + from[2]) / 3;
        share += own * own;
      }
      return share;
    });
  }

  const Model &model_, &linear_;
  const Partition& partition_;
  double alpha_ = 0, largest_ = 0, mass_share_ = 0;
  bool lumped_ = false;
  // kernels.h tells the layouts.
  AlignedVector<float> rotated_, coefficients_, mean_, inverse_, shares_;
  AlignedVector<float> mass_;    // lumped, of the smoother; zero where it is not
  std::vector<double> partial_;  // a number a chunk of nodes
};

PMultigrid::PMultigrid(const Model& model, const Partition& partition)
    : PMultigrid(model, partition, model.num_corners <= (model.quadratic() ? MOST_FACTORED : MOST_LINEAR_FACTORED))
{
}

PMultigrid::PMultigrid(const Model& model, const Partition& partition, bool factored)
    : linear_(linearModel(model, node_of_vertex_, vertices_of_)),
      linear_rotations_(restRotations(*linear_)),
      inverse_(std::make_unique<TurnedInverse>(
          *linear_, partition.threads(), factored ? TurnedInverse::Form::FACTOR : TurnedInverse::Form::AGGREGATION)),
      held_vertices_(node_of_vertex_.size())
{
  const BlockInverse& inverse = inverse_->inverse();
  cost_ = std::max(10.0, inverse.makingTime() / (4e-7 * model.num_tets + inverse.solvingTime()));
  if (!model.quadratic()) return;
  quadratic_ = std::make_unique<QuadraticLevel>(model, partition, *linear_);
  edges_begin_.assign(node_of_vertex_.size() + 1, 0);
  for (const auto& [a, b] : vertices_of_)
  {
    if (a == b) continue;
    ++edges_begin_[a + 1];
    ++edges_begin_[b + 1];
  }
  std::partial_sum(edges_begin_.begin(), edges_begin_.end(), edges_begin_.begin());
  edges_.resize(edges_begin_.back());
  std::vector<int> next(edges_begin_.begin(), edges_begin_.end() - 1);
  for (int i = 0; i < model.num_nodes; ++i)
  {
    if (vertices_of_[i][0] == vertices_of_[i][1]) continue;
    for (const int vertex : vertices_of_[i]) edges_[next[vertex]++] = i;
  }
  while (vertices_of_.size() % kernels::NODE_GROUP != 0) vertices_of_.push_back({0, 0});
}

PMultigrid::~PMultigrid() = default;

void PMultigrid::forget()
{
  inverse_->forget();
  if (quadratic_) quadratic_->forget();
}

void PMultigrid::took(int iterations)
{
  inverse_->took(iterations, cost_);
}

bool PMultigrid::prepare(const Model& model, const Rotations& rotations, const HeldAxes& held, double alpha,
                         double beta, const AlignedVector<double>& inverse)
{
  one_rotation_ = rotations.points == 1;
  if (quadratic_) quadratic_->take(rotations, alpha, beta, inverse);
  for (std::size_t k = 0; k < node_of_vertex_.size(); ++k) held_vertices_[k] = held[node_of_vertex_[k]];
  const bool same = inverse_->isOf(held_vertices_, alpha, beta);
  if (!same || !inverse_->valid())
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
    if (!inverse_->make(linear_rotations_, rotations, held_vertices_, alpha, beta)) return false;
    if (quadratic_ && !(same && quadratic_->estimated())) quadratic_->estimateLargest(held);
  }
  inverse_->turn(rotations);
  return true;
}

/** One V-cycle for the residual, of which the smoother's first term is there already, to `correction`. */
void PMultigrid::cycle()
{
  QuadraticLevel& level = *quadratic_;
  level.smooth();
  level.multiplySmoothed(level.direction);
  level.subtract();
  using Node = Eigen::Map<Eigen::Vector4f, Eigen::Aligned16>;
  using ConstNode = Eigen::Map<const Eigen::Vector4f, Eigen::Aligned16>;
  const float* residual = level.residual.data();
  // Regions hold edges where they hold both corners: so edges need no mask of their own.
  const auto restrict = [&](const int* vertices, int count) {
    for (int k = 0; k < count; ++k)
    {
      const int vertex = vertices[k];
      Eigen::Vector4f edges = Eigen::Vector4f::Zero();
      for (int e = edges_begin_[vertex]; e < edges_begin_[vertex + 1]; ++e)
      {
        edges += ConstNode(residual + 4L * edges_[e]);
      }
      Node(inverse_->right() + 4L * vertex) = ConstNode(residual + 4L * node_of_vertex_[vertex]) + 0.5f * edges;
    }
  };
  const float* corners = inverse_->solve(std::ref(restrict));
  level.correct(corners, vertices_of_);
  level.smooth();
}

void PMultigrid::apply(const NodalField& r, NodalField& z)
{
  if (!quadratic_)
  {
    inverse_->apply(r, z);
    return;
  }
  const double scale = quadratic_->start(r);
  cycle();
  const std::ptrdiff_t numbers = 4L * z.size();
  Eigen::Map<Eigen::VectorXd>(z.data(), numbers) =
      scale * Eigen::Map<const Eigen::VectorXf>(quadratic_->correction.data(), numbers).cast<double>();
}

bool PMultigrid::hasProduct(double tolerance) const
{
  return quadratic_ && one_rotation_ && tolerance * quadratic_->massShare() > ROUGH;
}

void PMultigrid::product(const NodalField& u, NodalField& rounded, NodalField& out)
{
  quadratic_->roundedProduct(u, rounded, out);
}

int PMultigrid::improve(const NodalField& r, double target, int max_iterations, NodalField& u)
{
  QuadraticLevel& level = *quadratic_;
  const double scale = level.start(r);
  target /= scale;
  int iterations = 0;
  double before = 0;
  while (iterations < max_iterations)
  {
    cycle();
    const double slope = level.slope();
    if (!(slope > 0)) break;
    level.redirect(iterations == 0 ? 0 : slope / before);
    before = slope;
    level.multiply(level.search);
    const double curvature = level.sumProduct();
    if (!(curvature > 0)) break;
    ++iterations;
    if (!(level.advance(slope / curvature) > target * target)) break;
  }
  level.addTo(u, scale);
  return iterations;
}

}  // namespace bezier_fem
