#include "bezier_fem/rest_watch.h"

#include <algorithm>
#include <cmath>

namespace bezier_fem
{
namespace
{
constexpr int SHORTEST_SPAN = 5;  // steps
constexpr double SPAN = 1.0 / 9;  // of the time at its end
constexpr double DECAY = 0.9;
constexpr int SPANS = 3;
constexpr double LONG = 86400;  // s
/** Of the tolerance and of the longest side: a quarter of what may remain. */
constexpr double WAY_OF_TOLERANCE = 0.025, LONGEST_WAY = 2.5e-6;
constexpr double LOAD_CHANGE = 1e-6;  // of the largest load

double longestSide(const Model& model)
{
  const auto points = model.rest.matrix().topRows<3>();
  return (points.rowwise().maxCoeff() - points.rowwise().minCoeff()).maxCoeff();
}

/** Whether no component differs by more than `most`; not where one is no number. */
bool isNear(const NodalField& a, const NodalField& b, double most)
{
  return ((a.matrix() - b.matrix()).array().abs() <= most).all();
}
}  // namespace

RestWatch::RestWatch(const Model& model, double tolerance)
    : way_(std::min(WAY_OF_TOLERANCE * tolerance, LONGEST_WAY) * longestSide(model)), load_(model.num_nodes)
{
}

void RestWatch::wake()
{
  time_ = span_begin_ = 0;
  steps_ = spans_ = 0;
  fastest_ = 0;
  before_.fill(0);
  solved_ = true;
  asleep_ = false;
}

void RestWatch::stepped(const NodalField& v, const NodalField& load, double time_step, bool solved)
{
  time_ += time_step;
  ++steps_;
  fastest_ = std::max(fastest_, std::sqrt(v.matrix().colwise().squaredNorm().maxCoeff()));
  solved_ = solved_ && solved;
  if (steps_ < SHORTEST_SPAN || time_ - span_begin_ < SPAN * time_) return;
  const bool decays = fastest_ <= DECAY * before_.back();
  const bool trembles = fastest_ * LONG <= way_ && fastest_ <= *std::max_element(before_.begin(), before_.end());
  const bool rests = solved_ && fastest_ * time_ <= way_ && (decays || trembles) && !isOtherLoad(load);
  spans_ = rests ? spans_ + 1 : 0;
  asleep_ = spans_ >= SPANS;
  load_.matrix() = load.matrix();
  span_begin_ = time_;
  steps_ = 0;
  std::rotate(before_.begin(), before_.begin() + 1, before_.end());
  before_.back() = fastest_;
  fastest_ = 0;
  solved_ = true;
}

bool RestWatch::isOtherLoad(const NodalField& load) const
{
  return !isNear(load, load_, LOAD_CHANGE * load_.matrix().cwiseAbs().maxCoeff());
}

bool RestWatch::isOtherPlace(const NodalField& a, const NodalField& b) const
{
  return !isNear(a, b, way_);
}

}  // namespace bezier_fem
