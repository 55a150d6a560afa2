#pragma once

#include <Eigen/Core>

#include "bezier_fem/model.h"
#include "bezier_fem/nodal_field.h"

namespace bezier_fem
{
class Partition;

/**
 * The rotation R that maximises tr(R^T F), with F's singular values s1 >= s2 >= |s3| and s3 negative where det F < 0:
 * R = U diag(1, 1, det(U W^T)) W^T of F = U S W^T (Irving, Teran, Fedkiw 2004, where an inverted element is pushed out
 * through its shortest side), found as the quaternion of Horn 1987, Eq. 35: the eigenvector to the largest eigenvalue
 * of a symmetric 4x4 matrix, whose two largest eigenvalues lie 2 (s2 + s3) apart.
 *
 * Where they meet (s2 + s3 = 0: a mirrored cube, a segment, a point; up to 1e-6 of the larger of s1 + s2 and 1) R is
 * not unique: the one nearest to `before` among the maxima is taken, so that a body in such a state does not flicker
 * between two rotations.
 *
 * @param F       deformation gradient, dimensionless: 1 at rest
 * @param margin  if given, set to (s2 + s3) / (s1 + s2), 0 for F = 0: how far R is from not being unique
 */
Eigen::Matrix3d polarRotation(const Eigen::Matrix3d& F, const Eigen::Matrix3d& before, double* margin = nullptr);

/** One rotation an element and what it makes of the gradients, in the blocks of model.h. */
struct Rotations
{
  AlignedVector<double> matrices;    // [block][9][LANES], row-major, world from rest
  AlignedVector<double> gradients;   // [block][9][LANES]: R g_1, R g_2, R g_3, 1/m
  std::vector<unsigned char> flags;  // [block][LANES]: bit 0 where s2 + s3 is well above zero, bit 1 where det F <= 0

  Eigen::Matrix3d matrix(int tet) const;
  /** R g_a of the four corners, 3 x 4, 1/m. */
  Eigen::Matrix<double, 3, 4> gradient(int tet) const;
  /** How many of the first num_tets elements have det F <= 0. */
  int inverted(int num_tets) const;
};

/** What a new set of rotations says of the step that led to it. */
struct Turn
{
  double angle = 0;  // rad, the largest between before and after of elements whose rotation is unique in both
  int inverted = 0;  // elements with det F <= 0 of their corners
};

/** No rotation at all: R = 1, as linear elasticity has it. */
Rotations restRotations(const Model& model);

/**
 * Rotations of the corner gradients F = sum_a x_aa g_a^T (Weber et al. 2011, section 5.1), from those before:
 * Newton's method, vectorised over elements, checked for having found the maximum; polarRotation() where it has not.
 */
Turn updateRotations(const Model& model, const Partition& partition, const NodalField& x, const Rotations& before,
                     Rotations& after, AlignedVector<double>& turned);

}  // namespace bezier_fem
