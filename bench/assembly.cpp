// Times the ways to a product with alpha M + beta K' of a body in motion, on one thread: element matrices, their
// traversals, both at once, and no matrix at all. Everything is run in turn, many times over, because machines drift:
// a few times to bring its own data into the caches, once timed. Medians count, and their ratio to the yardstick.

#include <CLI/CLI.hpp>
#include <cstdio>
#include <fstream>
#include <functional>
#include <iostream>
#include <nlohmann/json.hpp>

#include "bezier_fem/assembled_matrix.h"
#include "bezier_fem/element_operator.h"
#include "bezier_fem/simulation.h"
#include "yardstick.h"

namespace
{
using namespace bezier_fem;

struct Timed
{
  const char* name;
  std::function<void()> run;
  std::vector<double> ms{};
};

nlohmann::json bench(const std::string& file, const std::vector<std::string>& overrides, int runs)
{
  Simulation simulation(loadScene(file, overrides), 1, [](const std::string&) {});
  for (int k = 0; k < 20; ++k) simulation.step();  // so that every element has turned
  const Model& model = simulation.model();
  const Rotations& rotations = simulation.state().rotations;
  const double dt = simulation.scene().time_step;
  const Partition partition(model, 1);

  ElementMatrices elements(model);
  const RestStiffness stiffness = restStiffness(model);
  AssembledMatrix A(model), B(model);
  const Assembler conventional(model, A, Traversal::CONVENTIONAL), slots(model, A, Traversal::STORED_SLOTS),
      mesh_oriented(model, A, Traversal::MESH_ORIENTED);
  FusedAssembler fused(model, A);
  fused.assemble(model, partition, rotations, 1, dt * dt, A);
  Yardstick yardstick(A);
  NodalField product(model.num_nodes);
  AlignedVector<double> diagonal(8 * static_cast<std::size_t>(model.num_nodes));

  Timed stages[]{
      {"warped", [&] { warpedMatrices(model, partition, stiffness, rotations, 1, dt * dt, elements); }},
      {"rotated_gradients", [&] { rotatedGradientMatrices(model, partition, rotations, 1, dt * dt, elements); }},
      {"conventional", [&] { conventional.assemble(model, partition, elements, B); }},
      {"stored_slots", [&] { slots.assemble(model, partition, elements, B); }},
      {"mesh_oriented", [&] { mesh_oriented.assemble(model, partition, elements, B); }},
      {"fused", [&] { fused.assemble(model, partition, rotations, 1, dt * dt, A); }},
      {"assembled_product", [&] { A.product(partition, yardstick.x(), product); }},
      {"matrix_free_product", [&] { systemProduct(model, partition, rotations, 1, dt * dt, yardstick.x(), product); }},
      {"matrix_free_diagonal", [&] { systemDiagonal(model, partition, rotations, 1, dt * dt, diagonal); }},
  };
  for (int k = 0; k < runs; ++k)
  {
    yardstick.measure();
    for (Timed& stage : stages)
    {
      for (int warm = 0; warm < WARM_UPS; ++warm) stage.run();
      const double start = milliseconds();
      stage.run();
      stage.ms.push_back(milliseconds() - start);
    }
  }
  // What was timed is right: the last product is matrix-free, B mesh-oriented from rotated gradients.
  yardstick.compare(product);
  B.product(partition, yardstick.x(), product);
  yardstick.compare(product);

  nlohmann::json result{{"scene", file},
                        {"tets", model.num_tets},
                        {"nodes", model.num_nodes},
                        {"blocks", A.column().size()},
                        {"plain_product", yardstick.ms()}};
  for (const Timed& stage : stages) result["ms"][stage.name] = median(stage.ms);
  return result;
}

void print(const nlohmann::json& r)
{
  const std::string scene = r["scene"];
  std::printf("%s: %d tets, %d nodes, %d blocks; one plain product %.3f ms\n\n| | ms | products |\n|---|---|---|\n",
              scene.c_str(), r["tets"].get<int>(), r["nodes"].get<int>(), r["blocks"].get<int>(),
              r["plain_product"].get<double>());
  const std::pair<const char*, const char*> rows[]{
      {"warped", "element matrices, R K R^T"},
      {"rotated_gradients", "element matrices, rotated gradients"},
      {"conventional", "traversal, conventional with search"},
      {"stored_slots", "traversal, conventional with stored slots"},
      {"mesh_oriented", "traversal, mesh-oriented"},
      {"fused", "both at once, from rotated gradients"},
      {"assembled_product", "product, assembled"},
      {"matrix_free_product", "product, matrix-free"},
      {"matrix_free_diagonal", "diagonal, matrix-free"},
  };
  for (const auto& [key, name] : rows)
  {
    const double ms = r["ms"][key];
    std::printf("| %s | %.3f | %.2f |\n", name, ms, ms / r["plain_product"].get<double>());
  }
  const double conventional = r["ms"]["conventional"], slots = r["ms"]["stored_slots"], mesh = r["ms"]["mesh_oriented"];
  std::printf("\nAs fast as the conventional traversal: with stored slots %.2f times, mesh-oriented %.2f times.\n\n",
              conventional / slots, conventional / mesh);
  std::fflush(stdout);
}
}  // namespace

int main(int argc, char** argv)
{
  std::vector<std::string> scenes, overrides;
  std::string json;
  int runs = 101;
  CLI::App app{"Times the assembly of a scene's system matrix, stage by stage, and what it competes with."};
  app.add_option("SCENE", scenes, "Scene files")->required();
  app.add_option("--set", overrides, "KEY=VALUE for every scene")->take_all()->allow_extra_args(false);
  app.add_option("--runs", runs, "Runs, of which the medians count")->check(CLI::PositiveNumber);
  app.add_option("--json", json, "Write the figures to this file too, in ms");
  CLI11_PARSE(app, argc, argv);
  try
  {
    nlohmann::json all = nlohmann::json::array();
    for (const std::string& scene : scenes)
    {
      all.push_back(bench(scene, overrides, runs));
      print(all.back());
    }
    if (json.empty()) return 0;
    std::ofstream out(json);
    out << all.dump(2) << '\n';
    out.close();
    if (!out) throw std::runtime_error(json + ": cannot be written");
  }
  catch (const std::exception& error)
  {
    std::cerr << error.what() << std::endl;
    return 1;
  }
}
