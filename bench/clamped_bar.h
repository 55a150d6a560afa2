#pragma once

#include "bezier_fem/step.h"

/** The bar of Weber et al. 2011, Fig. 7: 0.4 x 0.4 x 1 m, held at z = 0, gravity along -y. */
namespace bezier_fem::bench
{
struct ClampedBar
{
  Model model;
  Supports supports;
  int tip;  // node of the lower free corner (0, 0, 1)

  /** Of the tip under gravity, m, positive. */
  double deflection(const NodalField& x) const { return model.rest[tip].y() - x[tip].y(); }
};

/**
 * @param cells   along x, y and z
 * @param graded  cells become smaller towards the clamped end and its four edges, where the stress is singular: for
 *                reference solutions
 */
ClampedBar clampedBar(const Eigen::Vector3i& cells, Element element, bool graded = false);

/** Cells of a bar that is `across` cells thick, as near to cubes as can be. */
Eigen::Vector3i cubicCells(int across);

/** Time steps of 20 ms; one tolerance for steps and equilibria. */
StepSettings barSettings(Elasticity elasticity, double tolerance);

/**
 * The static equilibrium under gravity.
 * @param start  control points to start from
 * @throws std::runtime_error if it is not reached
 */
State equilibrium(const ClampedBar& bar, Elasticity elasticity, const NodalField& start);

}  // namespace bezier_fem::bench
