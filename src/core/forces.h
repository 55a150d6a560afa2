#pragma once

#include "bezier_fem/assembled_system.h"
#include "bezier_fem/step.h"

namespace bezier_fem
{
/** f = gravity, the scene's loads and the external forces at a time and positions x, N. */
void externalForce(const Model& model, const StepSettings& settings, const std::vector<AppliedLoad>& loads,
                   const NodalField& external, double time, const NodalField& x, NodalField& f);

/** f = f_el(x) of the elasticity that the settings name, N; model.num_nodes rows. */
void internalForce(const Model& model, const Partition& partition, Elasticity elasticity, const Rotations& rotations,
                   const NodalField& x, NodalField& f);

/** The first rows of a field that has ghost rows behind them. */
inline auto nodes(NodalField& field, const Model& model)
{
  return field.matrix().leftCols(model.num_nodes);
}
inline auto nodes(const NodalField& field, const Model& model)
{
  return field.matrix().leftCols(model.num_nodes);
}

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
