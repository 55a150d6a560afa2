#include <ros/console.h>
#include <ros/init.h>

#include "bezier_fem/error.h"
#include "deformable_node.h"
#include "scene_from_parameters.h"

int main(int argc, char** argv)
{
  ros::init(argc, argv, "deformable_node");
  const ros::NodeHandle private_handle("~");  // outlives the rest: ROS shuts down, and logs no more, with the last one
  try
  {
    const bezier_fem::NodeParameters parameters = bezier_fem::readParameters(private_handle);
    bezier_fem::DeformableNode node(parameters.scene, parameters.threads);
    node.run();
    return 0;
  }
  catch (const bezier_fem::InputError& error)
  {
    ROS_FATAL("%s", error.what());
    return 2;
  }
  catch (const std::exception& error)
  {
    ROS_FATAL("%s", error.what());
    return 1;
  }
}
