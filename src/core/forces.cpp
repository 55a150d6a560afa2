#include "forces.h"

#include "bezier_fem/element_operator.h"
#include "bezier_fem/green_strain.h"

namespace bezier_fem
{
void externalForce(const Model& model, const StepSettings& settings, const std::vector<AppliedLoad>& loads,
                   const NodalField& external, double time, const NodalField& x, NodalField& f)
{
  f.matrix() = external.matrix();
  for (int i = 0; i < model.num_nodes; ++i) f[i] += model.node_mass[i] * settings.gravity;
  addLoads(model, loads, time, x, f);
}

void internalForce(const Model& model, const Partition& partition, Elasticity elasticity, const Rotations& rotations,
                   const NodalField& x, NodalField& f)
{
  if (elasticity == Elasticity::GREEN)
  {
    greenForce(model, partition, x, f);
  }
  else
  {
    elasticForce(model, partition, rotations, x, f);
  }
}

}  // namespace bezier_fem
