#pragma once

#include <Eigen/Core>
#include <vector>

#include "bezier_fem/embedding.h"
#include "bezier_fem/model.h"
#include "bezier_fem/nodal_field.h"
#include "bezier_fem/rotation.h"

/** What can be said of a state: energies, stresses, volume. None of it is needed for a step. */
namespace bezier_fem
{
/** Symmetric stress in world axes, Pa: xx, yy, zz, xy, yz, xz (ParaView's order). */
using Stress = Eigen::Matrix<double, 6, 1>;

/** sqrt(3/2 s:s), s the deviator, Pa. */
double vonMises(const Stress& stress);

/** Co-rotated (or, without rotations, small-strain) stress at a material point. */
Stress stressAt(const Model& model, const Rotations& rotations, const NodalField& x, const MaterialPoint& point);

/**
 * Stress at the nodes' material points (corners, middles of edges), the mean over the elements that meet there.
 * @return 6 x nodes
 */
Eigen::Matrix<double, 6, Eigen::Dynamic> nodalStress(const Model& model, const Rotations& rotations,
                                                     const NodalField& x);

/** Material position of a node: itself for a corner, (x_aa + 2 x_ab + x_bb)/4 for an edge. m. */
Eigen::Vector3d nodePosition(const Model& model, const NodalField& x, int node);

/** 1/2 v^T M v, J. */
double kineticEnergy(const Model& model, const NodalField& v);
/** 1/2 of the integral of strain : stress, J, with the rotations given. */
double elasticEnergy(const Model& model, const Rotations& rotations, const NodalField& x);
/** Minus the sum of mass times g . x, J: zero at the world's origin. */
double gravityEnergy(const Model& model, const Eigen::Vector3d& gravity, const NodalField& x);

/** Elements whose deformation gradient has det F <= 0 at a corner. */
int invertedElements(const Model& model, const NodalField& x);
/** Exact current volume, m^3: the integral of det F. */
double currentVolume(const Model& model, const NodalField& x);

}  // namespace bezier_fem
