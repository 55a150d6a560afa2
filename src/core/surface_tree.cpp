#include "bezier_fem/surface_tree.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

namespace bezier_fem
{
namespace
{
constexpr int LEAF_SIZE = 4;

/** Barycentric coordinates of the point of a triangle that is nearest to p; the triangle may have no area. */
Eigen::Vector3d nearestOnTriangle(const Eigen::Vector3d& p, const Eigen::Matrix3d& corners)
{
  const Eigen::Vector3d a = corners.col(0), ab = corners.col(1) - a, ac = corners.col(2) - a;
  const Eigen::Vector3d normal = ab.cross(ac);
  const double area_b = normal.dot((p - a).cross(ac)), area_c = normal.dot(ab.cross(p - a));
  const double area_a = normal.squaredNorm() - area_b - area_c;
  if (area_a > 0 && area_b > 0 && area_c > 0)
    return Eigen::Vector3d(area_a, area_b, area_c) / (area_a + area_b + area_c);

  Eigen::Vector3d best = Eigen::Vector3d::Zero();
  double best_square = std::numeric_limits<double>::infinity();
  for (int k = 0; k < 3; ++k)
  {
    const Eigen::Vector3d from = corners.col(k), edge = corners.col((k + 1) % 3) - from;
    const double square = edge.squaredNorm();
    const double t = square > 0 ? std::clamp(edge.dot(p - from) / square, 0.0, 1.0) : 0.0;
    const double distance = (from + t * edge - p).squaredNorm();
    if (distance >= best_square) continue;
    best_square = distance;
    best.setZero();
    best[k] = 1 - t;
    best[(k + 1) % 3] = t;
  }
  return best;
}

}  // namespace

SurfaceTree::SurfaceTree(const Eigen::Matrix3Xi& triangles, const Eigen::Matrix3Xd& points)
    : triangles_(triangles), order_(triangles.cols())
{
  Eigen::Matrix3Xd centroids(3, triangles.cols());
  for (int t = 0; t < triangles.cols(); ++t)
    centroids.col(t) = (points.col(triangles(0, t)) + points.col(triangles(1, t)) + points.col(triangles(2, t))) / 3;
  std::iota(order_.begin(), order_.end(), 0);
  build(0, static_cast<int>(order_.size()), centroids);
  refit(points);
}

void SurfaceTree::build(int begin, int end, const Eigen::Matrix3Xd& centroids)
{
  const int node = static_cast<int>(nodes_.size());
  nodes_.push_back({Eigen::AlignedBox3d(), begin, end, 0});
  if (end - begin <= LEAF_SIZE) return;

  Eigen::AlignedBox3d box;
  for (int i = begin; i < end; ++i) box.extend(centroids.col(order_[i]));
  int axis;
  box.sizes().maxCoeff(&axis);
  const int middle = (begin + end) / 2;
  std::nth_element(order_.begin() + begin, order_.begin() + middle, order_.begin() + end,
                   [&](int s, int t) { return centroids(axis, s) < centroids(axis, t); });
  build(begin, middle, centroids);
  nodes_[node].right = static_cast<int>(nodes_.size());
  build(middle, end, centroids);
}

void SurfaceTree::refit(const Eigen::Matrix3Xd& points)
{
  points_ = points;
  for (int n = static_cast<int>(nodes_.size()) - 1; n >= 0; --n)  // children come after their parents
  {
    Node& node = nodes_[n];
    node.box.setEmpty();
    if (node.right != 0)
    {
      node.box.extend(nodes_[n + 1].box).extend(nodes_[node.right].box);
      continue;
    }
    for (int i = node.begin; i < node.end; ++i)
      for (int k = 0; k < 3; ++k) node.box.extend(points_.col(triangles_(k, order_[i])));
  }
}

SurfaceTree::Nearest SurfaceTree::nearest(const Eigen::Vector3d& point) const
{
  Nearest best{-1, Eigen::Vector3d::Zero(), 0};
  double best_square = std::numeric_limits<double>::infinity();
  std::vector<std::pair<double, int>> stack{{nodes_[0].box.squaredExteriorDistance(point), 0}};
  while (!stack.empty())
  {
    const auto [square, n] = stack.back();
    stack.pop_back();
    if (square >= best_square) continue;
    const Node& node = nodes_[n];
    if (node.right != 0)
    {
      const double left = nodes_[n + 1].box.squaredExteriorDistance(point);
      const double right = nodes_[node.right].box.squaredExteriorDistance(point);
      stack.emplace_back(std::max(left, right), left < right ? node.right : n + 1);  // the nearer one on top
      stack.emplace_back(std::min(left, right), left < right ? n + 1 : node.right);
      continue;
    }
    for (int i = node.begin; i < node.end; ++i)
    {
      const Eigen::Matrix3d corners = cornersOf(order_[i]);
      const Eigen::Vector3d lambda = nearestOnTriangle(point, corners);
      const double d = (corners * lambda - point).squaredNorm();
      if (d >= best_square) continue;
      best_square = d;
      best = {order_[i], lambda, std::sqrt(d)};
    }
  }
  return best;
}

Eigen::Matrix3d SurfaceTree::cornersOf(int triangle) const
{
  Eigen::Matrix3d corners;
  for (int k = 0; k < 3; ++k) corners.col(k) = points_.col(triangles_(k, triangle));
  return corners;
}

std::vector<int> SurfaceTree::near(const Eigen::Vector3d& point, double radius) const
{
  std::vector<int> found;
  std::vector<int> stack{0};
  while (!stack.empty())
  {
    const int n = stack.back();
    stack.pop_back();
    const Node& node = nodes_[n];
    if (node.box.squaredExteriorDistance(point) > radius * radius) continue;
    if (node.right != 0)
    {
      stack.push_back(node.right);
      stack.push_back(n + 1);
      continue;
    }
    found.insert(found.end(), order_.begin() + node.begin, order_.begin() + node.end);
  }
  return found;
}

}  // namespace bezier_fem
