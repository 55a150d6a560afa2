#include "deformable_node.h"

#include <ros/console.h>
#include <ros/spinner.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <numeric>

#include "bezier_fem/measures.h"
#include "topics.h"

namespace bezier_fem
{
namespace
{
constexpr std::uint32_t LARGEST_STEP_REQUEST = 100000;
constexpr double LARGEST_GAP = 60;      // s between the stamps of inputs in lockstep; a longer one is skipped
constexpr double IDLE_PERIOD = 0.02;    // s, real: how often an idle loop looks around
constexpr double CLOCK_PERIOD = 0.001;  // s, real: the same while it follows /clock, which wakes nobody

const char* nameOf(Scene::Node::Mode mode)
{
  switch (mode)
  {
    case Scene::Node::Mode::REALTIME:
      return "realtime";
    case Scene::Node::Mode::LOCKSTEP:
      return "lockstep";
    case Scene::Node::Mode::FREE_RUN:
      return "free_run";
  }
  return "";
}

}  // namespace

DeformableNode::DeformableNode(const Scene& scene, int threads)
    : mode_(scene.node.mode),
      time_step_(scene.time_step),
      simulation_(scene, threads, [](const std::string& line) { ROS_INFO("%s", line.c_str()); }),
      frames_(scene.frame_id),
      inputs_(private_handle_, scene, frames_, simulation_,
              [this] {
                if (mode_ == Mode::LOCKSTEP) wake();
              }),
      outputs_(private_handle_, simulation_),
      live_(private_handle_, scene),
      settings_{scene.material, scene.damping, scene.gravity, scene.node.publish_rate},
      pacer_(scene.time_step)
{
  const auto& regions = simulation_.supports().regions;
  for (std::size_t i = 0; i < regions.size(); ++i)
    if (!regions[i].frame.empty())
      followers_.push_back({static_cast<int>(i), regions[i].frame, {}, "it was not seen yet"});

  diagnostics_.setHardwareID("none");
  diagnostics_.add("simulation", this, &DeformableNode::diagnoseSimulation);
  diagnostics_.add("inputs", this, &DeformableNode::diagnoseInputs);
  if (!followers_.empty()) diagnostics_.add("frames", this, &DeformableNode::diagnoseFrames);

  services_.push_back(private_handle_.advertiseService(topics::RESET, &DeformableNode::onReset, this));
  services_.push_back(private_handle_.advertiseService(topics::SET_PAUSED, &DeformableNode::onSetPaused, this));
  services_.push_back(private_handle_.advertiseService(topics::STEP, &DeformableNode::onStep, this));
}

void DeformableNode::run()
{
  // A service call waits in its thread until the loop has done it: messages and other calls have threads left
  ros::AsyncSpinner spinner(4);
  spinner.start();
  now_ = ros::Time::now();
  result_.stamp = stateStamp();
  while (ros::ok())
  {
    bool stepped = false;
    try
    {
      stepped = cycle();
    }
    catch (const std::exception& error)  // nothing known throws here, but a node that dies tells nobody why
    {
      lose(error.what());
    }
    wait(stepped);
  }
  answerSteps(false, "the node shuts down");
}

bool DeformableNode::cycle()
{
  now_ = ros::Time::now();
  runJobs();
  applySettings();
  inputs_.collect();
  followFrames();
  const bool step = prepareStep();
  if (step) makeStep();
  publishWhenDue();
  diagnostics_.update();
  return step;
}

// Service calls -----------------------------------------------------------------------------------------------------

DeformableNode::Outcome DeformableNode::callInLoop(std::function<std::future<Outcome>()> job)
{
  // Both futures are left alone when the node shuts down meanwhile: the loop may be past its jobs then
  const auto ready = [](const auto& future) {
    while (ros::ok())
      if (future.wait_for(std::chrono::milliseconds(50)) == std::future_status::ready) return true;
    return false;
  };
  try
  {
    std::packaged_task<std::future<Outcome>()> task(std::move(job));
    auto started = task.get_future();
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      jobs_.push_back(std::move(task));
    }
    wake();
    if (ready(started))
      if (auto done = started.get(); ready(done)) return done.get();
    return {false, "the node shuts down", 0};
  }
  catch (const std::exception& error)
  {
    return {false, error.what(), 0};
  }
}

bool DeformableNode::onReset(std_srvs::Trigger::Request& /*request*/, std_srvs::Trigger::Response& response)
{
  const Outcome done = callInLoop([this] {
    reset();
    std::promise<Outcome> promise;
    promise.set_value(outcome(true));
    return promise.get_future();
  });
  response.success = done.success;
  response.message = done.message;
  return true;
}

bool DeformableNode::onSetPaused(std_srvs::SetBool::Request& request, std_srvs::SetBool::Response& response)
{
  const Outcome done = callInLoop([this, pause = static_cast<bool>(request.data)] {
    std::promise<Outcome> promise;
    if (!pause && !lost_.empty())
      promise.set_value(outcome(false, lost_ + "; call ~reset first"));
    else
    {
      paused_ = pause;
      if (!pause) answerSteps(false, "the simulation was set running");
      promise.set_value(outcome(true, pause ? "paused" : "running"));
    }
    return promise.get_future();
  });
  response.success = done.success;
  response.message = done.message;
  return true;
}

bool DeformableNode::onStep(Step::Request& request, Step::Response& response)
{
  const Outcome done = callInLoop([this, steps = request.steps] {
    StepRequest step{steps, {}};
    auto future = step.outcome.get_future();
    if (steps > LARGEST_STEP_REQUEST)
      step.outcome.set_value(outcome(
          false, "steps is " + std::to_string(steps) + ", must be at most " + std::to_string(LARGEST_STEP_REQUEST)));
    else if (!lost_.empty())
      step.outcome.set_value(outcome(false, lost_ + "; call ~reset first"));
    else if (!paused_ && mode_ != Mode::LOCKSTEP)
      step.outcome.set_value(outcome(false, "the simulation is running; call ~set_paused first"));
    else if (steps == 0)
      step.outcome.set_value(outcome(true));
    else
      step_requests_.push_back(std::move(step));
    return future;
  });
  response.success = done.success;
  response.message = done.message;
  response.time = done.time;
  return true;
}

void DeformableNode::wake()
{
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    woken_ = true;
  }
  condition_.notify_one();
}

DeformableNode::Outcome DeformableNode::outcome(bool success, const std::string& message) const
{
  return {success, message, simulation_.time()};
}

void DeformableNode::answerSteps(bool success, const std::string& message)
{
  for (StepRequest& request : step_requests_) request.outcome.set_value(outcome(success, message));
  step_requests_.clear();
}

// The loop ----------------------------------------------------------------------------------------------------------

void DeformableNode::runJobs()
{
  std::vector<std::packaged_task<std::future<Outcome>()>> jobs;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    jobs.swap(jobs_);
  }
  for (auto& job : jobs) job();  // keeps what it throws for the caller
}

void DeformableNode::applySettings()
{
  const auto changed = live_.take();
  if (!changed) return;
  const auto& [material, damping, gravity, publish_rate] = *changed;
  const Material& old = settings_.material;
  if (material.young != old.young || material.poisson != old.poisson || material.density != old.density)
    simulation_.setMaterial(material);
  simulation_.setDamping(damping);
  simulation_.setGravity(gravity);
  settings_ = *changed;
}

void DeformableNode::reset()
{
  simulation_.reset();
  inputs_.clear();
  answerSteps(false, "the simulation was reset");
  lost_.clear();
  origin_ = {};
  pacer_.restart();
  real_time_factor_.restart();
  result_ = {{}, stateStamp(), 0};
  for (Follower& follower : followers_) follower.T_first_world.reset();  // the body is back where it started
  followFrames();
  publish_now_ = true;
}

/** Takes the inputs that are due and says whether a step is. */
bool DeformableNode::prepareStep()
{
  if (!lost_.empty()) return false;
  if (mode_ == Mode::LOCKSTEP) return prepareLockstep();

  inputs_.accept(now_.toSec(), ros::TIME_MAX);
  if (paused_)
  {
    pacer_.restart();
    real_time_factor_.restart();
    return !step_requests_.empty();
  }
  if (mode_ == Mode::FREE_RUN)
  {
    real_time_factor_.add(static_cast<double>(steps_made_) * time_step_, ros::SteadyTime::now().toSec());
    return true;
  }
  if (pacer_.advance(now_))
  {
    ROS_WARN("Time jumped back: forgot the wrenches and contacts of before");
    inputs_.clear();
    diagnostics_.force_update();  // it waits for the old time otherwise
  }
  real_time_factor_.add(static_cast<double>(steps_made_) * time_step_, pacer_.stateTime(now_).toSec());
  return pacer_.stepDue();
}

/**
 * An input acts from the step in which its stamp lies: the steps that end before its stamp come first. So the body
 * waits for its inputs, and the same inputs give the same motion however long they take.
 */
bool DeformableNode::prepareLockstep()
{
  const ros::Duration step(time_step_), rounding(1e-3 * time_step_);
  if (const auto first = inputs_.waiting(); first && !first->isZero())
  {
    const double gap = first->toSec() - stateStamp().toSec();
    if (gap > LARGEST_GAP && !origin_.isZero())
    {
      ROS_WARN("Skipped %g s: inputs stamped so far apart are not joined by steps", gap);
      skipped_ += gap;
    }
    if (gap > LARGEST_GAP || origin_.isZero())
      origin_ = *first - ros::Duration(std::min(simulation_.time(), first->toSec()));
  }
  const ros::Time next = stateStamp() + step - rounding;
  inputs_.accept(stateStamp().toSec(), next);
  real_time_factor_.add(static_cast<double>(steps_made_) * time_step_, ros::SteadyTime::now().toSec());
  if (!step_requests_.empty()) return true;
  const auto first = inputs_.waiting();
  const bool due = !paused_ && first && *first >= next;  // else none, or one that waits for its transform
  if (!due && unpublished_) publish_now_ = true;         // whoever closes a loop waits for what came of the input
  return due;
}

void DeformableNode::makeStep()
{
  inputs_.apply(mode_ == Mode::LOCKSTEP ? stateStamp().toSec() : now_.toSec(), simulation_.externalForces());
  result_.report = simulation_.step();
  ++steps_made_;
  const StepReport& report = result_.report;
  ++period_.steps;
  period_.asleep += report.asleep ? 1 : 0;
  period_.not_converged += report.converged ? 0 : 1;
  period_.substeps = std::max(period_.substeps, report.substeps);
  period_.iterations = std::max(period_.iterations, report.iterations);
  period_.residual = std::max(period_.residual, report.residual);
  period_.longest_ms = std::max(period_.longest_ms, report.ms.total);
  period_.total_ms += report.ms.total;
  if (!report.finite)
  {
    lose("it diverged");
    return;
  }
  if (mode_ == Mode::REALTIME && !paused_) pacer_.stepped();
  result_.stamp = stateStamp();
  unpublished_ = true;
  if (!step_requests_.empty() && --step_requests_.front().remaining == 0)
  {
    step_requests_.front().outcome.set_value(outcome(true));
    step_requests_.pop_front();
    publish_now_ = true;
  }
}

/** Leads the regions that follow frames. Those whose frame tf does not know stay where they are. */
void DeformableNode::followFrames()
{
  for (Follower& follower : followers_)
  {
    follower.missing.clear();
    std::optional<Eigen::Isometry3d> T_world_frame;
    if (mode_ == Mode::LOCKSTEP)
      T_world_frame = frames_.lookup(follower.frame, stateStamp() + ros::Duration(time_step_), follower.missing);
    if (!T_world_frame) T_world_frame = frames_.lookup(follower.frame, ros::Time(), follower.missing);
    if (!T_world_frame) continue;
    follower.missing.clear();
    if (!follower.T_first_world) follower.T_first_world = T_world_frame->inverse();
    simulation_.setRegionPose(follower.region, *T_world_frame * *follower.T_first_world);
  }
}

/** Gives up on a state that is no state any more; ~reset brings a new one. */
void DeformableNode::lose(const std::string& why)
{
  lost_ = "the simulation stopped in step " + std::to_string(simulation_.state().steps) + ": " + why;
  ROS_ERROR("%s; call ~reset", lost_.c_str());
  answerSteps(false, lost_);
  diagnostics_.force_update();
}

ros::Time DeformableNode::stateStamp() const
{
  if (mode_ == Mode::LOCKSTEP) return origin_ + ros::Duration(simulation_.time());
  return mode_ == Mode::REALTIME && !paused_ ? pacer_.stateTime(now_) : now_;
}

void DeformableNode::publishWhenDue()
{
  const double now = ros::SteadyTime::now().toSec();
  if (!publish_now_ && now < next_publish_) return;
  publish_now_ = false;
  const double period = std::clamp(1 / settings_.publish_rate, 1e-3, 1e6);  // s
  next_publish_ = std::max(next_publish_ + period, now);
  if (lost_.empty())
  {
    result_.real_time_factor = paused_ ? 0 : real_time_factor_.value();
    outputs_.publish(result_, inputs_.active(), now - last_publish_);
  }
  last_publish_ = now;
  unpublished_ = false;
}

void DeformableNode::wait(bool stepping)
{
  if (stepping) return;
  double seconds = std::min(IDLE_PERIOD, next_publish_ - ros::SteadyTime::now().toSec());
  if (mode_ == Mode::REALTIME && !paused_ && lost_.empty())
    seconds = std::min(seconds, ros::Time::isSimTime() ? CLOCK_PERIOD : pacer_.untilDue());
  std::unique_lock<std::mutex> lock(mutex_);
  if (seconds > 0) condition_.wait_for(lock, std::chrono::duration<double>(seconds), [this] { return woken_; });
  woken_ = false;
}

// Diagnostics -------------------------------------------------------------------------------------------------------

void DeformableNode::diagnoseSimulation(diagnostic_updater::DiagnosticStatusWrapper& status)
{
  using Level = diagnostic_msgs::DiagnosticStatus;
  const double factor = paused_ ? 0 : real_time_factor_.value();
  const double dropped = pacer_.dropped() + skipped_;
  const int inverted = lost_.empty() ? invertedElements(simulation_.model(), simulation_.state().x) : 0;

  status.summary(Level::OK, paused_ ? "paused" : result_.report.asleep ? "asleep: the body is at rest" : "running");
  if (dropped > dropped_told_ && mode_ == Mode::REALTIME)
    status.mergeSummaryf(Level::WARN, "falls behind, real-time factor %.2f", factor);
  if (period_.not_converged > 0)
    status.mergeSummaryf(Level::WARN, "%ld steps ended above the solver's tolerance", period_.not_converged);
  if (inverted > 0) status.mergeSummaryf(Level::WARN, "%d elements are inverted", inverted);
  if (!lost_.empty()) status.summary(Level::ERROR, lost_ + "; call ~reset");

  status.add("mode", nameOf(mode_));
  status.add("elements", simulation_.model().num_tets);
  status.add("steps", simulation_.state().steps);
  status.add("simulated time [s]", simulation_.time());
  status.addf("real-time factor", "%.3f", factor);
  status.addf("dropped time [s]", "%.3f", dropped);
  status.add("steps asleep", period_.asleep);
  status.addf("mean step [ms]", "%.3f", period_.steps > 0 ? period_.total_ms / static_cast<double>(period_.steps) : 0);
  status.addf("longest step [ms]", "%.3f", period_.longest_ms);
  status.add("largest number of sub-steps", period_.substeps);
  status.add("largest number of iterations", period_.iterations);
  status.addf("largest residual", "%.3g", period_.residual);
  status.add("steps not converged", period_.not_converged);
  status.add("inverted elements", inverted);
  status.add("messages computed", outputs_.published() - published_told_);
  dropped_told_ = dropped;
  published_told_ = outputs_.published();
  period_ = {};
}

void DeformableNode::diagnoseInputs(diagnostic_updater::DiagnosticStatusWrapper& status)
{
  using Level = diagnostic_msgs::DiagnosticStatus;
  const auto& refused = inputs_.refused();
  const std::uint64_t sum = std::accumulate(refused.begin(), refused.end(), std::uint64_t{0});
  if (sum > refusals_told_)
    status.summary(Level::WARN, "dropped " + inputs_.lastRefusal());
  else
    status.summary(Level::OK, "no input was dropped lately");
  refusals_told_ = sum;

  std::size_t wrenches = 0, contacts = 0;
  for (const auto& [key, input] : inputs_.active()) (input.contacts ? contacts : wrenches) += input.loads.size();
  status.add("acting wrenches", wrenches);
  status.add("acting contacts", contacts);
  for (int i = 0; i < Inputs::REFUSALS; ++i)
    status.add(std::string("dropped: ") + Inputs::REFUSAL_NAMES[i], refused[i]);
  status.add("last dropped", inputs_.lastRefusal());
}

void DeformableNode::diagnoseFrames(diagnostic_updater::DiagnosticStatusWrapper& status)
{
  using Level = diagnostic_msgs::DiagnosticStatus;
  status.summary(Level::OK, "all are known");
  for (const Follower& follower : followers_)
  {
    const std::string& region = simulation_.supports().regions[follower.region].name;
    if (!follower.missing.empty()) status.mergeSummary(Level::WARN, region + " stays where it is: " + follower.missing);
    status.add(region, follower.frame + (follower.missing.empty() ? "" : ": " + follower.missing));
  }
}

}  // namespace bezier_fem
