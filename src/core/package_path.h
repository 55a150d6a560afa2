#pragma once

#include <optional>
#include <string>

namespace bezier_fem
{
/**
 * The folder of a ROS package, found without ROS: below ROS_PACKAGE_PATH, in the prefixes of CMAKE_PREFIX_PATH, and
 * in the workspace, source tree or install prefix that holds the running program.
 */
std::optional<std::string> findPackage(const std::string& name);

}  // namespace bezier_fem
