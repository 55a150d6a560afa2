#pragma once

#include <bezier_fem/Step.h>
#include <diagnostic_updater/diagnostic_updater.h>
#include <ros/node_handle.h>
#include <ros/service_server.h>
#include <std_srvs/SetBool.h>
#include <std_srvs/Trigger.h>

#include <condition_variable>
#include <deque>
#include <functional>
#include <future>
#include <mutex>
#include <string>
#include <vector>

#include "bezier_fem/simulation.h"
#include "frames.h"
#include "inputs.h"
#include "live_settings.h"
#include "outputs.h"
#include "pacer.h"

namespace bezier_fem
{
/**
 * A body among other nodes. run() is the only thread that touches the simulation; ROS's callbacks run in others and
 * hand over what they get: messages to Inputs, values to LiveSettings, service calls as jobs.
 */
class DeformableNode
{
public:
  /** @throws InputError */
  DeformableNode(const Scene& scene, int threads);

  /** Until ROS shuts down. */
  void run();

private:
  struct Outcome
  {
    bool success;
    std::string message;
    double time;  // simulated, s
  };

  /** A call of ~step that is being carried out. */
  struct StepRequest
  {
    std::uint32_t remaining;
    std::promise<Outcome> outcome;
  };

  /** A region that follows a tf frame. */
  struct Follower
  {
    int region;
    std::string frame;
    std::optional<Eigen::Isometry3d> T_first_world;  // inverse of the frame's pose when it was first seen
    std::string missing;                             // why there is no transform; empty if there is one
  };

  // In other threads
  Outcome callInLoop(std::function<std::future<Outcome>()> job);
  bool onReset(std_srvs::Trigger::Request& request, std_srvs::Trigger::Response& response);
  bool onSetPaused(std_srvs::SetBool::Request& request, std_srvs::SetBool::Response& response);
  bool onStep(Step::Request& request, Step::Response& response);
  void wake();

  // In the loop
  bool cycle();  // true if it made a step
  void runJobs();
  void applySettings();
  bool prepareStep();
  bool prepareLockstep();
  void makeStep();
  void followFrames();
  void lose(const std::string& why);
  void answerSteps(bool success, const std::string& message);
  void reset();
  void publishWhenDue();
  void wait(bool stepping);
  ros::Time stateStamp() const;
  Outcome outcome(bool success, const std::string& message = "") const;

  // Diagnostics
  void diagnoseSimulation(diagnostic_updater::DiagnosticStatusWrapper& status);
  void diagnoseInputs(diagnostic_updater::DiagnosticStatusWrapper& status);
  void diagnoseFrames(diagnostic_updater::DiagnosticStatusWrapper& status);

  using Mode = Scene::Node::Mode;
  const Mode mode_;
  const double time_step_;  // s
  Simulation simulation_;
  ros::NodeHandle private_handle_{"~"};
  Frames frames_;
  Inputs inputs_;
  Outputs outputs_;
  LiveSettings live_;
  LiveSettings::Values settings_;
  std::vector<Follower> followers_;

  std::mutex mutex_;  // of the next three
  std::condition_variable condition_;
  bool woken_ = false;
  std::vector<std::packaged_task<std::future<Outcome>()>> jobs_;

  bool paused_ = false;
  std::string lost_;  // why the state is lost; empty if it is not
  std::deque<StepRequest> step_requests_;
  StepResult result_;

  // Times
  ros::Time now_;  // of this cycle
  Pacer pacer_;
  ros::Time origin_;    // stamp of the simulated time 0, in lockstep
  double skipped_ = 0;  // s, in lockstep
  RealTimeFactor real_time_factor_;
  long steps_made_ = 0;  // since the start
  bool publish_now_ = false, unpublished_ = false;
  double next_publish_ = 0, last_publish_ = 0;  // s, of the steady clock

  struct Period  // since the last diagnostics
  {
    long steps = 0, asleep = 0, not_converged = 0;
    int substeps = 0, iterations = 0;  // largest
    double residual = 0, longest_ms = 0, total_ms = 0;
  } period_;
  double dropped_told_ = 0;  // s
  std::uint64_t refusals_told_ = 0, published_told_ = 0;
  diagnostic_updater::Updater diagnostics_;

  std::vector<ros::ServiceServer> services_;  // last, so that callbacks end before what they use does
};

}  // namespace bezier_fem
