#pragma once

#include <cstddef>

/**
 * The inner loops, compiled once for each instruction set and chosen when the program starts. They see raw arrays
 * only: a header with inline functions, compiled here with AVX-512 on, could leave those functions in programs that
 * run without it.
 *
 * Vectors over nodes are arrays of x, y, z, 0 (nodal_field.h), elements come in blocks of LANES (model.h), one lane an
 * element. Symmetric 3x3 matrices: xx, xy, xz, yy, yz, zz.
 */
namespace bezier_fem::kernels
{
constexpr int LANES = 16;

/**
 * What an element adds to a node is its share, stored first and summed up node by node later: so elements need not take
 * turns where they meet, and sums do not depend on who works on them. A row of shares is that of one node of LANES
 * elements, four numbers each, in the order that makes whole registers of what comes out of a transpose; those of
 * diagonal blocks have DIAGONAL_STRIDE numbers each in two rows. The first ZERO_ROWS are of zeros; element kernels are
 * given the row after them, of diagonals twice as far on.
 */
constexpr long SHARES = 4L * LANES;
constexpr int ZERO_ROWS = 2;
constexpr int slotOf(int lane)
{
  return lane % 4 * 4 + lane / 4;
}

/** Nodes whose shares are summed up side by side. */
constexpr int NODE_GROUP = 4;

/** Where the shares of each node are. */
struct NodeShares
{
  const int* begin;  // of each group of nodes, then an end: steps in `slots`
  const int* slots;  // [step][NODE_GROUP]: 4 (LANES row + slotOf(lane)); 0, of zeros, where another node has more
};
/** Doubles a node of a diagonal block, and of its inverse: xx, yy, zz, 0, xy, xz, yz, 0. */
constexpr int DIAGONAL_STRIDE = 8;
/** Doubles of an element's ten products H_cd, c <= d 12 each: columns of x, y, z and a fourth number. */
constexpr int PRODUCTS_STRIDE = 120;

/** Lists of what to fetch soon end with so many marks more. */
constexpr int READ_AHEAD = 16;

/**
 * Most blocks of elements come by twos, of which the second one's elements each share a face with the first one's in
 * the same lane: that opposite to corner 0 of both. Corners 1, 2, 3 of the one are 1, 3, 2 of the other. What both add
 * to a node of that face is one share, in the first one's row, and the second one's row of it is left as it is. Kernels
 * that are given shares, and turn_work(), take ranges of blocks that divide no pair.
 */
enum Pairing : unsigned char
{
  ALONE,
  FIRST,
  SECOND
};
/** Of an element's nodes those of the face opposite to corner 0: which of them they are to the element across it. */
constexpr int ACROSS[10] = {-1, 1, 3, 2, -1, -1, -1, 8, 7, 9};

struct Elements
{
  int nodes_per_tet;             // 4 or 10
  int points;                    // rotations an element: 1, or 4 of a quadratic one
  const int* gather;             // [block][node][LANES]: where the numbers of a node begin, 4 times the node
  const unsigned char* pairing;  // of each block
  const double* coefficients;    // [block][3][LANES]: V lambda_L, V mu, V rho
  const double* mean;  // [block][LANES]: V times the part of lambda_L that acts on the mean dilatation, or null
};

/**
 * Quadratic elements of one rotation each, in single precision: alpha M + beta K' as a preconditioner sees it. Corners
 * have fields of their own, x, y, z, 0 a vertex.
 */
struct SingleElements
{
  const int* gather;         // [block][10][LANES], and
  const int* corner_gather;  // [block][4][LANES]: like Elements::gather
  const unsigned char* pairing;
  const float* rotated;       // [block][9][LANES]
  const float* coefficients;  // [block][3][LANES]: beta V lambda_L, beta V mu, alpha V rho
  const float* mean;          // [block][LANES]: beta times Elements::mean, or null
  bool mass;                  // whether alpha M is part of their products
};

/** Nodes whose inverted diagonal blocks lie side by side in single precision: three columns of x, y, z, 0 of each. */
constexpr int INVERSE_GROUP = NODE_GROUP;

/** Rows of 3x3 blocks, INVERSE_GROUP of them side by side. */
struct SingleRows
{
  const int* begin;    // of each group of rows, then an end: steps
  const int* columns;  // [step][INVERSE_GROUP]
  const float*
      blocks;  // [step][3][INVERSE_GROUP][4]: three columns of x, y, z, 0 of each; zero where there are no more
};

/**
 * Where the 3x3 blocks of an assembled matrix are, row by row, columns sorted. A block is 9 doubles, by columns; there
 * is one double more after the last block.
 */
struct BlockRows
{
  const int* row_begin;
  const int* column;
};

/** For blocks of an assembled matrix, which blocks of element matrices they are the sums of. */
struct Contributions
{
  struct Target
  {
    int slot, mirror;    // places of (i,j) and (j,i)
    long begin, turned;  // of `from`: contributions, of which those from `turned` on are transposed
  };
  const Target* targets;  // then an end, and READ_AHEAD marks
  const long* from;       // offsets in the element matrices, in doubles; then READ_AHEAD marks
};

/**
 * What the blocks of an assembled matrix belong to: the smallest vertex, edge, face or tetrahedron that has both
 * control points (Weber et al. 2011, Fig. 4). Corners a < b < c < d in the order of their nodes; an element's corners,
 * edges (01 02 03 12 13 23) and faces (by the corner that they do not have) are numbered in that order. Slots are the
 * places of a block and of its transpose, one after the other. Every list ends with READ_AHEAD marks.
 */
struct MeshEntities
{
  struct Vertex
  {
    int slot;
    int begin;  // of `uses`
  };
  struct Edge
  {
    int slots[7];  // (a,b), (a,ab), (ab,b), and (ab,ab) once; linear elements: (a,b)
    int begin;     // of `uses`
  };
  struct Face
  {
    int slots[12];  // (a,bc), (b,ac), (ab,c), (ab,ac), (ab,bc), (ac,bc)
    int uses[2];    // on the boundary, the second is an element of zeros
  };
  struct Tet
  {
    int slots[6];  // (ab,cd), (ac,bd), (ad,bc)
    int element;
  };
  /** Entities come in chunks of neighbours; the first ones of each. */
  struct Chunk
  {
    int vertex, edge, face, tet;
  };
  const Vertex* vertices;
  const Edge* edges;
  const Face* faces;
  const Tet* tets;
  const int* uses;  // 8 element + local number of the vertex, edge or face
  const Chunk* chunks;
};

/**
 * Barycentric coordinates of the four points of the rule of degree 2 (Hammer and Stroud 1956): NEAR to the corner of
 * the same number, FAR from the others; (5 + 3 sqrt 5)/20 and (5 - sqrt 5)/20, each with a quarter of the volume.
 */
constexpr double NEAR = 0.58541019662496845446, FAR = 0.13819660112501051518;

/** What update_rotations() takes rotations of. */
enum class Gradient
{
  OF_CORNERS,
  AT_CENTROID,
  AT_FOUR_POINTS
};

/** Bits that update_rotations() sets for a rotation. */
enum RotationFlag : unsigned char
{
  UNIQUE = 1,   // converged, and certified as the maximum with a margin; otherwise the result is to be made anew
  INVERTED = 2  // det F <= 0
};

/** Doubles an element that linearise() of St. Venant-Kirchhoff elasticity stores, linear and quadratic elements. */
constexpr int LINEAR_TANGENT = 15, QUADRATIC_TANGENT = 96;

/**
 * St. Venant-Kirchhoff elasticity of one kind of element, over blocks [begin, end).
 * @param rest  [block][9][LANES], gradients g_1, g_2, g_3 of the rest shape
 * @param tangent  [block][LINEAR_TANGENT or QUADRATIC_TANGENT][LANES]: F at the corners, then the integrals T_ab of
 *                 lambda_a lambda_b S (linear elements: F and V S)
 */
struct GreenTable
{
  double (*energy)(const Elements& elements, int begin, int end, const double* rest, const double* x);
  // Shares of what the namesakes in Table have them of
  void (*add_force)(const Elements& elements, int begin, int end, const double* rest, const double* x, double* shares);
  /** @param projected  without the negative eigenvalues of S */
  void (*linearise)(const Elements& elements, int begin, int end, const double* rest, const double* x, bool projected,
                    double* tangent);
  void (*add_product)(const Elements& elements, int begin, int end, const double* rest, const double* tangent,
                      double alpha, double beta, const double* u, double* shares);
  void (*add_diagonal)(const Elements& elements, int begin, int end, const double* rest, const double* tangent,
                       double alpha, double beta, double* shares);
};

struct Table
{
  const char* name;

  /**
   * Rotations R of gradients F and the rotated gradients R g_1, R g_2, R g_3, for blocks [begin, end).
   * @param gradients  [block][9][LANES], of the rest shape
   * @param before     [block][points][9][LANES], row-major 3x3, what `turned` is measured from
   * @param after      [block][points][9][LANES], result
   * @param rotated    [block][points][9][LANES], result
   * @param turned     [block][points][LANES], |after - before|_F^2 = 8 sin^2(angle/2), result
   * @param flags      [block][points][LANES], result, RotationFlag bits
   */
  void (*update_rotations)(const Elements& elements, Gradient gradient, int begin, int end, const double* gradients,
                           const double* x, const double* before, double* after, double* rotated, double* turned,
                           unsigned char* flags);

  /** Shares, [block][node] rows, of (alpha M + beta K') u over blocks [begin, end). */
  void (*add_product)(const Elements& elements, int begin, int end, const double* rotated, double alpha, double beta,
                      const double* u, double* shares);

  /** The same of the elastic force f_el = K' x - f_0 of the positions x. */
  void (*add_force)(const Elements& elements, int begin, int end, const double* rotated, const double* x,
                    double* shares);

  /** sums[block] = what that force grows by, times d, as the rotated gradients change, for each of the blocks. */
  void (*turn_work)(const Elements& elements, int begin, int end, const double* before, const double* after,
                    const double* x, const double* d, double* sums);

  /** Shares of the 3x3 diagonal blocks of alpha M + beta K'. */
  void (*add_diagonal)(const Elements& elements, int begin, int end, const double* rotated, double alpha, double beta,
                       double* shares);
  /** The same in single precision; alpha and beta times V rho and V lambda are to be within its range. */
  void (*add_single_diagonal)(const Elements& elements, int begin, int end, const double* rotated, double alpha,
                              double beta, float* shares);

  /**
   * Element matrices of alpha M + beta K': [element][stride], upper triangles of blocks of 9 doubles, by columns
   * (bezier_fem/assembled_matrix.h).
   */
  void (*element_matrices)(const Elements& elements, int begin, int end, const double* rotated, double alpha,
                           double beta, double* out);
  /** The same as alpha M + beta R K R^T from stored K, [block][pair][9][LANES], and R, [block][9][LANES]. */
  void (*warped_matrices)(const Elements& elements, int begin, int end, const double* stiffness,
                          const double* rotations, double alpha, double beta, double* out);

  /** Adds element matrices to the blocks of (i,j) and (j,i), found in the sorted columns; nodes: [element][node]. */
  void (*add_by_search)(const BlockRows& rows, int nodes_per_tet, int tets, const int* nodes, const double* matrices,
                        double* blocks);
  /** The same, the places known: [element][pair][2], then 2 READ_AHEAD marks. */
  void (*add_by_slots)(int nodes_per_tet, int tets, const int* slots, const double* matrices, double* blocks);
  /** Sets the blocks of targets [begin, end) to sums of their contributions. */
  void (*gather_blocks)(const Contributions& list, int begin, int end, const double* matrices, double* blocks);

  /**
   * What fuse_blocks() reads of each element: [element][PRODUCTS_STRIDE]; of quadratic ones with Elements::mean twice
   * as much, the second half without it.
   * @param corner_order  [block][4][LANES], local corners 0 to 3 in the order of their nodes
   */
  void (*gradient_products)(const Elements& elements, int begin, int end, const double* corner_order,
                            const double* rotated, double alpha, double beta, double* out);
  /** Sets the blocks that belong to the entities of chunks [begin, end). @param mean  of elements with Elements::mean
   */
  void (*fuse_blocks)(const MeshEntities& mesh, int nodes_per_tet, bool mean, int begin, int end,
                      const double* products, double* blocks);

  /** y = A x over rows [begin, end). */
  void (*block_product)(const BlockRows& rows, int begin, int end, const double* blocks, const double* x, double* y);

  // Vector operations over nodes [begin, end).
  /** Sums of the shares; begin is the first node of a group. */
  void (*sum_shares)(const NodeShares& lists, int begin, int end, const double* shares, double* out);
  /** The same of add_diagonal(), to DIAGONAL_STRIDE doubles a node. */
  void (*sum_diagonals)(const NodeShares& lists, int begin, int end, const double* shares, double* out);
  /** The same of add_single_diagonal(), times a factor. */
  void (*sum_single_diagonals)(const NodeShares& lists, int begin, int end, const float* shares, double factor,
                               double* out);
  /**
   * Replaces the blocks B by their inverses over the axes that are free, zero elsewhere. Returns the sum of
   * m^2 tr(B^-1) / 3, m the numbers of `mass`.
   * @param held      bits 1, 2, 4 of each node: x, y, z are held
   * @param definite  cleared where a block, over its free axes, is not positive definite; otherwise left as it is
   */
  double (*invert_blocks)(int begin, int end, const unsigned char* held, const double* mass, double* blocks,
                          bool* definite);
  double (*dot)(int begin, int end, const double* a, const double* b);
  /** z = B^-1 r */
  void (*times_inverse)(int begin, int end, const double* inverse, const double* r, double* z);
  /** r . B^-1 r */
  double (*norm2)(int begin, int end, const double* inverse, const double* r);
  /** r = b - q; returns r . B^-1 r. */
  double (*residual)(int begin, int end, const double* b, const double* q, const double* inverse, double* r);
  /** x += a p, r -= a q, z = B^-1 r; returns r.z. */
  double (*advance)(int begin, int end, double a, const double* p, const double* q, const double* inverse, double* x,
                    double* r, double* z);
  /** p = z + b p */
  void (*redirect)(int begin, int end, double b, const double* z, double* p);

  // In single precision, for preconditioners; nodes in whole groups of INVERSE_GROUP.
  /** Shares of (alpha M + beta K') u, or of beta K' u, over blocks [begin, end). */
  void (*single_product)(const SingleElements& elements, int begin, int end, const float* u, float* shares);
  /** The same of u = P c, c the values of linear elements. */
  void (*prolonged_product)(const SingleElements& elements, int begin, int end, const float* c, float* shares);
  /** q = sum of the shares; returns p . q */
  double (*single_sum)(const NodeShares& lists, int begin, int end, const float* shares, const float* p, float* q);
  /**
   * x += a p, r -= a q, d = z = gain B^-1 r, s = r - mass d; returns r . B^-1 r.
   * @param mass  a number a node: lumped, where products leave it to the nodes, or zero
   */
  double (*single_advance)(int begin, int end, float a, float gain, const float* p, const float* q,
                           const float* inverse, const float* mass, float* x, float* r, float* s, float* d, float* z);
  double (*single_dot)(int begin, int end, const float* a, const float* b);
  /** p = z + b p */
  void (*single_redirect)(int begin, int end, float b, const float* z, float* p);
  /** r -= the sum of the shares */
  void (*subtract_shares)(const NodeShares& lists, int begin, int end, const float* shares, float* r);
  /** That, then d = keep d + gain B^-1 r, z += d, r -= mass d. */
  void (*single_chebyshev)(const NodeShares& lists, int begin, int end, float keep, float gain, const float* shares,
                           const float* inverse, const float* mass, float* r, float* d, float* z);
  /**
   * The first term for shares of P c, with P c itself: r -= the sum of the shares + mass P c, d = gain B^-1 r,
   * z += P c + d, r -= mass d.
   * @param ends  two vertices a node, whose mean P c is there; up to a whole group of nodes
   */
  void (*prolonged_chebyshev)(const NodeShares& lists, int begin, int end, float gain, const float* shares,
                              const float* inverse, const float* mass, const int* ends, const float* c, float* r,
                              float* d, float* z);
  /** r = b - A x; r may be b. */
  void (*rows_residual)(const SingleRows& rows, int begin, int end, const float* b, const float* x, float* r);
  /** e = keep d + gain B^-1 r, z += e */
  void (*single_smooth)(int begin, int end, float keep, float gain, const float* inverse, const float* r,
                        const float* d, float* e, float* z);
  /** y = L x and y = L^T x of a panel L by columns, its rows a multiple of LANES, with zeros above its diagonal. */
  void (*panel_product)(int rows, int columns, const float* panel, const float* x, float* y);
  void (*panel_transpose_product)(int rows, int columns, const float* panel, const float* x, float* y);

  GreenTable green_linear, green_quadratic;
};

/** The widest of the machine's instruction sets; BEZIER_FEM_ISA=portable|avx2|avx512 in the environment narrows it. */
const Table& table();

/** By name, or null where this machine cannot run it. */
const Table* tableByName(const char* name);

}  // namespace bezier_fem::kernels
