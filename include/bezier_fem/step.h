#pragma once

#include <Eigen/Core>
#include <array>
#include <functional>
#include <memory>
#include <optional>
#include <vector>

#include "bezier_fem/boundary_conditions.h"
#include "bezier_fem/conjugate_gradient.h"
#include "bezier_fem/model.h"
#include "bezier_fem/nodal_field.h"
#include "bezier_fem/partition.h"
#include "bezier_fem/rotation.h"
#include "bezier_fem/scene.h"

namespace bezier_fem
{
class AssembledSystem;
class Preconditioner;
class SpectralBound;
struct GreenTangent;
struct NewtonMemory;

/** Everything about a body that changes in time. Positions and velocities of control points, not of material points. */
struct State
{
  NodalField x;         // m
  NodalField v;         // m/s
  Rotations rotations;  // of x
  double time = 0;      // s
  long steps = 0;
};

/** What a step needs to know beside the model; may change from step to step. */
struct StepSettings
{
  double time_step;  // s
  Elasticity elasticity;
  RotationRule rotation;
  Scene::Damping damping;
  Eigen::Vector3d gravity;  // m/s^2
  Scene::Solver solver;
};

/** Wall-clock times in ms. */
struct StageTimes
{
  double rotation = 0;  // rotations of the elements
  double assembly = 0;  // the system's diagonal blocks
  double force = 0;     // right-hand side
  double solve = 0;
  double total = 0;
};

struct StepReport
{
  int substeps = 1;           // 1: exactly one lagged step
  double turn = 0;            // rad: the largest angle that an element turned by in an accepted (sub-)step
  int inverted = 0;           // elements that end with det F <= 0: where a rotation is taken, or at a corner (green)
  int iterations = 0;         // of the linear solver, in all
  double residual = 0;        // worst (sub-)step, relative, as the tolerance measures it
  bool converged = true;      // every residual within the tolerance
  bool finite = true;         // false: the state is lost
  bool asleep = false;        // nothing was computed, because the body is at rest: 0 sub-steps
  bool second_order = false;  // done by SDIRK2
  /** What the last system was solved with that was not left to the diagonal blocks alone; never AUTO. */
  Scene::Solver::Preconditioner preconditioner = Scene::Solver::Preconditioner::BLOCK_JACOBI;
  StageTimes ms;
};

/** Scratch memory of the steps of one body, and what they remember of each other to start from. */
struct Workspace
{
  Workspace(const Model& model, const StepSettings& settings, int threads);

  ~Workspace();

  /** To be called when the state was not made by the last step: the same steps from it are then the same to the bit. */
  void forgetHistory();
  /** To be called after setMaterials(). */
  void forgetMaterials();

  Partition partition;
  ConjugateGradient solver;
  NodalField balance;  // force (N) of the supports on each control point in the last step; meaningful where held

  NodalField load, force, rhs, led, change, x_before, v_before, predicted;
  Rotations candidate, stage_rotations;
  AlignedVector<double> turned;
  std::array<NodalField, 3> past;                  // changes of v, the last one first
  int history = 0;                                 // how many steps before now they tell of, up to three
  int last_iterations = 0;                         // of the last system
  bool history_is_of_stages = false;               // of sdirk2Step(): they are those of its stages, two a step
  std::unique_ptr<Preconditioner> preconditioner;  // beyond the diagonal blocks, since it was first wanted
  Scene::Solver::Preconditioner preconditioner_kind = Scene::Solver::Preconditioner::BLOCK_JACOBI;
  bool preconditioner_failed = false;  // not to be tried again
  AlignedVector<double> like_inverse;  // of the diagonal blocks of K' where that only preconditions
  struct PreparedSystem
  {
    double alpha, beta, load_floor;
    HeldAxes held;
  };
  std::optional<PreparedSystem> prepared;      // of linear elasticity, what solver and assembled are prepared for
  std::unique_ptr<AssembledSystem> assembled;  // where the settings ask for a matrix
  std::unique_ptr<SpectralBound> bound;        // of explicit steps
  std::unique_ptr<GreenTangent> green;         // of explicit steps of Green's strain
  std::unique_ptr<NewtonMemory> newton;        // of implicit and static ones
};

/** The largest angle that an element may turn by in one lagged step, rad; METHOD: inflation by sqrt(1 + angle^2). */
constexpr double MAX_TURN = 0.2;
/** A step is cut into at most so many sub-steps. */
constexpr int MAX_SUBSTEPS = 32;

/**
 * One step of linearised implicit Euler (Baraff and Witkin 1998) with the rotations of its start:
 *     (M + dt^2 K' + dt D) dv = dt (f_ext - f_el(x) - dt K' v - D v),   v += dv,   x += dt v,   D = a M + b K'
 * (Weber et al. 2011, Eq. 18, whose right-hand side lacks the elastic force at the start of the step). Led and held
 * components enter as known dv.
 *
 * A step in which an element turns by more than MAX_TURN is taken back and done in sub-steps short enough, down to
 * time_step / MAX_SUBSTEPS; except while elements are inverted, when StepReport::turn alone tells.
 *
 * With co-rotated elasticity dv is shortened where the held rotations have hidden so much of a stressed body's
 * stiffness that the step would go too far; the system's residual is that of the whole dv. Linear momentum is kept.
 *
 * With Green's strain implicit Euler itself, solved for the end of the step by Newton's method:
 *     M dv + dt (f_el(x + dt (v + dv)) + D (v + dv) - f_ext) = 0,   D = a M + b K of the start of the step, projected;
 * K is the derivative of the force. The residual that the tolerance is for is this sum, relative to its value for
 * dv = 0 where free; the blocks B are those of the last of Newton's systems.
 *
 * @param external  force on control points, N, beside gravity and loads
 */
StepReport implicitEulerStep(const Model& model, const StepSettings& settings, const Supports& supports,
                             const std::vector<AppliedLoad>& loads, const NodalField& external, State& state,
                             Workspace& workspace);

/**
 * One step of the singly diagonally implicit Runge-Kutta method of two stages and second order (Alexander 1977). Each
 * stage is an implicit Euler step as above of g dt, g = 1 - sqrt(1/2): the first from x and v, the second from where
 * the first one's derivatives lead in (1 - g) dt; where the second ends, the step does. L-stable. The rotations of a
 * stage are those of the positions predicted for its end, with no acceleration in the first stage and the first one's
 * in the second: off by O(dt^2), and the force, of which K' is the derivative but for terms of the strain, by less.
 *
 * Cut into sub-steps where a rotation was off by more than MAX_TURN; StepReport::turn is then the largest turn between
 * the start, the two predictions and the end. Follower loads (pressure) are those of the predicted positions.
 */
StepReport sdirk2Step(const Model& model, const StepSettings& settings, const Supports& supports,
                      const std::vector<AppliedLoad>& loads, const NodalField& external, State& state,
                      Workspace& workspace);

/**
 * sdirk2Step(), or where that is of no use implicitEulerStep(): in a step that begins with an inverted element, or
 * that sdirk2Step() would end with one, with a rotation off by more than MAX_TURN, or with an unsolved system. The
 * former's second stage starts from an extrapolation, which throws what is inside out farther out; the latter's damping
 * brings it back.
 */
StepReport automaticStep(const Model& model, const StepSettings& settings, const Supports& supports,
                         const std::vector<AppliedLoad>& loads, const NodalField& external, State& state,
                         Workspace& workspace);

/** An explicit step is cut into at most so many sub-steps. */
constexpr int MAX_EXPLICIT_SUBSTEPS = 1000;

/** The longest step, s, that explicitStep() can be sure to be stable with, at the present positions. */
double stableStep(const Model& model, const StepSettings& settings, const State& state, Workspace& workspace);

/**
 * One step of velocity Verlet, M a = f_ext - f_el(x) - D v with the consistent mass matrix, for any elasticity:
 * of second order, and without numerical damping. Cut into sub-steps of at most 0.9 stableStep(); solver.tolerance is
 * that of each acceleration.
 */
StepReport explicitStep(const Model& model, const StepSettings& settings, const Supports& supports,
                        const std::vector<AppliedLoad>& loads, const NodalField& external, State& state,
                        Workspace& workspace);

/**
 * Moves x to the static equilibrium f_el(x) = f_ext(x) of the loads of the current time and stops the body. Converged
 * when |f_ext - f_el| over the components that are free is at most the tolerance times |f_ext| plus the same norm of
 * the supports' forces.
 * @param progress  called before each iteration with the relative residual; may be empty
 */
StepReport solveStatic(const Model& model, const StepSettings& settings, const Supports& supports,
                       const std::vector<AppliedLoad>& loads, const NodalField& external, State& state,
                       Workspace& workspace, const std::function<void(int, double)>& progress);

/** x, v, rotations and time of a body that starts at the positions x, in m, at time 0, with the velocity v, in m/s. */
State startState(const Model& model, const StepSettings& settings, const Supports& supports, const NodalField& x,
                 const Eigen::Vector3d& velocity, Workspace& workspace);

}  // namespace bezier_fem
