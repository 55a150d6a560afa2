// What each kernel takes of what the processor can do: its time beside the time that its arithmetic would take at the
// peak rate of multiply-adds and its data at the bandwidth of a triad of the same size, or of a read where that is
// faster, whichever is longer (Williams, Waterman, Patterson 2009, "Roofline"). All measured in the same run, on one
// thread, with the kernels' instruction set; and in products of an assembled matrix of the same model (yardstick.h).

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>
#include <functional>
#include <iostream>
#include <memory>
#include <utility>

#include "bezier_fem/assembled_matrix.h"
#include "bezier_fem/element_operator.h"
#include "bezier_fem/simulation.h"
#include "kernels.h"
#include "peak.h"
#include "sparse_cholesky.h"
#include "yardstick.h"

namespace
{
using namespace bezier_fem;

/** The shortest of several runs, ms: what the machine can do, undisturbed. */
double shortest(int runs, const std::function<void()>& run)
{
  double least = 1e300;
  for (int k = 0; k < runs; ++k)
  {
    const double start = milliseconds();
    run();
    least = std::min(least, milliseconds() - start);
  }
  return least;
}

class Machine
{
public:
  explicit Machine(const Peak& peak)
  {
    constexpr long ROUNDS = 1000000;
    volatile double sink = 0;
    gflops_double_ = 1e-6 * ROUNDS * peak.flops_double / shortest(21, [&]() { sink = peak.rounds_double(ROUNDS); });
    gflops_single_ = 1e-6 * ROUNDS * peak.flops_single / shortest(21, [&]() { sink = peak.rounds_single(ROUNDS); });

    constexpr std::size_t LEAST = 1 << 15, MOST = 1 << 28;
    for (std::size_t bytes = LEAST; bytes <= MOST; bytes *= 2)
    {
      const std::size_t size = bytes / (3 * sizeof(double)) / 8 * 8;
      AlignedVector<double> a(size), b(size, 1.0), c(size, 2.0);
      const int passes = static_cast<int>(std::max<std::size_t>(1, MOST / 8 / bytes));
      const double ms = shortest(9, [&]() {
        for (int k = 0; k < passes; ++k) peak.triad(size, 0.5, b.data(), c.data(), a.data());
      });
      volatile double sum = 0;
      const double read_ms = shortest(9, [&]() {
        for (int k = 0; k < passes; ++k)
          sum = peak.read(size, a.data()) + peak.read(size, b.data()) + peak.read(size, c.data());
      });
      const double moved = 3.0 * sizeof(double) * static_cast<double>(size);
      bandwidth_.push_back({moved, 1e-6 * moved * passes / ms, 1e-6 * moved * passes / read_ms});
    }
  }

  double gflops(bool single) const { return single ? gflops_single_ : gflops_double_; }
  /** GB/s where that many bytes are gone through again and again: of a triad or of a read, the faster one. */
  double bandwidth(double bytes) const
  {
    if (bytes <= bandwidth_.front().bytes) return bandwidth_.front().most();
    for (std::size_t k = 1; k < bandwidth_.size(); ++k)
    {
      const Bandwidth &before = bandwidth_[k - 1], &here = bandwidth_[k];
      if (bytes > here.bytes) continue;
      return before.most() +
             (here.most() - before.most()) * std::log(bytes / before.bytes) / std::log(here.bytes / before.bytes);
    }
    return bandwidth_.back().most();
  }
  void print() const
  {
    std::printf(
        "| peak | |\n|---|---|\n| multiply-add, double | %.1f GFlop/s |\n| multiply-add, single | %.1f GFlop/s |\n",
        gflops_double_, gflops_single_);
    for (const Bandwidth& of : bandwidth_)
    {
      std::printf("| triad, %.0f kB | %.1f GB/s |\n| read, %.0f kB | %.1f GB/s |\n", of.bytes / 1e3, of.triad,
                  of.bytes / 1e3, of.read);
    }
    std::printf("\n");
  }

private:
  struct Bandwidth
  {
    double bytes, triad, read;  // GB/s
    double most() const { return std::max(triad, read); }
  };
  double gflops_double_, gflops_single_;
  std::vector<Bandwidth> bandwidth_;  // sizes ascending
};

struct Kernel
{
  std::string name;
  bool single;
  /**
   * Additions, multiplications, divisions and roots of numbers that count, not of padding, as the formulas are written;
   * what a compiler finds twice is counted once.
   */
  double flops;
  /**
   * What every loop of it goes through, each place once, whether it is read, written or both: as STREAM counts the
   * triad's three arrays.
   */
  double bytes;
  /** Of these, what an earlier loop of it went through. */
  double again;
  std::function<void()> run;
};

// Floating-point operations ----------------------------------------------------------------------------------------
// Of 3-vectors a sum is 3, a product with a symmetric matrix 9 + 6 = 15.

/** Rotated gradient of corner 0: minus the sum of the others. */
constexpr int GRADIENT_0 = 6;
/**
 * Stress at a corner: three edges (9), three normal strains (3 x 5), three shears (3 x 11), trace (2), pressure (1),
 * normal stresses (3 x 2), shear stresses (3).
 */
constexpr int STRESS = 9 + 15 + 33 + 2 + 1 + 6 + 3;
/** lambda/5, mu/5, 2 mu, four stresses, their sum, which goes to each of them: symmetric matrices of 6 numbers. */
constexpr int STRESSES = 3 + 4 * STRESS + 3 * 6 + 4 * 6;
/**
 * q_a r_b of four corners a and three b, of which corners 1, 2, 3 take q_a r_a; corner 0 minus the sum of three; its
 * edges one less the sum of three; the other edges q_a r_b + q_b r_a. Rotated gradients of corner 0 are not needed.
 */
constexpr int FORCES = 4 * 3 * 15 + 6 + 3 * 9 + 3 * 3;
/** t_a of five nodes each; half their sum; that and t_a; for ten nodes t_b and u_ab added, scaled, added to the force.
 */
constexpr int MASS = 4 * 4 * 3 + (9 + 3) + 4 * 3 + 10 * (3 + 3 + 3 + 3);
/**
 * Ten shares are added to the sums of their nodes: six of two elements that share a face to each other first, where
 * elements are gone through.
 */
constexpr int SCATTER = 10 * 3;
/** Nodes that the two elements of a pair have in common, and corners among them (kernels.h, Pairing). */
constexpr int COMMON = 6, COMMON_CORNERS = 3;
/** 1/210 to the coefficient */
constexpr int SINGLE_PRODUCT = 1 + STRESSES + FORCES + MASS;
/** The mass is left to the nodes, where there are 3 + 3 operations more. */
constexpr int SMOOTHED_PRODUCT = SINGLE_PRODUCT - 1 - MASS;
/** alpha and beta to the coefficients */
constexpr int PRODUCT = 3 + SINGLE_PRODUCT + SCATTER;
/** 1/2 to lambda and mu, 2 mu, a stress and its forces on four corners; six sums of two. Of the mass as above. */
constexpr int PROLONGED_PRODUCT = 2 + 1 + GRADIENT_0 + STRESS + 4 * 15 + 6 * 3;
/** Of a node: B^-1 r. */
constexpr int INVERSE_PRODUCT = 15;
/** Six cofactors of 3 each, the determinant, a division, six products, and m^2 times the trace. */
constexpr int INVERSION = 6 * 3 + 5 + 1 + 6 + 5;
/** With the identity taken from the normal strains. */
constexpr int FORCE = STRESSES + 4 * 3 + FORCES + SCATTER;

/** H_cd + H_dc: dot product and 2 mu (6), diagonal (3 x 3), the rest (3 x 4). */
constexpr int SYMMETRIC_H = 6 + 9 + 12;
/**
 * beta, alpha, 1/35 and 2/105, sums of lambda and mu; four H_aa; a fifth of them at corners; at edges a fifth of the
 * sum of two and an H_ab; of the mass to diagonals; ten blocks added to the sums of their nodes. Of a node there are 6
 * operations more, in double precision: its block takes its units again.
 */
constexpr int DIAGONAL = 5 + 3 + GRADIENT_0 + 4 * SYMMETRIC_H + 4 * 6 + 6 * (SYMMETRIC_H + 3 * 6) + 10 * 3 + 10 * 6;

/**
 * Three edges, F (9 x 5), F^T F (6 x 5), cof F (9 x 3), det F, |F|^2, 2 det F and 4 of it, |cof F|^2, a root and a
 * product; two steps of Halley's method: value 5, slope 2, correction 10, size 2; slope 4, margin 2, scaling 4, the
 * symmetric factor 9, R (9 x 7), how far it turned (9 x 3), three rotated gradients (9 x 5).
 */
constexpr int ROTATION = 9 + 45 + 30 + 27 + 5 + 2 + 2 + 12 + 2 + 2 * (5 + 2 + 10 + 2) + 4 + 2 + 4 + 9 + 63 + 27 + 45;

// ------------------------------------------------------------------------------------------------------------------

/** The factor of the system of linear elements on the same tetrahedra, at rest. */
class Factor
{
public:
  Factor(const std::string& file, std::vector<std::string> overrides)
  {
    overrides.emplace_back("element=linear");
    const Simulation simulation(loadScene(file, overrides), 1, [](const std::string&) {});
    const Model& model = simulation.model();
    const double dt = simulation.scene().time_step;
    AssembledMatrix A(model);
    FusedAssembler(model, A).assemble(model, Partition(model, 1), restRotations(model), 1, dt * dt, A);
    cholesky_ = std::make_unique<SparseCholesky>(A, model.rest);
    if (!cholesky_->factor(A)) throw std::runtime_error(file + ": cannot be factored");
    rows_ = A.rows();
    takeRows(A);
  }
  double numbers() const { return static_cast<double>(cholesky_->size()); }
  double vertices() const { return rows_; }
  void solve() { cholesky_->solve(right_.data(), left_.data()); }

  // The same matrix by groups of rows, as where it is too large to be factored; with those that fill up a group
  double blocks() const { return static_cast<double>(columns_.size()); }
  void residual()
  {
    kernels::table().rows_residual({steps_.data(), columns_.data(), blocks_.data()}, 0, rows_, right_.data(),
                                   of_rows_.data(), left_.data());
  }
  /** A term of the smoother beside it. */
  void smooth()
  {
    kernels::table().single_smooth(0, rows_, 0.5f, 0.5f, inverse_.data(), right_.data(), of_rows_.data(), left_.data(),
                                   sum_.data());
  }

private:
  void takeRows(const AssembledMatrix& A)
  {
    constexpr int GROUP = kernels::INVERSE_GROUP;
    const auto begin = [&](int i) { return A.rowBegin()[std::min(i, A.rows())]; };
    steps_.push_back(0);
    for (int i = 0; i < A.rows(); i += GROUP)
    {
      int most = 0;
      for (int k = i; k < i + GROUP; ++k) most = std::max(most, begin(k + 1) - begin(k));
      for (int step = 0; step < most; ++step)
      {
        for (int k = i; k < i + GROUP; ++k)
        {
          columns_.push_back(begin(k) + step < begin(k + 1) ? A.column()[begin(k) + step] : i);
        }
      }
      steps_.push_back(steps_.back() + most);
    }
    blocks_.assign(12 * columns_.size(), 1e-3f);
    inverse_.assign(12 * GROUP * (steps_.size() - 1), 0.1f);
    of_rows_.assign(4 * GROUP * (steps_.size() - 1), 1.0f);
    sum_ = right_ = left_ = of_rows_;
  }

  std::unique_ptr<SparseCholesky> cholesky_;
  AlignedVector<float> right_, left_;
  int rows_ = 0;
  std::vector<int> steps_, columns_;
  AlignedVector<float> blocks_, inverse_, of_rows_, sum_;
};

/** Panels like those of a factor's large supernodes, of as many numbers as the factor has. */
class Panels
{
public:
  static constexpr int ROWS = 240, COLUMNS = 48;
  explicit Panels(double numbers)
      : count_(std::max(1, static_cast<int>(numbers / (ROWS * COLUMNS)))),
        values_(static_cast<std::size_t>(count_) * ROWS * COLUMNS, 1e-3f),
        long_(ROWS, 1.0f),
        short_(COLUMNS, 1.0f)
  {
  }
  /** Without the registers above the diagonal, which are left out. */
  double numbers() const
  {
    static_assert(COLUMNS % LANES == 0);
    return static_cast<double>(count_) * (ROWS * COLUMNS - COLUMNS * (COLUMNS - LANES) / 2);
  }
  void product()
  {
    for (int k = 0; k < count_; ++k)
      kernels::table().panel_product(ROWS, COLUMNS, panel(k), short_.data(), long_.data());
  }
  void transposeProduct()
  {
    for (int k = 0; k < count_; ++k)
      kernels::table().panel_transpose_product(ROWS, COLUMNS, panel(k), long_.data(), short_.data());
  }

private:
  const float* panel(int k) const { return values_.data() + static_cast<std::ptrdiff_t>(k) * ROWS * COLUMNS; }
  int count_;
  AlignedVector<float> values_, long_, short_;
};

/** What the kernels in single precision work on, for a model of quadratic elements; values of the size of 1. */
struct SingleData
{
  SingleData(const Model& model, const Rotations& rotations, double alpha, double beta)
      : rotated(rotations.gradients.begin(), rotations.gradients.end()),
        shares(kernels::SHARES * (kernels::ZERO_ROWS + static_cast<std::size_t>(model.num_blocks) * QUADRATIC_NODES))
  {
    constexpr std::size_t GROUP = kernels::NODE_GROUP;
    const std::size_t nodes = (static_cast<std::size_t>(model.num_nodes) + GROUP - 1) / GROUP * GROUP;
    for (AlignedVector<float>* field : {&x, &r, &s, &p, &q, &d, &z}) field->assign(4 * nodes, 1.0f);
    inverse.assign(12 * nodes, 0.1f);
    for (std::size_t k = 0; k < model.block_coefficients.size(); ++k)
    {
      coefficients.push_back(static_cast<float>((k / LANES % 3 == 2 ? alpha : beta) * model.block_coefficients[k]));
    }
    std::vector<int> vertex(model.num_nodes, -1);
    for (int i = 0; i < model.num_nodes; ++i)
    {
      if (model.ends[i][0] == model.ends[i][1]) vertex[i] = vertices++;
    }
    for (const auto& [a, b] : model.ends)
    {
      ends.push_back(vertex[model.node_of_corner[a]]);
      ends.push_back(vertex[model.node_of_corner[b]]);
    }
    ends.resize(2 * nodes);
    for (int block = 0; block < model.num_blocks; ++block)
    {
      const int* of = model.block_offsets.data() + static_cast<std::ptrdiff_t>(block) * QUADRATIC_NODES * LANES;
      for (int k = 0; k < CORNERS * LANES; ++k) corner_gather.push_back(4 * vertex[of[k] / 4]);
    }
    elements = {model.block_offsets.data(),
                corner_gather.data(),
                model.block_pairing.data(),
                rotated.data(),
                coefficients.data(),
                nullptr,
                true};
    smoothed = elements;
    smoothed.mass = false;
    mass.assign(nodes, 1e-3f);
  }
  float* elementShares() { return shares.data() + kernels::ZERO_ROWS * kernels::SHARES; }

  int vertices = 0;
  AlignedVector<float> rotated, coefficients, shares, inverse, mass, x, r, s, p, q, d, z;
  AlignedVector<int> corner_gather, ends;
  kernels::SingleElements elements, smoothed;  // with the mass, and with the mass left to the nodes
};

void bench(const std::string& file, const std::vector<std::string>& overrides, const Machine& machine)
{
  constexpr int STEPS = 10, RUNS = 31;
  Simulation simulation(loadScene(file, overrides), 1, [](const std::string&) {});
  const Model& model = simulation.model();
  if (!model.quadratic() || !model.block_mean.empty())
  {
    throw std::runtime_error(file + ": what is counted is the quadratic element with all of its dilatation at points");
  }
  const double dt = simulation.scene().time_step;
  const Partition partition(model, 1);
  for (int k = 0; k < STEPS; ++k) simulation.step();
  const NodalField& x = simulation.state().x;
  const Rotations before = restRotations(model);
  Rotations rotations = before;
  AlignedVector<double> turned(rotations.flags.size());
  AssembledMatrix A(model);
  FusedAssembler(model, A).assemble(model, partition, before, 1, dt * dt, A);
  Yardstick yardstick(A);

  NodalField u(model.num_nodes), v(model.num_nodes), p(model.num_nodes), q(model.num_nodes), z(model.num_nodes);
  for (int i = 0; i < model.num_nodes; ++i) u[i].setConstant(std::sin(i));
  AlignedVector<double> diagonal(static_cast<std::size_t>(kernels::DIAGONAL_STRIDE) * model.num_nodes);
  systemDiagonal(model, partition, rotations, 1, dt * dt, diagonal);
  AlignedVector<double> inverse(diagonal.size()), inverted = diagonal;
  const std::vector<unsigned char> held(model.num_nodes, 0);
  bool definite = true;
  const kernels::Table& table = kernels::table();
  SingleData single(model, before, 1e-3, 1e-3 * dt * dt);  // small, lest kernels that feed each other overflow
  Factor factor(file, overrides);
  Panels panels(factor.numbers());
  const kernels::NodeShares lists{model.share_begin.data(), model.share_slots.data()};
  const auto first = std::count(model.block_pairing.begin(), model.block_pairing.end(), kernels::FIRST);
  const kernels::BlockRows rows{A.rowBegin().data(), A.column().data()};

  const double tets = model.num_tets, nodes = model.num_nodes, blocks = static_cast<double>(A.column().size());
  const double vertices = single.vertices;
  // Bytes of a number, an index, a padded vector of a node and the three gradients of an element
  constexpr double NUMBER = sizeof(double), INDEX = sizeof(int), NODE = 4 * NUMBER, MATRIX = 9 * NUMBER;
  constexpr double BLOCK = kernels::DIAGONAL_STRIDE * NUMBER;
  constexpr double HALF = 0.5;  // of all but indices, in single precision
  // Of what the two elements of a pair have in common, the kernels read once where it is, and once what is there; they
  // add up the shares of it, and store one, which is in the lists once.
  const double pairs = static_cast<double>(LANES * first), joined = pairs * COMMON * 3;
  const double stored = tets * 10 - pairs * COMMON, corners = tets * 4 - pairs * COMMON_CORNERS;
  // Of all elements: coefficients and gradients. Their shares, which are written and read. Where to read and, node by
  // node, where shares are: an index a share each.
  const double numbers = tets * (3 * NUMBER + MATRIX), shares = stored * NODE, slots = stored * INDEX;
  const double elements = numbers + 2 * slots;
  const double single_numbers = HALF * numbers, no_mass = HALF * tets * NUMBER, single_shares = HALF * shares;
  const double values = HALF * nodes * NODE, inverses = HALF * nodes * 12 * NUMBER;
  const double factored = factor.numbers() * HALF * NUMBER, sides = factor.vertices() * HALF * NODE;
  const int count = model.num_nodes;
  double sink = 0;
  const std::vector<Kernel> all = {
      {"rotations", false, tets * ROTATION, tets * (4 * INDEX + 4 * MATRIX + NUMBER + 2) + vertices * NODE, 0,
       [&]() { updateRotations(model, partition, x, before, rotations, turned); }},
      {"product", false, tets * PRODUCT, elements + 2 * shares + nodes * 2 * NODE, shares,
       [&]() { systemProduct(model, partition, rotations, 1, dt * dt, u, v); }},
      {"elastic force", false, tets * FORCE, elements - tets * NUMBER + 2 * shares + nodes * 2 * NODE, shares,
       [&]() { elasticForce(model, partition, rotations, x, v); }},
      // Shares have twice as many numbers, in single precision.
      {"block diagonal", true, tets * DIAGONAL + nodes * 6, numbers + slots + 2 * shares + nodes * BLOCK, shares,
       [&]() { systemDiagonal(model, partition, rotations, 1, dt * dt, diagonal); }},
      {"assembled product", false, blocks * 18, blocks * (MATRIX + INDEX) + nodes * (INDEX + 2 * NODE), 0,
       [&]() { table.block_product(rows, 0, A.rows(), A.blocks().data(), u.data(), v.data()); }},
      // In place: blocks and their inverses by turns.
      {"inverses of the diagonal blocks", false, nodes * INVERSION, nodes * (BLOCK + NUMBER + 1), 0,
       [&]() {
         sink += table.invert_blocks(0, count, held.data(), model.node_mass.data(), inverted.data(), &definite);
       }},
      {"conjugate gradients: residual", false, nodes * (3 + INVERSE_PRODUCT + 6), nodes * (3 * NODE + BLOCK), 0,
       [&]() { sink += table.residual(0, count, p.data(), q.data(), inverse.data(), z.data()); }},
      {"conjugate gradients: norm", false, nodes * (INVERSE_PRODUCT + 6), nodes * (NODE + BLOCK), 0,
       [&]() { sink += table.norm2(0, count, inverse.data(), u.data()); }},
      // x += a p, r -= a q, z = B^-1 r, r.z
      {"conjugate gradients: advance", false, nodes * (6 + 6 + INVERSE_PRODUCT + 6), nodes * (5 * NODE + BLOCK), 0,
       [&]() {
         sink += table.advance(0, count, 1e-3, p.data(), q.data(), inverse.data(), z.data(), u.data(), v.data());
       }},
      {"conjugate gradients: redirect", false, nodes * 6, nodes * 2 * NODE, 0,
       [&]() { table.redirect(0, count, 0.5, z.data(), p.data()); }},
      {"conjugate gradients: dot", false, nodes * 6, nodes * 2 * NODE, 0,
       [&]() { sink += table.dot(0, count, u.data(), z.data()); }},
      // What the multigrid is made of. Its product has p.q with the sums, as its conjugate gradients take it.
      {"product", true, tets * (SINGLE_PRODUCT + SCATTER) + nodes * 6,
       single_numbers + 2 * slots + 2 * single_shares + 3 * values, single_shares + values,
       [&]() {
         table.single_product(single.elements, 0, model.num_blocks, single.p.data(), single.elementShares());
         sink += table.single_sum(lists, 0, count, single.shares.data(), single.p.data(), single.q.data());
       }},
      {"product: shares", true, tets * SINGLE_PRODUCT + joined, single_numbers + slots + single_shares + values, 0,
       [&]() { table.single_product(single.elements, 0, model.num_blocks, single.p.data(), single.elementShares()); }},
      {"smoother's product: shares", true, tets * SMOOTHED_PRODUCT + joined,
       single_numbers - no_mass + slots + single_shares + values, 0,
       [&]() { table.single_product(single.smoothed, 0, model.num_blocks, single.p.data(), single.elementShares()); }},
      {"product: sums and p.q", true, tets * SCATTER - joined + nodes * 6, slots + single_shares + 2 * values, 0,
       [&]() { sink += table.single_sum(lists, 0, count, single.shares.data(), single.p.data(), single.q.data()); }},
      {"prolonged product: shares", true, tets * PROLONGED_PRODUCT + joined,
       single_numbers - no_mass + corners * INDEX + single_shares + HALF * vertices * NODE, 0,
       [&]() {
         table.prolonged_product(single.smoothed, 0, model.num_blocks, single.p.data(), single.elementShares());
       }},
      {"subtracted sums", true, tets * SCATTER - joined + nodes * 3, slots + single_shares + values, 0,
       [&]() { table.subtract_shares(lists, 0, count, single.shares.data(), single.r.data()); }},
      // r -= the sums, d = keep d + gain B^-1 r, z += d, r -= mass d
      {"sums and Chebyshev's term", true, tets * SCATTER - joined + nodes * (3 + INVERSE_PRODUCT + 3 + 6 + 3 + 6),
       slots + single_shares + 3 * values + inverses + HALF * nodes * NUMBER, 0,
       [&]() {
         table.single_chebyshev(lists, 0, count, 0.5f, 0.5f, single.shares.data(), single.inverse.data(),
                                single.mass.data(), single.r.data(), single.d.data(), single.z.data());
       }},
      // With v, half the sum of two vertices: r -= the sums + mass v, d = gain B^-1 r, z += v + d, r -= mass d
      {"sums, prolongation and first term", true,
       tets * SCATTER - joined + nodes * (6 + 9 + INVERSE_PRODUCT + 3 + 6 + 6),
       slots + single_shares + 3 * values + inverses + nodes * (2 * INDEX + HALF * NUMBER) + HALF * vertices * NODE, 0,
       [&]() {
         table.prolonged_chebyshev(lists, 0, count, 0.5f, single.shares.data(), single.inverse.data(),
                                   single.mass.data(), single.ends.data(), single.x.data(), single.r.data(),
                                   single.d.data(), single.z.data());
       }},
      // x += a p, r -= a q, d = z = gain B^-1 r, s = r - mass d, r.B^-1 r
      {"multigrid's gradients: advance", true, nodes * (6 + 6 + INVERSE_PRODUCT + 3 + 6 + 6),
       7 * values + inverses + HALF * nodes * NUMBER, 0,
       [&]() {
         sink += table.single_advance(0, count, 1e-3f, 0.5f, single.p.data(), single.q.data(), single.inverse.data(),
                                      single.mass.data(), single.x.data(), single.r.data(), single.s.data(),
                                      single.d.data(), single.z.data());
       }},
      {"multigrid's gradients: redirect", true, nodes * 6, 2 * values, 0,
       [&]() { table.single_redirect(0, count, 0.5f, single.z.data(), single.p.data()); }},
      {"multigrid's gradients: dot", true, nodes * 6, 2 * values, 0,
       [&]() { sink += table.single_dot(0, count, single.r.data(), single.z.data()); }},
      // Of the factor of linear elements on the same tetrahedra, with what of its blocks' upper triangles is read.
      {"Cholesky solve", true, 4 * factor.numbers(), 2 * (factored + sides), factored, [&]() { factor.solve(); }},
      // Of the same matrix beyond some thousands of vertices, with what fills up groups of rows
      {"aggregates: residual", true, factor.blocks() * 18,
       factor.blocks() * (INDEX + 12 * HALF * NUMBER) + vertices * 3 * HALF * NODE, 0, [&]() { factor.residual(); }},
      {"aggregates: smoother's term", true, vertices * (INVERSE_PRODUCT + 3 + 6 + 3),
       vertices * HALF * (5 * NODE + 12 * NUMBER), 0, [&]() { factor.smooth(); }},
      {"panel product", true, 2 * panels.numbers(), panels.numbers() * HALF * NUMBER, 0, [&]() { panels.product(); }},
      {"panel product, transposed", true, 2 * panels.numbers(), panels.numbers() * HALF * NUMBER, 0,
       [&]() { panels.transposeProduct(); }},
  };
  std::vector<std::vector<double>> times(all.size());
  for (int k = 0; k < RUNS; ++k)
  {
    yardstick.measure();
    for (std::size_t i = 0; i < all.size(); ++i)
    {
      for (int warm = 0; warm < WARM_UPS; ++warm) all[i].run();
      const double start = milliseconds();
      all[i].run();
      times[i].push_back(milliseconds() - start);
    }
  }
  if (!std::isfinite(sink)) throw std::runtime_error("not finite");
  const std::string name = file.substr(file.find_last_of('/') + 1);
  for (std::size_t i = 0; i < all.size(); ++i)
  {
    const Kernel& kernel = all[i];
    const double ms = median(times[i]), by_flops = 1e-6 * kernel.flops / machine.gflops(kernel.single);
    const double by_bytes = 1e-6 * kernel.bytes / machine.bandwidth(kernel.bytes - kernel.again);
    std::printf("| %s | %d | %d | %s | %s | %.4f | %.3f | %.2f | %.1f | %.1f | %.2f | %.2f | %s | %.2f |\n",
                name.c_str(), model.num_tets, model.num_nodes, kernel.name.c_str(), kernel.single ? "single" : "double",
                ms, ms / yardstick.ms(), kernel.flops / kernel.bytes, 1e-6 * kernel.flops / ms,
                1e-6 * kernel.bytes / ms, by_flops / ms, by_bytes / ms,
                by_flops > by_bytes ? "arithmetic" : "bandwidth", std::max(by_flops, by_bytes) / ms);
  }
  std::fflush(stdout);
}
}  // namespace

int main(int argc, char** argv)
{
  std::vector<std::string> scenes, overrides;
  CLI::App app{"Times kernels on one thread, as shares of the machine's peak and of its bandwidth."};
  app.add_option("SCENE", scenes, "Scene files")->required();
  app.add_option("--set", overrides, "KEY=VALUE for every scene")->take_all()->allow_extra_args(false);
  CLI11_PARSE(app, argc, argv);
  try
  {
    const Machine machine(peakOf(kernels::table().name));
    std::printf("Instruction set: %s\n\n", kernels::table().name);
    machine.print();
    std::printf(
        "| scene | tets | nodes | kernel | precision | ms | products | flop/byte | GFlop/s | GB/s | of peak | "
        "of bandwidth | bound by | of the bound |\n|---|---|---|---|---|---|---|---|---|---|---|---|---|---|\n");
    for (const std::string& scene : scenes) bench(scene, overrides, machine);
  }
  catch (const std::exception& error)
  {
    std::cerr << error.what() << std::endl;
    return 1;
  }
}
