#pragma once

#include <vector>

#include "bezier_fem/model.h"
#include "bezier_fem/nodal_field.h"
#include "bezier_fem/partition.h"
#include "bezier_fem/scene.h"

namespace bezier_fem
{
/**
 * Bounds from above on the largest eigenvalue of M^-1 K, 1/s^2, M the consistent mass matrix: no eigenvalue of the
 * body exceeds the largest of its elements' own (Irons and Treharne 1971, "A bound theorem in eigenvalues and its
 * practical applications"). They hold for lumped masses too, which lower the eigenvalues.
 */
class SpectralBound
{
public:
  /** Two small eigenvalue problems an element; to be done anew when the materials change. */
  SpectralBound(const Model& model, const Partition& partition);

  /** Of linear and, in every state, of co-rotated elasticity with one rotation an element: rotated eigenvectors. */
  double corotated() const;

  /**
   * Of Green's strain at the positions x: the derivative of its force, projected or not. At rest the same as
   * corotated(). An element costs about as much as a few products.
   */
  double green(const Model& model, const Partition& partition, const NodalField& x) const;

private:
  std::vector<double> stiffness_;  // of each element's M^-1 K at rest, 1/s^2
  std::vector<double> gradient_;   // the same of the integral of |grad u|^2 in place of the elastic energy, 1/(Pa s^2)
};

/**
 * The longest stable time step, s, of
 *     v += dt M^-1 (f_ext - f_el(x) - D v),   x += dt v,   D = a M + b K,
 * for the largest eigenvalue of M^-1 K: 2/sqrt(eigenvalue) without damping.
 */
double stableStep(double largest_eigenvalue, const Scene::Damping& damping);

}  // namespace bezier_fem
