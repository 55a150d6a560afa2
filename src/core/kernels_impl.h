// The kernels of kernels.h for registers of WIDTH doubles. Included by one .cpp an instruction set, which defines
// WIDTH and TABLE; nothing with external linkage but that table may be defined here.
#include "kernels.h"

namespace bezier_fem::kernels
{
namespace
{
// For the innermost functions, of which a compiler leaves some out of line once a file has enough of them: a tenth more
// time for a product.
#define ALWAYS_INLINE inline __attribute__((always_inline))

using Vec = double __attribute__((vector_size(sizeof(double) * WIDTH)));
using Node = double __attribute__((vector_size(sizeof(double) * 4)));
static_assert(LANES % WIDTH == 0, "a block is a whole number of registers");

inline Vec load(const double* p)
{
  return *reinterpret_cast<const Vec*>(p);
}
inline void store(double* p, Vec v)
{
  *reinterpret_cast<Vec*>(p) = v;
}
inline Node loadNode(const double* base, int node)
{
  return *reinterpret_cast<const Node*>(base + 4L * node);
}

struct Vec3
{
  Vec x, y, z;
};
inline Vec3 operator+(const Vec3& a, const Vec3& b)
{
  return {a.x + b.x, a.y + b.y, a.z + b.z};
}
inline Vec3 operator-(const Vec3& a, const Vec3& b)
{
  return {a.x - b.x, a.y - b.y, a.z - b.z};
}
inline Vec3 operator*(Vec s, const Vec3& a)
{
  return {s * a.x, s * a.y, s * a.z};
}

/** The values of WIDTH nodes, one a lane: a transpose from x, y, z, 0 in memory to three registers. */
ALWAYS_INLINE Vec3 gather(const double* base, const int* nodes)
{
#if WIDTH == 2
  const Vec a = load(base + 4L * nodes[0]), b = load(base + 4L * nodes[1]);
  return {__builtin_shufflevector(a, b, 0, 2), __builtin_shufflevector(a, b, 1, 3),
          Vec{base[4L * nodes[0] + 2], base[4L * nodes[1] + 2]}};
#else
  Node x[WIDTH / 4], y[WIDTH / 4], z[WIDTH / 4];
  for (int k = 0; k < WIDTH / 4; ++k)
  {
    const Node a = loadNode(base, nodes[4 * k]), b = loadNode(base, nodes[4 * k + 1]);
    const Node c = loadNode(base, nodes[4 * k + 2]), d = loadNode(base, nodes[4 * k + 3]);
    const Node ab_xz = __builtin_shufflevector(a, b, 0, 4, 2, 6), ab_y = __builtin_shufflevector(a, b, 1, 5, 3, 7);
    const Node cd_xz = __builtin_shufflevector(c, d, 0, 4, 2, 6), cd_y = __builtin_shufflevector(c, d, 1, 5, 3, 7);
    x[k] = __builtin_shufflevector(ab_xz, cd_xz, 0, 1, 4, 5);
    y[k] = __builtin_shufflevector(ab_y, cd_y, 0, 1, 4, 5);
    z[k] = __builtin_shufflevector(ab_xz, cd_xz, 2, 3, 6, 7);
  }
#if WIDTH == 4
  return {x[0], y[0], z[0]};
#else
  return {__builtin_shufflevector(x[0], x[1], 0, 1, 2, 3, 4, 5, 6, 7),
          __builtin_shufflevector(y[0], y[1], 0, 1, 2, 3, 4, 5, 6, 7),
          __builtin_shufflevector(z[0], z[1], 0, 1, 2, 3, 4, 5, 6, 7)};
#endif
#endif
}

inline void addNode(double* base, int node, Node v)
{
  Node* p = reinterpret_cast<Node*>(base + 4L * node);
  *p += v;
}

/** The transpose of gather(): lane by lane, because two lanes may add to the same node. */
ALWAYS_INLINE void scatterAdd(double* base, const int* nodes, const Vec3& v)
{
#if WIDTH == 2
  for (int k = 0; k < 2; ++k)
  {
    double* p = base + 4L * nodes[k];
    p[0] += v.x[k];
    p[1] += v.y[k];
    p[2] += v.z[k];
  }
#else
  for (int k = 0; k < WIDTH / 4; ++k)
  {
#if WIDTH == 4
    const Node x = v.x, y = v.y, z = v.z;
#else
    const Node x = k ? __builtin_shufflevector(v.x, v.x, 4, 5, 6, 7) : __builtin_shufflevector(v.x, v.x, 0, 1, 2, 3);
    const Node y = k ? __builtin_shufflevector(v.y, v.y, 4, 5, 6, 7) : __builtin_shufflevector(v.y, v.y, 0, 1, 2, 3);
    const Node z = k ? __builtin_shufflevector(v.z, v.z, 4, 5, 6, 7) : __builtin_shufflevector(v.z, v.z, 0, 1, 2, 3);
#endif
    const Node zero = {0, 0, 0, 0};
    const Node xy_02 = __builtin_shufflevector(x, y, 0, 4, 2, 6), xy_13 = __builtin_shufflevector(x, y, 1, 5, 3, 7);
    const Node z_02 = __builtin_shufflevector(z, zero, 0, 4, 2, 6), z_13 = __builtin_shufflevector(z, zero, 1, 5, 3, 7);
    addNode(base, nodes[4 * k], __builtin_shufflevector(xy_02, z_02, 0, 1, 4, 5));
    addNode(base, nodes[4 * k + 1], __builtin_shufflevector(xy_13, z_13, 0, 1, 4, 5));
    addNode(base, nodes[4 * k + 2], __builtin_shufflevector(xy_02, z_02, 2, 3, 6, 7));
    addNode(base, nodes[4 * k + 3], __builtin_shufflevector(xy_13, z_13, 2, 3, 6, 7));
  }
#endif
}

/** Symmetric 3x3 matrix, one a lane. */
struct Sym
{
  Vec xx, xy, xz, yy, yz, zz;
};
inline Sym operator+(const Sym& a, const Sym& b)
{
  return {a.xx + b.xx, a.xy + b.xy, a.xz + b.xz, a.yy + b.yy, a.yz + b.yz, a.zz + b.zz};
}
inline Vec3 operator*(const Sym& m, const Vec3& v)
{
  return {m.xx * v.x + m.xy * v.y + m.xz * v.z, m.xy * v.x + m.yy * v.y + m.yz * v.z,
          m.xz * v.x + m.yz * v.y + m.zz * v.z};
}

struct RotatedGradients
{
  Vec3 r[4];
};

ALWAYS_INLINE RotatedGradients loadGradients(const double* p)
{
  RotatedGradients g;
  for (int a = 0; a < 3; ++a)
  {
    g.r[a + 1] = {load(p + (3L * a) * LANES), load(p + (3L * a + 1) * LANES), load(p + (3L * a + 2) * LANES)};
  }
  const Vec3 sum = g.r[1] + g.r[2] + g.r[3];
  g.r[0] = {-sum.x, -sum.y, -sum.z};
  return g;
}

/**
 * Stress of the strain sym(sum_d u_d r_d^T) - identity, u_d measured from u_0, which sum_d r_d = 0 allows and which
 * keeps a body far from the origin exact. Adds the strain's trace to `dilatation`.
 */
ALWAYS_INLINE Sym stress(const RotatedGradients& g, const Vec3& u1, const Vec3& u2, const Vec3& u3, double identity,
                         Vec lambda, Vec mu, Vec& dilatation)
{
  const Vec3 &a = g.r[1], &b = g.r[2], &c = g.r[3];
  const Vec exx = u1.x * a.x + u2.x * b.x + u3.x * c.x - identity;
  const Vec eyy = u1.y * a.y + u2.y * b.y + u3.y * c.y - identity;
  const Vec ezz = u1.z * a.z + u2.z * b.z + u3.z * c.z - identity;
  const Vec exy = u1.x * a.y + u2.x * b.y + u3.x * c.y + u1.y * a.x + u2.y * b.x + u3.y * c.x;
  const Vec exz = u1.x * a.z + u2.x * b.z + u3.x * c.z + u1.z * a.x + u2.z * b.x + u3.z * c.x;
  const Vec eyz = u1.y * a.z + u2.y * b.z + u3.y * c.z + u1.z * a.y + u2.z * b.y + u3.z * c.y;
  const Vec trace = exx + eyy + ezz, pressure = lambda * trace, two_mu = mu + mu;
  dilatation += trace;
  return {pressure + two_mu * exx, mu * exy, mu * exz, pressure + two_mu * eyy, mu * eyz, pressure + two_mu * ezz};
}

inline void addPressure(Sym& s, Vec pressure)
{
  s.xx += pressure;
  s.yy += pressure;
  s.zz += pressure;
}

/** Local control point (a,b); bernstein.h has the same table for the rest of the library. */
constexpr int POINT[4][4] = {{0, 4, 5, 6}, {4, 1, 7, 8}, {5, 7, 2, 9}, {6, 8, 9, 3}};

/** The sum of the points (c,d) over c. */
inline Vec3 columnSum(const Vec3* u, int d)
{
  return u[POINT[0][d]] + u[POINT[1][d]] + u[POINT[2][d]] + u[POINT[3][d]];
}

/**
 * f = K' u (identity = 0), or the elastic force of positions u (identity = 1); lambda and mu times V. The part `mean`
 * of lambda acts on the element's mean dilatation, the rest at every point.
 * @param rotated  rotated gradients, POINTS times 9 rows of LANES
 */
template <int NODES, int POINTS, bool MEAN>
inline void elasticForce(const double* rotated, const Vec3* u, double identity, Vec lambda, Vec mu, Vec mean, Vec3* f)
{
  Vec dilatation = Vec{};
  if constexpr (MEAN) lambda -= mean;
  if constexpr (NODES == 4)
  {
    const RotatedGradients g = loadGradients(rotated);
    const Sym s = stress(g, u[1] - u[0], u[2] - u[0], u[3] - u[0], identity, lambda, mu, dilatation);
    for (int a = 0; a < 4; ++a) f[a] = s * g.r[a];
  }
  else if constexpr (POINTS == 1)
  {
    // F_c = 2 sum_d x_cd g_d^T; Q_a = V/20 (s_a + sum_c s_c); the factors 2 of F_c and of f are put together: stress()
    // works on half the strain, with half the identity, and 2 * 2 / 20 = 1/5 goes to lambda and mu.
    const RotatedGradients g = loadGradients(rotated);
    lambda = lambda * 0.2;
    mu = mu * 0.2;
    Sym q[4];
    for (int c = 0; c < 4; ++c)
    {
      const Vec3& origin = u[POINT[c][0]];
      q[c] = stress(g, u[POINT[c][1]] - origin, u[POINT[c][2]] - origin, u[POINT[c][3]] - origin, 0.5 * identity,
                    lambda, mu, dilatation);
    }
    Sym sum = q[0] + q[1] + q[2] + q[3];
    // A constant pressure p gives 2 Q_a = V p/2, and p is `mean` times a quarter of the sum of the dilatations, of
    // which half is here.
    if constexpr (MEAN) addPressure(sum, 0.25 * mean * dilatation);
    for (int c = 0; c < 4; ++c) q[c] = q[c] + sum;
    for (int a = 0; a < 4; ++a)
    {
      f[a] = q[a] * g.r[a];
      for (int b = a + 1; b < 4; ++b) f[POINT[a][b]] = q[a] * g.r[b] + q[b] * g.r[a];
    }
  }
  else
  {
    // At point q, F = 2 sum_d z_d g_d^T with z_d = sum_c lambda_c x_cd, and with t_d = s R g_d a quarter of V times
    // 2 (lambda_a t_b + lambda_b t_a) goes to f_ab. Again half the strain; 2 * 2 / 4 = 1.
    const Vec far = Vec{} + FAR, above = Vec{} + (NEAR - FAR);
    Vec3 sum[4], t[4][4], total[4] = {};
    Sym s[4];
    for (int d = 0; d < 4; ++d) sum[d] = far * columnSum(u, d);
    for (int q = 0; q < 4; ++q)
    {
      const RotatedGradients g = loadGradients(rotated + 9L * q * LANES);
      Vec3 z[4];
      for (int d = 0; d < 4; ++d) z[d] = sum[d] + above * u[POINT[q][d]];
      s[q] = stress(g, z[1] - z[0], z[2] - z[0], z[3] - z[0], 0.5 * identity, lambda, mu, dilatation);
    }
    for (int q = 0; q < 4; ++q)
    {
      const RotatedGradients g = loadGradients(rotated + 9L * q * LANES);
      if constexpr (MEAN) addPressure(s[q], 0.25 * mean * dilatation);
      for (int d = 0; d < 4; ++d)
      {
        t[q][d] = s[q] * g.r[d];
        total[d] = total[d] + t[q][d];
        t[q][d] = above * t[q][d];
      }
    }
    for (int d = 0; d < 4; ++d) total[d] = far * total[d];
    for (int a = 0; a < 4; ++a)
    {
      f[a] = t[a][a] + total[a];
      for (int b = a + 1; b < 4; ++b) f[POINT[a][b]] = t[a][b] + t[b][a] + total[a] + total[b];
    }
  }
}

/** f += m M u / (rho V), with the exact integrals of products of basis functions; mass is m rho V. */
template <int NODES>
ALWAYS_INLINE void addMass(const Vec3* u, Vec mass, Vec3* f)
{
  if constexpr (NODES == 4)
  {
    const Vec scale = mass * (1.0 / 20);
    const Vec3 sum = u[0] + u[1] + u[2] + u[3];
    for (int a = 0; a < 4; ++a) f[a] = f[a] + scale * (sum + u[a]);
  }
  else
  {
    const Vec scale = mass * (1.0 / 210);
    Vec3 t[4];
    for (int a = 0; a < 4; ++a)
    {
      t[a] = u[a] + u[POINT[a][0]] + u[POINT[a][1]] + u[POINT[a][2]] + u[POINT[a][3]];
    }
    const Vec half = Vec{} + 0.5;
    const Vec3 sum = half * (t[0] + t[1] + t[2] + t[3]);
    for (int a = 0; a < 4; ++a)
    {
      for (int b = a; b < 4; ++b) f[POINT[a][b]] = f[POINT[a][b]] + scale * (sum + t[a] + t[b] + u[POINT[a][b]]);
    }
  }
}

/** Gathers an element's nodes, makes `out` from `in`, and scatters it. */
template <int NODES, bool MEAN, class Element>
inline void forEachElement(const Elements& elements, int begin, int end, const double* rotated, const double* x,
                           double* y, const Element& element)
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
      for (int k = 0; k < NODES; ++k) scatterAdd(y, elements.scatter + at + static_cast<long>(k) * LANES, out[k]);
    }
  }
}

template <int NODES, int POINTS, bool MEAN>
void addProduct(const Elements& elements, int begin, int end, const double* rotated, double alpha, double beta,
                const double* u, double* y)
{
  forEachElement<NODES, MEAN>(elements, begin, end, rotated, u, y,
                              [&](const double* g, const Vec3* in, Vec lambda, Vec mu, Vec mass, Vec mean, Vec3* out) {
                                elasticForce<NODES, POINTS, MEAN>(g, in, 0, beta * lambda, beta * mu, beta * mean, out);
                                addMass<NODES>(in, alpha * mass, out);
                              });
}

template <int NODES, int POINTS, bool MEAN>
void addForce(const Elements& elements, int begin, int end, const double* rotated, const double* x, double* y)
{
  forEachElement<NODES, MEAN>(elements, begin, end, rotated, x, y,
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

ALWAYS_INLINE void scatterDiagonal(double* d, const int* nodes, Sym s, Vec mass)
{
  s.xx += mass;
  s.yy += mass;
  s.zz += mass;
  for (int k = 0; k < WIDTH; ++k)
  {
    double* p = d + static_cast<long>(DIAGONAL_STRIDE) * nodes[k];
    p[0] += s.xx[k];
    p[1] += s.xy[k];
    p[2] += s.xz[k];
    p[3] += s.yy[k];
    p[4] += s.yz[k];
    p[5] += s.zz[k];
  }
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
inline void addDiagonalOfFour(double* d, const int* to, const double* rotated, Vec lambda, Vec mu, Vec mean, Vec mass)
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
      scatterDiagonal(d, to + static_cast<long>(POINT[a][b]) * LANES, half * sum,
                      mass * (a == b ? 1.0 / 35 : 2.0 / 105));
    }
  }
}

template <int NODES, int POINTS, bool MEAN>
void addDiagonal(const Elements& elements, int begin, int end, const double* rotated, double alpha, double beta,
                 double* d)
{
  for (int block = begin; block < end; ++block)
  {
    for (int part = 0; part < LANES; part += WIDTH)
    {
      const int* to = elements.scatter + static_cast<long>(block) * NODES * LANES + part;
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
        addDiagonalOfFour<MEAN>(d, to, own, lambda, mu, mean, mass);
        continue;
      }
      const RotatedGradients g = loadGradients(own);
      Sym h[4];  // 2 H_aa
      for (int a = 0; a < 4; ++a) h[a] = symmetricH(g.r[a], g.r[a], lambda, mu);
      if constexpr (NODES == 4)
      {
        const Vec half = Vec{} + 0.5;
        for (int a = 0; a < 4; ++a) scatterDiagonal(d, to + static_cast<long>(a) * LANES, half * h[a], mass * 0.1);
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
          scatterDiagonal(d, to + static_cast<long>(a) * LANES, corner, mass * (1.0 / 35));
          for (int b = a + 1; b < 4; ++b)
          {
            Sym edge = fifth * (h[a] + h[b] + symmetricH(g.r[a], g.r[b], lambda, mu));
            if constexpr (MEAN) edge = edge + square(quarter_mean, g.r[a] + g.r[b]);
            scatterDiagonal(d, to + static_cast<long>(POINT[a][b]) * LANES, edge, mass * (2.0 / 105));
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
  return s;
}

/** Finds `largest` by Halley's method, which comes down to it from any bound: all roots of p are real. */
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
      s.largest -= correction;
      // Convergence is cubic: a relative correction of 1e-6 leaves an error of rounding size.
      const Vec bound = 1e-6 * s.largest, size = correction < 0 ? -correction : correction;
      s.converged = size <= bound;
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

template <bool SUBTRACT>
void chebyshevTerm(int begin, int end, double keep, double gain, const double* q, const double* inverse, double* r,
                   double* d, double* z)
{
  for (int i = begin; i < end; ++i)
  {
    Node res = loadNode(r, i);
    if constexpr (SUBTRACT)
    {
      res -= loadNode(q, i);
      *reinterpret_cast<Node*>(r + 4L * i) = res;
    }
    const double* columns = inverse + static_cast<long>(INVERSE_STRIDE) * i;
    const Node pre = res[0] * loadNode(columns, 0) + res[1] * loadNode(columns, 1) + res[2] * loadNode(columns, 2);
    // Where nothing is kept, d may be anything.
    const Node direction = keep != 0 ? keep * loadNode(d, i) + gain * pre : gain * pre;
    *reinterpret_cast<Node*>(d + 4L * i) = direction;
    *reinterpret_cast<Node*>(z + 4L * i) += direction;
  }
}

void chebyshev(int begin, int end, double keep, double gain, const double* q, const double* inverse, double* r,
               double* d, double* z)
{
  (q ? chebyshevTerm<true> : chebyshevTerm<false>)(begin, end, keep, gain, q, inverse, r, d, z);
}

void redirect(int begin, int end, double b, const double* z, double* p)
{
  for (int i = begin; i < end; ++i) *reinterpret_cast<Node*>(p + 4L * i) = loadNode(z, i) + b * loadNode(p, i);
}

#include "kernels_green_impl.h"

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
                   const double* u, double* y)
{
  const auto one = elements.mean ? addProduct<10, 1, true> : addProduct<10, 1, false>;
  const auto four = elements.mean ? addProduct<10, 4, true> : addProduct<10, 4, false>;
  const auto add = elements.nodes_per_tet == 4 ? addProduct<4, 1, false> : elements.points == 1 ? one : four;
  add(elements, begin, end, rotated, alpha, beta, u, y);
}

void addForceAny(const Elements& elements, int begin, int end, const double* rotated, const double* x, double* y)
{
  const auto one = elements.mean ? addForce<10, 1, true> : addForce<10, 1, false>;
  const auto four = elements.mean ? addForce<10, 4, true> : addForce<10, 4, false>;
  const auto add = elements.nodes_per_tet == 4 ? addForce<4, 1, false> : elements.points == 1 ? one : four;
  add(elements, begin, end, rotated, x, y);
}

void addDiagonalAny(const Elements& elements, int begin, int end, const double* rotated, double alpha, double beta,
                    double* d)
{
  const auto one = elements.mean ? addDiagonal<10, 1, true> : addDiagonal<10, 1, false>;
  const auto four = elements.mean ? addDiagonal<10, 4, true> : addDiagonal<10, 4, false>;
  const auto add = elements.nodes_per_tet == 4 ? addDiagonal<4, 1, false> : elements.points == 1 ? one : four;
  add(elements, begin, end, rotated, alpha, beta, d);
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
    dot,
    advance,
    chebyshev,
    redirect,
    {greenEnergy<4>, addGreenForce<4>, lineariseGreen<4>, addGreenProduct<4>, addGreenDiagonal<4>},
    {greenEnergy<10>, addGreenForce<10>, lineariseGreen<10>, addGreenProduct<10>, addGreenDiagonal<10>}};

}  // namespace bezier_fem::kernels

#undef ALWAYS_INLINE
