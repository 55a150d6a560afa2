#pragma once

#include <bezier_fem/BodyState.h>
#include <ros/node_handle.h>
#include <ros/publisher.h>
#include <visualization_msgs/Marker.h>
#include <visualization_msgs/MarkerArray.h>

#include <cstdint>
#include <vector>

#include "bezier_fem/simulation.h"
#include "inputs.h"
#include "markers.h"

namespace bezier_fem
{
/** What the loop knows of the last step. */
struct StepResult
{
  StepReport report;
  ros::Time stamp;  // that the state is of
  double real_time_factor = 0;
};

/** From the state to messages. Computes only what somebody listens to. */
class Outputs
{
public:
  Outputs(ros::NodeHandle& private_handle, const Simulation& simulation);

  /** @param elapsed  since the last call, s, real */
  void publish(const StepResult& result, const std::map<std::string, Inputs::Active>& active, double elapsed);

  /** Messages that were computed, of all topics but the latched one. */
  std::uint64_t published() const { return published_; }

private:
  void publishState(const StepResult& result);
  void publishReactions(const ros::Time& stamp);

  const Simulation& simulation_;
  Eigen::AlignedBox3d body_;  // at rest
  ros::Publisher surface_, stress_, forces_, topology_, state_;
  std::vector<ros::Publisher> reactions_;  // of each of supports().regions
  SmoothedScale stress_scale_;
  ForceMarkers force_markers_;

  std::uint64_t published_ = 0;

  // Kept for their memory
  Eigen::Matrix3Xd positions_, normals_;
  Eigen::VectorXd von_mises_;
  visualization_msgs::Marker surface_marker_;
  visualization_msgs::MarkerArray stress_markers_;
  BodyState state_message_;
};

}  // namespace bezier_fem
