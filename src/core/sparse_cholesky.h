#pragma once

#include <cstddef>
#include <functional>
#include <vector>

#include "bezier_fem/assembled_matrix.h"
#include "bezier_fem/nodal_field.h"
#include "block_inverse.h"

namespace bezier_fem
{
/**
 * A = L L^T of a symmetric positive definite matrix of 3x3 blocks, in single precision: made to precondition. Nodes are
 * put in order by nested dissection of their positions; columns of like structure are kept as dense panels
 * (supernodes; Ng and Peyton 1993, "Block sparse Cholesky algorithms on advanced uniprocessor computers"). Subtrees of
 * the elimination tree that have nothing to do with each other are solved at the same time, as many for any number of
 * threads: what they add to the rows of those that part them is summed up in their order.
 */
class SparseCholesky final : public BlockInverse
{
public:
  /** @param positions  of the nodes; only their neighbourhood matters */
  SparseCholesky(const AssembledMatrix& pattern, const NodalField& positions);

  /**
   * @param matrix  of that pattern
   * @return        false if it is not positive definite, as far as single precision can tell
   */
  bool factor(const AssembledMatrix& matrix);

  bool make(const AssembledMatrix& matrix, const HeldAxes& /*held*/, const float* /*frames*/) override
  {
    return factor(matrix);
  }
  double makingTime() const override;
  double solvingTime() const override;

  /** x = A^-1 b; 4 floats a row: x, y, z and one that is not looked at. */
  void solve(const float* b, float* x);
  void solve(int threads, const Read& read, const Write& write) override;
  const std::vector<int>& order() const override { return order_; }

  /** Numbers of the factor, and of what fills up registers, each of which a solve reads twice. */
  std::size_t size() const { return size_; }

private:
  void invertDiagonal();
  void forward(int begin, int end, float* packed);
  void backward(int begin, int end, float* packed);

  struct Supernode
  {
    int begin, end;  // columns, in the order of elimination
    int rows_begin;  // of rows_: rows below the diagonal block
    int rows_count;
    // Of values_, column-major: L_11^-1 of its own columns, and below it L_21 L_11^-1, so that a solve is products.
    std::size_t values;
  };
  /** A subtree; or, without supernodes, the columns that part the subtrees from each other, which are the last. */
  struct Piece
  {
    int columns_begin, columns_end, supernodes_begin, supernodes_end;
  };
  std::vector<Piece> pieces_;
  int parting_column_ = 0, parting_supernode_ = 0;  // the first ones
  std::vector<int> order_;                          // new -> old
  std::vector<int> position_;                       // old -> new
  std::vector<Supernode> supernodes_;
  std::vector<int> rows_;
  std::vector<int> sums_;  // for each of rows_, the node of work_ that a solve takes its product off
  AlignedVector<float> values_;
  std::size_t size_ = 0;
  // Scratch, 4 floats a node: the columns, then for each piece what its products add to the columns that part the
  // pieces
  AlignedVector<float> work_;
  AlignedVector<float> packed_;  // scratch of each piece
  std::ptrdiff_t packed_begin_ = 0, packed_size_ = 0;
  AlignedVector<float> update_;                                 // scratch
  std::vector<int> local_, head_, next_, done_, supernode_of_;  // scratch, but for the last
};

}  // namespace bezier_fem
