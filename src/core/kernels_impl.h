// The kernels of kernels.h for registers of WIDTH doubles. Included by one .cpp an instruction set, which defines
// WIDTH and TABLE; nothing with external linkage but that table may be defined here.
#if WIDTH == 8
#include <immintrin.h>  // nothing but what is inlined always
#endif

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
// The same of a lambda.
#define INLINED __attribute__((always_inline))

#include "kernels_element_impl.h"

/**
 * Calls run(block, part, in, give) for registers of elements, of which in(k) gathers the nodes k and give(k, f) stores
 * the shares of nodes k. What a pair has in common is gathered by the first one, and stored by the second one for both,
 * which spares three tenths of gathering, of storing, and of summing up later.
 * @param list  [block][IN][LANES]: where the numbers of nodes, or of corners, begin
 */
template <class V, int IN, int OUT, class Scalar, class Run>
ALWAYS_INLINE void forEachElement(const unsigned char* pairing, const int* list, int begin, int end, const Scalar* x,
                                  Scalar* shares, const Run& run)
{
  for (long block = begin; block < end; block += pairing[block] == ALONE ? 1 : 2)
  {
    for (int part = 0; part < LANES; part += static_cast<int>(sizeof(V) / sizeof(Scalar)))
    {
      const int* from = list + block * IN * LANES + part;
      Scalar* to = shares + SHARES * OUT * block;
      const auto read = [&](int k) INLINED { return gather(x, from + static_cast<long>(k) * LANES); };
      const auto write = [&](int k, const Vec3Of<V>& f) INLINED { storeShares(to + SHARES * k, part, f); };
      if (pairing[block] == ALONE)
      {
        run(block, part, read, write);
        continue;
      }
      Vec3Of<V> u[IN], half[OUT];
      run(
          block, part,
          [&](int k) INLINED {
            const Vec3Of<V> v = read(k);
            if (ACROSS[k] >= 0) u[k] = v;
            return v;
          },
          [&](int k, const Vec3Of<V>& f) INLINED {
            if (ACROSS[k] >= 0)
            {
              half[k] = f;
            }
            else
            {
              write(k, f);
            }
          });
      run(
          block + 1, part, [&](int k) INLINED { return ACROSS[k] >= 0 ? u[ACROSS[k]] : read(IN + k); },
          [&](int k, const Vec3Of<V>& f) INLINED {
            if (ACROSS[k] >= 0)
            {
              write(ACROSS[k], half[ACROSS[k]] + f);
            }
            else
            {
              write(OUT + k, f);
            }
          });
    }
  }
}

/** Calls element(block, part, rotated, lambda, mu, mass, mean, in, give) likewise. */
template <int NODES, bool MEAN, class Element>
ALWAYS_INLINE void forElements(const Elements& elements, int begin, int end, const double* rotated, const double* x,
                               double* shares, const Element& element)
{
  forEachElement<Vec, NODES, NODES>(elements.pairing, elements.gather, begin, end, x, shares,
                                    [&](long block, int part, const auto& in, const auto& give) INLINED {
                                      const double* c = elements.coefficients + 3 * block * LANES + part;
                                      Vec mean = Vec{};
                                      if constexpr (MEAN) mean = load(elements.mean + block * LANES + part);
                                      element(block, part, rotated + block * elements.points * 9 * LANES + part,
                                              load(c), load(c + LANES), load(c + 2L * LANES), mean, in, give);
                                    });
}

template <int NODES, int POINTS, bool MEAN>
void addProduct(const Elements& elements, int begin, int end, const double* rotated, double alpha, double beta,
                const double* u, double* shares)
{
  forElements<NODES, MEAN>(elements, begin, end, rotated, u, shares,
                           [&](long /*block*/, int /*part*/, const double* g, Vec lambda, Vec mu, Vec mass, Vec mean,
                               const auto& in, const auto& give) INLINED {
                             systemForce<NODES, POINTS, MEAN>(g, in, beta * lambda, beta * mu, beta * mean,
                                                              alpha * mass, give);
                           });
}

template <int NODES, int POINTS, bool MEAN>
void addForce(const Elements& elements, int begin, int end, const double* rotated, const double* x, double* shares)
{
  forElements<NODES, MEAN>(elements, begin, end, rotated, x, shares,
                           [&](long /*block*/, int /*part*/, const double* g, Vec lambda, Vec mu, Vec /*mass*/,
                               Vec mean, const auto& in, const auto& give)
                               INLINED { elasticForce<NODES, POINTS, MEAN>(g, in, 1, lambda, mu, mean, give); });
}

template <int NODES, int POINTS, bool MEAN>
void turnWork(const Elements& elements, int begin, int end, const double* before, const double* after, const double* x,
              const double* d, double* sums)
{
  for (int block = begin; block < end; ++block) sums[block] = 0;
  forElements<NODES, MEAN>(elements, begin, end, before, x, sums,
                           [&](long block, int part, const double* g, Vec lambda, Vec mu, Vec /*mass*/, Vec mean,
                               const auto& in, const auto& /*give*/) INLINED {
                             const int* nodes = elements.gather + block * NODES * LANES + part;
                             Vec3 u[NODES], force[NODES];
                             unrolled<NODES>([&](auto k) INLINED { u[k] = in(k); });
                             const auto known = [&](int k) INLINED { return u[k]; };
                             elasticForce<NODES, POINTS, MEAN>(g, known, 1, lambda, mu, mean,
                                                               [&](int k, const Vec3& f) INLINED { force[k] = f; });
                             Vec work = {};
                             elasticForce<NODES, POINTS, MEAN>(
                                 after + (g - before), known, 1, lambda, mu, mean, [&](int k, const Vec3& f) INLINED {
                                   const Vec3 more = f - force[k];
                                   const Vec3 way = gather(d, nodes + static_cast<long>(k) * LANES);
                                   work += more.x * way.x + more.y * way.y + more.z * way.z;
                                 });
                             for (int lane = 0; lane < WIDTH; ++lane) sums[block] += work[lane];
                           });
}

/** H_cd + H_dc over V, with H_cd = lambda c d^T + mu d c^T + mu (c.d) 1; H_cc + H_cc = 2 H_cc for c = d. */
template <class V>
inline SymOf<V> symmetricH(const Vec3Of<V>& c, const Vec3Of<V>& d, V lambda, V mu)
{
  const V sum = lambda + mu;
  const V dot = (mu + mu) * (c.x * d.x + c.y * d.y + c.z * d.z);
  return {(sum + sum) * c.x * d.x + dot, sum * (c.x * d.y + c.y * d.x), sum * (c.x * d.z + c.z * d.x),
          (sum + sum) * c.y * d.y + dot, sum * (c.y * d.z + c.z * d.y), (sum + sum) * c.z * d.z + dot};
}

/** @param rows  the node's two rows of shares */
template <class Scalar, class V>
ALWAYS_INLINE void storeDiagonal(Scalar* rows, int part, const SymOf<V>& s, V mass)
{
  storeShares(rows, part, Vec3Of<V>{s.xx + mass, s.yy + mass, s.zz + mass}, Vec3Of<V>{s.xy, s.xz, s.yz});
}

template <class V>
inline SymOf<V> operator*(V s, const SymOf<V>& m)
{
  return {s * m.xx, s * m.xy, s * m.xz, s * m.yy, s * m.yz, s * m.zz};
}

/** s v v^T */
template <class V>
inline SymOf<V> square(V s, const Vec3Of<V>& v)
{
  const Vec3Of<V> w = s * v;
  return {w.x * v.x, w.x * v.y, w.x * v.z, w.y * v.y, w.y * v.z, w.z * v.z};
}

template <bool MEAN, class Scalar, class V>
inline void addDiagonalOfFour(Scalar* rows, int part, const double* rotated, V lambda, V mu, V mean, V mass)
{
  RotatedGradientsOf<V> g[4];
  for (int q = 0; q < 4; ++q) g[q] = loadGradients<double, V>(rotated + 9L * q * LANES);
  const V half = all<V>(0.5);
  for (int a = 0; a < 4; ++a)
  {
    for (int b = a; b < 4; ++b)
    {
      // V/4 times the sum of H_hh, h = 2 (lambda_a r_b + lambda_b r_a), halved where a = b; symmetricH() is 2 H.
      SymOf<V> sum = {};
      Vec3Of<V> total = {};
      for (int q = 0; q < 4; ++q)
      {
        const V to_b = all<V>(q == a ? NEAR : FAR), to_a = all<V>(q == b ? NEAR : FAR);
        const Vec3Of<V> h = a == b ? to_b * g[q].r[a] : to_b * g[q].r[b] + to_a * g[q].r[a];
        sum = sum + symmetricH(h, h, lambda, mu);
        if constexpr (MEAN) total = total + h;
      }
      if constexpr (MEAN) sum = sum + square(half * mean, total);
      storeDiagonal(rows + 2 * SHARES * POINT[a][b], part, half * sum, mass * all<V>(a == b ? 1.0 / 35 : 2.0 / 105));
    }
  }
}

/** @param shares  in the precision of V */
template <class V, int NODES, int POINTS, bool MEAN, class Scalar>
void addDiagonal(const Elements& elements, int begin, int end, const double* rotated, double alpha, double beta,
                 Scalar* shares)
{
  for (int block = begin; block < end; ++block)
  {
    for (int part = 0; part < LANES; part += static_cast<int>(sizeof(V) / sizeof(Scalar)))
    {
      Scalar* rows = shares + 2 * SHARES * NODES * block;
      const double* c = elements.coefficients + 3L * block * LANES + part;
      V lambda = loadAs<V>(c, beta), mean = V{};
      const V mu = loadAs<V>(c + LANES, beta), mass = loadAs<V>(c + 2L * LANES, alpha);
      if constexpr (MEAN)
      {
        mean = loadAs<V>(elements.mean + static_cast<long>(block) * LANES + part, beta);
        lambda -= mean;
      }
      const double* own = rotated + static_cast<long>(block) * POINTS * 9 * LANES + part;
      if constexpr (POINTS == 4)
      {
        addDiagonalOfFour<MEAN>(rows, part, own, lambda, mu, mean, mass);
        continue;
      }
      const auto g = loadGradients<double, V>(own);
      SymOf<V> h[4];  // 2 H_aa
      for (int a = 0; a < 4; ++a) h[a] = symmetricH(g.r[a], g.r[a], lambda, mu);
      if constexpr (NODES == 4)
      {
        const V half = all<V>(0.5);
        for (int a = 0; a < 4; ++a) storeDiagonal(rows + 2 * SHARES * a, part, half * h[a], mass * all<V>(0.1));
      }
      else
      {
        // 4 V/20 (2 H_aa) at corners, 4 V/20 (2 H_aa + 2 H_bb + H_ab + H_ba) at edges; M: rho V/35 and rho V 4/210.
        // Mean gradients: r_a/2 at corners, (r_a + r_b)/2 at edges.
        const V fifth = all<V>(0.2), quarter_mean = all<V>(0.25) * mean;
        for (int a = 0; a < 4; ++a)
        {
          SymOf<V> corner = fifth * h[a];
          if constexpr (MEAN) corner = corner + square(quarter_mean, g.r[a]);
          storeDiagonal(rows + 2 * SHARES * a, part, corner, mass * all<V>(1.0 / 35));
          for (int b = a + 1; b < 4; ++b)
          {
            SymOf<V> edge = fifth * (h[a] + h[b] + symmetricH(g.r[a], g.r[b], lambda, mu));
            if constexpr (MEAN) edge = edge + square(quarter_mean, g.r[a] + g.r[b]);
            storeDiagonal(rows + 2 * SHARES * POINT[a][b], part, edge, mass * all<V>(2.0 / 105));
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

inline Vec squareRoot(Vec v)
{
  Vec r;
  for (int k = 0; k < WIDTH; ++k) r[k] = __builtin_sqrt(v[k]);
  return r;
}

using Mask = decltype(Vec{} < Vec{});
/** One a lane. */
using Bytes = unsigned char __attribute__((vector_size(WIDTH)));

inline bool any(Mask mask)
{
  const Bytes bytes = __builtin_convertvector(mask, Bytes);
  unsigned long bits = 0;
  static_assert(sizeof(bytes) <= sizeof(bits), "");
  __builtin_memcpy(&bits, &bytes, sizeof(bytes));
  return bits != 0;
}

/**
 * What the rotation R of a gradient F is made of. The maximum l of tr(R^T F) over rotations is s1 + s2 + s3, s3 < 0
 * where det F < 0: the largest eigenvalue of Horn's 4x4 matrix (polarRotation()), whose characteristic polynomial is
 *     p(l) = (l^2 - |F|^2)^2 - 8 det(F) l - 4 |cof F|^2.
 * The derivative of l by F is R, so that p(l, F) = 0 gives R without an eigenvector, and without the rotation before:
 *     R = (F ((l^2 + |F|^2) 1 - 2 F^T F) + 2 l cof F) / (p'(l) / 4),   p'(l) / 8 = (s1 + s2) (s1 + s3) (s2 + s3).
 */
struct Stretch
{
  Mat f, cofactors;
  Sym square;                // F^T F
  Vec norm2, det2, minors4;  // |F|^2, 2 det F, 4 |cof F|^2
  Vec largest;               // l
  Mask converged;
};

/** Of F = sum_d y_d g_d^T, `largest` being an upper bound: close where the strain is no more than tens of per cent. */
ALWAYS_INLINE Stretch stretchOf(const Vec3* y, const double* gradients)
{
  Stretch s;
  auto& f = s.f.m;
  const Vec3 edges[3] = {y[1] - y[0], y[2] - y[0], y[3] - y[0]};
  for (int j = 0; j < 3; ++j)
  {
    const Vec g1 = load(gradients + j * LANES), g2 = load(gradients + (3L + j) * LANES);
    const Vec g3 = load(gradients + (6L + j) * LANES);
    f[0][j] = edges[0].x * g1 + edges[1].x * g2 + edges[2].x * g3;
    f[1][j] = edges[0].y * g1 + edges[1].y * g2 + edges[2].y * g3;
    f[2][j] = edges[0].z * g1 + edges[1].z * g2 + edges[2].z * g3;
  }
  const auto columns = [&](int i, int j) { return f[0][i] * f[0][j] + f[1][i] * f[1][j] + f[2][i] * f[2][j]; };
  const Sym c = {columns(0, 0), columns(0, 1), columns(0, 2), columns(1, 1), columns(1, 2), columns(2, 2)};
  for (int i = 0; i < 3; ++i)
  {
    const int i1 = (i + 1) % 3, i2 = (i + 2) % 3;
    for (int j = 0; j < 3; ++j)
    {
      const int j1 = (j + 1) % 3, j2 = (j + 2) % 3;
      s.cofactors.m[i][j] = f[i1][j1] * f[i2][j2] - f[i1][j2] * f[i2][j1];
    }
  }
  const Vec det = f[0][0] * s.cofactors.m[0][0] + f[0][1] * s.cofactors.m[0][1] + f[0][2] * s.cofactors.m[0][2];
  s.square = c;
  s.norm2 = c.xx + c.yy + c.zz;
  s.det2 = det + det;
  s.minors4 = 4 * ((c.xx * c.yy - c.xy * c.xy) + (c.xx * c.zz - c.xz * c.xz) + (c.yy * c.zz - c.yz * c.yz));
  s.largest = squareRoot(3 * s.norm2);
  s.converged = Mask{};
  return s;
}

/**
 * Finds `largest` by Halley's method, which comes down to it from any bound: all roots of p are real. What has
 * converged stays as it is while others go on, so that it does not depend on them.
 */
template <int MANY>
ALWAYS_INLINE void converge(Stretch* stretches)
{
  constexpr int MAX_STEPS = 8;
  for (int step = 0; step < MAX_STEPS; ++step)
  {
    Mask above = {};
    for (int k = 0; k < MANY; ++k)
    {
      Stretch& s = stretches[k];
      const Vec square = s.largest * s.largest, excess = square - s.norm2;
      const Vec value = excess * excess - 4 * s.det2 * s.largest - s.minors4;  // p
      const Vec slope = excess * s.largest - s.det2;                           // p' / 4
      const Vec correction = 2 * value * slope / (8 * slope * slope - value * (3 * square - s.norm2));
      s.largest = s.converged ? s.largest : s.largest - correction;
      // Convergence is cubic: a relative correction of 1e-6 leaves an error of rounding size.
      const Vec bound = 1e-6 * s.largest, size = correction < 0 ? -correction : correction;
      s.converged |= size <= bound;
      above |= size > bound;
    }
    if (!any(above)) break;
  }
}

/** See Table::update_rotations(). */
ALWAYS_INLINE void rotate(const Stretch& s, const double* gradients, const double* before, double* after,
                          double* rotated, double* turned, unsigned char* flags)
{
  const Vec square = s.largest * s.largest;
  const Vec slope = (square - s.norm2) * s.largest - s.det2;
  // The maximum is one only, with a margin: (s1 + s2) (s1 + s3) (s2 + s3) against the cube of twice the sum. And more
  // than the rounding noise of an element that is no larger than a point.
  const Mask certified = s.converged & (slope > 0.064 * square * s.largest) & (s.largest > 5e-6);

  const Vec scale = 1 / slope, twice = scale + scale;
  const Vec diagonal = scale * (square + s.norm2), by_cofactors = twice * s.largest;
  const Vec xx = diagonal - twice * s.square.xx, yy = diagonal - twice * s.square.yy;
  const Vec zz = diagonal - twice * s.square.zz;
  const Vec xy = -twice * s.square.xy, xz = -twice * s.square.xz, yz = -twice * s.square.yz;
  Mat r;
  for (int i = 0; i < 3; ++i)
  {
    const Vec *f = s.f.m[i], *cofactors = s.cofactors.m[i];
    r.m[i][0] = f[0] * xx + f[1] * xy + f[2] * xz + by_cofactors * cofactors[0];
    r.m[i][1] = f[0] * xy + f[1] * yy + f[2] * yz + by_cofactors * cofactors[1];
    r.m[i][2] = f[0] * xz + f[1] * yz + f[2] * zz + by_cofactors * cofactors[2];
  }

  Vec change = Vec{};
  for (int k = 0; k < 9; ++k)
  {
    const Vec d = r.m[k / 3][k % 3] - load(before + static_cast<long>(k) * LANES);
    change += d * d;
    store(after + static_cast<long>(k) * LANES, r.m[k / 3][k % 3]);
  }
  store(turned, change);
  for (int a = 0; a < 3; ++a)
  {
    const Vec x = load(gradients + 3L * a * LANES), y = load(gradients + (3L * a + 1) * LANES);
    const Vec z = load(gradients + (3L * a + 2) * LANES);
    for (int i = 0; i < 3; ++i) store(rotated + (3L * a + i) * LANES, r.m[i][0] * x + r.m[i][1] * y + r.m[i][2] * z);
  }
  const Mask bits = (certified & long{UNIQUE}) | (~(s.det2 > 0) & long{INVERTED});
  const Bytes bytes = __builtin_convertvector(bits, Bytes);
  __builtin_memcpy(flags, &bytes, sizeof(bytes));
}

template <Gradient GRADIENT>
void updateRotations(const Elements& elements, int begin, int end, const double* gradients, const double* x,
                     const double* before, double* after, double* rotated, double* turned, unsigned char* flags)
{
  constexpr int POINTS = GRADIENT == Gradient::AT_FOUR_POINTS ? 4 : 1;
  constexpr int NODES = GRADIENT == Gradient::OF_CORNERS ? 4 : 10;
  // Registers of rotations at a time: converge() alone would wait for one operation after the other.
  constexpr int MANY = 4;
  const long nodes = elements.nodes_per_tet, last = static_cast<long>(end) * LANES - WIDTH;
  for (long first = static_cast<long>(begin) * LANES; first <= last; first += MANY / POINTS * WIDTH)
  {
    Stretch stretches[MANY];
    long own[MANY / POINTS];
    for (int e = 0; e < MANY / POINTS; ++e)
    {
      own[e] = first + e * WIDTH < last ? first + e * WIDTH : last;  // the last ones more than once
      const long block = own[e] / LANES, part = own[e] % LANES;
      Vec3 u[NODES];
      for (int i = 0; i < NODES; ++i) u[i] = gather(x, elements.gather + (block * nodes + i) * LANES + part);
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
        stretches[e * POINTS + q] = stretchOf(y, gradients + 9 * block * LANES + part);
      }
    }
    converge<MANY>(stretches);
    for (int k = 0; k < MANY; ++k)
    {
      const long block = own[k / POINTS] / LANES, part = own[k / POINTS] % LANES;
      const long at = (block * POINTS + k % POINTS) * LANES;
      rotate(stretches[k], gradients + 9 * block * LANES + part, before + 9 * at + part, after + 9 * at + part,
             rotated + 9 * at + part, turned + at + part, flags + at + part);
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
      for (int k = 0; k < NODE_GROUP; ++k) sum[k] += *reinterpret_cast<const N*>(shares + slot[k]);
    }
    f(i, sum);
  }
}

void sumShares(const NodeShares& lists, int begin, int end, const double* shares, double* out)
{
  forEachSum<Node>(lists, begin, end, shares, [&](int i, const Node* sum) {
    const int count = end - i < NODE_GROUP ? end - i : NODE_GROUP;
    for (int k = 0; k < count; ++k) *reinterpret_cast<Node*>(out + 4L * (i + k)) = sum[k];
  });
}

/** Half a diagonal block, or all of it where a register has room. */
constexpr int PART = WIDTH == 8 ? 8 : 4, PARTS = DIAGONAL_STRIDE / PART;
using DiagonalPart = double __attribute__((vector_size(sizeof(double) * PART)));
using SingleDiagonalPart = float __attribute__((vector_size(sizeof(float) * PART)));

template <class From, class Scalar>
ALWAYS_INLINE void sumDiagonals(const NodeShares& lists, int begin, int end, const Scalar* shares, double factor,
                                double* out)
{
  for (int i = begin; i < end; i += NODE_GROUP)
  {
    DiagonalPart sum[NODE_GROUP][PARTS] = {};
    for (long step = lists.begin[i / NODE_GROUP]; step < lists.begin[i / NODE_GROUP + 1]; ++step)
    {
      for (int k = 0; k < NODE_GROUP; ++k)
      {
        const Scalar* from = shares + 2L * lists.slots[NODE_GROUP * step + k];  // a node has 8 numbers, not 4
        for (int part = 0; part < PARTS; ++part)
        {
          sum[k][part] += __builtin_convertvector(*reinterpret_cast<const From*>(from + static_cast<long>(PART) * part),
                                                  DiagonalPart);
        }
      }
    }
    for (int k = 0; k < NODE_GROUP && i + k < end; ++k)
    {
      double* to = out + static_cast<long>(DIAGONAL_STRIDE) * (i + k);
      for (int part = 0; part < PARTS; ++part)
      {
        *reinterpret_cast<DiagonalPart*>(to + static_cast<long>(PART) * part) = factor * sum[k][part];
      }
    }
  }
}

void sumDoubleDiagonals(const NodeShares& lists, int begin, int end, const double* shares, double* out)
{
  sumDiagonals<DiagonalPart>(lists, begin, end, shares, 1, out);
}

void sumSingleDiagonals(const NodeShares& lists, int begin, int end, const float* shares, double factor, double* out)
{
  sumDiagonals<SingleDiagonalPart>(lists, begin, end, shares, factor, out);
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

/** See Table::invert_blocks(): WIDTH blocks side by side. */
ALWAYS_INLINE Vec invertBlocks(const unsigned char* held, const double* mass, double* blocks, Mask& indefinite)
{
  Bytes axes;
  __builtin_memcpy(&axes, held, sizeof(axes));
  const Mask bits = __builtin_convertvector(axes, Mask);
  const Mask x = (bits & 1) != 0, y = (bits & 2) != 0, z = (bits & 4) != 0;
  int diagonal[WIDTH], others[WIDTH];
  for (int k = 0; k < WIDTH; ++k)
  {
    diagonal[k] = DIAGONAL_STRIDE * k;
    others[k] = DIAGONAL_STRIDE * k + 4;
  }
  const Vec3 on = gather(blocks, diagonal), off = gather(blocks, others);
  // What is held has a row and a column of the unit matrix.
  const Vec zero = Vec{}, one = zero + 1;
  const Vec xx = x ? one : on.x, yy = y ? one : on.y, zz = z ? one : on.z;
  const Vec xy = x | y ? zero : off.x, xz = x | z ? zero : off.y, yz = y | z ? zero : off.z;
  const Vec minor = xx * yy - xy * xy, of_xx = yy * zz - yz * yz, of_xy = xz * yz - xy * zz, of_xz = xy * yz - xz * yy;
  const Vec det = xx * of_xx + xy * of_xy + xz * of_xz, scale = 1 / det;
  indefinite |= ~((xx > 0) & (minor > 0) & (det > 0));
  const Vec3 inverse_on = {x ? zero : scale * of_xx, y ? zero : scale * (xx * zz - xz * xz), z ? zero : scale * minor};

  double rows[2 * SHARES] __attribute__((aligned(64)));
  storeShares(rows, 0, inverse_on, Vec3{scale * of_xy, scale * of_xz, scale * (xy * xz - xx * yz)});
  for (int k = 0; k < WIDTH; ++k)
  {
    for (int part = 0; part < PARTS; ++part)
    {
      const long at = static_cast<long>(PART) * part;
      *reinterpret_cast<DiagonalPart*>(blocks + static_cast<long>(DIAGONAL_STRIDE) * k + at) =
          *reinterpret_cast<const DiagonalPart*>(rows + static_cast<long>(DIAGONAL_STRIDE) * slotOf(k) + at);
    }
  }
  Vec masses;
  __builtin_memcpy(&masses, mass, sizeof(masses));
  return masses * masses * (inverse_on.x + inverse_on.y + inverse_on.z);
}

double invertBlocks(int begin, int end, const unsigned char* held, const double* mass, double* blocks, bool* definite)
{
  Vec sum = {};
  Mask indefinite = {};
  int i = begin;
  for (; i + WIDTH <= end; i += WIDTH)
  {
    sum += invertBlocks(held + i, mass + i, blocks + static_cast<long>(DIAGONAL_STRIDE) * i, indefinite);
  }
  if (i < end)
  {
    // The others of the last register are unit matrices without a mass.
    double some[DIAGONAL_STRIDE * WIDTH] __attribute__((aligned(64))) = {}, masses[WIDTH] = {};
    unsigned char axes[WIDTH] = {};
    for (int k = 0; k < WIDTH; ++k)
    {
      for (int axis = 0; axis < 3; ++axis) some[DIAGONAL_STRIDE * k + axis] = 1;
    }
    const unsigned long count = end - i;
    double* own = blocks + static_cast<long>(DIAGONAL_STRIDE) * i;
    __builtin_memcpy(some, own, DIAGONAL_STRIDE * sizeof(double) * count);
    __builtin_memcpy(masses, mass + i, sizeof(double) * count);
    __builtin_memcpy(axes, held + i, count);
    sum += invertBlocks(axes, masses, some, indefinite);
    __builtin_memcpy(own, some, DIAGONAL_STRIDE * sizeof(double) * count);
  }
  if (any(indefinite)) *definite = false;
  double total = 0;
  for (int k = 0; k < WIDTH; ++k) total += sum[k];
  return total / 3;
}

/** B^-1 r of a node. */
ALWAYS_INLINE Node timesInverse(const double* inverse, int node, Node r)
{
  const Node on = loadNode(inverse, 2 * node), off = loadNode(inverse, 2 * node + 1);
  return on * r + __builtin_shufflevector(off, off, 0, 0, 1, 3) * __builtin_shufflevector(r, r, 1, 0, 0, 3) +
         __builtin_shufflevector(off, off, 1, 2, 2, 3) * __builtin_shufflevector(r, r, 2, 2, 1, 3);
}

void timesInverse(int begin, int end, const double* inverse, const double* r, double* z)
{
  for (int i = begin; i < end; ++i) *reinterpret_cast<Node*>(z + 4L * i) = timesInverse(inverse, i, loadNode(r, i));
}

double norm2(int begin, int end, const double* inverse, const double* r)
{
  Node sum = {0, 0, 0, 0};
  for (int i = begin; i < end; ++i) sum += loadNode(r, i) * timesInverse(inverse, i, loadNode(r, i));
  return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

double residual(int begin, int end, const double* b, const double* q, const double* inverse, double* r)
{
  Node sum = {0, 0, 0, 0};
  for (int i = begin; i < end; ++i)
  {
    const Node res = loadNode(b, i) - loadNode(q, i);
    *reinterpret_cast<Node*>(r + 4L * i) = res;
    sum += res * timesInverse(inverse, i, res);
  }
  return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

double advance(int begin, int end, double a, const double* p, const double* q, const double* inverse, double* x,
               double* r, double* z)
{
  Node sum = {0, 0, 0, 0};
  for (int i = begin; i < end; ++i)
  {
    *reinterpret_cast<Node*>(x + 4L * i) += a * loadNode(p, i);
    const Node res = loadNode(r, i) - a * loadNode(q, i);
    *reinterpret_cast<Node*>(r + 4L * i) = res;
    const Node pre = timesInverse(inverse, i, res);
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

void turnWorkAny(const Elements& elements, int begin, int end, const double* before, const double* after,
                 const double* x, const double* d, double* sums)
{
  const auto one = elements.mean ? turnWork<10, 1, true> : turnWork<10, 1, false>;
  const auto four = elements.mean ? turnWork<10, 4, true> : turnWork<10, 4, false>;
  const auto work = elements.nodes_per_tet == 4 ? turnWork<4, 1, false> : elements.points == 1 ? one : four;
  work(elements, begin, end, before, after, x, d, sums);
}

template <class V, class Scalar>
void addDiagonalAny(const Elements& elements, int begin, int end, const double* rotated, double alpha, double beta,
                    Scalar* shares)
{
  const auto one = elements.mean ? addDiagonal<V, 10, 1, true, Scalar> : addDiagonal<V, 10, 1, false, Scalar>;
  const auto four = elements.mean ? addDiagonal<V, 10, 4, true, Scalar> : addDiagonal<V, 10, 4, false, Scalar>;
  const auto linear = addDiagonal<V, 4, 1, false, Scalar>;
  const auto add = elements.nodes_per_tet == 4 ? linear : elements.points == 1 ? one : four;
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
    turnWorkAny,
    addDiagonalAny<Vec, double>,
    addDiagonalAny<SingleVec, float>,
    elementMatricesAny,
    warpedMatricesAny,
    addBySearchAny,
    addBySlotsAny,
    gatherBlocks,
    gradientProductsAny,
    fuseBlocksAny,
    blockProduct,
    sumShares,
    sumDoubleDiagonals,
    sumSingleDiagonals,
    invertBlocks,
    dot,
    timesInverse,
    norm2,
    residual,
    advance,
    redirect,
    singleProductAny,
    prolongedProductAny,
    singleSum,
    singleAdvance,
    singleDot,
    singleRedirect,
    subtractShares,
    singleChebyshev,
    prolongedChebyshev,
    rowsResidual,
    singleSmooth,
    panelProduct,
    panelTransposeProduct,
    {greenEnergy<4>, addGreenForce<4>, lineariseGreen<4>, addGreenProduct<4>, addGreenDiagonal<4>},
    {greenEnergy<10>, addGreenForce<10>, lineariseGreen<10>, addGreenProduct<10>, addGreenDiagonal<10>}};

}  // namespace bezier_fem::kernels

#undef ALWAYS_INLINE
#undef INLINED
#undef BY_FOURS
#undef UP
