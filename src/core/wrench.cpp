#include "bezier_fem/wrench.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <unordered_map>

namespace bezier_fem
{
namespace
{
/** A part of a triangle: barycentric coordinates in it, one corner a column. */
using Part = Eigen::Matrix3d;

/** Collects samples, and each surface point that they refer to once. */
class PatchBuilder
{
public:
  PatchBuilder(const SurfaceTree& tree, const std::vector<MaterialPoint>& points) : tree_(tree), points_(points) {}

  void add(int triangle, const Eigen::Vector3d& barycentric, double weight)
  {
    SurfacePatch::Sample sample{{}, barycentric, weight};
    for (int k = 0; k < 3; ++k)
    {
      const int point = tree_.triangles()(k, triangle);
      const auto [entry, added] = local_.emplace(point, static_cast<int>(patch_.points.size()));
      if (added) patch_.points.push_back(points_[point]);
      sample.points[k] = entry->second;
    }
    patch_.samples.push_back(sample);
    total_ += weight;
  }

  double total() const { return total_; }

  SurfacePatch finish()
  {
    for (SurfacePatch::Sample& sample : patch_.samples) sample.weight /= total_;
    return std::move(patch_);
  }

private:
  const SurfaceTree& tree_;
  const std::vector<MaterialPoint>& points_;
  std::unordered_map<int, int> local_;  // surface point -> index in the patch
  SurfacePatch patch_;
  double total_ = 0;
};

/** Halves a triangle at its longest edge until the parts are small against the radius; those outside are left out. */
void sampleTriangle(int triangle, const Eigen::Matrix3d& corners, const Eigen::Vector3d& spot, double radius,
                    PatchBuilder& patch)
{
  std::vector<Part> parts{Part::Identity()};
  while (!parts.empty())
  {
    const Part part = parts.back();
    parts.pop_back();
    const Eigen::Matrix3d p = corners * part;
    const Eigen::Vector3d middle = p.rowwise().mean();
    int a = 0;
    double longest = 0;
    for (int k = 0; k < 3; ++k)
    {
      const double length = (p.col((k + 1) % 3) - p.col(k)).norm();
      if (length <= longest) continue;
      longest = length;
      a = k;
    }
    const double distance = (middle - spot).norm();
    if (distance >= radius + longest) continue;
    if (longest > radius / 2)
    {
      const int b = (a + 1) % 3;
      Part half = part;
      half.col(a) = (part.col(a) + part.col(b)) / 2;
      parts.push_back(half);
      half.col(b) = half.col(a);
      half.col(a) = part.col(a);
      parts.push_back(half);
      continue;
    }
    const double area = (p.col(1) - p.col(0)).cross(p.col(2) - p.col(0)).norm() / 2;
    const double fall = 1 - std::pow(distance / radius, 2);
    if (area > 0 && fall > 0) patch.add(triangle, part.rowwise().mean(), area * fall * fall);
  }
}

/** Current positions of the samples, 3 x samples. */
Eigen::Matrix3Xd samplePositions(const Model& model, const NodalField& x, const SurfacePatch& patch)
{
  Eigen::Matrix3Xd points(3, patch.points.size());
  for (std::size_t i = 0; i < patch.points.size(); ++i) points.col(i) = position(model, x, patch.points[i]);
  Eigen::Matrix3Xd positions(3, patch.samples.size());
  for (std::size_t i = 0; i < patch.samples.size(); ++i)
  {
    const SurfacePatch::Sample& s = patch.samples[i];
    positions.col(i) = s.barycentric[0] * points.col(s.points[0]) + s.barycentric[1] * points.col(s.points[1]) +
                       s.barycentric[2] * points.col(s.points[2]);
  }
  return positions;
}

Eigen::Vector3d weightedMean(const SurfacePatch& patch, const Eigen::Matrix3Xd& positions)
{
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (std::size_t i = 0; i < patch.samples.size(); ++i) mean += patch.samples[i].weight * positions.col(i);
  return mean;
}

}  // namespace

SurfacePatch pointPatch(const SurfaceTree& tree, const std::vector<MaterialPoint>& points,
                        const SurfaceTree::Nearest& spot)
{
  PatchBuilder patch(tree, points);
  patch.add(spot.triangle, spot.barycentric, 1);
  return patch.finish();
}

SurfacePatch patchAround(const SurfaceTree& tree, const std::vector<MaterialPoint>& points,
                         const SurfaceTree::Nearest& spot, double radius)
{
  const Eigen::Vector3d centre = tree.cornersOf(spot.triangle) * spot.barycentric;
  for (;; radius *= 2)
  {
    PatchBuilder patch(tree, points);
    for (int triangle : tree.near(centre, radius))
      sampleTriangle(triangle, tree.cornersOf(triangle), centre, radius, patch);
    // Only where the spot lies among triangles without area is there nothing to push on. A whole surface without area
    // bounds no body, so this ends.
    if (patch.total() > 0) return patch.finish();
  }
}

Eigen::Vector3d patchCentre(const Model& model, const NodalField& x, const SurfacePatch& patch)
{
  return weightedMean(patch, samplePositions(model, x, patch));
}

void addWrench(const Model& model, const NodalField& x, const SurfacePatch& patch, const Wrench& wrench, NodalField& f)
{
  Eigen::Matrix3Xd arms = samplePositions(model, x, patch);  // d_i
  // Once is not enough: on a small patch far from the origin the rounding of the mean is a force of its own
  for (int i = 0; i < 2; ++i) arms.colwise() -= weightedMean(patch, arms);

  Eigen::Matrix3d inertia = Eigen::Matrix3d::Zero();
  for (std::size_t i = 0; i < patch.samples.size(); ++i)
  {
    const Eigen::Vector3d d = arms.col(i);
    inertia += patch.samples[i].weight * (d.squaredNorm() * Eigen::Matrix3d::Identity() - d * d.transpose());
  }
  // Samples on a line cannot take up a torque about it: that part is left out rather than made up of huge forces.
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(inertia);
  const double smallest = 1e-12 * eigen.eigenvalues()[2];
  const Eigen::Vector3d inverse =
      eigen.eigenvalues().unaryExpr([&](double value) { return value > smallest ? 1 / value : 0.0; });
  const Eigen::Vector3d alpha =
      eigen.eigenvectors() * inverse.asDiagonal() * eigen.eigenvectors().transpose() * wrench.torque;

  Eigen::Matrix3Xd forces = Eigen::Matrix3Xd::Zero(3, patch.points.size());
  for (std::size_t i = 0; i < patch.samples.size(); ++i)
  {
    const SurfacePatch::Sample& s = patch.samples[i];
    const Eigen::Vector3d force = s.weight * (wrench.force + alpha.cross(Eigen::Vector3d(arms.col(i))));
    for (int k = 0; k < 3; ++k) forces.col(s.points[k]) += s.barycentric[k] * force;
  }
  for (std::size_t i = 0; i < patch.points.size(); ++i) addForce(model, patch.points[i], forces.col(i), f);
}

}  // namespace bezier_fem
