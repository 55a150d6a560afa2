#pragma once

#include <Eigen/Core>

#include "bezier_fem/embedding.h"
#include "bezier_fem/measures.h"
#include "bezier_fem/model.h"
#include "bezier_fem/nodal_field.h"
#include "bezier_fem/partition.h"

/**
 * St. Venant-Kirchhoff elasticity: Green's strain E = (F^T F - 1)/2 and a stress S = lambda tr(E) 1 + 2 mu E linear in
 * it. Unlike co-rotated elasticity it has an energy for quadratic elements too, whose exact gradient the force is, so
 * that energy and angular momentum are kept. It softens under compression: to be pressed flat costs a body a finite
 * energy, and it may turn inside out.
 *
 * Integrals are exact: F is linear in the barycentric coordinates and the integrands are of degree four.
 */
namespace bezier_fem
{
/** out = dU/dx, N: the force that the body exerts against its deformation. */
void greenForce(const Model& model, const Partition& partition, const NodalField& x, NodalField& out);

/** U, the integral of E : S / 2, J. */
double greenEnergy(const Model& model, const NodalField& x);

/** The derivative of greenForce() at some positions, in the form that its products need. */
struct GreenTangent
{
  explicit GreenTangent(const Model& model);

  AlignedVector<double> blocks;  // [block][numbers an element][LANES]: F (1), then stress integrals (Pa m^3)
};

enum class Projection
{
  NONE,             // the derivative of the force itself; may be indefinite where the body is compressed
  POSITIVE_STRESS,  // S without its negative eigenvalues: positive semidefinite in every state
};

/**
 * The derivative of the force is a material term, positive semidefinite in every state, and the geometric term
 * integral of tr(dF S dF^T), semidefinite where S is. The projection is taken at each of the points of a rule with
 * positive weights; without it, and where S has no negative eigenvalue, the integral is exact.
 */
void linearise(const Model& model, const Partition& partition, const NodalField& x, Projection projection,
               GreenTangent& tangent);

/** out = (alpha M + beta K_T) u. */
void systemProduct(const Model& model, const Partition& partition, const GreenTangent& tangent, double alpha,
                   double beta, const NodalField& u, NodalField& out);

/** The 3x3 diagonal blocks of alpha M + beta K_T, laid out as for rotations (element_operator.h). */
void systemDiagonal(const Model& model, const Partition& partition, const GreenTangent& tangent, double alpha,
                    double beta, AlignedVector<double>& blocks);

/**
 * Cauchy stress F S F^T / det F at a material point. Below 0.001 the size of det F counts as that, so that the stress
 * of a collapsed element is finite.
 */
Stress greenStressAt(const Model& model, const NodalField& x, const MaterialPoint& point);

/** The same at the nodes' material points, the mean over the elements that meet there: 6 x nodes. */
Eigen::Matrix<double, 6, Eigen::Dynamic> greenNodalStress(const Model& model, const NodalField& x);

}  // namespace bezier_fem
