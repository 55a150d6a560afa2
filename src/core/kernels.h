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
constexpr int LANES = 8;
/** Doubles a node that addDiagonal() fills: a symmetric 3x3 matrix, then two that stay zero. */
constexpr int DIAGONAL_STRIDE = 8;
/** Doubles a node of an inverted diagonal block: three columns of x, y, z, 0. */
constexpr int INVERSE_STRIDE = 12;

struct Elements
{
  int nodes_per_tet;           // 4 or 10
  int points;                  // rotations an element: 1, or 4 of a quadratic one
  const int* gather;           // [block][node][LANES]: where a node's value is read
  const int* scatter;          // the same shape: where it is added
  const double* coefficients;  // [block][3][LANES]: V lambda_L, V mu, V rho
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

struct Table
{
  const char* name;

  /**
   * Rotations R of gradients F and the rotated gradients R g_1, R g_2, R g_3, for blocks [begin, end).
   * @param gradients  [block][9][LANES], of the rest shape
   * @param before     [block][points][9][LANES], start values, row-major 3x3
   * @param after      [block][points][9][LANES], result
   * @param rotated    [block][points][9][LANES], result
   * @param turned     [block][points][LANES], |after - before|_F^2 = 8 sin^2(angle/2), result
   * @param flags      [block][points][LANES], result, RotationFlag bits
   */
  void (*update_rotations)(const Elements& elements, Gradient gradient, int begin, int end, const double* gradients,
                           const double* x, const double* before, double* after, double* rotated, double* turned,
                           unsigned char* flags);

  /** y += (alpha M + beta K') u over blocks [begin, end). */
  void (*add_product)(const Elements& elements, int begin, int end, const double* rotated, double alpha, double beta,
                      const double* u, double* y);

  /** y += elastic force of the positions x (METHOD: f_el = K' x - f_0), over blocks [begin, end). */
  void (*add_force)(const Elements& elements, int begin, int end, const double* rotated, const double* x, double* y);

  /** Adds the 3x3 diagonal blocks of alpha M + beta K' to d, DIAGONAL_STRIDE doubles a node. */
  void (*add_diagonal)(const Elements& elements, int begin, int end, const double* rotated, double alpha, double beta,
                       double* d);

  // Vector operations over nodes [begin, end).
  double (*dot)(int begin, int end, const double* a, const double* b);
  /** x += a p, r -= a q, z = B^-1 r; returns r.z. */
  double (*advance)(int begin, int end, double a, const double* p, const double* q, const double* inverse, double* x,
                    double* r, double* z);
  /** p = z + b p */
  void (*redirect)(int begin, int end, double b, const double* z, double* p);
};

/** The widest of the machine's instruction sets; BEZIER_FEM_ISA=portable|avx2|avx512 in the environment narrows it. */
const Table& table();

/** By name, or null where this machine cannot run it. */
const Table* tableByName(const char* name);

}  // namespace bezier_fem::kernels
