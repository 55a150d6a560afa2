#pragma once

#include "bezier_fem/assembled_system.h"
#include "bezier_fem/step.h"

namespace bezier_fem
{
/** f = gravity, the scene's loads and the external forces at a time and positions x, N. */
void externalForce(const Model& model, const Partition& partition, const StepSettings& settings,
                   const std::vector<AppliedLoad>& loads, const NodalField& external, double time, const NodalField& x,
                   NodalField& f);

/** f = f_el(x) of the elasticity that the settings name, N. */
void internalForce(const Model& model, const Partition& partition, Elasticity elasticity, const Rotations& rotations,
                   const NodalField& x, NodalField& f);

/** alpha M + beta K in the form that the settings ask for. */
template <class Linearisation>
const SystemOperator& systemOf(const MatrixFreeSystem<Linearisation>& matrix_free, const Linearisation& at,
                               double alpha, double beta, Workspace& w)
{
  if (!w.assembled) return matrix_free;
  w.assembled->assemble(at, alpha, beta);
  return *w.assembled;
}

}  // namespace bezier_fem
