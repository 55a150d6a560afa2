#pragma once

#include <ros/time.h>
#include <tf2_ros/buffer.h>
#include <tf2_ros/transform_listener.h>

#include <Eigen/Geometry>
#include <optional>
#include <string>

namespace bezier_fem
{
/** Where tf frames are in the scene's frame. Never waits. */
class Frames
{
public:
  explicit Frames(std::string frame_id) : frame_id_(std::move(frame_id)), listener_(buffer_) {}

  /**
   * @param stamp  zero: the latest known
   * @param why    is told in one line where there is no transform
   */
  std::optional<Eigen::Isometry3d> lookup(std::string frame, const ros::Time& stamp, std::string& why) const;

private:
  std::string frame_id_;
  tf2_ros::Buffer buffer_;
  tf2_ros::TransformListener listener_;  // has a thread of its own
};

}  // namespace bezier_fem
