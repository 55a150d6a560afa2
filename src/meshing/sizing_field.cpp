// SPDX-License-Identifier: GPL-3.0-or-later
#include "sizing_field.h"

#include <algorithm>

namespace make_model
{
namespace
{
// Parts of this many times the size are summed up as if the size in their middle held all over.
constexpr double PART = 2;

constexpr std::size_t LEAF = 8;  // points of a leaf

}  // namespace

SizingField::SizingField(double cell_size, std::vector<bezier_fem::SizePoint> points)
    : cell_size_(cell_size), points_(std::move(points))
{
  points_.erase(std::remove_if(points_.begin(), points_.end(), [&](const auto& p) { return p.size >= cell_size; }),
                points_.end());
  if (!isUniform()) build(0, points_.size());
}

void SizingField::build(std::size_t begin, std::size_t end)
{
  const std::size_t node = nodes_.size();
  nodes_.push_back({{}, cell_size_, begin, end, 0});
  for (std::size_t i = begin; i < end; ++i)
  {
    nodes_[node].box.extend(points_[i].position);
    nodes_[node].smallest = std::min(nodes_[node].smallest, points_[i].size);
  }
  if (end - begin <= LEAF) return;
  int axis = 0;
  nodes_[node].box.sizes().maxCoeff(&axis);
  const std::size_t middle = begin + (end - begin) / 2;
  const auto at = [&](std::size_t i) { return points_.begin() + static_cast<std::ptrdiff_t>(i); };
  std::nth_element(at(begin), at(middle), at(end),
                   [axis](const auto& a, const auto& b) { return a.position[axis] < b.position[axis]; });
  build(begin, middle);
  nodes_[node].right = nodes_.size();
  build(middle, end);
}

double SizingField::operator()(const Eigen::Vector3d& p) const
{
  double size = cell_size_;
  if (!isUniform()) lower(0, p, size);
  return size;
}

void SizingField::lower(std::size_t node, const Eigen::Vector3d& p, double& size) const
{
  const auto least = [&](std::size_t i) { return nodes_[i].smallest + GRADATION * nodes_[i].box.exteriorDistance(p); };
  if (least(node) >= size) return;
  if (nodes_[node].right == 0)
  {
    for (std::size_t i = nodes_[node].begin; i < nodes_[node].end; ++i)
      size = std::min(size, points_[i].size + GRADATION * (p - points_[i].position).norm());
    return;
  }
  std::size_t first = node + 1, second = nodes_[node].right;
  if (least(second) < least(first)) std::swap(first, second);
  lower(first, p, size);
  lower(second, p, size);
}

double integralOverTriangle(const ScaledField& field, const Eigen::Matrix3d& corners, double limit)
{
  int longest = 0;  // side, opposite to that corner
  Eigen::Vector3d sides;
  for (int i = 0; i < 3; ++i) sides[i] = (corners.col((i + 1) % 3) - corners.col((i + 2) % 3)).norm();
  sides.maxCoeff(&longest);
  const double h = field(corners.rowwise().mean());
  if (sides[longest] <= PART * h)
    return (corners.col(1) - corners.col(0)).cross(corners.col(2) - corners.col(0)).norm() / 2 / (h * h);
  const int a = (longest + 1) % 3, b = (longest + 2) % 3;
  const Eigen::Vector3d middle = (corners.col(a) + corners.col(b)) / 2;
  Eigen::Matrix3d half = corners;
  half.col(a) = middle;
  double sum = integralOverTriangle(field, half, limit);
  half.col(a) = corners.col(a);
  half.col(b) = middle;
  if (sum < limit) sum += integralOverTriangle(field, half, limit - sum);
  return sum;
}

double integralOverSolid(const ScaledField& field, const Eigen::AlignedBox3d& box, const Depth& depth, double limit,
                         bool inside)
{
  const Eigen::Vector3d center = box.center();
  bool center_inside = inside;
  if (!inside)
  {
    const double d = depth(center), reach = box.diagonal().norm() / 2;
    if (d <= -reach) return 0;
    inside = d >= reach;
    center_inside = d > 0;
  }
  int axis = 0;
  const double longest = box.sizes().maxCoeff(&axis), h = field(center);
  if (longest <= PART * h) return center_inside ? box.volume() / (h * h * h) : 0;
  Eigen::AlignedBox3d half = box;
  half.max()[axis] = center[axis];
  double sum = integralOverSolid(field, half, depth, limit, inside);
  half.max()[axis] = box.max()[axis];
  half.min()[axis] = center[axis];
  if (sum < limit) sum += integralOverSolid(field, half, depth, limit - sum, inside);
  return sum;
}

}  // namespace make_model
