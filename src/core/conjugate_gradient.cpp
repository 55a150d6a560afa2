#include "bezier_fem/conjugate_gradient.h"

#include <Eigen/Dense>
#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>

#include "kernels.h"
#include "parallel.h"

namespace bezier_fem
{
ConjugateGradient::ConjugateGradient(const Model& model, const Partition& partition)
    : inverse_(static_cast<std::size_t>(kernels::DIAGONAL_STRIDE) * model.num_nodes),
      r_(model.num_nodes),
      z_(model.num_nodes),
      p_(model.num_nodes),
      q_(model.num_nodes),
      extrapolated_(model.num_nodes),
      rounded_(model.num_nodes),
      partial_(partition.numChunks())
{
  images_.fill(NodalField(model.num_nodes));
}

template <class F>
double ConjugateGradient::sum(const Partition& partition, const F& f)
{
  return sumOverNodes(partition, partial_, f);
}

ConjugateGradient::Blocks ConjugateGradient::invertDiagonal(const SystemOperator& system, const Model& model,
                                                            const Partition& partition, const HeldAxes& held,
                                                            AlignedVector<double>& inverse)
{
  inverse.resize(inverse_.size());
  system.diagonal(inverse);
  std::atomic<bool> all_definite = true;
  // The load is M times a uniform field of ones: the integral of rho B_I.
  const double load2 = sum(partition, [&](int begin, int end) {
    bool definite = true;
    const double part =
        kernels::table().invert_blocks(begin, end, held.data(), model.node_mass.data(), inverse.data(), &definite);
    if (!definite) all_definite = false;
    return part;
  });
  return {all_definite, load2};
}

bool ConjugateGradient::prepare(const SystemOperator& system, const Model& model, const Partition& partition,
                                const HeldAxes& held, double load_floor)
{
  const Blocks blocks = invertDiagonal(system, model, partition, held, inverse_);
  floor_ = load_floor * std::sqrt(blocks.load2);
  return blocks.definite;
}

double ConjugateGradient::norm(const Partition& partition, const NodalField& r)
{
  return std::sqrt(sum(
      partition, [&](int begin, int end) { return kernels::table().norm2(begin, end, inverse_.data(), r.data()); }));
}

double ConjugateGradient::relativeNorm(const Partition& partition, const NodalField& r, const NodalField& b)
{
  const double scale = std::max(norm(partition, b), floor_);
  return scale == 0 ? 0 : norm(partition, r) / scale;
}

void ConjugateGradient::start(const SystemOperator& system, const Partition& partition, const NodalField& b,
                              const std::array<NodalField, 3>& past, int count, NodalField& u, Preconditioner* rough)
{
  u.setZero();
  product_known_ = false;
  product_rough_ = rough != nullptr;
  if (count == 0) return;
  // The last one, and the extrapolation from all: a third direction saves less than its product costs.
  const int directions = std::min(count, 2);
  const std::array<const NodalField*, 2> basis{product_rough_ ? &rounded_ : &past[0], &extrapolated_};
  forEachChunk(partition, [&](int first, int nodes) {
    const auto of = [&](int k) { return past[k].columns(first, nodes); };
    if (count == 2) extrapolated_.columns(first, nodes) = 2 * of(0) - of(1);
    if (count == 3) extrapolated_.columns(first, nodes) = 3 * (of(0) - of(1)) + of(2);
  });
  Eigen::Matrix2d gram = Eigen::Matrix2d::Identity();
  Eigen::Vector2d work = Eigen::Vector2d::Zero();
  const auto dot = [&](const NodalField& a, const NodalField& c) {
    return sum(partition, [&](int begin, int end) { return kernels::table().dot(begin, end, a.data(), c.data()); });
  };
  for (int k = 0; k < directions; ++k)
  {
    if (product_rough_)
    {
      const std::array<NodalField*, 2> rounded{&rounded_, &extrapolated_};
      rough->product(k == 0 ? past[0] : extrapolated_, *rounded[k], images_[k]);
    }
    else
    {
      system.product(*basis[k], images_[k]);
    }
    work[k] = dot(*basis[k], b);
    for (int j = 0; j <= k; ++j) gram(j, k) = gram(k, j) = dot(*basis[j], images_[k]);
  }
  if (!gram.allFinite()) return;  // nor are all images numbers
  const Eigen::Vector2d scale = gram.diagonal().cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
  const Eigen::LLT<Eigen::Matrix2d> llt(scale.asDiagonal() * gram * scale.asDiagonal());
  Eigen::Vector2d weights = scale.cwiseProduct(llt.solve(scale.cwiseProduct(work)));
  // Where the two do not differ, the last one.
  if (llt.info() != Eigen::Success) weights = {work[0] / gram(0, 0), 0};
  if (!weights.allFinite()) return;  // there was no motion
  forEachChunk(partition, [&](int first, int nodes) {
    q_.columns(first, nodes) = weights[0] * images_[0].columns(first, nodes);
    u.columns(first, nodes) = weights[0] * basis[0]->columns(first, nodes);
    if (directions == 1) return;
    q_.columns(first, nodes) += weights[1] * images_[1].columns(first, nodes);
    u.columns(first, nodes) += weights[1] * basis[1]->columns(first, nodes);
  });
  product_known_ = true;
}

SolveReport ConjugateGradient::solve(const SystemOperator& system, const Partition& partition, const NodalField& b,
                                     NodalField& u, double tolerance, int max_iterations,
                                     Preconditioner* preconditioner)
{
  const kernels::Table& kernel = kernels::table();
  const double scale = std::max(norm(partition, b), floor_);
  SolveReport report;
  if (!(scale > 0) || !std::isfinite(scale))
  {
    // Nothing is free, or nothing is finite.
    product_known_ = false;
    u.setZero();
    r_.matrix() = b.matrix();
    report.converged = scale == 0;
    report.residual = scale;
    return report;
  }
  bool may_restart = !product_known_;  // start()'s is not
  bool rough = product_known_ && product_rough_;
  double residual_before = std::numeric_limits<double>::infinity();
  while (true)
  {
    if (!product_known_) system.product(u, q_);
    product_known_ = false;
    double norm2 = sum(partition, [&](int begin, int end) {
      return kernel.residual(begin, end, b.data(), q_.data(), inverse_.data(), r_.data());
    });
    if (may_restart && norm2 > scale * scale)
    {
      // The start value is worse than none.
      may_restart = false;
      u.setZero();
      continue;
    }
    may_restart = false;
    report.residual = std::sqrt(norm2) / scale;
    report.converged = report.residual <= tolerance;
    if (rough)
    {
      // Not what is reported, which is of double precision.
      rough = false;
      if (report.converged || report.iterations >= max_iterations) continue;
    }
    if (report.converged || report.iterations >= max_iterations || !std::isfinite(norm2)) return report;
    const double target = tolerance * scale;
    if (preconditioner && preconditioner->improves() && report.residual < 0.5 * residual_before)
    {
      // What single precision can do at once is three digits or so. A little below the target, so that its rounding
      // does not cost a second round.
      residual_before = report.residual;
      report.iterations += preconditioner->improve(r_, std::max(0.9 * target, 1e-3 * std::sqrt(norm2)),
                                                   max_iterations - report.iterations, u);
      continue;
    }
    const auto precondition = [&](NodalField& z) {
      preconditioner->apply(r_, z);
      return sum(partition, [&](int begin, int end) { return kernel.dot(begin, end, r_.data(), z.data()); });
    };
    double rz = norm2;
    if (preconditioner)
    {
      rz = precondition(p_);
    }
    else
    {
      forEachPiece(partition, [&](int t) {
        kernel.times_inverse(partition.nodeBegin(t), partition.nodeEnd(t), inverse_.data(), r_.data(), p_.data());
      });
    }
    if (!(rz > 0))
    {
      if (!preconditioner) return report;
      preconditioner = nullptr;  // has lost its way, as it may with every element turned inside out
      continue;
    }
    while (report.iterations < max_iterations)
    {
      system.product(p_, q_);
      const double curvature =
          sum(partition, [&](int begin, int end) { return kernel.dot(begin, end, p_.data(), q_.data()); });
      ++report.iterations;
      if (!(curvature > 0))
      {
        report.indefinite = true;
        return report;
      }
      const double before = rz;
      norm2 = sum(partition, [&](int begin, int end) {
        return kernel.advance(begin, end, before / curvature, p_.data(), q_.data(), inverse_.data(), u.data(),
                              r_.data(), z_.data());
      });
      // A little below, so that rounding in the update does not cost a second round.
      if (!(std::sqrt(norm2) > 0.99 * target)) break;
      rz = preconditioner ? precondition(z_) : norm2;
      if (!(rz > 0)) break;
      forEachPiece(partition, [&](int t) {
        kernel.redirect(partition.nodeBegin(t), partition.nodeEnd(t), rz / before, z_.data(), p_.data());
      });
    }
  }
}

}  // namespace bezier_fem
