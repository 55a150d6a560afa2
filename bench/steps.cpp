// Times whole steps, by stage, beside a yardstick measured in the same run on the same model: one product of an
// assembled sparse matrix of 3x3 blocks, double precision, one thread, the fastest of two ways to write it. Machines
// differ and drift; the ratio to the yardstick is what carries over.

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>
#include <iostream>

#include "bezier_fem/assembled_matrix.h"
#include "bezier_fem/element_operator.h"
#include "bezier_fem/error.h"
#include "bezier_fem/simulation.h"
#include "yardstick.h"

namespace
{
using namespace bezier_fem;

void bench(const std::string& file, const std::vector<std::string>& overrides, int threads, int steps)
{
  Simulation simulation(loadScene(file, overrides), threads, [](const std::string&) {});
  const Model& model = simulation.model();

  const double dt = simulation.scene().time_step;
  const Partition partition(model, threads);
  const Rotations rest = restRotations(model);
  AssembledMatrix A(model);
  FusedAssembler(model, A).assemble(model, partition, rest, 1, dt * dt, A);
  Yardstick yardstick(A);
  NodalField product(model.num_nodes);
  std::vector<double> own_times;
  for (int k = 0; k < 41; ++k)
  {
    yardstick.measure();
    const double start = milliseconds();
    systemProduct(model, partition, rest, 1, dt * dt, yardstick.x(), product);
    own_times.push_back(milliseconds() - start);
  }
  yardstick.compare(product);
  const double unit = yardstick.ms(), own = median(own_times);

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
  std::printf("| %s | %d | %d | %d | %.3f | %.3f | %.3f | %.3f | %.3f | %.0f | %.1e | %.3f | %.1f | %.3f | %.2f |\n",
              name.c_str(), model.num_tets, model.num_nodes, threads, median(rotation), median(assembly), median(force),
              median(solve), median(total), median(iterations), worst, unit, median(total) / unit, own / unit,
              *std::max_element(total.begin(), total.end()));
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
        "residual | one product | step in products | own product in products | longest step |\n"
        "|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|\n");
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
