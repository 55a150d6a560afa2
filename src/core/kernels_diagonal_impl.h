// The 3x3 diagonal blocks of a system and their inverses, for kernels_impl.h, inside its unnamed namespace.

/** H_cd + H_dc over V, with H_cd = lambda c d^T + mu d c^T + mu (c.d) 1; H_cc + H_cc = 2 H_cc for c = d. */
template <class V>
inline SymOf<V> symmetricH(const Vec3Of<V>& c, const Vec3Of<V>& d, V lambda, V mu)
{
  const V sum = lambda + mu;
  const V dot = (mu + mu) * (c.x * d.x + c.y * d.y + c.z * d.z);
  return {(sum + sum) * c.x * d.x + dot, sum * (c.x * d.y + c.y * d.x), sum * (c.x * d.z + c.z * d.x),
          (sum + sum) * c.y * d.y + dot, sum * (c.y * d.z + c.z * d.y), (sum + sum) * c.z * d.z + dot};
}

template <class V>
inline SymOf<V> plusDiagonal(const SymOf<V>& s, V d)
{
  return {s.xx + d, s.xy, s.xz, s.yy + d, s.yz, s.zz + d};
}

/** Calls run(block, part, give) for registers of elements, of which give(k, s) writes the diagonal blocks of nodes k.
 */
template <class V, int NODES, class Scalar, class Run>
ALWAYS_INLINE void forEachDiagonal(const unsigned char* pairing, int begin, int end, Scalar* shares, const Run& run)
{
  forEachRegister<V, SymOf<V>, NODES, NODES>(
      pairing, begin, end, [](long, int) INLINED { return [](int) INLINED { return 0; }; },
      [&](long block, int part) INLINED {
        Scalar* to = shares + 2 * SHARES * NODES * block;
        return [to, part](int k, const SymOf<V>& s) INLINED {
          storeShares(to + 2 * SHARES * k, part, Vec3Of<V>{s.xx, s.yy, s.zz}, Vec3Of<V>{s.xy, s.xz, s.yz});
        };
      },
      [&](long block, int part, const auto& /*in*/, const auto& give) INLINED { run(block, part, give); });
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

template <bool MEAN, class V, class Give>
ALWAYS_INLINE void addDiagonalOfFour(const double* rotated, V lambda, V mu, V mean, V mass, const Give& give)
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
      give(POINT[a][b], plusDiagonal(half * sum, mass * all<V>(a == b ? 1.0 / 35 : 2.0 / 105)));
    }
  }
}

/** @param shares  in the precision of V */
template <class V, int NODES, int POINTS, bool MEAN, class Scalar>
void addDiagonal(const Elements& elements, int begin, int end, const double* rotated, double alpha, double beta,
                 Scalar* shares)
{
  forEachDiagonal<V, NODES>(elements.pairing, begin, end, shares, [&](long block, int part, const auto& give) INLINED {
    const double* c = elements.coefficients + 3 * block * LANES + part;
    V lambda = loadAs<V>(c, beta), mean = V{};
    const V mu = loadAs<V>(c + LANES, beta), mass = loadAs<V>(c + 2L * LANES, alpha);
    if constexpr (MEAN)
    {
      mean = loadAs<V>(elements.mean + block * LANES + part, beta);
      lambda -= mean;
    }
    const double* own = rotated + block * POINTS * 9 * LANES + part;
    if constexpr (POINTS == 4)
    {
      addDiagonalOfFour<MEAN>(own, lambda, mu, mean, mass, give);
    }
    else
    {
      const auto g = loadGradients<double, V>(own);
      SymOf<V> h[4];  // 2 H_aa
      for (int a = 0; a < 4; ++a) h[a] = symmetricH(g.r[a], g.r[a], lambda, mu);
      if constexpr (NODES == 4)
      {
        const V half = all<V>(0.5);
        for (int a = 0; a < 4; ++a) give(a, plusDiagonal(half * h[a], mass * all<V>(0.1)));
      }
      else
      {
        // 4 V/20 (2 H_aa) at corners, 4 V/20 (2 H_aa + 2 H_bb + H_ab + H_ba) at edges; M: rho V/35 and rho V 4/210.
        // Mean gradients: r_a/2 at corners, (r_a + r_b)/2 at edges.
        const V fifth = all<V>(0.2), quarter_mean = all<V>(0.25) * mean;
        const V corner_mass = mass * all<V>(1.0 / 35), edge_mass = mass * all<V>(2.0 / 105);
        unrolled<4>([&](auto a) INLINED {
          SymOf<V> corner = fifth * h[a];
          if constexpr (MEAN) corner = corner + square(quarter_mean, g.r[a]);
          give(a, plusDiagonal(corner, corner_mass));
        });
        unrolled<6>([&](auto k) INLINED {
          const int a = ENDS[4 + k][0], b = ENDS[4 + k][1];
          SymOf<V> edge = fifth * (h[a] + h[b] + symmetricH(g.r[a], g.r[b], lambda, mu));
          if constexpr (MEAN) edge = edge + square(quarter_mean, g.r[a] + g.r[b]);
          give(4 + k, plusDiagonal(edge, edge_mass));
        });
      }
    }
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
