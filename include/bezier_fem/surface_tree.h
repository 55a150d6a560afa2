#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <vector>

namespace bezier_fem
{
/**
 * Finds points of a triangle mesh that moves: a tree of boxes, built once over the mesh at rest and fitted anew to
 * every position that is asked about.
 */
class SurfaceTree
{
public:
  struct Nearest
  {
    int triangle;
    Eigen::Vector3d barycentric;  // none negative
    double distance;              // m
  };

  /**
   * @param triangles  3 x triangles, at least one
   * @param points     3 x points, m
   */
  SurfaceTree(const Eigen::Matrix3Xi& triangles, const Eigen::Matrix3Xd& points);

  /** Moves the points, which must be finite; 3 x points, m. */
  void refit(const Eigen::Matrix3Xd& points);

  Nearest nearest(const Eigen::Vector3d& point) const;

  /** All triangles whose box is within `radius` of a point, and so all that are nearer than that. */
  std::vector<int> near(const Eigen::Vector3d& point, double radius) const;

  /** Current corners of a triangle, one a column, m. */
  Eigen::Matrix3d cornersOf(int triangle) const;
  const Eigen::Matrix3Xi& triangles() const { return triangles_; }

private:
  struct Node  // its left child is the next one
  {
    Eigen::AlignedBox3d box;
    int begin, end;  // in order_
    int right;       // 0 in a leaf
  };

  void build(int begin, int end, const Eigen::Matrix3Xd& centroids);

  Eigen::Matrix3Xi triangles_;
  Eigen::Matrix3Xd points_;
  std::vector<int> order_;  // triangles, those of a node side by side
  std::vector<Node> nodes_;
};

}  // namespace bezier_fem
