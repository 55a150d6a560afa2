#pragma once

#include <functional>

#include "bezier_fem/preconditioner.h"
#include "bezier_fem/step.h"

namespace bezier_fem
{
/** How long what is made for a system, a factor above all, will serve. */
enum class Serves
{
  ONCE,
  SAME_COEFFICIENTS,  // systems to come have the same alpha and beta
  ALWAYS              // and the same rotations: linear elasticity
};

/**
 * The system alpha M + beta K' in the form that the settings ask for, and workspace.solver prepared for it. With linear
 * elasticity nothing is done where it is that of the last call.
 */
const SystemOperator& prepareSystem(const Model& model, const StepSettings& settings, const Supports& supports,
                                    const MatrixFreeSystem<Rotations>& matrix_free, const Rotations& rotations,
                                    double alpha, double beta, double load_floor, Workspace& workspace);

using Start = std::function<void(Preconditioner*)>;

/** What the matrix alpha M + beta K' of some rotations is to a system. */
enum class Likeness
{
  SAME,
  LIKE  // near enough for what is made of it to precondition the system, which is solved from zero
};

/**
 * Solves a system for workspace.change, of workspace.rhs, with the preconditioner that the settings ask for, made of
 * alpha M + beta K'; workspace.solver is prepared for the system. `auto` begins with the diagonal blocks and goes on
 * with multigrid where these take long, from then on at once; systems that always stay the same it factors, unless they
 * are large. Where the diagonal blocks meet a direction of negative curvature, what they have reached is the result.
 * @param start   sets workspace.change to begin with; is given what has products of the same system, or null
 * @param report  its iterations and preconditioner are brought up to date
 */
SolveReport solvePreconditioned(const Model& model, const StepSettings& settings, const Supports& supports,
                                const Rotations& rotations, Likeness likeness, const SystemOperator& system,
                                double alpha, double beta, double tolerance, int max_iterations, Serves serves,
                                const Start& start, Workspace& workspace, StepReport& report);

/**
 * Solves (alpha M + beta K') u = workspace.rhs for u = workspace.change in this way.
 * @param report  its residual and converged are brought up to date too
 */
void solveLinear(const Model& model, const StepSettings& settings, const Supports& supports, const Rotations& rotations,
                 const SystemOperator& system, double alpha, double beta, double tolerance, int max_iterations,
                 Serves serves, const Start& start, Workspace& workspace, StepReport& report);

}  // namespace bezier_fem
