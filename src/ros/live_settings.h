#pragma once

#include <bezier_fem/LiveConfig.h>
#include <dynamic_reconfigure/server.h>
#include <ros/node_handle.h>

#include <mutex>
#include <optional>

#include "bezier_fem/scene.h"

namespace bezier_fem
{
/** What can be changed while the body moves, by dynamic_reconfigure. */
class LiveSettings
{
public:
  struct Values
  {
    Material material;
    Scene::Damping damping;
    Eigen::Vector3d gravity;  // m/s^2
    double publish_rate;      // Hz
  };

  LiveSettings(const ros::NodeHandle& private_handle, const Scene& scene);

  /** What was set since the last call. */
  std::optional<Values> take();

private:
  void onChange(LiveConfig& config);

  std::mutex mutex_;  // of changed_
  std::optional<Values> changed_;
  LiveConfig last_;  // valid

  boost::recursive_mutex server_mutex_;
  dynamic_reconfigure::Server<LiveConfig> server_;  // last, so that callbacks end before what they use does
};

}  // namespace bezier_fem
