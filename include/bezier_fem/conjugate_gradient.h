#pragma once

#include <vector>

#include "bezier_fem/preconditioner.h"

namespace bezier_fem
{
/** What became of a linear system. */
struct SolveReport
{
  int iterations = 0;
  double residual = 0;  // at the solution, in the norm and relative to the scale of solve(); recomputed, not updated
  bool converged = true;
  bool indefinite = false;  // stopped at a direction of negative curvature, with a solution that leads downhill
};

/**
 * Conjugate gradients for A u = b on the components that are not held, preconditioned by the inverse of the system's
 * 3x3 diagonal blocks B or by what is given. With either, the residual is measured as sqrt(r^T B^-1 r), which strong
 * contrasts of mass or stiffness do not distort, and it has converged when that is at most tolerance * max(sqrt(b^T
 * B^-1 b), floor), floor being the same of the right-hand side of a uniform acceleration (prepare()). The residual
 * counts from b - A u computed afresh at the end; if rounding had let it drift, the iteration goes on from there.
 */
class ConjugateGradient
{
public:
  ConjugateGradient(const Model& model, const Partition& partition);

  struct Blocks
  {
    bool definite;  // each, and so may the system be
    double load2;   // m^T B^-1 m of the load m of a uniform acceleration, mean over its three directions
  };
  /** The inverses of any system's diagonal blocks, in the layout of inverse(). */
  Blocks invertDiagonal(const SystemOperator& system, const Model& model, const Partition& partition,
                        const HeldAxes& held, AlignedVector<double>& inverse);

  /**
   * Takes the system's diagonal.
   * @return  false where a block of it is not positive definite, and so neither is the system
   * @param load_floor  factor f of the right-hand side f M a of a uniform acceleration a = 1, root mean square over
   *                    its three directions, below which a right-hand side counts as that
   */
  bool prepare(const SystemOperator& system, const Model& model, const Partition& partition, const HeldAxes& held,
               double load_floor);

  /**
   * u = the combination of the last solution and the extrapolation from the past ones, the last one first, that is
   * nearest to A u = b in the norm of A; never farther than zero (compare Fischer 1998, "Projection techniques for
   * iterative solution of Ax = b with successive right-hand sides"). To be followed by solve() from that u.
   * @param system  that of the last prepare()
   * @param count   of the past solutions to use: 0 to 3
   * @param rough   prepared for the same system, to make its products in single precision; or null
   */
  void start(const SystemOperator& system, const Partition& partition, const NodalField& b,
             const std::array<NodalField, 3>& past, int count, NodalField& u, Preconditioner* rough = nullptr);

  /**
   * @param system  that of the last prepare()
   * @param b  right-hand side; its held components are not looked at
   * @param u  start value with held components zero, then the solution
   * @param preconditioner  prepared for the same system; null: the diagonal blocks
   */
  SolveReport solve(const SystemOperator& system, const Partition& partition, const NodalField& b, NodalField& u,
                    double tolerance, int max_iterations, Preconditioner* preconditioner = nullptr);

  /** B^-1 on the components that are not held, 0 on the others, in the layout of systemDiagonal(). */
  const AlignedVector<double>& inverse() const { return inverse_; }

  /** b - A u of the last solve(), of held components too. */
  const NodalField& residual() const { return r_; }

  /** sqrt(r^T B^-1 r) over the components that are not held. */
  double norm(const Partition& partition, const NodalField& r);
  /** norm(r) relative to what a residual is relative to for the right-hand side b. */
  double relativeNorm(const Partition& partition, const NodalField& r, const NodalField& b);

private:
  double floor_ = 0;
  AlignedVector<double> inverse_;
  NodalField r_, z_, p_, q_;
  NodalField extrapolated_, rounded_;  // of start()
  std::array<NodalField, 2> images_;
  bool product_known_ = false;   // q_ is A u of what start() has left,
  bool product_rough_ = false;   // but in single precision
  std::vector<double> partial_;  // a number a chunk of nodes

  template <class F>
  double sum(const Partition& partition, const F& f);
};

}  // namespace bezier_fem
