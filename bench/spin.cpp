#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "accuracy.h"
#include "bezier_fem/element_operator.h"
#include "bezier_fem/green_strain.h"
#include "bezier_fem/measures.h"
#include "bezier_fem/step.h"
#include "core/bar.h"

namespace bezier_fem::bench
{
namespace
{
constexpr double DURATION = 10, ROW_EVERY = 0.1;  // s

struct Conserved
{
  Eigen::Vector3d momentum;          // kg m/s
  Eigen::Vector3d angular_momentum;  // kg m^2/s, about the centre of mass
  double energy;                     // J
};

/** Exact for the field: with the mass matrix, not with masses at points. */
Conserved measure(const Model& model, Elasticity elasticity, const State& state, Workspace& workspace)
{
  Conserved now{Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero(), kineticEnergy(model, state.v)};
  now.energy +=
      elasticity == Elasticity::GREEN ? greenEnergy(model, state.x) : elasticEnergy(model, state.rotations, state.x);
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  for (int i = 0; i < model.num_nodes; ++i) centre += model.node_mass[i] / model.mass() * state.x[i];
  systemProduct(model, workspace.partition, state.rotations, 1, 0, state.v, workspace.force);
  for (int i = 0; i < model.num_nodes; ++i)
  {
    const Eigen::Vector3d p = workspace.force[i];
    now.momentum += p;
    now.angular_momentum += (state.x[i] - centre).cross(p);
  }
  return now;
}

/** How a body starts; what it keeps is told relative to what its energy could be as motion. */
struct Motion
{
  const char* name;
  double bend;           // rad from end to end
  Eigen::Vector3d spin;  // rad/s
};

/** The bar bent to an arc in the y-z plane, around its middle. */
NodalField bent(const Model& model, double angle)
{
  NodalField x = model.rest;
  if (angle == 0) return x;
  const double radius = 1 / angle;
  for (int i = 0; i < model.num_nodes; ++i)
  {
    const Eigen::Vector3d X = model.rest[i];
    const double at = angle * (X.z() - 0.5), r = radius + X.y() - 0.2;
    x[i] = Eigen::Vector3d(X.x(), 0.2 + r * std::cos(at) - radius, 0.5 + r * std::sin(at));
  }
  return x;
}

struct Law
{
  const char* elasticity;
  const char* rotation;  // null where the law has none
  Elasticity key;
  RotationRule rule;
};

struct Integration
{
  const char* name;
  decltype(&implicitEulerStep) step;
  double time_step;  // s
};

void addRun(const Motion& motion, Element element, const Law& law, const Integration& integration, Table& table)
{
  const Model model = test::boxModel(test::kuhnBox({2, 2, 5}, {0.4, 0.4, 1}), element);
  progress(std::string(motion.name) + ", " + test::name(element) + ", " + law.elasticity +
           (law.rotation ? std::string(" ") + law.rotation : "") + ", " + integration.name + " " +
           std::to_string(integration.time_step) + " s");
  Supports supports;
  supports.start = model.rest;
  supports.held.assign(model.num_nodes, 0);
  supports.region.assign(model.num_nodes, {-1, -1, -1});
  StepSettings settings{};
  settings.time_step = integration.time_step;
  settings.elasticity = law.key;
  settings.rotation = law.rule;
  settings.gravity.setZero();
  settings.solver.tolerance = 1e-7;  // the solver's error is not what is measured
  settings.solver.max_iterations = 10000;
  Workspace workspace(model, settings, 1);
  const NodalField no_force(model.num_nodes);
  State state = startState(model, settings, supports, bent(model, motion.bend), Eigen::Vector3d::Zero(), workspace);
  for (int i = 0; i < model.num_nodes; ++i)
  {
    state.v[i] = motion.spin.cross(Eigen::Vector3d(state.x[i] - Eigen::Vector3d(0.2, 0.2, 0.5)));
  }

  const Conserved start = measure(model, law.key, state, workspace);
  const double momentum = std::sqrt(2 * model.mass() * start.energy);
  const double angular_momentum =
      momentum * std::sqrt((0.4 * 0.4 + 1) / 12);  // inertia about the middle: m (a^2 + l^2)/12
  const int steps = static_cast<int>(std::lround(DURATION / integration.time_step));
  const int every = static_cast<int>(std::lround(ROW_EVERY / integration.time_step));
  int rows = 0;
  double residual = 0;
  for (int k = 0; k <= steps; ++k)
  {
    if (k > 0)
    {
      const StepReport report = integration.step(model, settings, supports, {}, no_force, state, workspace);
      if (!report.finite) throw std::runtime_error("the state was lost");
      residual = std::max(residual, report.residual);
    }
    if (k % every != 0) continue;
    const Conserved now = measure(model, law.key, state, workspace);
    table.push_back({{"motion", motion.name},
                     {"element", test::name(element)},
                     {"elasticity", law.elasticity},
                     {"rotation", law.rotation ? Table(law.rotation) : Table()},
                     {"integrator", integration.name},
                     {"time_step", integration.time_step},
                     {"time", ROW_EVERY * rows++},
                     {"momentum", (now.momentum - start.momentum).norm() / momentum},
                     {"angular_momentum", (now.angular_momentum - start.angular_momentum).norm() / angular_momentum},
                     {"energy", now.energy / start.energy},
                     {"worst_residual", residual}});
  }
}
}  // namespace

Table spin()
{
  const Motion motions[] = {{"spin", 0, {5, 0.5, 0.5}}, {"swing", 0.6, {0, 0, 0}}};
  const Law laws[] = {{"corotated", "corners", Elasticity::COROTATED, RotationRule::FROM_CORNERS},
                      {"corotated", "centroid", Elasticity::COROTATED, RotationRule::FROM_CENTROID},
                      {"corotated", "four", Elasticity::COROTATED, RotationRule::FOUR_POINTS},
                      {"green", nullptr, Elasticity::GREEN, RotationRule::FROM_CORNERS}};
  const Integration integrations[] = {{"implicit_euler", implicitEulerStep, 0.02},
                                      {"implicit_euler", implicitEulerStep, 0.01},
                                      {"implicit_euler", implicitEulerStep, 0.005},
                                      {"implicit_euler", implicitEulerStep, 0.001},
                                      {"sdirk2", sdirk2Step, 0.02},
                                      {"sdirk2", sdirk2Step, 0.01},
                                      {"sdirk2", sdirk2Step, 0.005},
                                      {"explicit", explicitStep, 0.0005}};
  Table table = Table::array();
  for (const Motion& motion : motions)
  {
    for (const Element element : {Element::QUADRATIC, Element::LINEAR})
    {
      for (const Law& law : laws)
      {
        // A linear element has one gradient, so all rules are one.
        if (element == Element::LINEAR && law.rule != RotationRule::FROM_CORNERS) continue;
        for (const Integration& integration : integrations) addRun(motion, element, law, integration, table);
      }
    }
  }
  return table;
}

}  // namespace bezier_fem::bench
