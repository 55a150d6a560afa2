// St. Venant-Kirchhoff elasticity for kernels_impl.h, inside its unnamed namespace.
//
// F is linear in the barycentric coordinates, so Green's strain E = (F^T F - 1)/2 and the stress S of it are quadratic
// and have ten Bernstein coefficients, those of pair (a,b) from the gradients at corners a and b. The force needs
//     Q_a = integral of lambda_a F S = sum_b F_b T_ab,   T_ab = integral of lambda_a lambda_b S,
// and T_ab is the mass matrix's formula (addMass()) applied to the coefficients of S. No quadrature there.

/** Corners at which F is kept, pairs of them, and F and T of an element as linearise() stores them. */
template <int NODES>
struct Green
{
  static constexpr int GRADIENTS = NODES == 4 ? 1 : 4;
  static constexpr int PAIRS = NODES == 4 ? 1 : 10;
  static constexpr int SIZE = 9 * GRADIENTS + 6 * PAIRS;
};
static_assert(Green<4>::SIZE == LINEAR_TANGENT && Green<10>::SIZE == QUADRATIC_TANGENT);

/** Gradients of the basis functions at the corners: g_a for linear elements, 2 g_a for quadratic ones. */
template <int NODES>
inline RotatedGradients basisGradients(const double* p)
{
  RotatedGradients g = loadGradients(p);
  if constexpr (NODES == 10)
  {
    for (Vec3& r : g.r) r = r + r;
  }
  return g;
}

inline void addOuter(Mat& m, const Vec3& u, const Vec3& g)
{
  const Vec column[3] = {u.x, u.y, u.z}, row[3] = {g.x, g.y, g.z};
  for (int i = 0; i < 3; ++i)
  {
    for (int j = 0; j < 3; ++j) m.m[i][j] += column[i] * row[j];
  }
}

/** Gradient of the field u at the corners: the same everywhere for linear elements. */
template <int NODES>
inline void gradients(const RotatedGradients& g, const Vec3* u, Mat* f)
{
  for (int c = 0; c < Green<NODES>::GRADIENTS; ++c)
  {
    const Vec3& origin = u[NODES == 4 ? 0 : POINT[c][0]];
    for (auto& row : f[c].m)
    {
      for (Vec& v : row) v = Vec{};
    }
    for (int d = 1; d < 4; ++d) addOuter(f[c], u[NODES == 4 ? d : POINT[c][d]] - origin, g.r[d]);
  }
}

/** Diagonal of A^T B and the sums of its other elements with their mirror images, as shear strains are measured. */
ALWAYS_INLINE Sym metric(const Mat& a, const Mat& b)
{
  const auto dot = [&](int i, int j) { return a.m[0][i] * b.m[0][j] + a.m[1][i] * b.m[1][j] + a.m[2][i] * b.m[2][j]; };
  return {dot(0, 0), dot(0, 1) + dot(1, 0), dot(0, 2) + dot(2, 0), dot(1, 1), dot(1, 2) + dot(2, 1), dot(2, 2)};
}

/** Stress of a strain whose shears are counted twice. */
inline Sym stressOf(const Sym& e, Vec lambda, Vec mu)
{
  const Vec pressure = lambda * (e.xx + e.yy + e.zz), two_mu = mu + mu;
  return {pressure + two_mu * e.xx, mu * e.xy, mu * e.xz,
          pressure + two_mu * e.yy, mu * e.yz, pressure + two_mu * e.zz};
}

/** Green's strain, shears counted twice, of F = a = b, or the coefficient of the pair of gradients a and b. */
inline Sym greenStrain(const Mat& a, const Mat& b)
{
  const Sym m = metric(a, b);
  const Vec half = Vec{} + 0.5;
  return {half * m.xx - half, half * m.xy, half * m.xz, half * m.yy - half, half * m.yz, half * m.zz - half};
}

inline Vec contract(const Sym& stress, const Sym& strain)
{
  return stress.xx * strain.xx + stress.yy * strain.yy + stress.zz * strain.zz + stress.xy * strain.xy +
         stress.xz * strain.xz + stress.yz * strain.yz;
}

/** From the coefficients of S to T_ab, up to the factor V/210. */
inline void integrate(Sym* s)
{
  const Vec half = Vec{} + 0.5;
  Sym t[4];
  for (int a = 0; a < 4; ++a) t[a] = s[a] + s[POINT[a][0]] + s[POINT[a][1]] + s[POINT[a][2]] + s[POINT[a][3]];
  const Sym sum = half * (t[0] + t[1] + t[2] + t[3]);
  for (int a = 0; a < 4; ++a)
  {
    for (int b = a + 1; b < 4; ++b) s[POINT[a][b]] = half * (sum + t[a] + t[b] + s[POINT[a][b]]);
    s[a] = sum + t[a] + t[a] + s[a];
  }
}

/** q += F T */
ALWAYS_INLINE void addTimes(Mat& q, const Mat& f, const Sym& t)
{
  for (int i = 0; i < 3; ++i)
  {
    const Vec x = f.m[i][0], y = f.m[i][1], z = f.m[i][2];
    q.m[i][0] += x * t.xx + y * t.xy + z * t.xz;
    q.m[i][1] += x * t.xy + y * t.yy + z * t.yz;
    q.m[i][2] += x * t.xz + y * t.yz + z * t.zz;
  }
}

inline Vec3 operator*(const Mat& m, const Vec3& v)
{
  return {m.m[0][0] * v.x + m.m[0][1] * v.y + m.m[0][2] * v.z, m.m[1][0] * v.x + m.m[1][1] * v.y + m.m[1][2] * v.z,
          m.m[2][0] * v.x + m.m[2][1] * v.y + m.m[2][2] * v.z};
}

/** Forces on the nodes from the integrals of lambda_a P (linear elements: of P). */
template <int NODES>
inline void nodalForces(const RotatedGradients& g, const Mat* q, Vec3* f)
{
  if constexpr (NODES == 4)
  {
    for (int a = 0; a < 4; ++a) f[a] = q[0] * g.r[a];
  }
  else
  {
    for (int a = 0; a < 4; ++a)
    {
      f[a] = q[a] * g.r[a];
      for (int b = a + 1; b < 4; ++b) f[POINT[a][b]] = q[a] * g.r[b] + q[b] * g.r[a];
    }
  }
}

/** Calls f(offset of the first lane among the nodes, block, first lane) for registers of elements, each by itself. */
template <int NODES, class F>
inline void forEachAlone(int begin, int end, const F& f)
{
  for (long block = begin; block < end; ++block)
  {
    for (int part = 0; part < LANES; part += WIDTH) f(block * NODES * LANES + part, block, part);
  }
}

template <int NODES>
inline void gatherNodes(const double* x, const int* nodes, Vec3* values)
{
  for (int k = 0; k < NODES; ++k) values[k] = gather(x, nodes + static_cast<long>(k) * LANES);
}

/** Calls f(block, first lane, u, shares) for each register of elements: what of x its nodes have, and what they get. */
template <int NODES, class F>
inline void forEachGreen(const Elements& elements, int begin, int end, const double* x, double* shares, const F& f)
{
  forEachElement<Vec, NODES, NODES>(elements.pairing, elements.gather, begin, end, x, shares,
                                    [&](long block, int part, const auto& in, const auto& give) {
                                      Vec3 u[NODES], out[NODES];
                                      unrolled<NODES>([&](auto k) { u[k] = in(k); });
                                      f(block, part, u, out);
                                      unrolled<NODES>([&](auto k) { give(k, out[k]); });
                                    });
}

/** T_ab of the strain of the gradients f (linear elements: S), for lambda and mu times V. */
template <int NODES>
inline void stressIntegrals(const Mat* f, Vec lambda, Vec mu, Sym* t)
{
  constexpr int CORNERS = Green<NODES>::GRADIENTS;
  if constexpr (NODES == 10)
  {
    lambda = lambda * (1.0 / 210);
    mu = mu * (1.0 / 210);
  }
  for (int a = 0; a < CORNERS; ++a)
  {
    for (int b = a; b < CORNERS; ++b) t[POINT[a][b]] = stressOf(greenStrain(f[a], f[b]), lambda, mu);
  }
  if constexpr (NODES == 10) integrate(t);
}

template <int NODES>
void addGreenForce(const Elements& elements, int begin, int end, const double* rest, const double* x, double* shares)
{
  constexpr int CORNERS = Green<NODES>::GRADIENTS;
  forEachGreen<NODES>(elements, begin, end, x, shares, [&](long block, int part, const Vec3* in, Vec3* out) {
    const double* c = elements.coefficients + 3 * block * LANES + part;
    const RotatedGradients g = basisGradients<NODES>(rest + 9 * block * LANES + part);
    Mat f[CORNERS], q[CORNERS];
    Sym t[Green<NODES>::PAIRS];
    gradients<NODES>(g, in, f);
    stressIntegrals<NODES>(f, load(c), load(c + LANES), t);
    for (int a = 0; a < CORNERS; ++a)
    {
      q[a] = Mat{};
      for (int b = 0; b < CORNERS; ++b) addTimes(q[a], f[b], t[POINT[a][b]]);
    }
    nodalForces<NODES>(g, q, out);
  });
}

template <int NODES>
double greenEnergy(const Elements& elements, int begin, int end, const double* rest, const double* x)
{
  constexpr int CORNERS = Green<NODES>::GRADIENTS;
  Vec sum = Vec{};
  forEachAlone<NODES>(begin, end, [&](long at, long block, int part) {
    const double* c = elements.coefficients + 3 * block * LANES + part;
    Vec3 in[NODES];
    gatherNodes<NODES>(x, elements.gather + at, in);
    Mat f[CORNERS];
    Sym t[Green<NODES>::PAIRS];
    gradients<NODES>(basisGradients<NODES>(rest + 9 * block * LANES + part), in, f);
    stressIntegrals<NODES>(f, load(c), load(c + LANES), t);
    for (int a = 0; a < CORNERS; ++a)
    {
      // The integral of S : E is the sum of T_ab : E_ab over ordered pairs.
      for (int b = a; b < CORNERS; ++b) sum += (a == b ? 0.5 : 1.0) * contract(t[POINT[a][b]], greenStrain(f[a], f[b]));
    }
  });
  double energy = 0;
  for (int k = 0; k < WIDTH; ++k) energy += sum[k];
  return energy;
}

/**
 * The symmetric matrix without its negative eigenvalues, by Jacobi's rotations. Positive semidefinite whether these
 * have converged or not, because it is put together from the eigenvalues that were kept.
 */
inline Sym positivePart(const Sym& s)
{
  constexpr int SWEEPS = 5, PAIRS[3][2] = {{0, 1}, {0, 2}, {1, 2}};
  Vec a[3][3] = {{s.xx, s.xy, s.xz}, {s.xy, s.yy, s.yz}, {s.xz, s.yz, s.zz}}, v[3][3] = {};
  for (int i = 0; i < 3; ++i) v[i][i] = Vec{} + 1;
  for (int sweep = 0; sweep < SWEEPS; ++sweep)
  {
    for (const auto& pair : PAIRS)
    {
      const int p = pair[0], q = pair[1], r = 3 - p - q;
      const Vec difference = a[q][q] - a[p][p], twice = 2 * a[p][q];
      const Vec root = squareRoot(difference * difference + twice * twice);
      const Vec denominator = difference >= 0 ? difference + root : difference - root;
      const Vec t = twice / (denominator != 0 ? denominator : Vec{} + 1);
      const Vec cosine = 1 / squareRoot(1 + t * t), sine = t * cosine;
      a[p][p] -= t * a[p][q];
      a[q][q] += t * a[p][q];
      a[p][q] = a[q][p] = Vec{};
      const Vec pr = cosine * a[p][r] - sine * a[q][r], qr = sine * a[p][r] + cosine * a[q][r];
      a[p][r] = a[r][p] = pr;
      a[q][r] = a[r][q] = qr;
      for (auto& row : v)
      {
        const Vec vp = cosine * row[p] - sine * row[q], vq = sine * row[p] + cosine * row[q];
        row[p] = vp;
        row[q] = vq;
      }
    }
  }
  Sym result = {};
  for (int k = 0; k < 3; ++k)
  {
    const Vec3 axis = {v[0][k], v[1][k], v[2][k]};
    const Vec value = a[k][k] > 0 ? a[k][k] : Vec{};
    const Vec3 scaled = value * axis;
    result = result + Sym{scaled.x * axis.x, scaled.x * axis.y, scaled.x * axis.z,
                          scaled.y * axis.y, scaled.y * axis.z, scaled.z * axis.z};
  }
  return result;
}

/** Whether leading minors say that every lane is positive definite. */
inline bool allPositive(const Sym& s)
{
  const Vec minor = s.xx * s.yy - s.xy * s.xy;
  const Vec det = s.zz * minor - s.xx * s.yz * s.yz - s.yy * s.xz * s.xz + 2 * s.xy * s.xz * s.yz;
  for (int k = 0; k < WIDTH; ++k)
  {
    if (!(s.xx[k] > 0 && minor[k] > 0 && det[k] > 0)) return false;
  }
  return true;
}

/**
 * Points and weights of a rule of degree 5 with positive weights (Walkington 2000, "Quadrature on simplices of
 * arbitrary dimension"): a projected stress must be weighed by positive numbers to stay semidefinite.
 */
struct QuadraturePoint
{
  double lambda[4], weight;
};
constexpr int QUADRATURE_POINTS = 14;
struct Quadrature
{
  QuadraturePoint points[QUADRATURE_POINTS];
};
constexpr Quadrature quadrature()
{
  constexpr double NEAR[2] = {0.31088591926330060980, 0.092735250310891226402};
  constexpr double NEAR_WEIGHT[2] = {0.11268792571801585080, 0.073493043116361949544};
  constexpr double EDGE = 0.045503704125649649492, EDGE_WEIGHT = 0.042546020777081466438;
  Quadrature rule{};
  int n = 0;
  for (int orbit = 0; orbit < 2; ++orbit)
  {
    for (int corner = 0; corner < 4; ++corner, ++n)
    {
      for (int a = 0; a < 4; ++a) rule.points[n].lambda[a] = a == corner ? 1 - 3 * NEAR[orbit] : NEAR[orbit];
      rule.points[n].weight = NEAR_WEIGHT[orbit];
    }
  }
  for (int a = 0; a < 4; ++a)
  {
    for (int b = a + 1; b < 4; ++b, ++n)
    {
      for (int c = 0; c < 4; ++c) rule.points[n].lambda[c] = c == a || c == b ? 0.5 - EDGE : EDGE;
      rule.points[n].weight = EDGE_WEIGHT;
    }
  }
  return rule;
}
constexpr Quadrature RULE = quadrature();

inline Mat gradientAt(const Mat* f, const double* lambda)
{
  Mat result;
  for (int i = 0; i < 3; ++i)
  {
    for (int j = 0; j < 3; ++j)
    {
      result.m[i][j] =
          lambda[0] * f[0].m[i][j] + lambda[1] * f[1].m[i][j] + lambda[2] * f[2].m[i][j] + lambda[3] * f[3].m[i][j];
    }
  }
  return result;
}

/** T_ab of the stress without its negative eigenvalues. */
template <int NODES>
inline void projectedIntegrals(const Mat* f, Vec lambda, Vec mu, Sym* t)
{
  if constexpr (NODES == 4)
  {
    const Sym s = stressOf(greenStrain(f[0], f[0]), lambda, mu);
    t[0] = allPositive(s) ? s : positivePart(s);
  }
  else
  {
    for (int k = 0; k < Green<NODES>::PAIRS; ++k) t[k] = Sym{};
    for (const QuadraturePoint& point : RULE.points)
    {
      const Mat at = gradientAt(f, point.lambda);
      Sym s = stressOf(greenStrain(at, at), point.weight * lambda, point.weight * mu);
      if (!allPositive(s)) s = positivePart(s);
      for (int a = 0; a < 4; ++a)
      {
        for (int b = a; b < 4; ++b)
        {
          t[POINT[a][b]] = t[POINT[a][b]] + (Vec{} + point.lambda[a] * point.lambda[b]) * s;
        }
      }
    }
  }
}

template <int NODES>
void lineariseGreen(const Elements& elements, int begin, int end, const double* rest, const double* x, bool projected,
                    double* tangent)
{
  using G = Green<NODES>;
  forEachAlone<NODES>(begin, end, [&](long at, long block, int part) {
    const double* c = elements.coefficients + 3 * block * LANES + part;
    Vec3 in[NODES];
    gatherNodes<NODES>(x, elements.gather + at, in);
    Mat f[G::GRADIENTS];
    Sym t[G::PAIRS];
    gradients<NODES>(basisGradients<NODES>(rest + 9 * block * LANES + part), in, f);
    (projected ? projectedIntegrals<NODES> : stressIntegrals<NODES>)(f, load(c), load(c + LANES), t);
    double* out = tangent + block * G::SIZE * LANES + part;
    for (const Mat& m : f)
    {
      for (int k = 0; k < 9; ++k, out += LANES) store(out, m.m[k / 3][k % 3]);
    }
    for (const Sym& s : t)
    {
      const Vec values[6] = {s.xx, s.xy, s.xz, s.yy, s.yz, s.zz};
      for (const Vec v : values)
      {
        store(out, v);
        out += LANES;
      }
    }
  });
}

/** What lineariseGreen() stored. */
template <int NODES>
inline void loadTangent(const double* from, Mat* f, Sym* t)
{
  using G = Green<NODES>;
  for (int c = 0; c < G::GRADIENTS; ++c) f[c] = loadMatrix(from + 9L * c * LANES);
  from += 9L * G::GRADIENTS * LANES;
  for (int k = 0; k < G::PAIRS; ++k, from += 6L * LANES)
  {
    t[k] = {load(from),
            load(from + LANES),
            load(from + 2L * LANES),
            load(from + 3L * LANES),
            load(from + 4L * LANES),
            load(from + 5L * LANES)};
  }
}

template <int NODES>
void addGreenProduct(const Elements& elements, int begin, int end, const double* rest, const double* tangent,
                     double alpha, double beta, const double* u, double* shares)
{
  using G = Green<NODES>;
  forEachGreen<NODES>(elements, begin, end, u, shares, [&](long block, int part, const Vec3* in, Vec3* out) {
    const double* c = elements.coefficients + 3 * block * LANES + part;
    const RotatedGradients g = basisGradients<NODES>(rest + 9 * block * LANES + part);
    Mat f[G::GRADIENTS], df[G::GRADIENTS], q[G::GRADIENTS];
    Sym t[G::PAIRS], dt[G::PAIRS];
    loadTangent<NODES>(tangent + block * G::SIZE * LANES + part, f, t);
    gradients<NODES>(g, in, df);
    // dE_ab = (F_a^T dF_b + F_b^T dF_a)/2, symmetric part; the factor 1/2 of mixed pairs goes to lambda and mu.
    const Vec scale = Vec{} + (NODES == 4 ? beta : beta / 210);
    const Vec lambda = scale * load(c), mu = scale * load(c + LANES);
    for (int a = 0; a < G::GRADIENTS; ++a)
    {
      dt[a] = stressOf(metric(f[a], df[a]), lambda, mu);
      for (int b = a + 1; b < G::GRADIENTS; ++b)
      {
        dt[POINT[a][b]] = stressOf(metric(f[a], df[b]) + metric(f[b], df[a]), lambda * 0.5, mu * 0.5);
      }
    }
    if constexpr (NODES == 10) integrate(dt);
    // dQ_a = sum_b (F_b dT_ab + dF_b T_ab)
    for (Mat& m : df)
    {
      for (auto& row : m.m)
      {
        for (Vec& v : row) v = v * beta;
      }
    }
    for (int a = 0; a < G::GRADIENTS; ++a)
    {
      q[a] = Mat{};
      for (int b = 0; b < G::GRADIENTS; ++b)
      {
        addTimes(q[a], f[b], dt[POINT[a][b]]);
        addTimes(q[a], df[b], t[POINT[a][b]]);
      }
    }
    nodalForces<NODES>(g, q, out);
    addMass<NODES>(in, alpha * load(c + 2L * LANES), out);
  });
}

inline Vec dot(const Vec3& a, const Vec3& b)
{
  return a.x * b.x + a.y * b.y + a.z * b.z;
}

/** d += (lambda + mu) (F n)(F n)^T + mu (n.n) F F^T: the 3x3 block that a node with the gradient n has with itself. */
inline void addOwnBlock(Sym& d, const Vec3& fn, Vec nn, const Sym& fft, Vec sum, Vec mu)
{
  const Vec3 s = sum * fn;
  d = d + Sym{s.x * fn.x, s.x * fn.y, s.x * fn.z, s.y * fn.y, s.y * fn.z, s.z * fn.z} + (mu * nn) * fft;
}

inline Sym timesTranspose(const Mat& f)
{
  const auto rows = [&](int i, int j) { return f.m[i][0] * f.m[j][0] + f.m[i][1] * f.m[j][1] + f.m[i][2] * f.m[j][2]; };
  return {rows(0, 0), rows(0, 1), rows(0, 2), rows(1, 1), rows(1, 2), rows(2, 2)};
}

template <int NODES>
void addGreenDiagonal(const Elements& elements, int begin, int end, const double* rest, const double* tangent,
                      double alpha, double beta, double* shares)
{
  using G = Green<NODES>;
  forEachDiagonal<Vec, NODES>(elements.pairing, begin, end, shares, [&](long block, int part, const auto& give) {
    const double* c = elements.coefficients + 3 * block * LANES + part;
    const RotatedGradients g = basisGradients<NODES>(rest + 9 * block * LANES + part);
    const Vec mu = beta * load(c + LANES), sum = beta * load(c) + mu, mass = alpha * load(c + 2L * LANES);
    Mat f[G::GRADIENTS];
    Sym t[G::PAIRS], own[NODES] = {};
    loadTangent<NODES>(tangent + block * G::SIZE * LANES + part, f, t);
    if constexpr (NODES == 4)
    {
      const Sym fft = timesTranspose(f[0]);
      for (int a = 0; a < 4; ++a)
      {
        addOwnBlock(own[a], f[0] * g.r[a], dot(g.r[a], g.r[a]), fft, sum, mu);
        const Vec geometric = beta * dot(g.r[a], t[0] * g.r[a]);
        give(a, plusDiagonal(own[a], mass * 0.1 + geometric));
      }
    }
    else
    {
      // The material term is of degree four, for which the rule is exact.
      for (const QuadraturePoint& point : RULE.points)
      {
        const double* lambda = point.lambda;
        const Mat here = gradientAt(f, lambda);
        const Sym fft = timesTranspose(here);
        const Vec point_sum = point.weight * sum, point_mu = point.weight * mu;
        Vec3 n[4], fn[4];
        for (int a = 0; a < 4; ++a) fn[a] = here * g.r[a];
        for (int a = 0; a < 4; ++a)
        {
          const Vec la = Vec{} + lambda[a];
          n[a] = la * g.r[a];
          addOwnBlock(own[a], la * fn[a], dot(n[a], n[a]), fft, point_sum, point_mu);
          for (int b = a + 1; b < 4; ++b)
          {
            const Vec lb = Vec{} + lambda[b];
            const Vec3 edge = la * g.r[b] + lb * g.r[a];
            addOwnBlock(own[POINT[a][b]], la * fn[b] + lb * fn[a], dot(edge, edge), fft, point_sum, point_mu);
          }
        }
      }
      for (int a = 0; a < 4; ++a)
      {
        const Vec corner = beta * dot(g.r[a], t[a] * g.r[a]);
        give(a, plusDiagonal(own[a], mass * (1.0 / 35) + corner));
        for (int b = a + 1; b < 4; ++b)
        {
          const Vec edge = beta * (dot(g.r[b], t[a] * g.r[b]) + dot(g.r[a], t[b] * g.r[a]) +
                                   2 * dot(g.r[a], t[POINT[a][b]] * g.r[b]));
          give(POINT[a][b], plusDiagonal(own[POINT[a][b]], mass * (2.0 / 105) + edge));
        }
      }
    }
  });
}
