// What each kernel takes of what the processor can do: its time beside the time that its arithmetic would take at the
// peak rate of multiply-adds and its data at the bandwidth of a triad of the same size, whichever is longer (Williams,
// Waterman, Patterson 2009, "Roofline"). All measured in the same run, on one thread, with the kernels' instruction
// set; and in products of an assembled matrix of the same model (yardstick.h).

#include <CLI/CLI.hpp>
#include <cstdio>
#include <functional>
#include <iostream>
#include <utility>

#include "bezier_fem/assembled_matrix.h"
#include "bezier_fem/element_operator.h"
#include "bezier_fem/simulation.h"
#include "kernels.h"
#include "peak.h"
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
    constexpr long ROUNDS = 2000000;
    volatile double sink = 0;
    gflops_double_ = 1e-6 * ROUNDS * peak.flops_double / shortest(5, [&]() { sink = peak.rounds_double(ROUNDS); });
    gflops_single_ = 1e-6 * ROUNDS * peak.flops_single / shortest(5, [&]() { sink = peak.rounds_single(ROUNDS); });

    constexpr std::size_t LEAST = 1 << 15, MOST = 1 << 28;
    for (std::size_t bytes = LEAST; bytes <= MOST; bytes *= 2)
    {
      const std::size_t size = bytes / (3 * sizeof(double)) / 8 * 8;
      AlignedVector<double> a(size), b(size, 1.0), c(size, 2.0);
      const int passes = static_cast<int>(std::max<std::size_t>(1, MOST / 8 / bytes));
      const double ms = shortest(5, [&]() {
        for (int k = 0; k < passes; ++k) peak.triad(size, 0.5, b.data(), c.data(), a.data());
      });
      const double moved = 3.0 * sizeof(double) * static_cast<double>(size);
      bandwidth_.emplace_back(moved, 1e-6 * moved * passes / ms);
    }
  }

  double gflops(bool single) const { return single ? gflops_single_ : gflops_double_; }
  /** GB/s of a triad whose three arrays have that many bytes together. */
  double bandwidth(double bytes) const
  {
    if (bytes <= bandwidth_.front().first) return bandwidth_.front().second;
    for (std::size_t k = 1; k < bandwidth_.size(); ++k)
    {
      const auto& [size, rate] = bandwidth_[k];
      const auto& [smaller, before] = bandwidth_[k - 1];
      if (bytes <= size) return before + (rate - before) * std::log(bytes / smaller) / std::log(size / smaller);
    }
    return bandwidth_.back().second;
  }
  void print() const
  {
    std::printf(
        "| peak | |\n|---|---|\n| multiply-add, double | %.1f GFlop/s |\n| multiply-add, single | %.1f GFlop/s |\n",
        gflops_double_, gflops_single_);
    for (const auto& [bytes, rate] : bandwidth_) std::printf("| triad, %.0f kB | %.1f GB/s |\n", bytes / 1e3, rate);
    std::printf("\n");
  }

private:
  double gflops_double_, gflops_single_;
  std::vector<std::pair<double, double>> bandwidth_;  // bytes and GB/s, sizes ascending
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
  /** What is read and what is written, once each, as STREAM counts: a line that is written is not counted as read. */
  double bytes;
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
/** Four corners q_a r_a; six edges q_a r_b + q_b r_a. */
constexpr int FORCES = 4 * 15 + 6 * (2 * 15 + 3);
/** t_a of five nodes each; half their sum; that and t_a; for ten nodes t_b and u_ab added, scaled, added to the force.
 */
constexpr int MASS = 4 * 4 * 3 + (9 + 3) + 4 * 3 + 10 * (3 + 3 + 3 + 3);
/** Ten nodes are added to. */
constexpr int SCATTER = 10 * 3;
/** alpha, beta and 1/210 to the coefficients */
constexpr int PRODUCT = 4 + GRADIENT_0 + STRESSES + FORCES + MASS + SCATTER;
/** With the identity taken from the normal strains. */
constexpr int FORCE = GRADIENT_0 + STRESSES + 4 * 3 + FORCES + SCATTER;

/** H_cd + H_dc: dot product and 2 mu (6), diagonal (3 x 3), the rest (3 x 4). */
constexpr int SYMMETRIC_H = 6 + 9 + 12;
/**
 * beta, alpha, 1/35 and 2/105, sums of lambda and mu; four H_aa; a fifth of them at corners; at edges a fifth of the
 * sum of two and an H_ab; of the mass to diagonals; ten blocks added to.
 */
constexpr int DIAGONAL = 5 + 3 + GRADIENT_0 + 4 * SYMMETRIC_H + 4 * 6 + 6 * (SYMMETRIC_H + 3 * 6) + 10 * 3 + 10 * 6;

/**
 * Three edges, F (9 x 5), F^T F (6 x 5), cof F (9 x 3), det F, |F|^2, 2 det F and 4 of it, |cof F|^2, a root and a
 * product; two steps of Halley's method: value 5, slope 2, correction 10, size 2; slope 4, margin 2, scaling 4, the
 * symmetric factor 9, R (9 x 7), how far it turned (9 x 3), three rotated gradients (9 x 5).
 */
constexpr int ROTATION = 9 + 45 + 30 + 27 + 5 + 2 + 2 + 12 + 2 + 2 * (5 + 2 + 10 + 2) + 4 + 2 + 4 + 9 + 63 + 27 + 45;

// ------------------------------------------------------------------------------------------------------------------

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
  AlignedVector<double> inverse(static_cast<std::size_t>(kernels::INVERSE_STRIDE) * model.num_nodes);
  const kernels::Table& table = kernels::table();
  const kernels::BlockRows rows{A.rowBegin().data(), A.column().data()};

  const double tets = model.num_tets, nodes = model.num_nodes, blocks = static_cast<double>(A.column().size());
  const double vertices =
      std::count_if(model.ends.begin(), model.ends.end(), [](const auto& e) { return e[0] == e[1]; });
  // Bytes of a number, an index, a padded vector of a node and the three gradients of an element
  constexpr double NUMBER = sizeof(double), INDEX = sizeof(int), NODE = 4 * NUMBER, MATRIX = 9 * NUMBER;
  constexpr double BLOCK = kernels::DIAGONAL_STRIDE * NUMBER, INVERSE = kernels::INVERSE_STRIDE * NUMBER;
  // Each a loop over elements that reads a vector of nodes, and clears and adds to another.
  const double element = 2 * 10 * INDEX + 3 * NUMBER + MATRIX, vectors = nodes * (NODE + 3 * NODE);
  double sink = 0;
  const std::vector<Kernel> all = {
      {"rotations", false, tets * ROTATION, tets * (4 * INDEX + 4 * MATRIX + NUMBER + 2) + vertices * NODE,
       [&]() { updateRotations(model, partition, x, before, rotations, turned); }},
      {"product", false, tets * PRODUCT, tets * element + vectors,
       [&]() { systemProduct(model, partition, rotations, 1, dt * dt, u, v); }},
      {"elastic force", false, tets * FORCE, tets * (element - NUMBER) + vectors,
       [&]() { elasticForce(model, partition, rotations, x, v); }},
      {"block diagonal", false, tets * DIAGONAL, tets * (element - 10 * INDEX) + nodes * 3 * BLOCK,
       [&]() { systemDiagonal(model, partition, rotations, 1, dt * dt, diagonal); }},
      {"assembled product", false, blocks * 18, blocks * (MATRIX + INDEX) + nodes * (INDEX + 2 * NODE),
       [&]() { table.block_product(rows, 0, A.rows(), A.blocks().data(), u.data(), v.data()); }},
      // x += a p, r -= a q, z = B^-1 r, r.z
      {"conjugate gradients: advance", false, nodes * (6 + 6 + 15 + 6), nodes * (7 * NODE + INVERSE),
       [&]() {
         sink +=
             table.advance(0, model.num_nodes, 1e-3, p.data(), q.data(), inverse.data(), z.data(), u.data(), v.data());
       }},
      {"conjugate gradients: redirect", false, nodes * 6, nodes * 3 * NODE,
       [&]() { table.redirect(0, model.num_nodes, 0.5, z.data(), p.data()); }},
      {"conjugate gradients: dot", false, nodes * 6, nodes * 2 * NODE,
       [&]() { sink += table.dot(0, model.num_nodes, u.data(), z.data()); }},
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
    const double by_bytes = 1e-6 * kernel.bytes / machine.bandwidth(kernel.bytes);
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
