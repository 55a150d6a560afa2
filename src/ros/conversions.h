#pragma once

#include <geometry_msgs/Point.h>
#include <geometry_msgs/Transform.h>
#include <geometry_msgs/Vector3.h>

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace bezier_fem
{
inline Eigen::Vector3d toEigen(const geometry_msgs::Point& p)
{
  return {p.x, p.y, p.z};
}
inline Eigen::Vector3d toEigen(const geometry_msgs::Vector3& v)
{
  return {v.x, v.y, v.z};
}

inline Eigen::Isometry3d toEigen(const geometry_msgs::Transform& t)
{
  const auto& q = t.rotation;
  return Eigen::Translation3d(toEigen(t.translation)) * Eigen::Quaterniond(q.w, q.x, q.y, q.z).normalized();
}

inline geometry_msgs::Point toPoint(const Eigen::Vector3d& p)
{
  geometry_msgs::Point message;
  message.x = p.x();
  message.y = p.y();
  message.z = p.z();
  return message;
}

inline geometry_msgs::Vector3 toVector3(const Eigen::Vector3d& v)
{
  geometry_msgs::Vector3 message;
  message.x = v.x();
  message.y = v.y();
  message.z = v.z();
  return message;
}

}  // namespace bezier_fem
