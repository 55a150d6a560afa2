#include "live_settings.h"

#include <ros/console.h>

#include <cmath>

#include "topics.h"

namespace bezier_fem
{
namespace
{
LiveConfig configOf(const Scene& scene)
{
  LiveConfig config = LiveConfig::__getDefault__();
  config.young = scene.material.young;
  config.poisson = scene.material.poisson;
  config.density = scene.material.density;
  config.mass_damping = scene.damping.mass;
  config.stiffness_damping = scene.damping.stiffness;
  config.gravity_x = scene.gravity.x();
  config.gravity_y = scene.gravity.y();
  config.gravity_z = scene.gravity.z();
  config.publish_rate = scene.node.publish_rate;
  return config;
}

/** What is wrong with the first value that a scene may not have either; null if nothing is. */
const char* complaint(const LiveConfig& config)
{
  const auto positive = [](double value) { return value > 0 && std::isfinite(value); };
  const auto not_negative = [](double value) { return value >= 0 && std::isfinite(value); };
  if (!positive(config.young)) return "young must be above 0";
  if (!(config.poisson > -1 && config.poisson < 0.5)) return "poisson must be above -1 and below 0.5";
  if (!positive(config.density)) return "density must be above 0";
  if (!not_negative(config.mass_damping)) return "mass_damping must be 0 or above";
  if (!not_negative(config.stiffness_damping)) return "stiffness_damping must be 0 or above";
  if (!std::isfinite(config.gravity_x + config.gravity_y + config.gravity_z)) return "gravity must be finite";
  if (!positive(config.publish_rate)) return "publish_rate must be above 0";
  return nullptr;
}

}  // namespace

LiveSettings::LiveSettings(const ros::NodeHandle& private_handle, const Scene& scene)
    : last_(configOf(scene)), server_(server_mutex_, ros::NodeHandle(private_handle, topics::LIVE))
{
  server_.updateConfig(last_);
  server_.setCallback([this](LiveConfig& config, std::uint32_t /*level*/) { onChange(config); });
}

void LiveSettings::onChange(LiveConfig& config)
{
  if (const char* why = complaint(config))
  {
    ROS_WARN("Kept the last settings of %s: %s", topics::LIVE, why);
    config = last_;  // the client is told so
    return;
  }
  last_ = config;
  const std::lock_guard<std::mutex> lock(mutex_);
  changed_ = Values{{config.young, config.poisson, config.density},
                    {config.mass_damping, config.stiffness_damping},
                    {config.gravity_x, config.gravity_y, config.gravity_z},
                    config.publish_rate};
}

std::optional<LiveSettings::Values> LiveSettings::take()
{
  const std::lock_guard<std::mutex> lock(mutex_);
  std::optional<Values> values;
  values.swap(changed_);
  return values;
}

}  // namespace bezier_fem
