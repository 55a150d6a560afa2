#pragma once

#include "bezier_fem/model.h"
#include "bezier_fem/nodal_field.h"
#include "bezier_fem/partition.h"
#include "bezier_fem/rotation.h"

/**
 * The elastic force, the stiffness and the mass of a body as functions of fields, never as matrices: rotating the four
 * gradients of an element rotates its whole stiffness, K'_IJ = R K_IJ R^T, so twelve numbers an element are all that a
 * step changes. Integrals are exact (products of Bernstein polynomials; Weber et al. 2011, Eq. 20-21, with the
 * exponents of G decremented, which the paper's last formula of section 5.2 omits).
 *
 * K' is the stiffness with the rotations held: symmetric, positive semidefinite in every state, and not the derivative
 * of the elastic force, which would have terms of the turning rotations too.
 */
namespace bezier_fem
{
/** out = f_el(x) = K' x - f_0, N: the force that the body exerts against its deformation (Weber et al. 2011, Eq. 19).
 */
void elasticForce(const Model& model, const Partition& partition, const Rotations& rotations, const NodalField& x,
                  NodalField& out);

/**
 * What the elastic force of the positions x grows by as the rotations change, times d; J if d is in m. The same for any
 * number of threads.
 */
double turnWork(const Model& model, const Partition& partition, const Rotations& before, const Rotations& after,
                const NodalField& x, const NodalField& d);

/** out = (alpha M + beta K') u. */
void systemProduct(const Model& model, const Partition& partition, const Rotations& rotations, double alpha,
                   double beta, const NodalField& u, NodalField& out);

/**
 * The 3x3 diagonal blocks of alpha M + beta K', right to 1e-6 of each: enough for a preconditioner. Of a material so
 * nearly incompressible that this might leave a block indefinite, (lambda + 2 mu) / mu above 1e4, to rounding.
 * @param blocks  8 doubles a node: xx, yy, zz, 0, xy, xz, yz, 0 of each block
 */
void systemDiagonal(const Model& model, const Partition& partition, const Rotations& rotations, double alpha,
                    double beta, AlignedVector<double>& blocks);

}  // namespace bezier_fem
