#include "clamped_bar.h"

#include <stdexcept>

#include "core/bar.h"

namespace bezier_fem::bench
{
ClampedBar clampedBar(const Eigen::Vector3i& cells, Element element, bool graded)
{
  const Eigen::Vector3d size(0.4, 0.4, 1);
  TetMesh mesh = test::kuhnBox(cells, size);
  if (graded)
  {
    for (Eigen::Index i = 0; i < mesh.corners.cols(); ++i)
    {
      const Eigen::Array3d s = mesh.corners.col(i).cwiseQuotient(size);
      // Quadratic towards both sides of the section and towards the wall.
      for (int axis = 0; axis < 2; ++axis)
      {
        const double inward = std::min(s[axis], 1 - s[axis]);
        const double moved = 2 * inward * inward;
        mesh.corners(axis, i) = size[axis] * (s[axis] < 0.5 ? moved : 1 - moved);
      }
      mesh.corners(2, i) = size[2] * s[2] * s[2];
    }
  }
  ClampedBar bar{test::boxModel(mesh, element), {}, 0};
  bar.tip = bar.model.node_of_corner[mesh.corners.cols() - static_cast<Eigen::Index>(cells.x() + 1) * (cells.y() + 1)];

  Supports& supports = bar.supports;
  supports.start = bar.model.rest;
  supports.held.assign(bar.model.num_nodes, 0);
  supports.region.assign(bar.model.num_nodes, {-1, -1, -1});
  supports.regions.resize(1);
  for (int i = 0; i < bar.model.num_nodes; ++i)
  {
    if (bar.model.rest[i].z() > 1e-9) continue;
    supports.held[i] = 7;
    supports.region[i] = {0, 0, 0};
    supports.regions[0].nodes.push_back(i);
  }
  return bar;
}

Eigen::Vector3i cubicCells(int across)
{
  return {across, across, (5 * across + 1) / 2};
}

StepSettings barSettings(Elasticity elasticity, double tolerance)
{
  Scene defaults;
  StepSettings settings{};
  settings.time_step = 0.02;
  settings.rotation = defaults.rotation;
  settings.solver = defaults.solver;
  settings.elasticity = elasticity;
  settings.gravity = {0, -9.81, 0};
  settings.solver.tolerance = tolerance;
  settings.solver.max_iterations = 10000;
  return settings;
}

State equilibrium(const ClampedBar& bar, Elasticity elasticity, const NodalField& start)
{
  const StepSettings settings = barSettings(elasticity, 1e-6);
  Workspace workspace(bar.model, settings, 1);
  State state = startState(bar.model, settings, bar.supports, start, Eigen::Vector3d::Zero(), workspace);
  const NodalField no_force(bar.model.num_nodes);
  if (!solveStatic(bar.model, settings, bar.supports, {}, no_force, state, workspace, {}).converged)
  {
    throw std::runtime_error("no equilibrium of the bar of " + std::to_string(bar.model.num_tets) + " tetrahedra");
  }
  return state;
}

}  // namespace bezier_fem::bench
