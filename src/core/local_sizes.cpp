#include "bezier_fem/local_sizes.h"

#include <algorithm>
#include <cmath>

#include "bezier_fem/error.h"
#include "bezier_fem/green_strain.h"
#include "bezier_fem/measures.h"

namespace bezier_fem
{
namespace
{
/** Adds to each element's density of error, J/m^3, that of the present state. */
void addDensities(const Simulation& simulation, std::vector<double>& densities)
{
  const Model& model = simulation.model();
  const State& state = simulation.state();
  const bool green = simulation.scene().elasticity == Elasticity::GREEN;
  const auto smooth = simulation.nodalStress();
  for (int t = 0; t < model.num_tets; ++t)
  {
    for (int c = 0; c < CORNERS; ++c)
    {
      const MaterialPoint corner{t, Eigen::Vector4d::Unit(c)};
      const Stress own =
          green ? greenStressAt(model, state.x, corner) : stressAt(model, state.rotations, state.x, corner);
      const Stress apart = own - smooth.col(model.nodesOf(t)[c]);
      densities[t] += (apart.head<3>().squaredNorm() + 2 * apart.tail<3>().squaredNorm()) /
                      (4 * CORNERS * lameMu(model.materials[t]));
    }
  }
}
}  // namespace

std::vector<SizePoint> balancedSizes(const Scene& scene, const RunPlan& plan)
{
  constexpr long MOST_TIMES = 20;
  Simulation simulation(scene, plan.threads, [](const std::string&) {});
  const Model& model = simulation.model();
  std::vector<double> densities(model.num_tets, 0.0);
  if (plan.statics)
  {
    simulation.solveStatic();
    addDensities(simulation, densities);
  }
  else
  {
    const auto steps = static_cast<long>(std::ceil(plan.duration / scene.time_step - 1e-6));
    const long every = std::max(1L, steps / MOST_TIMES);
    for (long step = 1; step <= steps; ++step)
    {
      simulation.step();
      if (step % every == 0) addDensities(simulation, densities);
    }
  }

  const double order = model.quadratic() ? 2 : 1;
  double mean = 0;
  std::vector<double> edges(model.num_tets);  // of a regular tetrahedron of the same volume, m
  std::vector<double> factors(model.num_tets);
  for (int t = 0; t < model.num_tets; ++t)
  {
    edges[t] = std::cbrt(6 * std::sqrt(2.0) * model.volumes[t]);
    factors[t] = densities[t] / std::pow(edges[t], 2 * order);
    mean += factors[t] * model.volumes[t] / model.volume();
  }
  constexpr double ROUNDING = 1e-24;  // of Young's modulus: the energy density of a strain of 1e-12
  if (!(*std::max_element(densities.begin(), densities.end()) > ROUNDING * scene.material.young))
    throw InputError("--local: there is no stress in this scene to refine for");
  double wanted = 0;  // elements, with the factors for sizes in m and but for a constant
  for (int t = 0; t < model.num_tets; ++t)
  {
    constexpr double LEAST = 1e-6;  // what bears next to nothing needs no elements of any size
    factors[t] = std::pow(std::max(factors[t] / mean, LEAST), -1 / (2 * order + 3));
    wanted += model.volumes[t] / std::pow(factors[t], 3);
  }
  const double scale =
      *scene.model.cell_size * std::cbrt(wanted / model.volume());  // as many as at cell_size everywhere
  std::vector<SizePoint> sizes(model.num_tets);
  for (int t = 0; t < model.num_tets; ++t)
  {
    sizes[t].position.setZero();
    for (int c = 0; c < CORNERS; ++c) sizes[t].position += model.rest[model.nodesOf(t)[c]] / CORNERS;
    sizes[t].size = scale * factors[t];
  }
  return sizes;
}

}  // namespace bezier_fem
