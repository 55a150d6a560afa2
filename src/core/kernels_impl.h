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
 * Calls run(block, part, in, give) for registers V of elements, of which in(k) reads what their nodes k have and
 * give(k, share) writes what they get. What a pair has in common is read by the first one, and written by the second
 * one for both, which spares three tenths of reading, of writing, and of summing up later.
 * @param reader  reader(block, part)(row) reads; rows from IN on are those of the next block
 * @param writer  writer(block, part)(row, share) writes; rows from OUT on are those of the next block
 */
template <class V, class Share, int IN, int OUT, class Reader, class Writer, class Run>
ALWAYS_INLINE void forEachRegister(const unsigned char* pairing, int begin, int end, const Reader& reader,
                                   const Writer& writer, const Run& run)
{
  for (long block = begin; block < end; block += pairing[block] == ALONE ? 1 : 2)
  {
    for (int part = 0; part < LANES; part += static_cast<int>(sizeof(V) / sizeof(std::declval<V&>()[0])))
    {
      const auto read = reader(block, part);
      const auto write = writer(block, part);
      if (pairing[block] == ALONE)
      {
        run(block, part, read, write);
        continue;
      }
      decltype(read(0)) common[IN];
      Share half[OUT];
      run(
          block, part,
          [&](int k) INLINED {
            const auto values = read(k);
            if (ACROSS[k] >= 0) common[k] = values;
            return values;
          },
          [&](int k, const Share& share) INLINED {
            if (ACROSS[k] >= 0)
            {
              half[k] = share;
            }
            else
            {
              write(k, share);
            }
          });
      run(
          block + 1, part, [&](int k) INLINED { return ACROSS[k] >= 0 ? common[ACROSS[k]] : read(IN + k); },
          [&](int k, const Share& share) INLINED {
            if (ACROSS[k] >= 0)
            {
              write(ACROSS[k], half[ACROSS[k]] + share);
            }
            else
            {
              write(OUT + k, share);
            }
          });
    }
  }
}

/**
 * The same where in(k) gathers the vectors of nodes k, and what they get are vectors.
 * @param list  [block][IN][LANES]: where the numbers of nodes, or of corners, begin
 */
template <class V, int IN, int OUT, class Scalar, class Run>
ALWAYS_INLINE void forEachElement(const unsigned char* pairing, const int* list, int begin, int end, const Scalar* x,
                                  Scalar* shares, const Run& run)
{
  forEachRegister<V, Vec3Of<V>, IN, OUT>(
      pairing, begin, end,
      [&](long block, int part) INLINED {
        const int* from = list + block * IN * LANES + part;
        return [x, from](int k) INLINED { return gather(x, from + static_cast<long>(k) * LANES); };
      },
      [&](long block, int part) INLINED {
        Scalar* to = shares + SHARES * OUT * block;
        return [to, part](int k, const Vec3Of<V>& f) INLINED { storeShares(to + SHARES * k, part, f); };
      },
      run);
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

#include "kernels_rotation_impl.h"

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

#include "kernels_diagonal_impl.h"

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
