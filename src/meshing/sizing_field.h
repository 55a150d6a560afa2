// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <Eigen/Geometry>
#include <algorithm>
#include <functional>
#include <limits>
#include <vector>

#include "bezier_fem/sizing.h"

namespace make_model
{
/**
 * The cell size as a function of the place: the smallest of size_i + GRADATION |p - x_i| over the given points, and at
 * most the cell size of the whole body. A function without jumps, whose slope is GRADATION at most.
 *
 * With a slope g below 1, no element whose circumsphere reaches to a point of size s has a radius R above s / (1 - g),
 * since R <= s + g R. And neighbours differ in size by about 1 + g: 0.3 is what P.-O. Persson, "Mesh size functions for
 * implicit geometries and PDE-based gradient limiting", Engineering with Computers 2006, takes. Measured (a bunny with
 * feet four times as fine, a cube with one fine corner): 0.15 makes 2 to 4 times as many elements, of the same quality;
 * from 0.5 on single points are passed over and neighbours differ by up to 2.1 (0.3: 1.8).
 */
class SizingField
{
public:
  static constexpr double GRADATION = 0.3;

  /** @param cell_size m; everywhere, where there are no points of smaller size */
  explicit SizingField(double cell_size, std::vector<bezier_fem::SizePoint> points = {});

  /** [m] */
  double operator()(const Eigen::Vector3d& p) const;

  bool isUniform() const { return points_.empty(); }
  double largest() const { return cell_size_; }  // m
  double smallest() const { return isUniform() ? cell_size_ : nodes_[0].smallest; }

private:
  /** A subtree of points, with its left child behind it. */
  struct Node
  {
    Eigen::AlignedBox3d box;
    double smallest;         // size
    std::size_t begin, end;  // its points
    std::size_t right;       // child; 0 for a leaf
  };

  void build(std::size_t begin, std::size_t end);
  void lower(std::size_t node, const Eigen::Vector3d& p, double& size) const;

  double cell_size_;
  std::vector<bezier_fem::SizePoint> points_;
  std::vector<Node> nodes_;
};

/** A field made smaller as a whole, and cut off at `largest`. */
struct ScaledField
{
  const SizingField& field;
  double factor = 1;
  double largest = std::numeric_limits<double>::infinity();  // m
  double operator()(const Eigen::Vector3d& p) const { return std::min(factor * field(p), largest); }
};

/**
 * The integral of 1/h^2 over a triangle, h the field, to some per cent.
 * @param limit  that is enough: the sum may be left unfinished above
 */
double integralOverTriangle(const ScaledField& field, const Eigen::Matrix3d& corners, double limit);

/** For a point: its distance from the surface of a solid, negative outside [m]. */
using Depth = std::function<double(const Eigen::Vector3d&)>;

/**
 * The integral of 1/h^3 over what a box has of a solid, h the field, to some tens of per cent.
 * @param inside  whether the whole box is known to be inside
 */
double integralOverSolid(const ScaledField& field, const Eigen::AlignedBox3d& box, const Depth& depth, double limit,
                         bool inside = false);

}  // namespace make_model
