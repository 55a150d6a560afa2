// What preconditions, in single precision, for kernels_impl.h, inside its unnamed namespace.

/**
 * Calls element(rotated, in, lambda, mu, mass, mean, give) for registers of elements, of which in(k) gathers the nodes
 * k, or the corners where IN is 4, and give(k, f) stores the shares of nodes k.
 */
template <int IN, bool MEAN, class Element>
ALWAYS_INLINE void forEachSingle(const SingleElements& e, int begin, int end, const float* x, float* shares,
                                 const Element& element)
{
  using V = SingleVec;
  forEachElement<V, IN, 10>(e.pairing, IN == 4 ? e.corner_gather : e.gather, begin, end, x, shares,
                            [&](long block, int part, const auto& in, const auto& give) INLINED {
                              const float* c = e.coefficients + 3 * block * LANES + part;
                              V mean = {};
                              if constexpr (MEAN) mean = load(e.mean + block * LANES + part);
                              element(e.rotated + 9 * block * LANES + part, in, load(c), load(c + LANES),
                                      load(c + 2L * LANES), mean, give);
                            });
}

template <bool MEAN, bool MASS>
void singleProduct(const SingleElements& elements, int begin, int end, const float* u, float* shares)
{
  using V = SingleVec;
  forEachSingle<10, MEAN>(
      elements, begin, end, u, shares,
      [](const float* g, const auto& in, V lambda, V mu, [[maybe_unused]] V mass, V mean, const auto& give) INLINED {
        if constexpr (MASS)
        {
          systemForce<10, 1, MEAN>(g, in, lambda, mu, mean, mass, give);
        }
        else
        {
          elasticForce<10, 1, MEAN>(g, in, 0, lambda, mu, mean, give);
        }
      });
}

void singleProductAny(const SingleElements& elements, int begin, int end, const float* u, float* shares)
{
  if (elements.mean)
  {
    (elements.mass ? singleProduct<true, true> : singleProduct<true, false>)(elements, begin, end, u, shares);
  }
  else
  {
    (elements.mass ? singleProduct<false, true> : singleProduct<false, false>)(elements, begin, end, u, shares);
  }
}

/** One stress for the whole element, V/2 of it for r_a at (a,a) and r_a + r_b at (a,b); of the mass V/60 (c_a + c_b +
 * sum of all c). */
template <bool MASS>
void prolongedProduct(const SingleElements& elements, int begin, int end, const float* corners, float* shares)
{
  using V = SingleVec;
  forEachSingle<4, false>(
      elements, begin, end, corners, shares,
      [](const float* rotated, const auto& in, V lambda, V mu, [[maybe_unused]] V mass, V /*mean*/,
         const auto& give) INLINED {
        const V half = all<V>(0.5);
        const auto g = loadGradients(rotated);
        V dilatation = {};
        const Vec3Of<V> c[4] = {in(0), in(1), in(2), in(3)};
        const SymOf<V> s = stress(g, c[1] - c[0], c[2] - c[0], c[3] - c[0], 0, half * lambda, half * mu, dilatation);
        Vec3Of<V> sum[4] = {s * g.r[0], s * g.r[1], s * g.r[2], s * g.r[3]};
        if constexpr (MASS)
        {
          const Vec3Of<V> half_total = half * (c[0] + c[1] + c[2] + c[3]);
          const V scale = mass * all<V>(1.0 / 60);
          unrolled<4>([&](auto a) INLINED {
            const Vec3Of<V> share = scale * (c[a] + half_total);
            sum[a] = sum[a] + share;
            give(a, sum[a] + share);
          });
        }
        else
        {
          unrolled<4>([&](auto a) INLINED { give(a, sum[a]); });
        }
        unrolled<6>([&](auto k) INLINED { give(4 + k, sum[ENDS[4 + k][0]] + sum[ENDS[4 + k][1]]); });
      });
}

void prolongedProductAny(const SingleElements& elements, int begin, int end, const float* corners, float* shares)
{
  (elements.mass ? prolongedProduct<true> : prolongedProduct<false>)(elements, begin, end, corners, shares);
}

/** B^-1 r of SINGLE_WIDTH / 4 nodes. @param inverse  three columns of each, INVERSE_GROUP nodes side by side */
ALWAYS_INLINE SingleVec timesInverse(const float* inverse, SingleVec r)
{
  constexpr int COLUMN = 4 * INVERSE_GROUP;
  return BY_FOURS(r, r, 0, 0, 0, 0) * load(inverse) + BY_FOURS(r, r, 1, 1, 1, 1) * load(inverse + COLUMN) +
         BY_FOURS(r, r, 2, 2, 2, 2) * load(inverse + 2L * COLUMN);
}

/** SINGLE_WIDTH / 4 nodes in a register. */
ALWAYS_INLINE SingleVec together(const SingleNode* nodes)
{
#if WIDTH == 8
  const auto low = __builtin_shufflevector(nodes[0], nodes[1], 0, 1, 2, 3, 4, 5, 6, 7);
  const auto high = __builtin_shufflevector(nodes[2], nodes[3], 0, 1, 2, 3, 4, 5, 6, 7);
  return __builtin_shufflevector(low, high, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
#elif WIDTH == 4
  return __builtin_shufflevector(nodes[0], nodes[1], 0, 1, 2, 3, 4, 5, 6, 7);
#else
  return nodes[0];
#endif
}

/** Calls f(first node, offset of inverses, sum of shares) for every SINGLE_WIDTH / 4 nodes. */
template <class F>
ALWAYS_INLINE void forEachSingleSum(const NodeShares& lists, int begin, int end, const float* shares, const F& f)
{
  forEachSum<SingleNode>(lists, begin, end, shares, [&](int i, const SingleNode* sum) INLINED {
    for (int k = 0; k < NODE_GROUP; k += SINGLE_WIDTH / 4) f(i + k, 12L * i + 4L * k, together(sum + k));
  });
}

/** The number of each of SINGLE_WIDTH / 4 nodes four times; `at` is the first one's offset of values. */
ALWAYS_INLINE SingleVec byNodes(const float* numbers, long at)
{
#if WIDTH == 8
  // In fewer steps GCC 12 takes it through memory.
  const SingleNode n = *reinterpret_cast<const SingleNode*>(numbers + at / 4);
  const auto two = __builtin_shufflevector(n, n, 0, 1, 2, 3, 0, 1, 2, 3);
  const SingleVec four = __builtin_shufflevector(two, two, 0, 1, 2, 3, 4, 5, 6, 7, 0, 1, 2, 3, 4, 5, 6, 7);
  return __builtin_shufflevector(four, four, 0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3);
#elif WIDTH == 4
  const float first = numbers[at / 4], second = numbers[at / 4 + 1];
  const SingleNode a = {first, first, first, first}, b = {second, second, second, second};
  return __builtin_shufflevector(a, b, 0, 1, 2, 3, 4, 5, 6, 7);
#else
  return SingleVec{} + numbers[at / 4];
#endif
}

void subtractShares(const NodeShares& lists, int begin, int end, const float* shares, float* r)
{
  forEachSingleSum(lists, begin, end, shares, [&](long node, long /*block*/, SingleVec sum) INLINED {
    store(r + 4 * node, load(r + 4 * node) - sum);
  });
}

void singleChebyshev(const NodeShares& lists, int begin, int end, float keep, float gain, const float* shares,
                     const float* inverse, const float* mass, float* r, float* d, float* z)
{
  const SingleVec k = SingleVec{} + keep, g = SingleVec{} + gain;
  forEachSingleSum(lists, begin, end, shares, [&](long node, long block, SingleVec sum) INLINED {
    const long at = 4 * node;
    const SingleVec res = load(r + at) - sum;
    // What a first term has nothing to keep of may be anything.
    SingleVec direction = g * timesInverse(inverse + block, res);
    if (keep != 0) direction += k * load(d + at);
    store(r + at, res - byNodes(mass, at) * direction);
    store(d + at, direction);
    store(z + at, load(z + at) + direction);
  });
}

void prolongedChebyshev(const NodeShares& lists, int begin, int end, float gain, const float* shares,
                        const float* inverse, const float* mass, const int* ends, const float* corners, float* r,
                        float* d, float* z)
{
  const SingleVec g = SingleVec{} + gain, half = all<SingleVec>(0.5);
  forEachSingleSum(lists, begin, end, shares, [&](long node, long block, SingleVec sum) INLINED {
    SingleNode twice[SINGLE_WIDTH / 4];
    unrolled<SINGLE_WIDTH / 4>([&](auto k) INLINED {
      twice[k] = loadNode(corners, ends[2 * (node + k)]) + loadNode(corners, ends[2 * (node + k) + 1]);
    });
    const long at = 4 * node;
    const SingleVec prolonged = half * together(twice), lumped = byNodes(mass, at);
    const SingleVec res = load(r + at) - sum - lumped * prolonged;
    const SingleVec direction = g * timesInverse(inverse + block, res);
    store(r + at, res - lumped * direction);
    store(d + at, direction);
    store(z + at, load(z + at) + prolonged + direction);
  });
}

/** Of products that came four numbers a node. */
inline float total(SingleVec v)
{
  float sum[4] = {};
  for (int k = 0; k < SINGLE_WIDTH; k += 4)
  {
    for (int c = 0; c < 4; ++c) sum[c] += v[k + c];
  }
  return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

double singleSum(const NodeShares& lists, int begin, int end, const float* shares, const float* p, float* q)
{
  SingleVec work = {};
  forEachSingleSum(lists, begin, end, shares, [&](long node, long /*block*/, SingleVec sum) INLINED {
    store(q + 4 * node, sum);
    work += sum * load(p + 4 * node);
  });
  return total(work);
}

/** Calls f(offset of values, offset of inverses) for every SINGLE_WIDTH / 4 nodes. */
template <class F>
ALWAYS_INLINE void forEachSingleNodes(int begin, int end, const F& f)
{
  for (int i = begin; i < end; i += NODE_GROUP)
  {
    for (int part = 0; part < 4 * NODE_GROUP; part += SINGLE_WIDTH) f(4L * i + part, 12L * i + part);
  }
}

double singleAdvance(int begin, int end, float a, float gain, const float* p, const float* q, const float* inverse,
                     const float* mass, float* x, float* r, float* s, float* d, float* z)
{
  SingleVec sum = {};
  const SingleVec length = SingleVec{} + a, g = SingleVec{} + gain;
  forEachSingleNodes(begin, end, [&](long at, long block) {
    store(x + at, load(x + at) + length * load(p + at));
    const SingleVec res = load(r + at) - length * load(q + at), pre = timesInverse(inverse + block, res);
    const SingleVec direction = g * pre;
    store(r + at, res);
    store(s + at, res - byNodes(mass, at) * direction);
    store(d + at, direction);
    store(z + at, direction);
    sum += res * pre;
  });
  return total(sum);
}

double singleDot(int begin, int end, const float* a, const float* b)
{
  SingleVec sum = {};
  forEachSingleNodes(begin, end, [&](long at, long /*block*/) { sum += load(a + at) * load(b + at); });
  return total(sum);
}

void singleRedirect(int begin, int end, float b, const float* z, float* p)
{
  const SingleVec keep = SingleVec{} + b;
  forEachSingleNodes(begin, end, [&](long at, long /*block*/) { store(p + at, load(z + at) + keep * load(p + at)); });
}

void rowsResidual(const SingleRows& rows, int begin, int end, const float* b, const float* x, float* r)
{
  constexpr int REGISTERS = 4 * NODE_GROUP / SINGLE_WIDTH;
  for (int i = begin; i < end; i += NODE_GROUP)
  {
    SingleVec sum[REGISTERS];
    for (int part = 0; part < REGISTERS; ++part) sum[part] = load(b + 4L * i + part * SINGLE_WIDTH);
    for (long step = rows.begin[i / NODE_GROUP]; step < rows.begin[i / NODE_GROUP + 1]; ++step)
    {
      const int* columns = rows.columns + NODE_GROUP * step;
      const float* blocks = rows.blocks + 12L * NODE_GROUP * step;
      for (int part = 0; part < REGISTERS; ++part)
      {
        SingleNode nodes[SINGLE_WIDTH / 4];
        unrolled<SINGLE_WIDTH / 4>([&](auto k)
                                       INLINED { nodes[k] = loadNode(x, columns[part * (SINGLE_WIDTH / 4) + k]); });
        sum[part] -= timesInverse(blocks + part * SINGLE_WIDTH, together(nodes));
      }
    }
    for (int part = 0; part < REGISTERS; ++part) store(r + 4L * i + part * SINGLE_WIDTH, sum[part]);
  }
}

void singleSmooth(int begin, int end, float keep, float gain, const float* inverse, const float* r, const float* d,
                  float* e, float* z)
{
  const SingleVec k = SingleVec{} + keep, g = SingleVec{} + gain;
  forEachSingleNodes(begin, end, [&](long at, long block) {
    SingleVec direction = g * timesInverse(inverse + block, load(r + at));
    if (keep != 0) direction += k * load(d + at);
    store(e + at, direction);
    store(z + at, load(z + at) + direction);
  });
}

/** N registers of y = L x from row i on. */
template <int N>
ALWAYS_INLINE void panelRows(int rows, int columns, const float* panel, const float* x, int i, float* y)
{
  SingleVec even[N] = {}, odd[N] = {};
  const float* p = panel + i;
  int j = 0;
  // Registers above the diagonal are left out.
#pragma GCC unroll 4
  for (int first = 0; first < N; ++first)
  {
    const int diagonal = i + (first + 1) * SINGLE_WIDTH, last = columns < diagonal ? columns : diagonal;
    for (; j + 1 < last; j += 2, p += 2L * rows)
    {
      const SingleVec a = SingleVec{} + x[j], b = SingleVec{} + x[j + 1];
      for (int k = first; k < N; ++k)
      {
        even[k] += a * load(p + static_cast<long>(k) * SINGLE_WIDTH);
        odd[k] += b * load(p + rows + static_cast<long>(k) * SINGLE_WIDTH);
      }
    }
    if (j < last)
    {
      const SingleVec a = SingleVec{} + x[j];
      for (int k = first; k < N; ++k) even[k] += a * load(p + static_cast<long>(k) * SINGLE_WIDTH);
      ++j;
      p += rows;
    }
  }
  for (int k = 0; k < N; ++k) store(y + i + static_cast<long>(k) * SINGLE_WIDTH, even[k] + odd[k]);
}

/** y = L x, L of `rows` x `columns`, by columns, rows whole registers. */
void panelProduct(int rows, int columns, const float* panel, const float* x, float* y)
{
  int i = 0;
  for (; i + 4 * SINGLE_WIDTH <= rows; i += 4 * SINGLE_WIDTH) panelRows<4>(rows, columns, panel, x, i, y);
  const int left = (rows - i) / SINGLE_WIDTH;
  if (left == 3) panelRows<3>(rows, columns, panel, x, i, y);
  if (left == 2) panelRows<2>(rows, columns, panel, x, i, y);
  if (left == 1) panelRows<1>(rows, columns, panel, x, i, y);
}

/** The sums of the numbers of each. */
ALWAYS_INLINE SingleNode totals(SingleVec a, SingleVec b, SingleVec c, SingleVec d)
{
  const SingleVec ab = BY_FOURS(a, b, 0, 4, 1, 5) + BY_FOURS(a, b, 2, 6, 3, 7);
  const SingleVec cd = BY_FOURS(c, d, 0, 4, 1, 5) + BY_FOURS(c, d, 2, 6, 3, 7);
  const SingleVec sum = BY_FOURS(ab, cd, 0, 1, 4, 5) + BY_FOURS(ab, cd, 2, 3, 6, 7);
#if WIDTH == 2
  return sum;
#elif WIDTH == 4
  return __builtin_shufflevector(sum, sum, 0, 1, 2, 3) + __builtin_shufflevector(sum, sum, 4, 5, 6, 7);
#else
  const auto half = __builtin_shufflevector(sum, sum, 0, 1, 2, 3, 4, 5, 6, 7) +
                    __builtin_shufflevector(sum, sum, 8, 9, 10, 11, 12, 13, 14, 15);
  return __builtin_shufflevector(half, half, 0, 1, 2, 3) + __builtin_shufflevector(half, half, 4, 5, 6, 7);
#endif
}

/** N numbers of y = L^T x from column j on, a multiple of 4. */
template <int N>
ALWAYS_INLINE void panelColumns(int rows, const float* panel, const float* x, int j, float* y)
{
  SingleVec sum[4];
  for (SingleVec& each : sum) each = zeros<SingleVec>();
  const float* p = panel + static_cast<long>(j) * rows;
  // Registers above the diagonal are left out.
  for (int i = j - j % SINGLE_WIDTH; i < rows; i += SINGLE_WIDTH)
  {
    const SingleVec v = load(x + i);
    for (int k = 0; k < N; ++k) sum[k] += v * load(p + static_cast<long>(k) * rows + i);
  }
  const SingleNode made = totals(sum[0], sum[1], sum[2], sum[3]);
  for (int k = 0; k < N; ++k) y[j + k] = made[k];
}

/** y = L^T x */
void panelTransposeProduct(int rows, int columns, const float* panel, const float* x, float* y)
{
  int j = 0;
  for (; j + 4 <= columns; j += 4) panelColumns<4>(rows, panel, x, j, y);
  if (columns - j == 3) panelColumns<3>(rows, panel, x, j, y);
  if (columns - j == 2) panelColumns<2>(rows, panel, x, j, y);
  if (columns - j == 1) panelColumns<1>(rows, panel, x, j, y);
}
