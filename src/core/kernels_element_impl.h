// What the element loops of kernels_impl.h are made of, inside its unnamed namespace: registers of either precision
// with an element a lane, and the formulas of the element. They know of a register only what arithmetic needs.

using Vec = double __attribute__((vector_size(sizeof(double) * WIDTH)));
using Node = double __attribute__((vector_size(sizeof(double) * 4)));
/** Twice as many in single precision. */
constexpr int SINGLE_WIDTH = 2 * WIDTH;
using SingleVec = float __attribute__((vector_size(sizeof(float) * SINGLE_WIDTH)));
using SingleNode = float __attribute__((vector_size(sizeof(float) * 4)));
static_assert(LANES % SINGLE_WIDTH == 0, "a block is a whole number of registers");

inline Vec load(const double* p)
{
  return *reinterpret_cast<const Vec*>(p);
}
inline SingleVec load(const float* p)
{
  return *reinterpret_cast<const SingleVec*>(p);
}

/** Numbers in double precision, times a factor, in a register of either. */
template <class V>
ALWAYS_INLINE V loadAs(const double* p, double factor = 1)
{
  if constexpr (std::is_same_v<V, Vec>)
  {
    return factor * load(p);
  }
  else
  {
    using Half = float __attribute__((vector_size(sizeof(float) * WIDTH)));
    const Half a = __builtin_convertvector(factor * load(p), Half);
    const Half b = __builtin_convertvector(factor * load(p + WIDTH), Half);
    V result;
    __builtin_memcpy(&result, &a, sizeof(a));
    __builtin_memcpy(reinterpret_cast<char*>(&result) + sizeof(a), &b, sizeof(b));
    return result;
  }
}
template <class V>
ALWAYS_INLINE V loadAs(const float* p)
{
  return load(p);
}
inline void store(double* p, Vec v)
{
  *reinterpret_cast<Vec*>(p) = v;
}
inline void store(float* p, SingleVec v)
{
  *reinterpret_cast<SingleVec*>(p) = v;
}
inline Node nodeAt(const double* p)
{
  return *reinterpret_cast<const Node*>(p);
}
inline SingleNode nodeAt(const float* p)
{
  return *reinterpret_cast<const SingleNode*>(p);
}
inline Node loadNode(const double* base, int node)
{
  return *reinterpret_cast<const Node*>(base + 4L * node);
}
inline SingleNode loadNode(const float* base, int node)
{
  return *reinterpret_cast<const SingleNode*>(base + 4L * node);
}

/** Zeros that the compiler does not know of: GCC 12.2 gets some permutations of a register with zeros wrong. */
template <class V>
ALWAYS_INLINE V zeros()
{
  V zero = {};
#if WIDTH == 8
  __asm__("" : "+v"(zero));
#endif
  return zero;
}

/** A number in every lane. */
template <class V>
inline V all(double value)
{
  using Scalar = std::remove_reference_t<decltype(std::declval<V&>()[0])>;
  return V{} + static_cast<Scalar>(value);
}

/** V is a register. */
template <class V>
struct Vec3Of
{
  V x, y, z;
};
using Vec3 = Vec3Of<Vec>;
template <class V>
inline Vec3Of<V> operator+(const Vec3Of<V>& a, const Vec3Of<V>& b)
{
  return {a.x + b.x, a.y + b.y, a.z + b.z};
}
template <class V>
inline Vec3Of<V> operator-(const Vec3Of<V>& a, const Vec3Of<V>& b)
{
  return {a.x - b.x, a.y - b.y, a.z - b.z};
}
template <class V>
inline Vec3Of<V> operator*(V s, const Vec3Of<V>& a)
{
  return {s * a.x, s * a.y, s * a.z};
}

/**
 * The values of WIDTH nodes, one a lane: a transpose from x, y, z, 0 in memory to three registers.
 * @param nodes  where the numbers of each begin
 */
ALWAYS_INLINE Vec3 gather(const double* base, const int* nodes)
{
#if WIDTH == 2
  const Vec a = load(base + nodes[0]), b = load(base + nodes[1]);
  return {__builtin_shufflevector(a, b, 0, 2), __builtin_shufflevector(a, b, 1, 3),
          Vec{base[nodes[0] + 2], base[nodes[1] + 2]}};
#else
#if WIDTH == 4
  const Vec a = nodeAt(base + nodes[0]), b = nodeAt(base + nodes[1]);
  const Vec c = nodeAt(base + nodes[2]), d = nodeAt(base + nodes[3]);
  const Vec ab_xz = __builtin_shufflevector(a, b, 0, 4, 2, 6), ab_y = __builtin_shufflevector(a, b, 1, 5, 3, 7);
  const Vec cd_xz = __builtin_shufflevector(c, d, 0, 4, 2, 6), cd_y = __builtin_shufflevector(c, d, 1, 5, 3, 7);
  return {__builtin_shufflevector(ab_xz, cd_xz, 0, 1, 4, 5), __builtin_shufflevector(ab_y, cd_y, 0, 1, 4, 5),
          __builtin_shufflevector(ab_xz, cd_xz, 2, 3, 6, 7)};
#else
  const auto pair = [&](int k) {
    return __builtin_shufflevector(nodeAt(base + nodes[k]), nodeAt(base + nodes[k + 4]), 0, 1, 2, 3, 4, 5, 6, 7);
  };
  const Vec a = pair(0), b = pair(1), c = pair(2), d = pair(3);
  const Vec ab_xz = __builtin_shufflevector(a, b, 0, 8, 2, 10, 4, 12, 6, 14);
  const Vec ab_y = __builtin_shufflevector(a, b, 1, 9, 3, 11, 5, 13, 7, 15);
  const Vec cd_xz = __builtin_shufflevector(c, d, 0, 8, 2, 10, 4, 12, 6, 14);
  const Vec cd_y = __builtin_shufflevector(c, d, 1, 9, 3, 11, 5, 13, 7, 15);
  return {__builtin_shufflevector(ab_xz, cd_xz, 0, 1, 8, 9, 4, 5, 12, 13),
          __builtin_shufflevector(ab_y, cd_y, 0, 1, 8, 9, 4, 5, 12, 13),
          __builtin_shufflevector(ab_xz, cd_xz, 2, 3, 10, 11, 6, 7, 14, 15)};
#endif
#endif
}

#if WIDTH != 2
/** The transpose of gather(): lanes k, k + 4, ... to the register k, x, y, z, 0 each. */
ALWAYS_INLINE void transpose(const Vec3& v, Vec* rows)
{
  const Vec zero = zeros<Vec>();
#if WIDTH == 4
  const Vec xy_02 = __builtin_shufflevector(v.x, v.y, 0, 4, 2, 6),
            xy_13 = __builtin_shufflevector(v.x, v.y, 1, 5, 3, 7);
  const Vec z_02 = __builtin_shufflevector(v.z, zero, 0, 4, 2, 6),
            z_13 = __builtin_shufflevector(v.z, zero, 1, 5, 3, 7);
  rows[0] = __builtin_shufflevector(xy_02, z_02, 0, 1, 4, 5);
  rows[1] = __builtin_shufflevector(xy_13, z_13, 0, 1, 4, 5);
  rows[2] = __builtin_shufflevector(xy_02, z_02, 2, 3, 6, 7);
  rows[3] = __builtin_shufflevector(xy_13, z_13, 2, 3, 6, 7);
#else
  const Vec xy_even = __builtin_shufflevector(v.x, v.y, 0, 8, 2, 10, 4, 12, 6, 14);
  const Vec xy_odd = __builtin_shufflevector(v.x, v.y, 1, 9, 3, 11, 5, 13, 7, 15);
  const Vec z_even = __builtin_shufflevector(v.z, zero, 0, 8, 2, 10, 4, 12, 6, 14);
  const Vec z_odd = __builtin_shufflevector(v.z, zero, 1, 9, 3, 11, 5, 13, 7, 15);
  rows[0] = __builtin_shufflevector(xy_even, z_even, 0, 1, 8, 9, 4, 5, 12, 13);
  rows[1] = __builtin_shufflevector(xy_odd, z_odd, 0, 1, 8, 9, 4, 5, 12, 13);
  rows[2] = __builtin_shufflevector(xy_even, z_even, 2, 3, 10, 11, 6, 7, 14, 15);
  rows[3] = __builtin_shufflevector(xy_odd, z_odd, 2, 3, 10, 11, 6, 7, 14, 15);
#endif
}
#endif

#if WIDTH == 2
#define BY_FOURS(a, b, i, j, k, l) __builtin_shufflevector(a, b, i, j, k, l)
#elif WIDTH == 4
#define UP(i) ((i) < 4 ? (i) : (i) + 4)
#define BY_FOURS(a, b, i, j, k, l) \
  __builtin_shufflevector(a, b, UP(i), UP(j), UP(k), UP(l), UP(i) + 4, UP(j) + 4, UP(k) + 4, UP(l) + 4)
#else
#define UP(i) ((i) < 4 ? (i) : (i) + 12)
#define BY_FOURS(a, b, i, j, k, l)                                                                                 \
  __builtin_shufflevector(a, b, UP(i), UP(j), UP(k), UP(l), UP(i) + 4, UP(j) + 4, UP(k) + 4, UP(l) + 4, UP(i) + 8, \
                          UP(j) + 8, UP(k) + 8, UP(l) + 8, UP(i) + 12, UP(j) + 12, UP(k) + 12, UP(l) + 12)
#endif

/** Nodes q, q + 4, ... of a list of where their numbers begin, side by side. */
ALWAYS_INLINE SingleVec loadEveryFourth(const float* base, const int* nodes)
{
#if WIDTH == 2
  return nodeAt(base + nodes[0]);
#else
#if WIDTH == 4
  const SingleNode a = nodeAt(base + nodes[0]), b = nodeAt(base + nodes[4]);
  return __builtin_shufflevector(a, b, 0, 1, 2, 3, 4, 5, 6, 7);
#else
  // GCC would shuffle whole registers, which takes a tenth more of a product's time.
  const auto pair = [&](int k) INLINED {
    return _mm256_insertf128_ps(_mm256_castps128_ps256(nodeAt(base + nodes[k])), nodeAt(base + nodes[k + 4]), 1);
  };
  return _mm512_insertf32x8(_mm512_castps256_ps512(pair(0)), pair(8), 1);
#endif
#endif
}

ALWAYS_INLINE Vec3Of<SingleVec> gather(const float* base, const int* nodes)
{
  const SingleVec a = loadEveryFourth(base, nodes), b = loadEveryFourth(base, nodes + 1);
  const SingleVec c = loadEveryFourth(base, nodes + 2), d = loadEveryFourth(base, nodes + 3);
  const SingleVec ab_xy = BY_FOURS(a, b, 0, 4, 1, 5), cd_xy = BY_FOURS(c, d, 0, 4, 1, 5);
  const SingleVec ab_z = BY_FOURS(a, b, 2, 6, 3, 7), cd_z = BY_FOURS(c, d, 2, 6, 3, 7);
  return {BY_FOURS(ab_xy, cd_xy, 0, 1, 4, 5), BY_FOURS(ab_xy, cd_xy, 2, 3, 6, 7), BY_FOURS(ab_z, cd_z, 0, 1, 4, 5)};
}

ALWAYS_INLINE void transpose(const Vec3Of<SingleVec>& v, SingleVec* rows)
{
  const SingleVec zero = zeros<SingleVec>();
  const SingleVec xy_01 = BY_FOURS(v.x, v.y, 0, 4, 1, 5), xy_23 = BY_FOURS(v.x, v.y, 2, 6, 3, 7);
  const SingleVec z_01 = BY_FOURS(v.z, zero, 0, 4, 1, 5), z_23 = BY_FOURS(v.z, zero, 2, 6, 3, 7);
  rows[0] = BY_FOURS(xy_01, z_01, 0, 1, 4, 5);
  rows[1] = BY_FOURS(xy_01, z_01, 2, 3, 6, 7);
  rows[2] = BY_FOURS(xy_23, z_23, 0, 1, 4, 5);
  rows[3] = BY_FOURS(xy_23, z_23, 2, 3, 6, 7);
}

/** A share a lane, to the place that slotOf() names in a row of LANES. */
template <class Scalar, class V>
ALWAYS_INLINE void storeShares(Scalar* row, int part, const Vec3Of<V>& v)
{
#if WIDTH == 2
  if constexpr (std::is_same_v<Scalar, double>)
  {
    for (int k = 0; k < 2; ++k)
    {
      double* p = row + 4L * slotOf(part + k);
      *reinterpret_cast<Vec*>(p) = Vec{v.x[k], v.y[k]};
      *reinterpret_cast<Vec*>(p + 2) = Vec{v.z[k], 0};
    }
    return;
  }
  else
#endif
  {
    V rows[4];
    transpose(v, rows);
    for (int k = 0; k < 4; ++k) store(row + part + static_cast<long>(k) * LANES, rows[k]);  // part: 4 slotOf(part)
  }
}

/** Four numbers of a, four of b, the next four of a, ... */
ALWAYS_INLINE void storeByTurns(float* to, SingleVec a, SingleVec b)
{
#if WIDTH == 2
  store(to, a);
  store(to + SINGLE_WIDTH, b);
#elif WIDTH == 4
  store(to, __builtin_shufflevector(a, b, 0, 1, 2, 3, 8, 9, 10, 11));
  store(to + SINGLE_WIDTH, __builtin_shufflevector(a, b, 4, 5, 6, 7, 12, 13, 14, 15));
#else
  store(to, __builtin_shufflevector(a, b, 0, 1, 2, 3, 16, 17, 18, 19, 4, 5, 6, 7, 20, 21, 22, 23));
  store(to + SINGLE_WIDTH, __builtin_shufflevector(a, b, 8, 9, 10, 11, 24, 25, 26, 27, 12, 13, 14, 15, 28, 29, 30, 31));
#endif
}
ALWAYS_INLINE void storeByTurns(double* to, Vec a, Vec b)
{
#if WIDTH == 8
  store(to, __builtin_shufflevector(a, b, 0, 1, 2, 3, 8, 9, 10, 11));
  store(to + WIDTH, __builtin_shufflevector(a, b, 4, 5, 6, 7, 12, 13, 14, 15));
#else
  store(to, a);
  store(to + WIDTH, b);
#endif
}

/** The same of two vectors a lane, the second one after the first. */
template <class Scalar, class V>
ALWAYS_INLINE void storeShares(Scalar* rows, int part, const Vec3Of<V>& a, const Vec3Of<V>& b)
{
#if WIDTH == 2
  if constexpr (std::is_same_v<Scalar, double>)
  {
    for (int k = 0; k < 2; ++k)
    {
      double* p = rows + 8L * slotOf(part + k);
      *reinterpret_cast<Vec*>(p) = Vec{a.x[k], a.y[k]};
      *reinterpret_cast<Vec*>(p + 2) = Vec{a.z[k], 0};
      *reinterpret_cast<Vec*>(p + 4) = Vec{b.x[k], b.y[k]};
      *reinterpret_cast<Vec*>(p + 6) = Vec{b.z[k], 0};
    }
    return;
  }
  else
#endif
  {
    V of_a[4], of_b[4];
    transpose(a, of_a);
    transpose(b, of_b);
    for (int k = 0; k < 4; ++k) storeByTurns(rows + 2L * (part + static_cast<long>(k) * LANES), of_a[k], of_b[k]);
  }
}

/** Symmetric 3x3 matrix, one a lane. */
template <class V>
struct SymOf
{
  V xx, xy, xz, yy, yz, zz;
};
using Sym = SymOf<Vec>;
template <class V>
inline SymOf<V> operator+(const SymOf<V>& a, const SymOf<V>& b)
{
  return {a.xx + b.xx, a.xy + b.xy, a.xz + b.xz, a.yy + b.yy, a.yz + b.yz, a.zz + b.zz};
}
template <class V>
inline Vec3Of<V> operator*(const SymOf<V>& m, const Vec3Of<V>& v)
{
  return {m.xx * v.x + m.xy * v.y + m.xz * v.z, m.xy * v.x + m.yy * v.y + m.yz * v.z,
          m.xz * v.x + m.yz * v.y + m.zz * v.z};
}

template <class V>
struct RotatedGradientsOf
{
  Vec3Of<V> r[4];
};
using RotatedGradients = RotatedGradientsOf<Vec>;

template <class Scalar, class V = decltype(load(std::declval<const Scalar*>()))>
ALWAYS_INLINE RotatedGradientsOf<V> loadGradients(const Scalar* p)
{
  RotatedGradientsOf<V> g;
  for (int a = 0; a < 3; ++a)
  {
    g.r[a + 1] = {loadAs<V>(p + (3L * a) * LANES), loadAs<V>(p + (3L * a + 1) * LANES),
                  loadAs<V>(p + (3L * a + 2) * LANES)};
  }
  const Vec3Of<V> sum = g.r[1] + g.r[2] + g.r[3];
  g.r[0] = {-sum.x, -sum.y, -sum.z};
  return g;
}

/**
 * Stress of the strain sym(sum_d u_d r_d^T) - identity, u_d measured from u_0, which sum_d r_d = 0 allows and which
 * keeps a body far from the origin exact. Adds the strain's trace to `dilatation`.
 */
template <class V>
ALWAYS_INLINE SymOf<V> stress(const RotatedGradientsOf<V>& g, const Vec3Of<V>& u1, const Vec3Of<V>& u2,
                              const Vec3Of<V>& u3, double identity, V lambda, V mu, V& dilatation)
{
  const V one = all<V>(identity);
  const Vec3Of<V>&a = g.r[1], &b = g.r[2], &c = g.r[3];
  const V exx = u1.x * a.x + u2.x * b.x + u3.x * c.x - one;
  const V eyy = u1.y * a.y + u2.y * b.y + u3.y * c.y - one;
  const V ezz = u1.z * a.z + u2.z * b.z + u3.z * c.z - one;
  const V exy = u1.x * a.y + u2.x * b.y + u3.x * c.y + u1.y * a.x + u2.y * b.x + u3.y * c.x;
  const V exz = u1.x * a.z + u2.x * b.z + u3.x * c.z + u1.z * a.x + u2.z * b.x + u3.z * c.x;
  const V eyz = u1.y * a.z + u2.y * b.z + u3.y * c.z + u1.z * a.y + u2.z * b.y + u3.z * c.y;
  const V trace = exx + eyy + ezz, pressure = lambda * trace, two_mu = mu + mu;
  dilatation += trace;
  return {pressure + two_mu * exx, mu * exy, mu * exz, pressure + two_mu * eyy, mu * eyz, pressure + two_mu * ezz};
}

template <class V>
inline void addPressure(SymOf<V>& s, V pressure)
{
  s.xx += pressure;
  s.yy += pressure;
  s.zz += pressure;
}

/** Local control point (a,b); bernstein.h has the same table for the rest of the library. */
constexpr int POINT[4][4] = {{0, 4, 5, 6}, {4, 1, 7, 8}, {5, 7, 2, 9}, {6, 8, 9, 3}};

/** The corners a <= b of a point. */
constexpr int ENDS[10][2] = {{0, 0}, {1, 1}, {2, 2}, {3, 3}, {0, 1}, {0, 2}, {0, 3}, {1, 2}, {1, 3}, {2, 3}};

/** The sum of the points (c,d) over c. */
template <class V>
inline Vec3Of<V> columnSum(const Vec3Of<V>* u, int d)
{
  return u[POINT[0][d]] + u[POINT[1][d]] + u[POINT[2][d]] + u[POINT[3][d]];
}

/** Calls f(0), ..., f(N - 1) with numbers that the compiler knows, so that what they index can stay in registers. */
template <class F, int... K>
ALWAYS_INLINE void unrolled(const F& f, std::integer_sequence<int, K...> /*numbers*/)
{
  (f(std::integral_constant<int, K>{}), ...);
}
template <int N, class F>
ALWAYS_INLINE void unrolled(const F& f)
{
  unrolled(f, std::make_integer_sequence<int, N>{});
}

/**
 * K' u (identity = 0), or the elastic force of positions u (identity = 1); lambda and mu times V. The part `mean` of
 * lambda acts on the element's mean dilatation, the rest at every point.
 * @param rotated  rotated gradients, POINTS times 9 rows of LANES
 * @param in       u of a node: in(k)
 * @param give     takes what comes out for a node: give(k, force)
 */
template <int NODES, int POINTS, bool MEAN, class Scalar, class V, class In, class Give>
ALWAYS_INLINE void elasticForce(const Scalar* rotated, const In& in, double identity, V lambda, V mu, V mean,
                                const Give& give)
{
  V dilatation = V{};
  if constexpr (MEAN) lambda -= mean;
  if constexpr (NODES == 4)
  {
    const RotatedGradientsOf<V> g = loadGradients(rotated);
    const Vec3Of<V> u0 = in(0);
    const SymOf<V> s = stress(g, in(1) - u0, in(2) - u0, in(3) - u0, identity, lambda, mu, dilatation);
    unrolled<4>([&](auto a) INLINED { give(a, s * g.r[a]); });
  }
  else if constexpr (POINTS == 1)
  {
    // F_c = 2 sum_d x_cd g_d^T; Q_a = V/20 (s_a + sum_c s_c); the factors 2 of F_c and of f are put together: stress()
    // works on half the strain, with half the identity, and 2 * 2 / 20 = 1/5 goes to lambda and mu.
    const RotatedGradientsOf<V> g = loadGradients(rotated);
    lambda = lambda * all<V>(0.2);
    mu = mu * all<V>(0.2);
    const auto at = [&](const Vec3Of<V>& origin, const Vec3Of<V>& u1, const Vec3Of<V>& u2,
                        const Vec3Of<V>& u3) INLINED {
      return stress(g, u1 - origin, u2 - origin, u3 - origin, 0.5 * identity, lambda, mu, dilatation);
    };
    // Points are asked for when they are needed, and forces given as they come: all of them are more than there are
    // registers. Written out, with every number in sight; loops would keep it all in memory, for half as long again.
    const Vec3Of<V> u01 = in(4), u02 = in(5), u03 = in(6);
    SymOf<V> q0 = at(in(0), u01, u02, u03);
    const Vec3Of<V> u12 = in(7), u13 = in(8);
    SymOf<V> q1 = at(u01, in(1), u12, u13);
    const Vec3Of<V> u23 = in(9);
    SymOf<V> q2 = at(u02, u12, in(2), u23);
    SymOf<V> q3 = at(u03, u13, u23, in(3));
    SymOf<V> sum = (q0 + q1) + (q2 + q3);
    // A constant pressure p gives 2 Q_a = V p/2, and p is `mean` times a quarter of the sum of the dilatations, of
    // which half is here.
    if constexpr (MEAN) addPressure(sum, all<V>(0.25) * mean * dilatation);
    q0 = q0 + sum;
    q1 = q1 + sum;
    q2 = q2 + sum;
    q3 = q3 + sum;
    // What goes to (a,b) is Q_a g_b + Q_b g_a, and the sum of all g_b is zero.
    const Vec3Of<V> zero = {};
    const Vec3Of<V> f01 = q0 * g.r[1], f02 = q0 * g.r[2], f03 = q0 * g.r[3];
    give(0, zero - f01 - (f02 + f03));
    const Vec3Of<V> f11 = q1 * g.r[1], f12 = q1 * g.r[2], f13 = q1 * g.r[3];
    give(1, f11);
    give(4, f01 - f11 - (f12 + f13));
    const Vec3Of<V> f21 = q2 * g.r[1], f22 = q2 * g.r[2], f23 = q2 * g.r[3];
    give(2, f22);
    give(5, f02 - f21 - (f22 + f23));
    give(7, f12 + f21);
    const Vec3Of<V> f31 = q3 * g.r[1], f32 = q3 * g.r[2], f33 = q3 * g.r[3];
    give(3, f33);
    give(6, f03 - f31 - (f32 + f33));
    give(8, f13 + f31);
    give(9, f23 + f32);
  }
  else
  {
    // At point q, F = 2 sum_d z_d g_d^T with z_d = sum_c lambda_c x_cd, and with t_d = s R g_d a quarter of V times
    // 2 (lambda_a t_b + lambda_b t_a) goes to f_ab. Again half the strain; 2 * 2 / 4 = 1.
    const V far = all<V>(FAR), above = all<V>(NEAR - FAR);
    Vec3Of<V> u[NODES], sum[4], t[4][4], total[4] = {};
    SymOf<V> s[4];
    for (int k = 0; k < NODES; ++k) u[k] = in(k);
    for (int d = 0; d < 4; ++d) sum[d] = far * columnSum(u, d);
    for (int q = 0; q < 4; ++q)
    {
      const RotatedGradientsOf<V> g = loadGradients(rotated + 9L * q * LANES);
      Vec3Of<V> z[4];
      for (int d = 0; d < 4; ++d) z[d] = sum[d] + above * u[POINT[q][d]];
      s[q] = stress(g, z[1] - z[0], z[2] - z[0], z[3] - z[0], 0.5 * identity, lambda, mu, dilatation);
    }
    for (int q = 0; q < 4; ++q)
    {
      const RotatedGradientsOf<V> g = loadGradients(rotated + 9L * q * LANES);
      if constexpr (MEAN) addPressure(s[q], all<V>(0.25) * mean * dilatation);
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
      give(a, t[a][a] + total[a]);
      for (int b = a + 1; b < 4; ++b) give(POINT[a][b], t[a][b] + t[b][a] + total[a] + total[b]);
    }
  }
}

/** The same, and m M u / (rho V) with it, with the exact integrals of products of basis functions; mass is m rho V. */
template <int NODES, int POINTS, bool MEAN, class Scalar, class V, class In, class Give>
ALWAYS_INLINE void systemForce(const Scalar* rotated, const In& in, V lambda, V mu, V mean, V mass, const Give& give)
{
  Vec3Of<V> u[NODES];
  unrolled<NODES>([&](auto k) INLINED { u[k] = in(k); });
  const auto known = [&](int k) INLINED { return u[k]; };
  if constexpr (NODES == 4)
  {
    const V scale = mass * all<V>(1.0 / 20);
    const Vec3Of<V> sum = u[0] + u[1] + u[2] + u[3];
    elasticForce<NODES, POINTS, MEAN>(rotated, known, 0, lambda, mu, mean,
                                      [&](int k, const Vec3Of<V>& f) INLINED { give(k, f + scale * (sum + u[k])); });
  }
  else
  {
    const V scale = mass * all<V>(1.0 / 210);
    Vec3Of<V> t[4];
    unrolled<4>([&](auto a)
                    INLINED { t[a] = u[a] + u[POINT[a][0]] + u[POINT[a][1]] + u[POINT[a][2]] + u[POINT[a][3]]; });
    const Vec3Of<V> sum = all<V>(0.5) * (t[0] + t[1] + t[2] + t[3]);
    elasticForce<NODES, POINTS, MEAN>(rotated, known, 0, lambda, mu, mean, [&](int k, const Vec3Of<V>& f) INLINED {
      give(k, f + scale * (sum + t[ENDS[k][0]] + t[ENDS[k][1]] + u[k]));
    });
  }
}

/** f += m M u / (rho V), with the exact integrals of products of basis functions; mass is m rho V. */
template <int NODES, class V>
ALWAYS_INLINE void addMass(const Vec3Of<V>* u, V mass, Vec3Of<V>* f)
{
  if constexpr (NODES == 4)
  {
    const V scale = mass * all<V>(1.0 / 20);
    const Vec3Of<V> sum = u[0] + u[1] + u[2] + u[3];
    for (int a = 0; a < 4; ++a) f[a] = f[a] + scale * (sum + u[a]);
  }
  else
  {
    const V scale = mass * all<V>(1.0 / 210);
    Vec3Of<V> t[4];
    for (int a = 0; a < 4; ++a)
    {
      t[a] = u[a] + u[POINT[a][0]] + u[POINT[a][1]] + u[POINT[a][2]] + u[POINT[a][3]];
    }
    const V half = all<V>(0.5);
    const Vec3Of<V> sum = half * (t[0] + t[1] + t[2] + t[3]);
    for (int a = 0; a < 4; ++a)
    {
      for (int b = a; b < 4; ++b) f[POINT[a][b]] = f[POINT[a][b]] + scale * (sum + t[a] + t[b] + u[POINT[a][b]]);
    }
  }
}
