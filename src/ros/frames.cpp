#include "frames.h"

#include <algorithm>

#include "conversions.h"

namespace bezier_fem
{
std::optional<Eigen::Isometry3d> Frames::lookup(std::string frame, const ros::Time& stamp, std::string& why) const
{
  if (!frame.empty() && frame.front() == '/') frame.erase(0, 1);  // tf1 wrote frames so
  if (frame == frame_id_) return Eigen::Isometry3d::Identity();   // whether tf knows it or not
  try
  {
    const Eigen::Isometry3d pose = toEigen(buffer_.lookupTransform(frame_id_, frame, stamp).transform);
    if (pose.matrix().allFinite()) return pose;
    why = "the transform from '" + frame + "' to '" + frame_id_ + "' is not finite";
  }
  catch (const std::exception& error)  // tf2's, and whatever an odd stamp or name makes it throw
  {
    why = "no transform from '" + frame + "' to '" + frame_id_ + "': " + error.what();
    std::replace(why.begin(), why.end(), '\n', ' ');
  }
  return {};
}

}  // namespace bezier_fem
