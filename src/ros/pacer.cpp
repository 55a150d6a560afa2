#include "pacer.h"

#include <algorithm>

namespace bezier_fem
{
namespace
{
constexpr double LARGEST_BACKLOG = 0.1;  // s, or two steps if that is more
constexpr double WINDOW = 1;             // s
constexpr double SAMPLE_PERIOD = 0.05;   // s
}  // namespace

bool Pacer::advance(const ros::Time& now)
{
  if (now.isZero()) return false;
  const bool jumped_back = last_ && now < *last_;
  if (last_ && !jumped_back) owed_ += (now - *last_).toSec();
  last_ = now;
  const double largest = std::max(LARGEST_BACKLOG, 2 * time_step_);
  dropped_ += std::max(owed_ - largest, 0.0);
  owed_ = std::min(owed_, largest);
  return jumped_back;
}

ros::Time Pacer::stateTime(const ros::Time& now) const
{
  return now.toSec() > owed_ ? now - ros::Duration(owed_) : now;
}

void RealTimeFactor::add(double simulated, double clock)
{
  if (!samples_.empty() && (clock < samples_.back().clock || simulated < samples_.back().simulated)) samples_.clear();
  // The newest sample is kept up to date, older ones stay a period apart
  if (samples_.size() > 1 && clock - samples_[samples_.size() - 2].clock < SAMPLE_PERIOD) samples_.pop_back();
  samples_.push_back({simulated, clock});
  while (samples_.size() > 2 && clock - samples_[1].clock >= WINDOW) samples_.pop_front();
}

double RealTimeFactor::value() const
{
  if (samples_.empty()) return 0;
  const double clock = samples_.back().clock - samples_.front().clock;
  return clock > 0 ? (samples_.back().simulated - samples_.front().simulated) / clock : 0;
}

}  // namespace bezier_fem
