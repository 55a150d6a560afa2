#pragma once

#include <Eigen/Core>
#include <limits>
#include <string>
#include <vector>

#include "bezier_fem/model.h"
#include "bezier_fem/scene.h"
#include "bezier_fem/simulation.h"

/**
 * Variants of a scene - other elements, cells, time steps, tolerances - run, and compared with a reference on a mesh of
 * its own. What is compared are material points of the rest shape, which every mesh of the body can evaluate.
 *
 * A difference between two recordings is all of the model's error, not the discretisation's alone: the boundary that
 * CGAL gives a surface differs from one cell size to the next, and so do the corners, faces and elements that a box or
 * a sphere selects (what is held, where a load acts). A point that lies outside of a variant's mesh moves with the
 * nearest element, extrapolated.
 */
namespace bezier_fem
{
/** How the variants of one comparison are run. */
struct RunPlan
{
  bool statics = false;  // the equilibrium, else `duration` of motion
  double duration = 1;   // s; a variant goes on to the end of the step that reaches it
  int threads = 1;
  double time_limit = std::numeric_limits<double>::infinity();  // s, wall clock of one variant's run, without loading
};

/** Points spread through a body. */
struct BodyPoints
{
  Eigen::Matrix3Xd rest;    // 3 x points, m
  Eigen::VectorXd weights;  // m^3, sum to the body's volume; 0 for points of the boundary, which only a maximum counts
};

/**
 * 1000 points inside, each for the same share of the volume, and up to 500 corners of the boundary; the same ones for
 * the same model.
 */
BodyPoints bodyPoints(const Model& model);

enum class RunStatus
{
  OK,
  NOT_CONVERGED,  // a system was left above its tolerance; recorded to the end all the same
  DIVERGED,       // positions are no longer finite; nothing to compare
  REFUSED,        // the scene or its mesh is wrong; nothing to compare
  STOPPED         // took longer than RunPlan::time_limit; nothing to compare
};
/** "ok", "not_converged", "diverged", "refused", "stopped". */
const char* nameOf(RunStatus status);

/** A variant's run. */
struct Recording
{
  RunStatus status = RunStatus::OK;
  std::string reason;  // one line; empty if OK
  bool comparable() const { return status == RunStatus::OK || status == RunStatus::NOT_CONVERGED; }

  int tets = 0, nodes = 0;
  long degrees_of_freedom = 0;
  double load_seconds = 0;  // wall clock until the first step, meshing included
  long steps = 0;           // 0 in statics
  long substeps = 0;
  double iterations = 0;     // of the linear solver: median a step; in all in statics
  double residual = 0;       // worst, as the tolerance measures it
  double ms_per_step = 0;    // wall clock, median; in statics of the whole solve
  double ms_per_second = 0;  // wall clock of the steps per simulated second, ms/s; 0 in statics
  bool starts_at_rest = true;

  BodyPoints body;
  Eigen::Matrix3Xd probe_rest;  // 3 x probes, m, in the scene's order
  // At the start and after every k-th step, k the largest with k * time_step <= duration / 200, and the last; in
  // statics at the equilibrium only
  std::vector<double> times;             // s
  std::vector<Eigen::Matrix3Xd> probes;  // 3 x probes, m
  std::vector<Eigen::Matrix3Xd> points;  // 3 x body points, m
  Eigen::VectorXd von_mises;             // at the probes at the end, Pa: the nodes' mean stress, linear in between
};

/**
 * Runs a scene and records it. Nothing is thrown: what goes wrong is in the status. A run of less than 50 ms is
 * repeated for its times, of which each step's shortest counts. The scene's fine surface is left out.
 * @param points  those of the reference; null: the model's own, for the reference itself
 */
Recording record(Scene scene, const RunPlan& plan, const BodyPoints* points, const Simulation::Log& log);

/**
 * Largest displacements (from rest) below are the reference's, over all its times, body points and probes; an error of
 * displacement is relative to them. NaN: nothing to compare, or 0/0.
 *
 * Times: the coarser recording's, as far as both go; there the finer one is interpolated by cubics through its four
 * nearest times. With n recorded times a period that errs by about 0.023 (2 pi / n)^4 of the amplitude: 1e-6 at n = 80.
 */
struct VariantErrors
{
  double tip = NOTHING;  // of the probe that moves most (without probes: the body point): root mean square in time
  double field_rms = NOTHING;  // root mean square over the body's volume and time
  double field_max = NOTHING;  // largest over all body points, probes and times
  double von_mises = NOTHING;  // largest over the probes, at the end, each relative to its own stress in the reference
                               // (which at a free corner or next to a clamped edge has no limit worth the name)
  double period = NOTHING;     // of the main swing, relative
  double decay = NOTHING;      // of the main swing: difference of the shares of its amplitude lost in a period
  std::vector<double> von_mises_of_probes;

  static constexpr double NOTHING = std::numeric_limits<double>::quiet_NaN();
};

VariantErrors compare(const Recording& variant, const Recording& reference);

/** A turning point of a coordinate over time. */
struct TurningPoint
{
  double time, value;
};

/**
 * Where a signal turns by more than a twentieth of its whole range, each by the parabola through the three samples
 * there. The first sample counts where the body starts at rest.
 */
std::vector<TurningPoint> turningPoints(const std::vector<double>& times, const std::vector<double>& values,
                                        bool starts_at_rest);

/** The main swing: of the probe (without probes: body point) and axis of the widest range. */
struct Swing
{
  double period = VariantErrors::NOTHING;  // s; NaN with fewer than three turning points: no swing to speak of
  double decay =
      VariantErrors::NOTHING;  // share of the amplitude, from one turning point to the next, lost in a period
};

/** Period and decay between the first `count` turning points. */
Swing swingOf(const std::vector<TurningPoint>& points, std::size_t count);
/** The same of a recording, with all its turning points. */
Swing swingOf(const Recording& recording);

}  // namespace bezier_fem
