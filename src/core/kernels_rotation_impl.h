// Rotations of the elements from their gradients, for kernels_impl.h, inside its unnamed namespace.

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
