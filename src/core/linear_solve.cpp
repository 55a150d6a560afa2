#include "linear_solve.h"

#include <algorithm>
#include <cmath>

#include "bezier_fem/p_multigrid.h"
#include "direct_preconditioner.h"
#include "forces.h"

namespace bezier_fem
{
namespace
{
using Kind = Scene::Solver::Preconditioner;

/** Iterations with the diagonal blocks that cost about as much as a few of multigrid's. */
constexpr int PATIENCE = 20;
/** The same where the factor may not serve again. */
constexpr int PATIENCE_ONCE = 200;
/** Of the linear elements: beyond, the system of their aggregates is as large as what is factored elsewhere. */
constexpr int MOST_VERTICES = 400000;
/** Of the whole system: beyond, its factor leaves the caches, and takes half a second to make. */
constexpr int MOST_NODES = 3000;

/** What is tried beside the diagonal blocks. */
Kind kindOf(const Model& model, Kind wanted, Serves serves)
{
  if (wanted != Kind::AUTO) return wanted;
  if (serves == Serves::ALWAYS && model.num_nodes <= MOST_NODES) return Kind::DIRECT;
  return model.num_corners <= MOST_VERTICES ? Kind::PMULTIGRID : Kind::BLOCK_JACOBI;
}

void make(Kind kind, const Model& model, Workspace& w)
{
  if (w.preconditioner && w.preconditioner_kind == kind) return;
  if (kind == Kind::DIRECT)
  {
    w.preconditioner = std::make_unique<DirectPreconditioner>(model, w.partition.threads());
  }
  else
  {
    w.preconditioner = std::make_unique<PMultigrid>(model, w.partition);
  }
  w.preconditioner_kind = kind;
}
/** A preconditioner as that of another system: it can be applied, but what it solves by itself is not that system. */
class OfLikeSystem final : public Preconditioner
{
public:
  explicit OfLikeSystem(Preconditioner* own) : own_(own) {}
  bool prepare(const Model& model, const Rotations& rotations, const HeldAxes& held, double alpha, double beta,
               const AlignedVector<double>& inverse) override
  {
    return own_->prepare(model, rotations, held, alpha, beta, inverse);
  }
  void forget() override { own_->forget(); }
  void took(int iterations) override { own_->took(iterations); }
  int patience() const override { return own_->patience(); }
  void apply(const NodalField& r, NodalField& z) override { own_->apply(r, z); }

private:
  Preconditioner* own_;
};
}  // namespace

const SystemOperator& prepareSystem(const Model& model, const StepSettings& settings, const Supports& supports,
                                    const MatrixFreeSystem<Rotations>& matrix_free, const Rotations& rotations,
                                    double alpha, double beta, double load_floor, Workspace& w)
{
  const bool linear = settings.elasticity == Elasticity::LINEAR;
  const auto& last = w.prepared;
  if (linear && last && last->alpha == alpha && last->beta == beta && last->load_floor == load_floor &&
      last->held == supports.held)
  {
    if (w.assembled) return *w.assembled;
    return matrix_free;
  }
  const SystemOperator& system = systemOf(matrix_free, rotations, alpha, beta, w);
  w.solver.prepare(system, model, w.partition, supports.held, load_floor);
  if (linear) w.prepared = Workspace::PreparedSystem{alpha, beta, load_floor, supports.held};
  return system;
}

SolveReport solvePreconditioned(const Model& model, const StepSettings& settings, const Supports& supports,
                                const Rotations& rotations, Likeness likeness, const SystemOperator& system,
                                double alpha, double beta, double tolerance, int max_iterations, Serves serves,
                                const Start& start, Workspace& w, StepReport& report)
{
  const Kind wanted = settings.solver.preconditioner, kind = kindOf(model, wanted, serves);
  const bool possible = kind != Kind::BLOCK_JACOBI && !w.preconditioner_failed;
  const bool lasting = serves != Serves::ONCE;
  int iterations = 0;
  SolveReport solved;
  const auto solve = [&](Preconditioner* preconditioner, int limit) {
    OfLikeSystem of_like(preconditioner);
    if (preconditioner && likeness == Likeness::LIKE) preconditioner = &of_like;
    solved = w.solver.solve(system, w.partition, w.rhs, w.change, tolerance, limit, preconditioner);
    iterations += solved.iterations;
  };
  const auto prepare = [&] {
    if (likeness == Likeness::SAME)
    {
      return w.preconditioner->prepare(model, rotations, supports.held, alpha, beta, w.solver.inverse());
    }
    // The smoother's largest eigenvalue is that of this diagonal.
    const MatrixFreeSystem<Rotations> like(model, w.partition, rotations, alpha, beta);
    w.solver.invertDiagonal(like, model, w.partition, supports.held, w.like_inverse);
    return w.preconditioner->prepare(model, rotations, supports.held, alpha, beta, w.like_inverse);
  };

  bool started = false;
  const bool at_once = possible && lasting && (w.preconditioner || wanted != Kind::AUTO || kind == Kind::DIRECT);
  if (!at_once)
  {
    started = true;
    start(nullptr);
    solve(nullptr, possible ? std::min(lasting ? PATIENCE : PATIENCE_ONCE, max_iterations) : max_iterations);
  }
  if (at_once || (possible && !solved.converged && !solved.indefinite && iterations < max_iterations))
  {
    make(kind, model, w);
    report.preconditioner = kind;
    bool again = true;
    while (again)
    {
      w.preconditioner_failed = !prepare();
      if (!started)
      {
        started = true;
        const bool rough =
            !w.preconditioner_failed && likeness == Likeness::SAME && w.preconditioner->hasProduct(tolerance);
        start(rough ? w.preconditioner.get() : nullptr);
      }
      if (w.preconditioner_failed)
      {
        report.preconditioner = Kind::BLOCK_JACOBI;
        solve(nullptr, max_iterations - iterations);
        break;
      }
      // That of systems like it is counted in iterations a digit.
      const int patience = likeness == Likeness::SAME ? w.preconditioner->patience() : max_iterations + 1;
      solve(w.preconditioner.get(), std::min(max_iterations - iterations, patience));
      if (likeness == Likeness::SAME)
      {
        w.preconditioner->took(solved.iterations);
      }
      else if (at_once && solved.converged)
      {
        // Newton's systems are solved to another tolerance each time.
        const double before = w.solver.relativeNorm(w.partition, w.rhs, w.rhs);
        const double digits = std::max(1.0, std::log10(before / solved.residual));
        w.preconditioner->took(static_cast<int>(std::lround(solved.iterations / digits)));
      }
      again = !solved.converged && solved.iterations == patience && iterations < max_iterations;
    }
  }
  report.iterations += iterations;
  solved.iterations = iterations;
  return solved;
}

void solveLinear(const Model& model, const StepSettings& settings, const Supports& supports, const Rotations& rotations,
                 const SystemOperator& system, double alpha, double beta, double tolerance, int max_iterations,
                 Serves serves, const Start& start, Workspace& w, StepReport& report)
{
  const SolveReport solved = solvePreconditioned(model, settings, supports, rotations, Likeness::SAME, system, alpha,
                                                 beta, tolerance, max_iterations, serves, start, w, report);
  report.residual = std::max(report.residual, solved.residual);
  report.converged = report.converged && solved.converged;
}

}  // namespace bezier_fem
