// Times whole steps, by stage, beside a yardstick measured in the same run on the same model: one product of an
// assembled sparse matrix of 3x3 blocks, double precision, one thread, the fastest of two ways to write it. Machines
// differ and drift; the ratio to the yardstick is what carries over.

#include <CLI/CLI.hpp>
#include <Eigen/Dense>
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <iostream>
#include <map>

#include "bezier_fem/element_operator.h"
#include "bezier_fem/error.h"
#include "bezier_fem/simulation.h"
#include "plain_product.h"

namespace
{
using namespace bezier_fem;

double milliseconds()
{
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

double median(std::vector<double> values)
{
  std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2), values.end());
  return values[values.size() / 2];
}

/** M + dt^2 K of the body at rest, rows of 3x3 blocks. */
struct BlockMatrix
{
  std::vector<int> row_begin, column;
  AlignedVector<double> blocks;   // 9 a block, row-major
  AlignedVector<double> columns;  // 12 a block: three columns of x, y, z, 0
};

BlockMatrix assemble(const Model& model, double dt)
{
  // The structure from the elements, the values from products with unit fields would be slow; so from the formula.
  std::vector<std::map<int, Eigen::Matrix3d>> rows(model.num_nodes);
  const int n = model.nodes_per_tet;
  std::array<std::array<int, 2>, QUADRATIC_NODES> factors{};
  for (int a = 0; a < CORNERS; ++a) factors[a] = {a, a};
  for (int e = 0; e < EDGES; ++e) factors[CORNERS + e] = EDGE_CORNERS[e];
  for (int t = 0; t < model.num_tets; ++t)
  {
    Eigen::Matrix<double, 3, 4> g;
    g.rightCols<3>() = model.gradients.middleCols<3>(3L * t);
    g.col(0) = -(g.col(1) + g.col(2) + g.col(3));
    const Material& m = model.materials[t];
    const double lambda = lameLambda(m), mu = lameMu(m), volume = model.volumes[t];
    const auto H = [&](int c, int d) -> Eigen::Matrix3d {
      return lambda * g.col(c) * g.col(d).transpose() + mu * g.col(d) * g.col(c).transpose() +
             mu * g.col(c).dot(g.col(d)) * Eigen::Matrix3d::Identity();
    };
    for (int I = 0; I < n; ++I)
    {
      for (int J = 0; J < n; ++J)
      {
        Eigen::Matrix3d block = Eigen::Matrix3d::Zero();
        if (n == CORNERS)
        {
          block = dt * dt * volume * H(I, J) + m.density * volume / 20 * (I == J ? 2 : 1) * Eigen::Matrix3d::Identity();
        }
        else
        {
          const auto [a, b] = factors[I];
          const auto [e, f] = factors[J];
          // grad B_ab = 2 (lambda_a g_b + lambda_b g_a), halved where a = b.
          const double scale = 4 * volume / 20 * (a == b ? 0.5 : 1) * (e == f ? 0.5 : 1) * dt * dt;
          for (const auto& [p, r] : {std::array{a, b}, std::array{b, a}})
          {
            for (const auto& [q, s] : {std::array{e, f}, std::array{f, e}}) block += scale * (p == q ? 2 : 1) * H(r, s);
          }
          double overlap = 1.0 / 210;
          std::array<int, 4> i{}, j{};
          ++i[a], ++i[b], ++j[e], ++j[f];
          for (int c = 0; c < CORNERS; ++c)
            overlap *= i[c] + j[c] == 4 ? 6 : i[c] + j[c] == 3 ? 3 : i[c] * j[c] == 1 ? 2 : 1;
          block += m.density * volume * overlap * Eigen::Matrix3d::Identity();
        }
        rows[model.nodesOf(t)[I]].try_emplace(model.nodesOf(t)[J], Eigen::Matrix3d::Zero()).first->second += block;
      }
    }
  }
  BlockMatrix A;
  A.row_begin.push_back(0);
  for (const auto& row : rows)
  {
    for (const auto& [j, block] : row)
    {
      A.column.push_back(j);
      for (int k = 0; k < 9; ++k) A.blocks.push_back(block(k / 3, k % 3));
      for (int c = 0; c < 3; ++c)
      {
        for (int r = 0; r < 3; ++r) A.columns.push_back(block(r, c));
        A.columns.push_back(0);
      }
    }
    A.row_begin.push_back(static_cast<int>(A.column.size()));
  }
  return A;
}

template <class F>
double fastestMedian(const F& f)
{
  std::vector<double> times;
  for (int k = 0; k < 41; ++k)
  {
    const double start = milliseconds();
    f();
    times.push_back(milliseconds() - start);
  }
  return median(times);
}

void bench(const std::string& file, const std::vector<std::string>& overrides, int threads, int steps)
{
  Simulation simulation(loadScene(file, overrides), threads, [](const std::string&) {});
  const Model& model = simulation.model();

  const double dt = simulation.scene().time_step;
  const BlockMatrix A = assemble(model, dt);
  std::vector<double> x(3L * model.num_nodes), y(x.size());
  NodalField u(model.num_nodes), v(model.num_nodes);
  for (int i = 0; i < 3 * model.num_nodes; ++i) x[i] = u[i / 3][i % 3] = std::sin(i);
  const double plain = fastestMedian(
      [&] { plainProduct(model.num_nodes, A.row_begin.data(), A.column.data(), A.blocks.data(), x.data(), y.data()); });
  const double padded = fastestMedian([&] {
    paddedProduct(model.num_nodes, A.row_begin.data(), A.column.data(), A.columns.data(), u.data(), v.data());
  });
  const double unit = std::min(plain, padded);

  const Partition partition(model, threads);
  NodalField w(partition.rows());
  const Rotations rest = restRotations(model);
  const double own = fastestMedian([&] { systemProduct(model, partition, rest, 1, dt * dt, u, w); });
  double apart = 0;
  for (int i = 0; i < 3 * model.num_nodes; ++i)
  {
    apart = std::max({apart, std::abs(w[i / 3][i % 3] - y[i]), std::abs(v[i / 3][i % 3] - y[i])});
  }
  if (apart > 1e-9 * w.matrix().cwiseAbs().maxCoeff()) throw std::runtime_error("the products disagree");

  std::vector<double> rotation, assembly, force, solve, total, iterations;
  double worst = 0;
  for (int k = 0; k < steps; ++k)
  {
    const StepReport report = simulation.step();
    rotation.push_back(report.ms.rotation);
    assembly.push_back(report.ms.assembly);
    force.push_back(report.ms.force);
    solve.push_back(report.ms.solve);
    total.push_back(report.ms.total);
    iterations.push_back(report.iterations);
    worst = std::max(worst, report.residual);
  }
  const std::string name = file.substr(file.find_last_of('/') + 1);
  std::printf("| %s | %d | %d | %d | %.2f | %.2f | %.2f | %.2f | %.2f | %.0f | %.1e | %.3f | %.0f | %.2f |\n",
              name.c_str(), model.num_tets, model.num_nodes, threads, median(rotation), median(assembly), median(force),
              median(solve), median(total), median(iterations), worst, unit, median(total) / unit, own / unit);
  std::fflush(stdout);
}
}  // namespace

int main(int argc, char** argv)
{
  std::vector<std::string> scenes, overrides;
  std::vector<int> threads{1, 2};
  int steps = 60;
  CLI::App app{
      "Times whole steps of scenes, in ms (medians), and in products of an assembled matrix of the same model."};
  app.add_option("SCENE", scenes, "Scene files")->required();
  app.add_option("--set", overrides, "KEY=VALUE for every scene")->take_all()->allow_extra_args(false);
  app.add_option("--threads", threads, "Numbers of threads, each measured");
  app.add_option("--steps", steps, "Steps")->check(CLI::PositiveNumber);
  CLI11_PARSE(app, argc, argv);
  try
  {
    std::printf(
        "| scene | tets | nodes | threads | rotation | diagonal | force | solve | whole step | iterations | worst "
        "residual | one product | step in products | own product in products |\n"
        "|---|---|---|---|---|---|---|---|---|---|---|---|---|---|\n");
    for (const std::string& scene : scenes)
    {
      for (const int count : threads) bench(scene, overrides, count, steps);
    }
  }
  catch (const std::exception& error)
  {
    std::cerr << error.what() << std::endl;
    return 1;
  }
}
