#pragma once

#include <array>

#include "bezier_fem/model.h"
#include "bezier_fem/nodal_field.h"

namespace bezier_fem
{
/**
 * Tells from a body's speed when it has come to rest, so that it may sleep, and from what acts on it when it has to
 * wake.
 *
 * A body that is slow for a moment may turn back, and one that creeps goes far in time. So the watch knows of no
 * moments. It cuts the time t since the body was let go into spans, each a ninth of t at its end, and looks at the
 * largest speed V of a control point in each. Of the first turning point that a swing of amplitude A comes to, the span
 * before it has V t > 0.27 A, of later ones more. A creep whose V falls by a tenth from span to span has no farther to
 * go than 3.2 V t. Rest is: V t at most a part of the body's size in three spans running, V falling by a tenth in each,
 * and the loads the same. What is left is then at most 4 V t. Stiff bodies tremble for ever as rounding has it: where
 * V would not go that way in a day it is enough that it is no larger than in one of the three spans before.
 */
class RestWatch
{
public:
  /** @param tolerance  of the solver, relative: what remains is at most 0.1 of it times the body's longest side, and at
   *                    most 1e-5 of that side */
  RestWatch(const Model& model, double tolerance);

  /** The body is let go anew: it is awake. */
  void wake();

  /**
   * To be called after each step; falls asleep where that has been the last one.
   * @param v          velocities, m/s
   * @param load       forces on the control points in this step, N
   * @param time_step  s
   * @param solved     whether the step has met its tolerance
   */
  void stepped(const NodalField& v, const NodalField& load, double time_step, bool solved);

  bool asleep() const { return asleep_; }

  /** Whether these are other loads than those it rests under, by more than 1e-6 of the largest. */
  bool isOtherLoad(const NodalField& load) const;
  /** Whether positions are farther apart than what may remain, m. */
  bool isOtherPlace(const NodalField& a, const NodalField& b) const;

private:
  double way_;                        // m, that V t may be
  NodalField load_;                   // of the last span's end
  double time_ = 0, span_begin_ = 0;  // s since it was let go
  int steps_ = 0;                     // of the span
  double fastest_ = 0;                // V of the span, m/s
  std::array<double, 3> before_{};    // and of those before, the last one last
  bool solved_ = true;
  int spans_ = 0;  // in which it was at rest
  bool asleep_ = false;
};

}  // namespace bezier_fem
