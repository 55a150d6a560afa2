#pragma once

#include <XmlRpcValue.h>
#include <ros/node_handle.h>

#include <string>

#include "bezier_fem/scene.h"

namespace bezier_fem
{
/** The value as YAML text of the same types: strings quoted, doubles with a point or exponent and 17 digits. */
std::string toYaml(const XmlRpc::XmlRpcValue& value);

/** All that the node reads from its private parameters. */
struct NodeParameters
{
  Scene scene;
  int threads = 1;
};

/**
 * Parameters that are neither a key of the scene nor the node's nor ROS's own are errors. The scene's relative paths
 * are relative to the parameter scene_directory.
 * @throws InputError
 */
NodeParameters readParameters(const ros::NodeHandle& private_handle);

}  // namespace bezier_fem
