#pragma once

#include <cstddef>
#include <memory>
#include <vector>

#include "bezier_fem/model.h"
#include "bezier_fem/nodal_field.h"
#include "bezier_fem/partition.h"
#include "bezier_fem/rotation.h"

/**
 * alpha M + beta K' as a sparse matrix of 3x3 blocks, one for every pair of control points that share a tetrahedron
 * (Weber et al. 2011, section 6). There are three stages that go together freely: element matrices, their assembly,
 * and what the matrix is for. FusedAssembler does the first two at once.
 */
namespace bezier_fem
{
/** The 3x3 blocks (I,J), I <= J, of every element's matrix, in the local order of bernstein.h. */
struct ElementMatrices
{
  explicit ElementMatrices(const Model& model);

  int nodes;                     // 4 or 10
  int stride;                    // doubles from one element to the next
  AlignedVector<double> blocks;  // [element, to a whole number of LANES][stride]: pair(I, J), 9 each, by columns

  /** Which block (I,J) is, I <= J: row by row. */
  int pair(int I, int J) const { return I * nodes - I * (I - 1) / 2 + J - I; }
  /** Where in `blocks` it begins. */
  std::ptrdiff_t at(int element, int I, int J) const { return std::ptrdiff_t{stride} * element + 9 * pair(I, J); }
};

/** Element matrices of alpha M + beta K' from rotated gradients: no stiffness is stored. */
void rotatedGradientMatrices(const Model& model, const Partition& partition, const Rotations& rotations, double alpha,
                             double beta, ElementMatrices& out);

/** Element stiffness matrices of the rest shape, N/m: [block][pair][9][LANES], blocks by columns. To be made anew for a
 * new material. */
using RestStiffness = AlignedVector<double>;
RestStiffness restStiffness(const Model& model);

/** The same as rotatedGradientMatrices() in the classic way, stiffness warping: R K R^T of stored matrices. */
void warpedMatrices(const Model& model, const Partition& partition, const RestStiffness& stiffness,
                    const Rotations& rotations, double alpha, double beta, ElementMatrices& out);

/** Rows of 3x3 blocks, both triangles. */
class AssembledMatrix
{
public:
  /** All zero. */
  explicit AssembledMatrix(const Model& model);
  /** All zero, of a pattern that is symmetric and has the diagonal; columns sorted within a row. */
  AssembledMatrix(std::vector<int> row_begin, std::vector<int> column);

  /** out = A u; out has at least num_nodes rows. The same whatever the number of threads. */
  void product(const Partition& partition, const NodalField& u, NodalField& out) const;
  /** The diagonal blocks, in the format of systemDiagonal(). */
  void diagonal(AlignedVector<double>& blocks) const;

  int rows() const { return static_cast<int>(row_begin_.size()) - 1; }
  const std::vector<int>& rowBegin() const { return row_begin_; }  // rows + 1
  const std::vector<int>& column() const { return column_; }       // sorted within a row
  /** 9 doubles a block, by columns; one more after the last. */
  const AlignedVector<double>& blocks() const { return blocks_; }
  AlignedVector<double>& blocks() { return blocks_; }
  /** Place of block (i,j), -1 where there is none. */
  int slot(int i, int j) const;

private:
  std::vector<int> row_begin_, column_, diagonal_;
  AlignedVector<double> blocks_;
};

/** How element matrices are added up. */
enum class Traversal
{
  CONVENTIONAL,  // element by element, columns found by binary search
  STORED_SLOTS,  // the same, the places stored beforehand
  MESH_ORIENTED  // block by block: each is written once
};

/**
 * Adds up element matrices, whatever they were made from, to matrices of one model's pattern. Only MESH_ORIENTED uses
 * more than one thread; the others would have to share blocks among them, and are here to be compared with.
 */
class Assembler
{
public:
  Assembler(const Model& model, const AssembledMatrix& pattern, Traversal traversal);
  ~Assembler();

  void assemble(const Model& model, const Partition& partition, const ElementMatrices& elements,
                AssembledMatrix& out) const;

private:
  struct Lists;
  Traversal traversal_;
  std::unique_ptr<Lists> lists_;
};

/**
 * Sets matrices of one model's pattern to alpha M + beta K' straight from rotated gradients, entity by entity of the
 * mesh. All blocks of a vertex, edge, face or tetrahedron are sums of the same few products H_cd of rotated gradients,
 * so these are added up over the entity's elements, once, and the blocks made of the sums: no element matrix exists.
 * The fastest way for quadratic elements; a linear one's matrix is just such products, and storing it is faster.
 */
class FusedAssembler
{
public:
  FusedAssembler(const Model& model, const AssembledMatrix& pattern);
  ~FusedAssembler();

  void assemble(const Model& model, const Partition& partition, const Rotations& rotations, double alpha, double beta,
                AssembledMatrix& out);

private:
  struct Lists;
  std::unique_ptr<Lists> lists_;
};

}  // namespace bezier_fem
