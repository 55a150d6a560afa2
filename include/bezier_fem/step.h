#pragma once

#include <Eigen/Core>
#include <vector>

#include "bezier_fem/boundary_conditions.h"
#include "bezier_fem/conjugate_gradient.h"
#include "bezier_fem/model.h"
#include "bezier_fem/nodal_field.h"
#include "bezier_fem/partition.h"
#include "bezier_fem/rotation.h"
#include "bezier_fem/scene.h"

namespace bezier_fem
{
/** Everything about a body that changes in time. Positions and velocities of control points, not of material points. */
struct State
{
  NodalField x;         // m
  NodalField v;         // m/s
  Rotations rotations;  // of x
  double time = 0;      // s
  long steps = 0;
};

/** Median-able times of one step, in ms. */
struct StageTimes
{
  double rotation = 0, assembly = 0, force = 0, solve = 0, total = 0;
};

struct StepReport
{
  int substeps = 1;         // 1: exactly one lagged step
  double turn = 0;          // rad, the largest angle that an element turned by in a (sub-)step
  int iterations = 0;       // of the linear solver, in all
  double residual = 0;      // worst of the sub-steps, relative as the tolerance measures it
  bool converged = true;
  bool finite = true;       // false: the state is lost
  StageTimes ms;
};

}  // namespace bezier_fem
