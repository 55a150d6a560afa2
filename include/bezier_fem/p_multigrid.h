#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "bezier_fem/system_operator.h"

namespace bezier_fem
{
class AssembledMatrix;
class FusedAssembler;
class SparseCholesky;

/**
 * Preconditions alpha M + beta K' by the linear elements below the quadratic ones (Weber et al. 2015, "Deformation
 * simulation using cubic finite elements and efficient p-multigrid methods"): a symmetric V-cycle of Chebyshev
 * smoothing with the 3x3 diagonal blocks and a correction from the linear elements on the same tetrahedra. These are a
 * subspace, by degree elevation: b_aa = v_a, b_ab = (v_a + v_b)/2. Of linear elements only the correction is left.
 *
 * The linear elements' system is factored now and then, and applied in frames that turn with the mean rotation of each
 * vertex's elements since. What the body has deformed since makes the iteration longer, and never the result wrong.
 */
class PMultigrid
{
public:
  PMultigrid(const Model& model, const Partition& partition);
  ~PMultigrid();

  /**
   * Sets the system. The factorisation is made anew where alpha, beta or the held axes differ from the last ones, or
   * forget() was called.
   * @param inverse  inverses of the diagonal blocks, zero where held: ConjugateGradient::inverse()
   * @return         false where the linear elements' system is too ill-conditioned for single precision
   */
  bool prepare(const Model& model, const Rotations& rotations, const std::vector<std::uint8_t>& held, double alpha,
               double beta, const AlignedVector<double>& inverse);

  /** To be called when the model's materials have changed, or when the factor is to be that of the next rotations. */
  void forget() { factored_ = false; }

  /** Tells how many iterations a solve took: when those above what a new factor gave add up to its cost, it is renewed.
   */
  void took(int iterations);

  /** z = about A^-1 r on the free components, 0 on the held ones. */
  void apply(const NodalField& r, NodalField& z);

  /** Whether improve() can be asked. */
  bool improves() const { return quadratic_ != nullptr; }
  /**
   * Quadratic elements: conjugate gradients for A e = r in single precision, which is twice as fast. Their rounding
   * errors are relative to e: what is left of r after u += e has to be computed afresh, in double precision.
   * @param target  of sqrt(r^T B^-1 r)
   * @return        iterations
   */
  int improve(const NodalField& r, double target, int max_iterations, NodalField& u);

private:
  class QuadraticLevel;

  bool factor(const Model& model, const Rotations& rotations, const std::vector<std::uint8_t>& held);
  void turnFrames(const Model& model, const Rotations& rotations);
  void solveCoarse();
  void cycle();

  std::vector<int> node_of_vertex_;              // of the linear elements, to the model's nodes
  std::vector<std::array<int, 2>> vertices_of_;  // the two vertices of each node
  std::vector<int> edges_begin_, edges_;         // of each vertex: the nodes of its edges
  std::unique_ptr<Model> linear_;
  Partition linear_partition_;
  Rotations linear_rotations_;  // only their gradients are looked at
  std::unique_ptr<AssembledMatrix> matrix_;
  std::unique_ptr<FusedAssembler> assembler_;
  std::unique_ptr<SparseCholesky> cholesky_;
  int fewest_ = -1, excess_ = 0;  // iterations: with a new factor, and above that since
  bool factored_ = false;
  double alpha_ = 0, beta_ = 0;
  std::vector<std::uint8_t> held_;
  AlignedVector<float> factored_frames_;
  AlignedVector<float> frames_;                // 9 a vertex, by columns
  AlignedVector<float> right_, left_;          // 4 a vertex
  std::unique_ptr<QuadraticLevel> quadratic_;  // null for linear elements
};

}  // namespace bezier_fem
