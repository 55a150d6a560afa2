#include "linear_solve.h"

#include <algorithm>

#include "bezier_fem/p_multigrid.h"

namespace bezier_fem
{
namespace
{
/** Iterations with the diagonal blocks that cost about as much as multigrid's dozen. */
constexpr int PATIENCE = 60;
/** The same where the factor may not serve again. */
constexpr int PATIENCE_ONCE = 200;
/** Of the linear elements: beyond, their factor is no longer cheap to apply. */
constexpr int MOST_VERTICES = 7000;
}  // namespace

void solveLinear(const Model& model, const StepSettings& settings, const Supports& supports, const Rotations& rotations,
                 const SystemOperator& system, double alpha, double beta, double tolerance, int max_iterations,
                 bool lasting, Workspace& w, StepReport& report)
{
  using Preconditioner = Scene::Solver::Preconditioner;
  const Preconditioner wanted = settings.solver.preconditioner;
  const bool possible = !w.multigrid_failed && wanted != Preconditioner::BLOCK_JACOBI &&
                        (wanted == Preconditioner::PMULTIGRID || model.num_corners <= MOST_VERTICES);
  int iterations = 0;
  SolveReport solved;
  const auto solve = [&](PMultigrid* multigrid, int limit) {
    solved = w.solver.solve(system, w.partition, w.rhs, w.change, tolerance, limit, multigrid);
    iterations += solved.iterations;
  };

  bool multigrid = possible && lasting && (w.multigrid || wanted == Preconditioner::PMULTIGRID);
  if (!multigrid)
  {
    solve(nullptr, possible ? std::min(lasting ? PATIENCE : PATIENCE_ONCE, max_iterations) : max_iterations);
    multigrid = possible && !solved.converged && iterations < max_iterations;
  }
  if (multigrid)
  {
    if (!w.multigrid) w.multigrid = std::make_unique<PMultigrid>(model, w.partition);
    w.multigrid_failed = !w.multigrid->prepare(model, rotations, supports.held, alpha, beta, w.solver.inverse());
    solve(w.multigrid_failed ? nullptr : w.multigrid.get(), max_iterations - iterations);
    report.multigrid = !w.multigrid_failed;
    w.multigrid->took(solved.iterations);
  }
  report.iterations += iterations;
  report.residual = std::max(report.residual, solved.residual);
  report.converged = report.converged && solved.converged;
}

}  // namespace bezier_fem
