// Element matrices, their assembly and the product of the assembled matrix, for kernels_impl.h, which includes this.

namespace bezier_fem::kernels
{
namespace
{
using UnalignedNode = double __attribute__((vector_size(sizeof(double) * 4), aligned(8)));

/** A 3x3 block by columns; the fourth numbers mean nothing. */
struct Block
{
  Node c[3];
};
inline Block operator+(const Block& a, const Block& b)
{
  return {{a.c[0] + b.c[0], a.c[1] + b.c[1], a.c[2] + b.c[2]}};
}

/** From 9 doubles; reads the tenth too. */
inline Block loadPacked(const double* p)
{
  return {{*reinterpret_cast<const UnalignedNode*>(p), *reinterpret_cast<const UnalignedNode*>(p + 3),
           *reinterpret_cast<const UnalignedNode*>(p + 6)}};
}

/** To 9 doubles, none more. */
inline void storePacked(double* p, const Block& b)
{
  using Half = double __attribute__((vector_size(sizeof(double) * 2), aligned(8)));
  *reinterpret_cast<UnalignedNode*>(p) = b.c[0];
  *reinterpret_cast<UnalignedNode*>(p + 3) = b.c[1];
  *reinterpret_cast<Half*>(p + 6) = __builtin_shufflevector(b.c[2], b.c[2], 0, 1);
  p[8] = b.c[2][2];
}

/** A packed block may lie on two cache lines. */
inline void prefetchForWriting(const double* p)
{
  __builtin_prefetch(p, 1);
  __builtin_prefetch(p + 8, 1);
}

inline Block transpose(const Block& b)
{
  const Node xz = __builtin_shufflevector(b.c[0], b.c[1], 0, 4, 2, 6);
  const Node y = __builtin_shufflevector(b.c[0], b.c[1], 1, 5, 3, 7);
  const Node swapped = __builtin_shufflevector(b.c[2], b.c[2], 1, 0, 3, 2);
  return {{__builtin_shufflevector(xz, b.c[2], 0, 1, 4, 5), __builtin_shufflevector(y, swapped, 0, 1, 4, 5),
           __builtin_shufflevector(xz, b.c[2], 2, 3, 6, 7)}};
}

/** Transposes WIDTH registers in place (Eklundh 1972). */
inline void transpose(Vec* v)
{
#if WIDTH == 2
  const Vec a = v[0], b = v[1];
  v[0] = __builtin_shufflevector(a, b, 0, 2);
  v[1] = __builtin_shufflevector(a, b, 1, 3);
#elif WIDTH == 4
  for (int i = 0; i < 4; i += 2)
  {
    const Vec a = v[i], b = v[i + 1];
    v[i] = __builtin_shufflevector(a, b, 0, 4, 2, 6);
    v[i + 1] = __builtin_shufflevector(a, b, 1, 5, 3, 7);
  }
  for (int i = 0; i < 2; ++i)
  {
    const Vec a = v[i], b = v[i + 2];
    v[i] = __builtin_shufflevector(a, b, 0, 1, 4, 5);
    v[i + 2] = __builtin_shufflevector(a, b, 2, 3, 6, 7);
  }
#else
  for (int i = 0; i < 8; i += 2)
  {
    const Vec a = v[i], b = v[i + 1];
    v[i] = __builtin_shufflevector(a, b, 0, 8, 2, 10, 4, 12, 6, 14);
    v[i + 1] = __builtin_shufflevector(a, b, 1, 9, 3, 11, 5, 13, 7, 15);
  }
  for (int i = 0; i < 8; i += i % 2 ? 3 : 1)
  {
    const Vec a = v[i], b = v[i + 2];
    v[i] = __builtin_shufflevector(a, b, 0, 1, 8, 9, 4, 5, 12, 13);
    v[i + 2] = __builtin_shufflevector(a, b, 2, 3, 10, 11, 6, 7, 14, 15);
  }
  for (int i = 0; i < 4; ++i)
  {
    const Vec a = v[i], b = v[i + 4];
    v[i] = __builtin_shufflevector(a, b, 0, 1, 2, 3, 8, 9, 10, 11);
    v[i + 4] = __builtin_shufflevector(a, b, 4, 5, 6, 7, 12, 13, 14, 15);
  }
#endif
}

/** From one element a lane to one after the other: COUNT numbers each, `stride` apart. */
template <int COUNT>
inline void storeByElement(const Vec* values, double* out, long stride)
{
  static_assert(COUNT % WIDTH == 0, "whole registers");
  for (int at = 0; at < COUNT; at += WIDTH)
  {
    Vec v[WIDTH];
    for (int k = 0; k < WIDTH; ++k) v[k] = values[at + k];
    transpose(v);
    for (int k = 0; k < WIDTH; ++k) store(out + k * stride + at, v[k]);
  }
}

/** What an element's matrix is made of: its blocks (I,J), I <= J, row after row of the upper triangle. */
template <int NODES>
struct ElementMatrix
{
  static constexpr int PAIRS = NODES * (NODES + 1) / 2;
  static constexpr int STRIDE = (9 * PAIRS + LANES - 1) / LANES * LANES;  // whole cache lines

  static constexpr int pair(int I, int J) { return I * NODES - I * (I - 1) / 2 + J - I; }

  /** Integral of B_I B_J / V: products of binomials / 210, or (1 + delta_IJ)/20. */
  static constexpr double massWeight(int I, int J)
  {
    if (NODES == 4) return (I == J ? 2 : 1) / 20.0;
    int weight = 1;
    for (int c = 0; c < 4; ++c)
    {
      const int i = (ENDS[I][0] == c) + (ENDS[I][1] == c), j = (ENDS[J][0] == c) + (ENDS[J][1] == c);
      weight *= i + j == 4 ? 6 : i + j == 3 ? 3 : i * j == 1 ? 2 : 1;
    }
    return weight / 210.0;
  }
  struct MassWeights
  {
    double of[PAIRS] = {};
    constexpr MassWeights()
    {
      for (int I = 0; I < NODES; ++I)
      {
        for (int J = I; J < NODES; ++J) of[pair(I, J)] = massWeight(I, J);
      }
    }
  };
  static constexpr MassWeights MASS_WEIGHTS{};

  Vec values[STRIDE];

  void set(int p, const Vec (&m)[3][3], Vec mass)
  {
    for (int column = 0; column < 3; ++column)
    {
      for (int row = 0; row < 3; ++row)
      {
        values[9 * p + 3 * column + row] = row == column ? m[row][column] + MASS_WEIGHTS.of[p] * mass : m[row][column];
      }
    }
  }
  void clearPadding()
  {
    for (int k = 9 * PAIRS; k < STRIDE; ++k) values[k] = Vec{};
  }
};

inline Mat operator+(const Mat& a, const Mat& b)
{
  Mat r;
  for (int k = 0; k < 9; ++k) r.m[k / 3][k % 3] = a.m[k / 3][k % 3] + b.m[k / 3][k % 3];
  return r;
}
inline Mat twice(const Mat& a)
{
  return a + a;
}
inline Mat outer(const Vec3& a, const Vec3& b)
{
  return {{{a.x * b.x, a.x * b.y, a.x * b.z}, {a.y * b.x, a.y * b.y, a.y * b.z}, {a.z * b.x, a.z * b.y, a.z * b.z}}};
}

/** H_cd = lambda c d^T + mu d c^T + mu (c.d) 1 */
inline Mat gradientProduct(const Vec3& c, const Vec3& d, Vec lambda, Vec mu)
{
  const Vec dot = mu * (c.x * d.x + c.y * d.y + c.z * d.z);
  const Vec left[3] = {c.x, c.y, c.z}, right[3] = {d.x, d.y, d.z};
  Mat h;
  for (int i = 0; i < 3; ++i)
  {
    for (int j = 0; j < 3; ++j) h.m[i][j] = lambda * left[i] * right[j] + mu * right[i] * left[j];
    h.m[i][i] += dot;
  }
  return h;
}

template <int NODES, bool MEAN>
void elementMatrices(const Elements& elements, int begin, int end, const double* rotated, double alpha, double beta,
                     double* out)
{
  using Matrix = ElementMatrix<NODES>;
  Matrix matrix;
  matrix.clearPadding();
  // K_IJ in V/5: grad B_aa = 2 l_a g_a, grad B_ab = 2 (l_a g_b + l_b g_a), and the integral of l_a l_b is V/20, twice
  // that for a = b.
  const double scale = NODES == 4 ? beta : beta * 0.2;
  for (int block = begin; block < end; ++block)
  {
    for (int part = 0; part < LANES; part += WIDTH)
    {
      const double* c = elements.coefficients + 3L * block * LANES + part;
      const RotatedGradients g = loadGradients(rotated + 9L * block * LANES + part);
      Vec lambda = scale * load(c);
      const Vec mu = scale * load(c + LANES), mass = alpha * load(c + 2L * LANES);
      Vec3 mean[MEAN ? NODES : 1], weighted[MEAN ? NODES : 1];  // twice the basis functions' mean gradients
      if constexpr (MEAN)
      {
        const Vec part_of_lambda = load(elements.mean + static_cast<long>(block) * LANES + part);
        lambda -= scale * part_of_lambda;
        for (int a = 0; a < 4; ++a)
        {
          mean[a] = g.r[a];
          for (int b = a + 1; b < 4; ++b) mean[POINT[a][b]] = g.r[a] + g.r[b];
        }
        for (int I = 0; I < NODES; ++I) weighted[I] = 0.25 * beta * part_of_lambda * mean[I];
      }
      const auto set = [&](int I, int J, const Mat& m) {
        if constexpr (MEAN)
        {
          matrix.set(Matrix::pair(I, J), (m + outer(weighted[I], mean[J])).m, mass);
        }
        else
        {
          matrix.set(Matrix::pair(I, J), m.m, mass);
        }
      };
      Mat h[4][4];
      for (int a = 0; a < 4; ++a)
      {
        for (int b = 0; b < 4; ++b) h[a][b] = gradientProduct(g.r[a], g.r[b], lambda, mu);
      }
      for (int a = 0; a < 4; ++a)
      {
        set(a, a, NODES == 4 ? h[a][a] : twice(h[a][a]));
        for (int b = a + 1; b < 4; ++b) set(a, b, h[a][b]);
      }
      if constexpr (NODES == 10)
      {
        for (int a = 0; a < 4; ++a)
        {
          for (int b = 0; b < 4; ++b)
          {
            if (b == a) continue;
            const int ab = POINT[a][b];
            set(a, ab, twice(h[a][b]) + h[a][a]);
            if (a < b) set(ab, ab, twice(h[a][a] + h[b][b]) + (h[a][b] + h[b][a]));
            for (int d = b + 1; d < 4; ++d)
            {
              if (d == a) continue;
              set(a, POINT[b][d], h[a][b] + h[a][d]);
              set(ab, POINT[a][d], twice(h[b][d]) + h[a][a] + (h[b][a] + h[a][d]));
            }
          }
        }
        for (int b = 1; b < 4; ++b)
        {
          const int d = b == 1 ? 2 : 1, e = b == 3 ? 2 : 3;  // edges 0b and de
          set(POINT[0][b], POINT[d][e], (h[b][e] + h[b][d]) + (h[0][e] + h[0][d]));
        }
      }
      storeByElement<Matrix::STRIDE>(matrix.values, out + Matrix::STRIDE * (static_cast<long>(block) * LANES + part),
                                     Matrix::STRIDE);
    }
  }
}

template <int NODES>
void warpedMatrices(const Elements& elements, int begin, int end, const double* stiffness, const double* rotations,
                    double alpha, double beta, double* out)
{
  using Matrix = ElementMatrix<NODES>;
  Matrix matrix;
  matrix.clearPadding();
  for (int block = begin; block < end; ++block)
  {
    for (int part = 0; part < LANES; part += WIDTH)
    {
      const Mat r = loadMatrix(rotations + 9L * block * LANES + part);
      Mat scaled = r;
      for (auto& row : scaled.m)
      {
        for (Vec& v : row) v *= beta;
      }
      const Vec mass = alpha * load(elements.coefficients + (3L * block + 2) * LANES + part);
      for (int p = 0; p < Matrix::PAIRS; ++p)
      {
        const double* columns = stiffness + 9L * LANES * (static_cast<long>(block) * Matrix::PAIRS + p) + part;
        Mat k;
        for (int e = 0; e < 9; ++e) k.m[e % 3][e / 3] = load(columns + static_cast<long>(e) * LANES);
        const Mat t = scaled * k;
        Mat m;
        for (int i = 0; i < 3; ++i)
        {
          for (int j = 0; j < 3; ++j)
          {
            m.m[i][j] = t.m[i][0] * r.m[j][0] + t.m[i][1] * r.m[j][1] + t.m[i][2] * r.m[j][2];
          }
        }
        matrix.set(p, m.m, mass);
      }
      storeByElement<Matrix::STRIDE>(matrix.values, out + Matrix::STRIDE * (static_cast<long>(block) * LANES + part),
                                     Matrix::STRIDE);
    }
  }
}

/** The place of (i,j): the columns of a row are sorted. */
inline int find(const BlockRows& rows, int i, int j)
{
  const int* first = rows.column + rows.row_begin[i];
  int count = rows.row_begin[i + 1] - rows.row_begin[i];
  while (count > 1)
  {
    const int half = count / 2;
    first = first[half] <= j ? first + half : first;
    count -= half;
  }
  return static_cast<int>(first - rows.column);
}

inline void addPacked(double* p, const Block& b)
{
  storePacked(p, loadPacked(p) + b);
}

template <int NODES>
void addBySearch(const BlockRows& rows, int tets, const int* nodes, const double* matrices, double* blocks)
{
  using Matrix = ElementMatrix<NODES>;
  for (int t = 0; t < tets; ++t)
  {
    const int* n = nodes + static_cast<long>(NODES) * t;
    const double* p = matrices + static_cast<long>(Matrix::STRIDE) * t;
    for (int I = 0; I < NODES; ++I)
    {
      for (int J = I; J < NODES; ++J, p += 9)
      {
        const Block b = loadPacked(p);
        addPacked(blocks + 9L * find(rows, n[I], n[J]), b);
        if (I != J) addPacked(blocks + 9L * find(rows, n[J], n[I]), transpose(b));
      }
    }
  }
}

template <int NODES>
void addBySlots(int tets, const int* slots, const double* matrices, double* blocks)
{
  using Matrix = ElementMatrix<NODES>;
  for (int t = 0; t < tets; ++t)
  {
    const double* p = matrices + static_cast<long>(Matrix::STRIDE) * t;
    const int* s = slots + 2L * Matrix::PAIRS * t;
    for (int k = 0; k < Matrix::PAIRS; ++k, p += 9, s += 2)
    {
      const Block b = loadPacked(p);
      prefetchForWriting(blocks + 9L * s[2 * READ_AHEAD]);
      prefetchForWriting(blocks + 9L * s[2 * READ_AHEAD + 1]);
      addPacked(blocks + 9L * s[0], b);
      if (s[0] != s[1]) addPacked(blocks + 9L * s[1], transpose(b));
    }
  }
}

void gatherBlocks(const Contributions& list, int begin, int end, const double* matrices, double* blocks)
{
  const long* from = list.from + list.targets[begin].begin;
  for (int k = begin; k < end; ++k)
  {
    const auto& target = list.targets[k];
    prefetchForWriting(blocks + 9L * list.targets[k + READ_AHEAD].mirror);
    Block sum = {};
    const long* straight_end = list.from + target.turned;
    const long* turned_end = list.from + list.targets[k + 1].begin;
    for (; from < straight_end; ++from)
    {
      __builtin_prefetch(matrices + from[READ_AHEAD]);
      sum = sum + loadPacked(matrices + *from);
    }
    if (from < turned_end)
    {
      Block turned = {};
      for (; from < turned_end; ++from)
      {
        __builtin_prefetch(matrices + from[READ_AHEAD]);
        turned = turned + loadPacked(matrices + *from);
      }
      sum = sum + transpose(turned);
    }
    storePacked(blocks + 9L * target.slot, sum);
    if (target.mirror != target.slot) storePacked(blocks + 9L * target.mirror, transpose(sum));
  }
}

// Straight from rotated gradients. In an element's own order of its corners, by their node numbers, every edge and face
// runs the same way in all elements that have it, and no block is ever turned round.

/** Where an element has H_cd. */
constexpr int PRODUCT[4][4] = {{0, 12, 24, 36}, {12, 48, 60, 72}, {24, 60, 84, 96}, {36, 72, 96, 108}};

template <int NODES, bool MEAN>
void gradientProducts(const Elements& elements, int begin, int end, const double* corner_order, const double* rotated,
                      double alpha, double beta, double* out)
{
  constexpr int STRIDE = MEAN ? 2 * PRODUCTS_STRIDE : PRODUCTS_STRIDE;
  Vec values[STRIDE] = {};
  const double scale = NODES == 4 ? beta : beta * 0.2, mass_scale = NODES == 4 ? alpha / 20 : alpha / 210;
  for (int block = begin; block < end; ++block)
  {
    for (int part = 0; part < LANES; part += WIDTH)
    {
      const double* c = elements.coefficients + 3L * block * LANES + part;
      const RotatedGradients g = loadGradients(rotated + 9L * block * LANES + part);
      Vec lambda = scale * load(c), mean = Vec{};
      const Vec mu = scale * load(c + LANES), mass = mass_scale * load(c + 2L * LANES);
      if constexpr (MEAN)
      {
        mean = beta * load(elements.mean + static_cast<long>(block) * LANES + part);
        lambda -= 0.2 * mean;
        mean = 0.25 * mean;
      }
      RotatedGradients sorted;
      for (int a = 0; a < 4; ++a)
      {
        const Vec from = load(corner_order + (4L * block + a) * LANES + part);
        const auto pick = [&](Vec Vec3::*axis) {
          const Vec low = from == 0 ? g.r[0].*axis : g.r[1].*axis, high = from == 2 ? g.r[2].*axis : g.r[3].*axis;
          return from < 2 ? low : high;
        };
        sorted.r[a] = {pick(&Vec3::x), pick(&Vec3::y), pick(&Vec3::z)};
      }
      for (int a = 0; a < 4; ++a)
      {
        for (int b = a; b < 4; ++b)
        {
          Mat h = gradientProduct(sorted.r[a], sorted.r[b], lambda, mu);
          Vec* to = values + PRODUCT[a][b];
          if constexpr (MEAN)
          {
            for (int k = 0; k < 9; ++k) to[PRODUCTS_STRIDE + 4 * (k / 3) + k % 3] = h.m[k % 3][k / 3];
            h = h + outer(mean * sorted.r[a], sorted.r[b]);
          }
          for (int k = 0; k < 9; ++k) to[4 * (k / 3) + k % 3] = h.m[k % 3][k / 3];
          if (a == b) to[3] = mass;
        }
      }
      storeByElement<STRIDE>(values, out + STRIDE * (static_cast<long>(block) * LANES + part), STRIDE);
    }
  }
}

inline Block loadProduct(const double* element, int a, int b)
{
  const Node* p = reinterpret_cast<const Node*>(element + PRODUCT[a][b]);
  return {{p[0], p[1], p[2]}};
}
/** The mass that comes with a product H_aa, or a sum of them. */
inline double massOf(const Block& b)
{
  return b.c[0][3];
}
inline Block addMass(const Block& b, double mass)
{
  const Node x = {mass, 0, 0, 0}, y = {0, mass, 0, 0}, z = {0, 0, mass, 0};
  return {{b.c[0] + x, b.c[1] + y, b.c[2] + z}};
}
inline void storePair(double* blocks, const int* slots, const Block& b)
{
  storePacked(blocks + 9L * slots[0], b);
  storePacked(blocks + 9L * slots[1], transpose(b));
}

template <int NODES, bool MEAN>
void fuseBlocks(const MeshEntities& mesh, int begin, int end, const double* products, double* blocks)
{
  constexpr int EDGE[6][2] = {{0, 1}, {0, 2}, {0, 3}, {1, 2}, {1, 3}, {2, 3}};
  constexpr int FACE[4][3] = {{1, 2, 3}, {0, 2, 3}, {0, 1, 3}, {0, 1, 2}};
  // So many entities ahead, the blocks are fetched that will be written.
  constexpr int EDGES_AHEAD = 4, FACES_AHEAD = 3, TETS_AHEAD = 6;
  const auto willWrite = [&](const auto& slots) {
    for (const int slot : slots) prefetchForWriting(blocks + 9L * slot);
  };
  constexpr long STRIDE = MEAN ? 2 * PRODUCTS_STRIDE : PRODUCTS_STRIDE;
  const auto element = [&](int use) { return products + STRIDE * (use >> 3); };
  // Integrals of lambda_a^2 are twice those of lambda_a lambda_b: what is added again, `product` itself or, of a mean
  // dilatation, which has no such integrals, the product without it.
  const auto again = [&](const Block& product, const auto& without) -> Block {
    if constexpr (MEAN) return without(PRODUCTS_STRIDE);
    return product;
  };
  for (int chunk = begin; chunk < end; ++chunk)
  {
    const auto &from = mesh.chunks[chunk], &to = mesh.chunks[chunk + 1];
    for (int k = from.vertex; k < to.vertex; ++k)
    {
      const auto& vertex = mesh.vertices[k];
      const auto sum = [&](int offset) {
        Block aa = {};
        for (int u = vertex.begin; u < mesh.vertices[k + 1].begin; ++u)
        {
          aa = aa + loadProduct(element(mesh.uses[u]) + offset, mesh.uses[u] & 7, mesh.uses[u] & 7);
        }
        return aa;
      };
      const Block aa = sum(0);
      const double mass = massOf(aa);
      storePacked(blocks + 9L * vertex.slot,
                  NODES == 4 ? addMass(aa, 2 * mass) : addMass(aa + again(aa, sum), 6 * mass));
    }
    for (int k = from.edge; k < to.edge; ++k)
    {
      const auto& edge = mesh.edges[k];
      willWrite(mesh.edges[k + EDGES_AHEAD].slots);
      Block aa = {}, ab = {}, bb = {}, ab_again = {}, aa_bb_again = {};
      for (int u = edge.begin; u < mesh.edges[k + 1].begin; ++u)
      {
        const double* e = element(mesh.uses[u]);
        const int *ends = EDGE[mesh.uses[u] & 7], a = ends[0], b = ends[1];
        aa = aa + loadProduct(e, a, a);
        ab = ab + loadProduct(e, a, b);
        if (NODES == 10) bb = bb + loadProduct(e, b, b);
        if constexpr (MEAN)
        {
          e += PRODUCTS_STRIDE;
          ab_again = ab_again + loadProduct(e, a, b);
          aa_bb_again = aa_bb_again + (loadProduct(e, a, a) + loadProduct(e, b, b));
        }
      }
      const double mass = massOf(aa);
      storePair(blocks, edge.slots, addMass(ab, mass));
      if constexpr (NODES == 10)
      {
        const Block two_ab = ab + (MEAN ? ab_again : ab), aa_bb = aa + bb;
        storePair(blocks, edge.slots + 2, addMass(two_ab + aa, 3 * mass));
        storePair(blocks, edge.slots + 4, addMass(two_ab + bb, 3 * mass));
        const Block two_aa_bb = aa_bb + (MEAN ? aa_bb_again : aa_bb);
        storePacked(blocks + 9L * edge.slots[6], addMass(two_aa_bb + (ab + transpose(ab)), 4 * mass));
      }
    }
    if constexpr (NODES == 10)
    {
      for (int k = from.face; k < to.face; ++k)
      {
        const auto& face = mesh.faces[k];
        willWrite(mesh.faces[k + FACES_AHEAD].slots);
        const double *e = element(face.uses[0]), *f = element(face.uses[1]);
        const int *of_e = FACE[face.uses[0] & 7], *of_f = FACE[face.uses[1] & 7];
        const auto sum = [&](int a, int b, int offset = 0) {
          return loadProduct(e + offset, of_e[a], of_e[b]) + loadProduct(f + offset, of_f[a], of_f[b]);
        };
        const auto two = [&](const Block& product, int a, int b) {
          return product + again(product, [&](int offset) { return sum(a, b, offset); });
        };
        const Block aa = sum(0, 0), ab = sum(0, 1), ac = sum(0, 2), bb = sum(1, 1), bc = sum(1, 2), cc = sum(2, 2);
        const double mass = massOf(aa);
        const Block ba = transpose(ab), cb = transpose(bc);
        storePair(blocks, face.slots, addMass(ab + ac, mass));
        storePair(blocks, face.slots + 2, addMass(bc + ba, mass));
        storePair(blocks, face.slots + 4, addMass(bc + ac, mass));
        storePair(blocks, face.slots + 6, addMass(two(bc, 1, 2) + (ba + ac) + aa, 2 * mass));
        storePair(blocks, face.slots + 8, addMass(two(ac, 0, 2) + (ab + bc) + bb, 2 * mass));
        storePair(blocks, face.slots + 10, addMass(two(ab, 0, 1) + (cb + ac) + cc, 2 * mass));
      }
      for (int k = from.tet; k < to.tet; ++k)
      {
        const auto& tet = mesh.tets[k];
        willWrite(mesh.tets[k + TETS_AHEAD].slots);
        const double* e = products + STRIDE * tet.element;
        const double mass = massOf(loadProduct(e, 0, 0));
        const Block ab = loadProduct(e, 0, 1), ac = loadProduct(e, 0, 2), ad = loadProduct(e, 0, 3);
        const Block bc = loadProduct(e, 1, 2), bd = loadProduct(e, 1, 3), cd = loadProduct(e, 2, 3);
        const Block cb = transpose(bc);
        storePair(blocks, tet.slots, addMass((bd + bc) + (ad + ac), mass));
        storePair(blocks, tet.slots + 2, addMass((cd + cb) + (ad + ab), mass));
        storePair(blocks, tet.slots + 4, addMass(transpose(cd + bd) + (ac + ab), mass));
      }
    }
  }
}

void blockProduct(const BlockRows& rows, int begin, int end, const double* blocks, const double* x, double* y)
{
  constexpr int AHEAD = 320;  // doubles: as far as memory outside the second-level cache is away
  for (int i = begin; i < end; ++i)
  {
    Node a = {}, b = {}, c = {};
    for (int k = rows.row_begin[i]; k < rows.row_begin[i + 1]; ++k)
    {
      const double* p = blocks + 9L * k;
      __builtin_prefetch(p + AHEAD);
      __builtin_prefetch(p + AHEAD + 8);
      const Block block = loadPacked(p);
      const double* v = x + 4L * rows.column[k];
      a += v[0] * block.c[0];
      b += v[1] * block.c[1];
      c += v[2] * block.c[2];
    }
    const Node zero = {};
    *reinterpret_cast<Node*>(y + 4L * i) = __builtin_shufflevector(a + b + c, zero, 0, 1, 2, 7);
  }
}

void elementMatricesAny(const Elements& elements, int begin, int end, const double* rotated, double alpha, double beta,
                        double* out)
{
  const auto make = elements.nodes_per_tet == 4 ? elementMatrices<4, false>
                    : elements.mean             ? elementMatrices<10, true>
                                                : elementMatrices<10, false>;
  make(elements, begin, end, rotated, alpha, beta, out);
}

void warpedMatricesAny(const Elements& elements, int begin, int end, const double* stiffness, const double* rotations,
                       double alpha, double beta, double* out)
{
  (elements.nodes_per_tet == 4 ? warpedMatrices<4> : warpedMatrices<10>)(elements, begin, end, stiffness, rotations,
                                                                         alpha, beta, out);
}

void addBySearchAny(const BlockRows& rows, int nodes_per_tet, int tets, const int* nodes, const double* matrices,
                    double* blocks)
{
  (nodes_per_tet == 4 ? addBySearch<4> : addBySearch<10>)(rows, tets, nodes, matrices, blocks);
}

void addBySlotsAny(int nodes_per_tet, int tets, const int* slots, const double* matrices, double* blocks)
{
  (nodes_per_tet == 4 ? addBySlots<4> : addBySlots<10>)(tets, slots, matrices, blocks);
}

void gradientProductsAny(const Elements& elements, int begin, int end, const double* corner_order,
                         const double* rotated, double alpha, double beta, double* out)
{
  const auto make = elements.nodes_per_tet == 4 ? gradientProducts<4, false>
                    : elements.mean             ? gradientProducts<10, true>
                                                : gradientProducts<10, false>;
  make(elements, begin, end, corner_order, rotated, alpha, beta, out);
}

void fuseBlocksAny(const MeshEntities& mesh, int nodes_per_tet, bool mean, int begin, int end, const double* products,
                   double* blocks)
{
  const auto fuse = nodes_per_tet == 4 ? fuseBlocks<4, false> : mean ? fuseBlocks<10, true> : fuseBlocks<10, false>;
  fuse(mesh, begin, end, products, blocks);
}
}  // namespace
}  // namespace bezier_fem::kernels
