// The kernels of kernels.h for registers of WIDTH doubles. Included by one .cpp an instruction set, which defines
// WIDTH and TABLE; nothing with external linkage but that table may be defined here.
#include <type_traits>
#include <utility>

#include "kernels.h"

namespace bezier_fem::kernels
{
namespace
{
// For the innermost functions, of which a compiler leaves some out of line once a file has enough of them: a tenth more
// time for a product.
#define ALWAYS_INLINE inline __attribute__((always_inline))

#include "kernels_element_impl.h"

/** Gathers an element's nodes, makes `out` from `in`, and stores it. */
template <int NODES, bool MEAN, class Element>
inline void forEachElement(const Elements& elements, int begin, int end, const double* rotated, const double* x,
                           double* shares, const Element& element)
{
  for (int block = begin; block < end; ++block)
  {
    for (int part = 0; part < LANES; part += WIDTH)
    {
      const long at = static_cast<long>(block) * NODES * LANES + part;
      const double* c = elements.coefficients + 3L * block * LANES + part;
      Vec mean = Vec{};
      if constexpr (MEAN) mean = load(elements.mean + static_cast<long>(block) * LANES + part);
      Vec3 in[NODES], out[NODES];
      for (int k = 0; k < NODES; ++k) in[k] = gather(x, elements.gather + at + static_cast<long>(k) * LANES);
      element(rotated + static_cast<long>(block) * elements.points * 9 * LANES + part, in, load(c), load(c + LANES),
              load(c + 2L * LANES), mean, out);
      for (int k = 0; k < NODES; ++k) storeShares(shares + SHARES * block * NODES + SHARES * k, part, out[k]);
    }
  }
}

template <int NODES, int POINTS, bool MEAN>
void addProduct(const Elements& elements, int begin, int end, const double* rotated, double alpha, double beta,
                const double* u, double* shares)
{
  forEachElement<NODES, MEAN>(elements, begin, end, rotated, u, shares,
                              [&](const double* g, const Vec3* in, Vec lambda, Vec mu, Vec mass, Vec mean, Vec3* out) {
                                elasticForce<NODES, POINTS, MEAN>(g, in, 0, beta * lambda, beta * mu, beta * mean, out);
                                addMass<NODES>(in, alpha * mass, out);
                              });
}

template <int NODES, int POINTS, bool MEAN>
void addForce(const Elements& elements, int begin, int end, const double* rotated, const double* x, double* shares)
{
  forEachElement<NODES, MEAN>(elements, begin, end, rotated, x, shares,
                              [](const double* g, const Vec3* in, Vec lambda, Vec mu, Vec /*mass*/, Vec mean,
                                 Vec3* out) { elasticForce<NODES, POINTS, MEAN>(g, in, 1, lambda, mu, mean, out); });
}

/** H_cd + H_dc over V, with H_cd = lambda c d^T + mu d c^T + mu (c.d) 1; H_cc + H_cc = 2 H_cc for c = d. */
inline Sym symmetricH(const Vec3& c, const Vec3& d, Vec lambda, Vec mu)
{
  const Vec sum = lambda + mu;
  const Vec dot = (mu + mu) * (c.x * d.x + c.y * d.y + c.z * d.z);
  return {(sum + sum) * c.x * d.x + dot, sum * (c.x * d.y + c.y * d.x), sum * (c.x * d.z + c.z * d.x),
          (sum + sum) * c.y * d.y + dot, sum * (c.y * d.z + c.z * d.y), (sum + sum) * c.z * d.z + dot};
}

/** @param row  of the node's two rows of shares the first */
ALWAYS_INLINE void storeDiagonal(double* row, int part, const Sym& s, Vec mass)
{
  storeShares(row, part, {s.xx + mass, s.yy + mass, s.zz + mass});
  storeShares(row + SHARES, part, {s.xy, s.xz, s.yz});
}

inline Sym operator*(Vec s, const Sym& m)
{
  return {s * m.xx, s * m.xy, s * m.xz, s * m.yy, s * m.yz, s * m.zz};
}

/** s v v^T */
inline Sym square(Vec s, const Vec3& v)
{
  const Vec3 w = s * v;
  return {w.x * v.x, w.x * v.y, w.x * v.z, w.y * v.y, w.y * v.z, w.z * v.z};
}

template <bool MEAN>
inline void addDiagonalOfFour(double* rows, int part, const double* rotated, Vec lambda, Vec mu, Vec mean, Vec mass)
{
  RotatedGradients g[4];
  for (int q = 0; q < 4; ++q) g[q] = loadGradients(rotated + 9L * q * LANES);
  const Vec half = Vec{} + 0.5;
  for (int a = 0; a < 4; ++a)
  {
    for (int b = a; b < 4; ++b)
    {
      // V/4 times the sum of H_hh, h = 2 (lambda_a r_b + lambda_b r_a), halved where a = b; symmetricH() is 2 H.
      Sym sum = {};
      Vec3 total = {};
      for (int q = 0; q < 4; ++q)
      {
        const Vec to_b = Vec{} + (q == a ? NEAR : FAR), to_a = Vec{} + (q == b ? NEAR : FAR);
        const Vec3 h = a == b ? to_b * g[q].r[a] : to_b * g[q].r[b] + to_a * g[q].r[a];
        sum = sum + symmetricH(h, h, lambda, mu);
        if constexpr (MEAN) total = total + h;
      }
      if constexpr (MEAN) sum = sum + square(half * mean, total);
      storeDiagonal(rows + 2 * SHARES * POINT[a][b], part, half * sum, mass * (a == b ? 1.0 / 35 : 2.0 / 105));
    }
  }
}

template <int NODES, int POINTS, bool MEAN>
void addDiagonal(const Elements& elements, int begin, int end, const double* rotated, double alpha, double beta,
                 double* shares)
{
  for (int block = begin; block < end; ++block)
  {
    for (int part = 0; part < LANES; part += WIDTH)
    {
      double* rows = shares + 2 * SHARES * NODES * block;
      const double* c = elements.coefficients + 3L * block * LANES + part;
      Vec lambda = beta * load(c), mean = Vec{};
      const Vec mu = beta * load(c + LANES), mass = alpha * load(c + 2L * LANES);
      if constexpr (MEAN)
      {
        mean = beta * load(elements.mean + static_cast<long>(block) * LANES + part);
        lambda -= mean;
      }
      const double* own = rotated + static_cast<long>(block) * POINTS * 9 * LANES + part;
      if constexpr (POINTS == 4)
      {
        addDiagonalOfFour<MEAN>(rows, part, own, lambda, mu, mean, mass);
        continue;
      }
      const RotatedGradients g = loadGradients(own);
      Sym h[4];  // 2 H_aa
      for (int a = 0; a < 4; ++a) h[a] = symmetricH(g.r[a], g.r[a], lambda, mu);
      if constexpr (NODES == 4)
      {
        const Vec half = Vec{} + 0.5;
        for (int a = 0; a < 4; ++a) storeDiagonal(rows + 2 * SHARES * a, part, half * h[a], mass * 0.1);
      }
      else
      {
        // 4 V/20 (2 H_aa) at corners, 4 V/20 (2 H_aa + 2 H_bb + H_ab + H_ba) at edges; M: rho V/35 and rho V 4/210.
        // Mean gradients: r_a/2 at corners, (r_a + r_b)/2 at edges.
        const Vec fifth = Vec{} + 0.2, quarter_mean = 0.25 * mean;
        for (int a = 0; a < 4; ++a)
        {
          Sym corner = fifth * h[a];
          if constexpr (MEAN) corner = corner + square(quarter_mean, g.r[a]);
          storeDiagonal(rows + 2 * SHARES * a, part, corner, mass * (1.0 / 35));
          for (int b = a + 1; b < 4; ++b)
          {
            Sym edge = fifth * (h[a] + h[b] + symmetricH(g.r[a], g.r[b], lambda, mu));
            if constexpr (MEAN) edge = edge + square(quarter_mean, g.r[a] + g.r[b]);
            storeDiagonal(rows + 2 * SHARES * POINT[a][b], part, edge, mass * (2.0 / 105));
          }
        }
      }
    }
  }
}

struct Mat
{
  Vec m[3][3];
};

inline Mat loadMatrix(const double* p)
{
  Mat r;
  for (int k = 0; k < 9; ++k) r.m[k / 3][k % 3] = load(p + static_cast<long>(k) * LANES);
  return r;
}

inline Mat operator*(const Mat& a, const Mat& b)
{
  Mat r;
  for (int i = 0; i < 3; ++i)
  {
    for (int j = 0; j < 3; ++j) r.m[i][j] = a.m[i][0] * b.m[0][j] + a.m[i][1] * b.m[1][j] + a.m[i][2] * b.m[2][j];
  }
  return r;
}

inline Mat transposeTimes(const Mat& a, const Mat& b)
{
  Mat r;
  for (int i = 0; i < 3; ++i)
  {
    for (int j = 0; j < 3; ++j) r.m[i][j] = a.m[0][i] * b.m[0][j] + a.m[1][i] * b.m[1][j] + a.m[2][i] * b.m[2][j];
  }
  return r;
}

inline Vec squareRoot(Vec v)
{
  Vec r;
  for (int k = 0; k < WIDTH; ++k) r[k] = __builtin_sqrt(v[k]);
  return r;
}

inline bool anyAbove(Vec v, double bound)
{
  for (int k = 0; k < WIDTH; ++k)
  {
    if (!(v[k] <= bound)) return true;
  }
  return false;
}

/** The rotation of F = sum_d y_d g_d^T; see Table::update_rotations(). */
inline void rotate(const Vec3* y, const RotatedGradients& g, const double* before, double* after, double* rotated,
                   double* turned, unsigned char* flags)
{
  constexpr int MAX_NEWTON_STEPS = 8;
  Mat f;
  for (auto& row : f.m)
  {
    for (Vec& v : row) v = Vec{};
  }
  for (int a = 1; a < 4; ++a)
  {
    const Vec3 d = y[a] - y[0];
    const Vec column[3] = {d.x, d.y, d.z}, row[3] = {g.r[a].x, g.r[a].y, g.r[a].z};
    for (int i = 0; i < 3; ++i)
    {
      for (int j = 0; j < 3; ++j) f.m[i][j] += column[i] * row[j];
    }
  }

  // Newton's method for the maximum of tr(R^T F) over rotations: with S = R^T F and H = tr(S) 1 - sym(S), the
  // correction is R exp(w), H w = axial(S - S^T). A maximum has H positive definite, and there is one only.
  const Mat start = loadMatrix(before);
  Mat r = start;
  Vec certified = Vec{};
  for (int step = 0; step < MAX_NEWTON_STEPS; ++step)
  {
    const Mat s = transposeTimes(r, f);
    const Vec trace = s.m[0][0] + s.m[1][1] + s.m[2][2];
    const Vec hxx = trace - s.m[0][0], hyy = trace - s.m[1][1], hzz = trace - s.m[2][2];
    const Vec hxy = -0.5 * (s.m[0][1] + s.m[1][0]), hxz = -0.5 * (s.m[0][2] + s.m[2][0]);
    const Vec hyz = -0.5 * (s.m[1][2] + s.m[2][1]);
    const Vec ax = s.m[2][1] - s.m[1][2], ay = s.m[0][2] - s.m[2][0], az = s.m[1][0] - s.m[0][1];
    // adj(H), symmetric
    const Vec cxx = hyy * hzz - hyz * hyz, cxy = hxz * hyz - hxy * hzz, cxz = hxy * hyz - hxz * hyy;
    const Vec cyy = hxx * hzz - hxz * hxz, cyz = hxy * hxz - hxx * hyz, czz = hxx * hyy - hxy * hxy;
    const Vec det = hxx * cxx + hxy * cxy + hxz * cxz;
    // Positive definite with a margin: the product of the eigenvalues against the cube of their sum. And more than
    // the rounding noise of an element that is no larger than a point.
    const Vec sum = hxx + hyy + hzz;
    const auto well = (hxx > 0) & (czz > 0) & (det > 4e-3 * sum * sum * sum) & (sum > 1e-5);
    certified = well ? Vec{} + 1 : Vec{};
    const Vec scale = 1 / (det != 0 ? det : Vec{} + 1);
    Vec wx = scale * (cxx * ax + cxy * ay + cxz * az);
    Vec wy = scale * (cxy * ax + cyy * ay + cyz * az);
    Vec wz = scale * (cxz * ax + cyz * ay + czz * az);
    const Vec size2 = wx * wx + wy * wy + wz * wz;
    // In a plane, w is the tangent of the angle that is missing; half that angle's tangent goes to Cayley's map.
    const Vec shrink = 1 / (1 + squareRoot(1 + size2));
    wx *= shrink;
    wy *= shrink;
    wz *= shrink;
    const Vec two = 2 / (1 + wx * wx + wy * wy + wz * wz);
    Mat q;
    q.m[0][0] = 1 - two * (wy * wy + wz * wz);
    q.m[0][1] = two * (wx * wy - wz);
    q.m[0][2] = two * (wx * wz + wy);
    q.m[1][0] = two * (wx * wy + wz);
    q.m[1][1] = 1 - two * (wx * wx + wz * wz);
    q.m[1][2] = two * (wy * wz - wx);
    q.m[2][0] = two * (wx * wz - wy);
    q.m[2][1] = two * (wy * wz + wx);
    q.m[2][2] = 1 - two * (wx * wx + wy * wy);
    r = r * q;
    // Convergence is cubic: a correction of 1e-5 leaves an error of rounding size.
    certified = size2 < 1e-10 ? certified : Vec{};
    if (!anyAbove(size2, 1e-10)) break;
  }
  // One Newton-Schulz step, so that rounding does not add up over millions of steps.
  Mat correction = transposeTimes(r, r);
  for (int i = 0; i < 3; ++i)
  {
    for (int j = 0; j < 3; ++j) correction.m[i][j] = (i == j ? 1.5 : 0.0) - 0.5 * correction.m[i][j];
  }
  r = r * correction;

  Vec change = Vec{};
  for (int k = 0; k < 9; ++k)
  {
    const Vec d = r.m[k / 3][k % 3] - start.m[k / 3][k % 3];
    change += d * d;
    store(after + static_cast<long>(k) * LANES, r.m[k / 3][k % 3]);
  }
  store(turned, change);
  for (int a = 0; a < 3; ++a)
  {
    const Vec3& v = g.r[a + 1];
    for (int i = 0; i < 3; ++i)
    {
      store(rotated + (3L * a + i) * LANES, r.m[i][0] * v.x + r.m[i][1] * v.y + r.m[i][2] * v.z);
    }
  }
  const Vec det = f.m[0][0] * (f.m[1][1] * f.m[2][2] - f.m[1][2] * f.m[2][1]) +
                  f.m[0][1] * (f.m[1][2] * f.m[2][0] - f.m[1][0] * f.m[2][2]) +
                  f.m[0][2] * (f.m[1][0] * f.m[2][1] - f.m[1][1] * f.m[2][0]);
  for (int k = 0; k < WIDTH; ++k)
  {
    flags[k] = static_cast<unsigned char>((certified[k] > 0 ? UNIQUE : 0) | (det[k] > 0 ? 0 : INVERTED));
  }
}

template <Gradient GRADIENT>
void updateRotations(const Elements& elements, int begin, int end, const double* gradients, const double* x,
                     const double* before, double* after, double* rotated, double* turned, unsigned char* flags)
{
  constexpr int POINTS = GRADIENT == Gradient::AT_FOUR_POINTS ? 4 : 1;
  constexpr int NODES = GRADIENT == Gradient::OF_CORNERS ? 4 : 10;
  const long nodes = elements.nodes_per_tet;
  for (int block = begin; block < end; ++block)
  {
    for (int part = 0; part < LANES; part += WIDTH)
    {
      const int* from = elements.gather + block * nodes * LANES + part;
      const RotatedGradients g = loadGradients(gradients + 9L * block * LANES + part);
      Vec3 u[NODES];
      for (int k = 0; k < NODES; ++k) u[k] = gather(x, from + static_cast<long>(k) * LANES);
      for (int q = 0; q < POINTS; ++q)
      {
        Vec3 y[4];
        for (int d = 0; d < 4; ++d)
        {
          if constexpr (GRADIENT == Gradient::OF_CORNERS)
          {
            y[d] = u[d];
          }
          else if constexpr (GRADIENT == Gradient::AT_CENTROID)
          {
            y[d] = (Vec{} + 0.5) * columnSum(u, d);
          }
          else
          {
            y[d] = (Vec{} + 2 * FAR) * columnSum(u, d) + (Vec{} + 2 * (NEAR - FAR)) * u[POINT[q][d]];
          }
        }
        const long at = (static_cast<long>(block) * POINTS + q) * LANES;
        rotate(y, g, before + 9 * at + part, after + 9 * at + part, rotated + 9 * at + part, turned + at + part,
               flags + at + part);
      }
    }
  }
}

/** Calls f(node, sum of its shares) for the nodes [begin, end), begin the first of a group. */
template <class N, class Scalar, class F>
ALWAYS_INLINE void forEachSum(const NodeShares& lists, int begin, int end, const Scalar* shares, const F& f)
{
  for (int i = begin; i < end; i += NODE_GROUP)
  {
    N sum[NODE_GROUP] = {};
    const int* last = lists.slots + NODE_GROUP * static_cast<long>(lists.begin[i / NODE_GROUP + 1]);
    for (const int* slot = lists.slots + NODE_GROUP * static_cast<long>(lists.begin[i / NODE_GROUP]); slot < last;
         slot += NODE_GROUP)
    {
      for (int k = 0; k < NODE_GROUP; ++k) sum[k] += loadNode(shares, slot[k]);
    }
    f(i, sum);
  }
}

double sumShares(const NodeShares& lists, int begin, int end, const double* shares, const double* u, double* out)
{
  Node work[NODE_GROUP] = {};
  forEachSum<Node>(lists, begin, end, shares, [&](int i, const Node* sum) {
    const int count = end - i < NODE_GROUP ? end - i : NODE_GROUP;
    for (int k = 0; k < count; ++k) *reinterpret_cast<Node*>(out + 4L * (i + k)) = sum[k];
    for (int k = 0; k < count && u; ++k) work[k] += sum[k] * loadNode(u, i + k);
  });
  const Node total = (work[0] + work[1]) + (work[2] + work[3]);
  return (total[0] + total[1]) + (total[2] + total[3]);
}

void sumDiagonals(const NodeShares& lists, int begin, int end, const double* shares, double* out)
{
  for (int i = begin; i < end; i += NODE_GROUP)
  {
    Node sum[NODE_GROUP][2] = {};
    for (long step = lists.begin[i / NODE_GROUP]; step < lists.begin[i / NODE_GROUP + 1]; ++step)
    {
      for (int k = 0; k < NODE_GROUP; ++k)
      {
        // A node has two rows of shares, one after the other.
        const int slot = lists.slots[NODE_GROUP * step + k], row = slot / LANES;
        const double* from = shares + 2 * SHARES * row + 4L * (slot % LANES);
        sum[k][0] += *reinterpret_cast<const Node*>(from);
        sum[k][1] += *reinterpret_cast<const Node*>(from + SHARES);
      }
    }
    for (int k = 0; k < NODE_GROUP && i + k < end; ++k)
    {
      double* to = out + static_cast<long>(DIAGONAL_STRIDE) * (i + k);
      *reinterpret_cast<Node*>(to) = sum[k][0];
      *reinterpret_cast<Node*>(to + 4) = sum[k][1];
    }
  }
}

double dot(int begin, int end, const double* a, const double* b)
{
  Node sum = {0, 0, 0, 0}, other = {0, 0, 0, 0};
  int i = begin;
  for (; i + 1 < end; i += 2)
  {
    sum += loadNode(a, i) * loadNode(b, i);
    other += loadNode(a, i + 1) * loadNode(b, i + 1);
  }
  if (i < end) sum += loadNode(a, i) * loadNode(b, i);
  sum += other;
  return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

double advance(int begin, int end, double a, const double* p, const double* q, const double* inverse, double* x,
               double* r, double* z)
{
  Node sum = {0, 0, 0, 0};
  for (int i = begin; i < end; ++i)
  {
    const double* columns = inverse + static_cast<long>(INVERSE_STRIDE) * i;
    *reinterpret_cast<Node*>(x + 4L * i) += a * loadNode(p, i);
    const Node res = loadNode(r, i) - a * loadNode(q, i);
    *reinterpret_cast<Node*>(r + 4L * i) = res;
    const Node pre = res[0] * loadNode(columns, 0) + res[1] * loadNode(columns, 1) + res[2] * loadNode(columns, 2);
    *reinterpret_cast<Node*>(z + 4L * i) = pre;
    sum += res * pre;
  }
  return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

void redirect(int begin, int end, double b, const double* z, double* p)
{
  for (int i = begin; i < end; ++i) *reinterpret_cast<Node*>(p + 4L * i) = loadNode(z, i) + b * loadNode(p, i);
}

#include "kernels_green_impl.h"
#include "kernels_single_impl.h"

void updateRotationsAny(const Elements& elements, Gradient gradient, int begin, int end, const double* gradients,
                        const double* x, const double* before, double* after, double* rotated, double* turned,
                        unsigned char* flags)
{
  const auto update = gradient == Gradient::OF_CORNERS    ? updateRotations<Gradient::OF_CORNERS>
                      : gradient == Gradient::AT_CENTROID ? updateRotations<Gradient::AT_CENTROID>
                                                          : updateRotations<Gradient::AT_FOUR_POINTS>;
  update(elements, begin, end, gradients, x, before, after, rotated, turned, flags);
}

void addProductAny(const Elements& elements, int begin, int end, const double* rotated, double alpha, double beta,
                   const double* u, double* shares)
{
  const auto one = elements.mean ? addProduct<10, 1, true> : addProduct<10, 1, false>;
  const auto four = elements.mean ? addProduct<10, 4, true> : addProduct<10, 4, false>;
  const auto add = elements.nodes_per_tet == 4 ? addProduct<4, 1, false> : elements.points == 1 ? one : four;
  add(elements, begin, end, rotated, alpha, beta, u, shares);
}

void addForceAny(const Elements& elements, int begin, int end, const double* rotated, const double* x, double* shares)
{
  const auto one = elements.mean ? addForce<10, 1, true> : addForce<10, 1, false>;
  const auto four = elements.mean ? addForce<10, 4, true> : addForce<10, 4, false>;
  const auto add = elements.nodes_per_tet == 4 ? addForce<4, 1, false> : elements.points == 1 ? one : four;
  add(elements, begin, end, rotated, x, shares);
}

void addDiagonalAny(const Elements& elements, int begin, int end, const double* rotated, double alpha, double beta,
                    double* shares)
{
  const auto one = elements.mean ? addDiagonal<10, 1, true> : addDiagonal<10, 1, false>;
  const auto four = elements.mean ? addDiagonal<10, 4, true> : addDiagonal<10, 4, false>;
  const auto add = elements.nodes_per_tet == 4 ? addDiagonal<4, 1, false> : elements.points == 1 ? one : four;
  add(elements, begin, end, rotated, alpha, beta, shares);
}
}  // namespace
}  // namespace bezier_fem::kernels

#include "kernels_assembly_impl.h"

namespace bezier_fem::kernels
{
extern const Table TABLE;
const Table TABLE = {
    TABLE_NAME,
    updateRotationsAny,
    addProductAny,
    addForceAny,
    addDiagonalAny,
    elementMatricesAny,
    warpedMatricesAny,
    addBySearchAny,
    addBySlotsAny,
    gatherBlocks,
    gradientProductsAny,
    fuseBlocksAny,
    blockProduct,
    sumShares,
    sumDiagonals,
    dot,
    advance,
    redirect,
    singleProductAny,
    prolongedProduct,
    singleSum,
    singleAdvance,
    singleDot,
    singleRedirect,
    subtractShares,
    singleChebyshev,
    panelProduct,
    panelTransposeProduct,
    {greenEnergy<4>, addGreenForce<4>, lineariseGreen<4>, addGreenProduct<4>, addGreenDiagonal<4>},
    {greenEnergy<10>, addGreenForce<10>, lineariseGreen<10>, addGreenProduct<10>, addGreenDiagonal<10>}};

}  // namespace bezier_fem::kernels

#undef ALWAYS_INLINE
#undef BY_FOURS
#undef UP
