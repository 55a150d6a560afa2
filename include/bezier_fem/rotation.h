#pragma once

#include <Eigen/Core>

#include "bezier_fem/model.h"
#include "bezier_fem/nodal_field.h"
#include "bezier_fem/scene.h"

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

/**
 * The elements' rotations and what they make of the gradients, in the blocks of model.h. With one rotation an element
 * K' and f_el cost least; for quadratic elements, whose F varies, f_el is then not the gradient of an energy. Four
 * rotations, at the points of the rule that integrates the energy exactly once R is given, make it one, of
 *     U = sum over points of V/4 (mu |F - R|^2 + lambda/2 tr(R^T F - 1)^2),
 * so that angular momentum and energy are kept.
 */
struct Rotations
{
  RotationRule rule = RotationRule::FROM_CORNERS;
  int points = 1;                   // rotations an element: 4 for RotationRule::FOUR_POINTS of quadratic elements
  AlignedVector<double> matrices;   // [block][points][9][LANES], row-major, world from rest
  AlignedVector<double> gradients;  // [block][points][9][LANES]: R g_1, R g_2, R g_3, 1/m
  std::vector<unsigned char>
      flags;  // [block][points][LANES]: bit 0 where s2 + s3 is well above zero, bit 1: det F <= 0

  Eigen::Matrix3d matrix(int tet, int point = 0) const;
  /** R g_a of the four corners, 3 x 4, 1/m. */
  Eigen::Matrix<double, 3, 4> gradient(int tet, int point = 0) const;
  /** How many of the first num_tets elements have det F <= 0 at a point where a rotation is taken. */
  int inverted(int num_tets) const;
};

/** What a new set of rotations says of the step that led to it. */
struct Turn
{
  double angle = 0;  // rad, the largest between before and after of rotations that are unique in both
  int inverted = 0;  // elements with det F <= 0 where a rotation is taken
};

/** No rotation at all: R = 1, as linear elasticity has it. Linear elements have one rule, FROM_CORNERS. */
Rotations restRotations(const Model& model, RotationRule rule = RotationRule::FROM_CORNERS);

/**
 * Rotations of the gradients that before.rule names: of the corners F = sum_a x_aa g_a^T (Weber et al. 2011, section
 * 5.1), at the centroid, or at four points. Vectorised over elements, from the largest root of a quartic alone;
 * polarRotation() where that leaves a doubt, which is the only place where those before have a say.
 * @param turned  scratch, as many numbers as flags
 */
Turn updateRotations(const Model& model, const Partition& partition, const NodalField& x, const Rotations& before,
                     Rotations& after, AlignedVector<double>& turned);

}  // namespace bezier_fem
