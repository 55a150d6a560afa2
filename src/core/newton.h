#pragma once

#include "bezier_fem/green_strain.h"
#include "bezier_fem/step.h"
#include "bezier_fem/system_operator.h"
#include "linear_solve.h"

namespace bezier_fem
{
/** Scratch memory of Newton's method. */
struct NewtonMemory
{
  explicit NewtonMemory(const Model& model);

  GreenTangent tangent;  // at the iterate
  GreenTangent damping;  // K_0 of the quadratic part
  NodalField quadratic;  // gradient of the quadratic part at the iterate
  NodalField gradient;   // of the sum
  NodalField first;      // the same where the residual is measured from
  NodalField bend;       // how `quadratic` changes along a direction
  NodalField start;      // v that a stage starts from
  NodalField x;          // positions that a line search starts from
  // Of the iterate, and scratch: what preconditions is K' of these, which knows of neither the strain nor its stress.
  Rotations rotations, before;
  AlignedVector<double> turned;
};

/**
 * Minimises U(x_0 + h v) + q(v), U the energy of Green's strain and q quadratic with the second derivative
 * alpha M + beta K_0, over the components of v that are free: inexact Newton with a line search, each step of which
 * lowers the sum. The tangent is first the derivative of the force itself. Where that is not positive definite,
 * conjugate gradients end early, and what they have reached still leads downhill (Nocedal and Wright 2006, algorithm
 * 7.1). If they have reached nothing, the projected tangent takes over: it always leads downhill, but is stiffer than
 * the body where this is compressed, the more so the more slender it is, and takes several times as many rounds.
 *
 * What preconditions conjugate gradients beyond the diagonal blocks is made of the co-rotated alpha M + beta K' of the
 * iterate: for small strains the same, and never the result wrong.
 */
class GreenNewton
{
public:
  /** Keeps references to its arguments; K_0 is the damping tangent of workspace.newton. */
  GreenNewton(const Model& model, const StepSettings& settings, const Supports& supports, const Rotations& rest,
              double h, double alpha, double beta, double load_floor, Serves serves, NodalField& x, NodalField& v,
              Workspace& workspace);

  /** out = (alpha M + beta K_0) u */
  void quadraticProduct(const NodalField& u, NodalField& out) const;
  /** To be called when x, v and the quadratic part's gradient have been set. */
  void start();
  /** Takes the whole direction if that lowers the sum. */
  void tryDirection(const NodalField& direction);
  /** Sets the system of the iterate, with the projected tangent also where its diagonal is not positive otherwise. */
  void linearise(Projection projection);
  /**
   * A step from the iterate of the last linearise().
   * @param forcing  tolerance of the linear system
   * @return  false where no step lowers the sum
   */
  bool iterate(double forcing, int max_iterations, StepReport& report);

private:
  bool prepare(Projection projection);
  bool solve(double forcing, int max_iterations, StepReport& report);
  bool search(const NodalField& direction, int trials);

  const Model& model_;
  const StepSettings& settings_;
  const Supports& supports_;
  const Rotations& rest_;
  const double h_, alpha_, beta_, load_floor_;
  const Serves serves_;
  NodalField &x_, &v_;
  Workspace& w_;
  NewtonMemory& m_;
  MatrixFreeSystem<GreenTangent> matrix_free_;
  const SystemOperator* system_ = nullptr;
  bool projected_ = false;
};

/** An implicit Euler step from the x and v of a state, alone or as a part of a longer step. */
struct Stage
{
  double length;  // s
  int past;       // how many of workspace.past are changes of v before this stage
  bool lasting;   // more of this length will follow, so that what is factored for it will serve again
  double ahead;   // where a start that is extrapolated from the last two lies beyond the last, in distances of them
};

/** Sets workspace.change to what the last two changes of v lead to, where there are so many. */
bool extrapolate(const Stage& stage, Workspace& workspace);

/**
 * The stage of Green's strain, under the force workspace.load and to the positions workspace.led where held: sets x and
 * v, and workspace.change to the change of v where free.
 */
void newtonStage(const Model& model, const StepSettings& settings, const Supports& supports, const Stage& stage,
                 State& state, Workspace& workspace, StepReport& report);

}  // namespace bezier_fem
