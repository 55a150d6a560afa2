#include "forces.h"

#include "bezier_fem/element_operator.h"
#include "bezier_fem/green_strain.h"
#include "parallel.h"

namespace bezier_fem
{
void externalForce(const Model& model, const Partition& partition, const StepSettings& settings,
                   const std::vector<AppliedLoad>& loads, const NodalField& external, double time, const NodalField& x,
                   NodalField& f)
{
  const Eigen::Vector4d gravity(settings.gravity[0], settings.gravity[1], settings.gravity[2], 0);
  forEachPiece(partition, [&](int t) {
    for (int i = partition.nodeBegin(t); i < partition.nodeEnd(t); ++i)
    {
      f.matrix().col(i) = external.matrix().col(i) + model.node_mass[i] * gravity;
    }
  });
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
