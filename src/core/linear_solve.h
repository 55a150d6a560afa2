#pragma once

#include "bezier_fem/step.h"

namespace bezier_fem
{
/**
 * Solves (alpha M + beta K') u = workspace.rhs for u = workspace.change, which is also the start, with the
 * preconditioner that the settings ask for; workspace.solver is prepared for the system. `auto` begins with the
 * diagonal blocks and goes on with multigrid where these take long, from then on at once.
 * @param lasting  whether steps to come have the same alpha and beta, so that a factorisation pays
 * @param report   its iterations, residual, converged and multigrid are brought up to date
 */
void solveLinear(const Model& model, const StepSettings& settings, const Supports& supports, const Rotations& rotations,
                 const SystemOperator& system, double alpha, double beta, double tolerance, int max_iterations,
                 bool lasting, Workspace& workspace, StepReport& report);

}  // namespace bezier_fem
