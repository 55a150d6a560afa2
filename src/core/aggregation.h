#pragma once

#include <Eigen/Core>
#include <vector>

#include "bezier_fem/nodal_field.h"
#include "block_inverse.h"
#include "sparse_cholesky.h"

namespace bezier_fem
{
/**
 * A symmetric multigrid cycle over aggregates of neighbouring nodes, each of which moves as a rigid body does (Bulgakov
 * 1993, "Multi-level iterative method and aggregation concept with semi-analytical preconditioning for solving
 * boundary-value problems"). The aggregates' system, of about a tenth of the unknowns, is factored; Chebyshev's
 * iteration with the 3x3 diagonal blocks goes before and after. Made for a matrix that is too large to be factored
 * itself: it takes time and memory in proportion to the nodes, and its convergence does not depend on how many they
 * are.
 */
class Aggregation final : public BlockInverse
{
public:
  /**
   * @param pattern    with the stiffness at rest, or one like it: weak connections, as those of what is stiff with what
   *                   is soft, do not make aggregates
   * @param positions  of the nodes at rest; kept by reference
   */
  Aggregation(const AssembledMatrix& pattern, const NodalField& positions);

  bool make(const AssembledMatrix& matrix, const HeldAxes& held, const float* frames) override;
  void solve(int threads, const Read& read, const Write& write) override;
  const std::vector<int>& order() const override { return order_; }
  double makingTime() const override;
  double solvingTime() const override;

  int aggregates() const { return static_cast<int>(begin_.size()) - 1; }

private:
  static constexpr int MODES = 6;
  class Sets;

  Aggregation(const AssembledMatrix& pattern, const NodalField& positions, const Sets& sets);

  void makeRows(const AssembledMatrix& pattern);
  void takeMatrix(const AssembledMatrix& matrix);
  void makeModes(const HeldAxes& held, const float* frames);
  Eigen::Matrix<double, 3, MODES> modesAt(int node) const;
  void makeCoarse(const AssembledMatrix& matrix);
  void estimateLargest();

  template <class F>
  void forEachRange(int threads, const F& f) const;
  void takeOff(int begin, int end);
  void addTerm(int begin, int end, double keep, double gain);
  template <class F>
  void smooth(int threads, const F& residual);
  void correct(int threads);

  const NodalField& positions_;
  std::vector<int> order_;         // new -> old; the nodes of an aggregate one after the other
  std::vector<int> position_;      // old -> new
  std::vector<int> begin_;         // of each aggregate's nodes, in the new order; then an end
  std::vector<int> aggregate_of_;  // of each node in the new order
  NodalField centres_;             // of aggregates at rest, each twice: three modes make a node of their system
  AssembledMatrix coarse_;
  SparseCholesky cholesky_;
  double largest_ = 0;  // eigenvalue of B^-1 A, from below

  // Rows in the new order, as kernels::SingleRows has them, up to a whole group; for each block its place in the
  // matrix, or a negative number.
  std::vector<int> steps_, columns_, slots_;
  AlignedVector<float> blocks_, inverse_;
  AlignedVector<float> modes_;  // [node][MODES][4], orthonormal over an aggregate; zero where held
  // 4 floats a node: residual, the last term and the next one, solution; and the aggregates' solution.
  AlignedVector<float> residual_, last_, next_, solution_, moves_;
};

}  // namespace bezier_fem
