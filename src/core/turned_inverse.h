#pragma once

#include <functional>
#include <memory>

#include "bezier_fem/assembled_system.h"
#include "bezier_fem/preconditioner.h"
#include "block_inverse.h"

namespace bezier_fem
{
/**
 * The inverse of alpha M + beta K' of a body in one state, in single precision, to precondition the systems of other
 * states: it is applied in frames that turn with the mean rotation of each node's elements since. What the body has
 * deformed since makes the iteration longer, and never the result wrong.
 */
class TurnedInverse
{
public:
  enum class Form
  {
    FACTOR,      // by Cholesky's method
    AGGREGATION  // about: one multigrid cycle, for what would take too much to factor
  };

  /** Keeps a reference to the model. */
  TurnedInverse(const Model& model, int threads, Form form);

  /** Whether the last make() was for these. */
  bool isOf(const HeldAxes& held, double alpha, double beta) const
  {
    return alpha == alpha_ && beta == beta_ && held == held_;
  }
  /** Whether there is one, not to be renewed. */
  bool valid() const { return valid_; }

  /**
   * @param rotations  what the matrix is made of; only the gradients are looked at
   * @param frames     the same rotations, from which the nodes' frames are taken
   * @return           false where the system is too ill-conditioned for single precision
   */
  bool make(const Rotations& rotations, const Rotations& frames, const HeldAxes& held, double alpha, double beta);

  /** Has the next make() wanted, because the materials have changed or the next rotations are far from the last. */
  void forget() { valid_ = false; }

  /**
   * Tells how many iterations a solve took. When those above what the new one gave add up to `cost`, that of make() in
   * iterations, it is no longer valid.
   */
  void took(int iterations, double cost);
  /** The fewest iterations that the next solve has to take for that. */
  int patience(double cost) const;

  /** Turns the frames to the present rotations. */
  void turn(const Rotations& rotations);

  /** A right-hand side, 4 floats a node; what it has in held components is not looked at. */
  float* right() { return right_.data(); }
  /** Fills in the right-hand side of some nodes; of different ones at the same time. */
  using Fill = std::function<void(const int* nodes, int count)>;
  /** About A^-1 right on the free components, 0 on the held ones; 4 floats a node. */
  const float* solve(const Fill& fill);
  /** z = that of r. */
  void apply(const NodalField& r, NodalField& z);

  const BlockInverse& inverse() const { return *inverse_; }

private:
  bool takeRotations(const Rotations& rotations);
  template <class F>
  void forEachNode(const F& f) const;

  const Model& model_;
  Partition partition_;
  AssembledSystem system_;
  std::unique_ptr<BlockInverse> inverse_;
  bool valid_ = false;
  double alpha_ = 0, beta_ = 0;
  HeldAxes held_;
  int fewest_ = -1, excess_ = 0;    // iterations: with a new one, and above that since
  bool turned_ = false;             // to rotations_
  AlignedVector<float> rotations_;  // of the elements, 4 floats a column, sums where an element has several
  // Of the nodes in the order of the inverse: their elements; and 4 floats a column, the frames when made, and G
  // and G^T that turn out of and into these, rows of G zero where held.
  std::vector<int> elements_begin_, elements_;
  AlignedVector<float> made_frames_, frames_;
  AlignedVector<float> right_, left_;  // 4 a node
};

}  // namespace bezier_fem
