#pragma once

#include <ros/time.h>

#include <deque>
#include <optional>

namespace bezier_fem
{
/**
 * Says when a simulation that follows a clock owes its next step. What it cannot make up for is dropped, so that a
 * stall of the machine or of the solver ends in a bounded burst of steps and not in a spiral.
 */
class Pacer
{
public:
  explicit Pacer(double time_step) : time_step_(time_step) {}

  /** Tells the clock's time; true if it jumped back. Neither that nor a clock not running yet (zero) owes a step. */
  bool advance(const ros::Time& now);

  bool stepDue() const { return owed_ > (1 - 1e-6) * time_step_; }  // clocks tick in whole nanoseconds
  void stepped() { owed_ -= time_step_; }

  /** The clock's time that the state is of after the steps made so far. */
  ros::Time stateTime(const ros::Time& now) const;

  /** Time until the next step is due, s. */
  double untilDue() const { return time_step_ - owed_; }

  /** Forgets what is owed: after a pause. */
  void restart() { last_.reset(), owed_ = 0; }

  /** What was not made up for, s, in all. */
  double dropped() const { return dropped_; }

private:
  double time_step_;
  std::optional<ros::Time> last_;
  double owed_ = 0;  // s
  double dropped_ = 0;
};

/** Simulated time per time of a clock, over the last second and a bit. */
class RealTimeFactor
{
public:
  /** Tells both clocks, s; call once a cycle. */
  void add(double simulated, double clock);
  void restart() { samples_.clear(); }
  /** 0 before there is anything to measure. */
  double value() const;

private:
  struct Sample
  {
    double simulated, clock;
  };
  std::deque<Sample> samples_;
};

}  // namespace bezier_fem
