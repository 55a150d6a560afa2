#include "bezier_fem/boundary_conditions.h"

#include <algorithm>
#include <array>

namespace bezier_fem
{
namespace
{
Eigen::Isometry3d poseOf(const MotionSample& sample)
{
  const Eigen::Vector4d& q = sample.quaternion;
  return Eigen::Translation3d(sample.translation) * Eigen::Quaterniond(q[3], q[0], q[1], q[2]);
}

Eigen::Isometry3d interpolate(const Eigen::Isometry3d& a, const Eigen::Isometry3d& b, double s)
{
  const Eigen::Quaterniond q = Eigen::Quaterniond(a.linear()).slerp(s, Eigen::Quaterniond(b.linear()));
  return Eigen::Translation3d((1 - s) * a.translation() + s * b.translation()) * q;
}

/** Force on the six (three) control points of a face from a pressure on its current shape. */
void addPressure(const Model& model, const Model::Face& face, double pressure, const NodalField& x, NodalField& f)
{
  const auto nodes = model.nodesOf(face);
  if (!model.quadratic())
  {
    const Eigen::Vector3d normal = (x[nodes[1]] - x[nodes[0]]).cross(x[nodes[2]] - x[nodes[0]]) / 2;
    for (int k = 0; k < 3; ++k) f[nodes[k]] -= pressure / 3 * normal;
    return;
  }
  // integral of B_I (x_u x x_v) du dv, a polynomial of degree 4: exact with the six points of Dunavant 1985.
  constexpr double W[2] = {0.223381589678011, 0.109951743655322}, P[2] = {0.445948490915965, 0.091576213509771};
  for (int orbit = 0; orbit < 2; ++orbit)
  {
    for (int k = 0; k < 3; ++k)
    {
      Eigen::Vector3d l = Eigen::Vector3d::Constant(P[orbit]);
      l[k] = 1 - 2 * P[orbit];
      // Derivatives with respect to l1 and l2, l0 = 1 - l1 - l2; control points 00 11 22 01 02 12.
      const Eigen::Vector3d d0 = l[0] * x[nodes[0]] + l[1] * x[nodes[3]] + l[2] * x[nodes[4]];
      const Eigen::Vector3d d1 = l[0] * x[nodes[3]] + l[1] * x[nodes[1]] + l[2] * x[nodes[5]];
      const Eigen::Vector3d d2 = l[0] * x[nodes[4]] + l[1] * x[nodes[5]] + l[2] * x[nodes[2]];
      const Eigen::Vector3d load = -pressure * W[orbit] / 2 * (2 * (d1 - d0)).cross(2 * (d2 - d0));
      const std::array<double, 6> b{l[0] * l[0],     l[1] * l[1],     l[2] * l[2],
                                    2 * l[0] * l[1], 2 * l[0] * l[2], 2 * l[1] * l[2]};
      for (int i = 0; i < 6; ++i) f[nodes[i]] += b[i] * load;
    }
  }
}
}  // namespace

Eigen::Isometry3d motionAt(const std::vector<MotionSample>& motion, double time)
{
  const auto next = std::upper_bound(motion.begin(), motion.end(), time,
                                     [](double t, const MotionSample& sample) { return t < sample.time; });
  if (next == motion.begin()) return poseOf(motion.front());
  if (next == motion.end()) return poseOf(motion.back());
  const MotionSample& last = *(next - 1);
  return interpolate(poseOf(last), poseOf(*next), (time - last.time) / (next->time - last.time));
}

void applySupports(const Supports& supports, double time, double fraction, NodalField& x)
{
  for (std::size_t k = 0; k < supports.regions.size(); ++k)
  {
    const HeldRegion& region = supports.regions[k];
    const bool moves = !region.motion.empty() || !region.frame.empty();
    Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
    if (!region.motion.empty()) pose = motionAt(region.motion, time);
    if (!region.frame.empty()) pose = interpolate(region.begin, region.end, fraction);
    for (const int node : region.nodes)
    {
      const Eigen::Vector3d start = supports.start[node];
      const Eigen::Vector3d target = moves ? Eigen::Vector3d(pose * start) : start;
      for (int axis = 0; axis < 3; ++axis)
      {
        if (supports.region[node][axis] == static_cast<int>(k)) x[node][axis] = target[axis];
      }
    }
  }
}

std::vector<Reaction> reactions(const Supports& supports, const NodalField& x, const NodalField& balance)
{
  std::vector<Reaction> result(supports.regions.size());
  for (std::size_t k = 0; k < result.size(); ++k)
  {
    for (const int node : supports.regions[k].nodes)
    {
      Eigen::Vector3d force = Eigen::Vector3d::Zero();
      for (int axis = 0; axis < 3; ++axis)
      {
        if (supports.region[node][axis] == static_cast<int>(k)) force[axis] = balance[node][axis];
      }
      result[k].force += force;
      // A rotation about the origin moves control points as it moves the body, so this is the work-conjugate torque.
      result[k].torque += Eigen::Vector3d(x[node]).cross(force);
    }
  }
  return result;
}

void addLoads(const Model& model, const std::vector<AppliedLoad>& loads, double time, const NodalField& x,
              NodalField& f)
{
  for (const AppliedLoad& load : loads)
  {
    if (time < load.from || time >= load.until) continue;
    for (const auto& [node, force] : load.nodal) f[node] += force;
    for (const Model::Face& face : load.faces) addPressure(model, face, load.pressure, x, f);
  }
}

}  // namespace bezier_fem
