#include "bezier_fem/embedding.h"

#include <Eigen/Dense>
#include <Eigen/Geometry>
#include <algorithm>
#include <limits>
#include <unsupported/Eigen/BVH>

#include "parallel.h"

namespace bezier_fem
{
namespace
{
/** Squared distance of p to the triangle abc (Ericson, Real-Time Collision Detection, 2005, section 5.1.5). */
double squaredDistanceToTriangle(const Eigen::Vector3d& p, const Eigen::Vector3d& a, const Eigen::Vector3d& b,
                                 const Eigen::Vector3d& c)
{
  const auto toSegment = [&](const Eigen::Vector3d& s, const Eigen::Vector3d& e) {
    const Eigen::Vector3d d = e - s;
    const double t = std::clamp((p - s).dot(d) / d.squaredNorm(), 0.0, 1.0);
    return (p - s - t * d).squaredNorm();
  };
  const Eigen::Vector3d ab = b - a, ac = c - a, n = ab.cross(ac);
  const bool inside = n.cross(ab).dot(p - a) >= 0 && n.cross(c - b).dot(p - b) >= 0 && n.cross(a - c).dot(p - c) >= 0;
  if (inside)
  {
    const double d = (p - a).dot(n);
    return d * d / n.squaredNorm();
  }
  return std::min({toSegment(a, b), toSegment(b, c), toSegment(c, a)});
}

Eigen::Vector3d corner(const Model& model, int tet, int a)
{
  return model.rest[model.nodesOf(tet)[a]];
}

Eigen::Vector4d barycentric(const Model& model, int tet, const Eigen::Vector3d& p)
{
  Eigen::Vector4d lambda;
  const Eigen::Vector3d d = p - corner(model, tet, 0);
  lambda.tail<3>() = model.gradients.middleCols<3>(3 * static_cast<Eigen::Index>(tet)).transpose() * d;
  lambda[0] = 1 - lambda.tail<3>().sum();
  return lambda;
}

double squaredDistance(const Model& model, int tet, const Eigen::Vector3d& p)
{
  const Eigen::Vector4d lambda = barycentric(model, tet, p);
  double best = lambda.minCoeff() >= 0 ? 0 : std::numeric_limits<double>::infinity();
  for (int a = 0; a < CORNERS && best > 0; ++a)
  {
    if (lambda[a] >= 0) continue;  // the nearest point lies on a face that p is outside of
    const auto& f = FACE_CORNERS[a];
    best = std::min(best, squaredDistanceToTriangle(p, corner(model, tet, f[0]), corner(model, tet, f[1]),
                                                    corner(model, tet, f[2])));
  }
  return best;
}
}  // namespace

struct PointLocator::Tree
{
  Eigen::KdBVH<double, 3, int> bvh;
};

PointLocator::PointLocator(const Model& model) : model_(model), tree_(std::make_unique<Tree>())
{
  std::vector<int> tets(model.num_tets);
  std::vector<Eigen::AlignedBox3d> boxes(model.num_tets);
  for (int t = 0; t < model.num_tets; ++t)
  {
    tets[t] = t;
    for (int a = 0; a < CORNERS; ++a) boxes[t].extend(corner(model, t, a));
  }
  tree_->bvh.init(tets.begin(), tets.end(), boxes.begin(), boxes.end());
}

PointLocator::~PointLocator() = default;

MaterialPoint PointLocator::locate(const Eigen::Vector3d& rest, double* distance) const
{
  struct Nearest
  {
    using Scalar = double;  // as BVMinimize() asks
    const Model& model;
    const Eigen::Vector3d& point;
    int tet = -1;
    double best = std::numeric_limits<double>::infinity();

    double minimumOnVolume(const Eigen::AlignedBox3d& box) const { return box.squaredExteriorDistance(point); }
    double minimumOnObject(int t)
    {
      const double d = squaredDistance(model, t, point);
      // Of several at the same distance the first, so that the answer does not depend on the tree.
      if (d < best || (d == best && t < tet))
      {
        best = d;
        tet = t;
      }
      return d;
    }
  } nearest{model_, rest};
  Eigen::BVMinimize(tree_->bvh, nearest);
  if (distance) *distance = std::sqrt(nearest.best);
  return {nearest.tet, barycentric(model_, nearest.tet, rest)};
}

Eigen::Vector3d position(const Model& model, const NodalField& x, const MaterialPoint& point)
{
  const auto weights = basis(model.nodes_per_tet, point.lambda);
  Eigen::Vector3d p = Eigen::Vector3d::Zero();
  for (int k = 0; k < model.nodes_per_tet; ++k) p += weights[k] * x[model.nodesOf(point.tet)[k]];
  return p;
}

Eigen::Matrix3d deformationGradient(const Model& model, const NodalField& x, const MaterialPoint& point)
{
  // F = sum_d y_d g_d^T with y_d = x_d, or for quadratic elements 2 sum_c lambda_c x_cd; measured from y_0.
  const int* nodes = model.nodesOf(point.tet);
  Eigen::Matrix<double, 3, CORNERS> y;
  for (int d = 0; d < CORNERS; ++d)
  {
    if (!model.quadratic())
    {
      y.col(d) = x[nodes[d]];
      continue;
    }
    y.col(d).setZero();
    for (int c = 0; c < CORNERS; ++c) y.col(d) += 2 * point.lambda[c] * x[nodes[CONTROL_POINT[c][d]]];
  }
  return (y.rightCols<3>().colwise() - y.col(0)) *
         model.gradients.middleCols<3>(3 * static_cast<Eigen::Index>(point.tet)).transpose();
}

void addForce(const Model& model, const MaterialPoint& point, const Eigen::Vector3d& force, NodalField& f)
{
  const auto weights = basis(model.nodes_per_tet, point.lambda);
  for (int k = 0; k < model.nodes_per_tet; ++k) f[model.nodesOf(point.tet)[k]] += weights[k] * force;
}

void evaluate(const Model& model, const Partition& partition, const NodalField& x,
              const std::vector<MaterialPoint>& points, const Eigen::Matrix3Xd& rest_normals,
              Eigen::Matrix3Xd& positions, Eigen::Matrix3Xd* normals)
{
  const auto count = static_cast<Eigen::Index>(points.size());
  positions.resize(3, count);
  if (normals) normals->resize(3, count);
  const int pieces = partition.pieces();
  forEachPiece(partition, [&](int t) {
    for (Eigen::Index i = count * t / pieces; i < count * (t + 1) / pieces; ++i)
    {
      positions.col(i) = position(model, x, points[i]);
      if (!normals) continue;
      const Eigen::Matrix3d F = deformationGradient(model, x, points[i]);
      Eigen::Matrix3d cofactor;
      cofactor << F.col(1).cross(F.col(2)), F.col(2).cross(F.col(0)), F.col(0).cross(F.col(1));
      normals->col(i) = (cofactor * rest_normals.col(i)).normalized();
    }
  });
}

}  // namespace bezier_fem
