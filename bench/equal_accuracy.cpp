#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "accuracy.h"
#include "bezier_fem/embedding.h"
#include "clamped_bar.h"
#include "core/bar.h"

namespace bezier_fem::bench
{
namespace
{
constexpr double WANTED = 0.02;  // relative error of the tip's static deflection
constexpr int STEPS = 45;        // 0.9 s: the bar swings down and up

/** Control points of `bar` that interpolate the positions of another solution: the start of a search near its end. */
NodalField transfer(const ClampedBar& from, const NodalField& x, const ClampedBar& bar)
{
  const Model& model = bar.model;
  const PointLocator locator(from.model);
  NodalField start(model.num_nodes);
  for (int i = 0; i < model.num_nodes; ++i) start[i] = position(from.model, x, locator.locate(model.rest[i]));
  const NodalField middles = start;
  for (int i = 0; i < model.num_nodes; ++i)
  {
    const auto [a, b] = model.ends[i];
    if (a == b) continue;
    start[i] = 2 * middles[i] - (middles[model.node_of_corner[a]] + middles[model.node_of_corner[b]]) / 2;
  }
  return start;
}

/** Median wall-clock time of the steps that swing the bar from rest, one thread. */
struct StepCost
{
  double ms, iterations;
};

StepCost swing(const ClampedBar& bar, Elasticity elasticity)
{
  const StepSettings settings = barSettings(elasticity, 1e-4);
  Workspace workspace(bar.model, settings, 1);
  State state = startState(bar.model, settings, bar.supports, bar.model.rest, Eigen::Vector3d::Zero(), workspace);
  const NodalField no_force(bar.model.num_nodes);
  std::vector<double> ms, iterations;
  for (int k = 0; k < STEPS; ++k)
  {
    const StepReport report = implicitEulerStep(bar.model, settings, bar.supports, {}, no_force, state, workspace);
    if (!report.converged) throw std::runtime_error("a step was not solved");
    ms.push_back(report.ms.total);
    iterations.push_back(report.iterations);
  }
  for (std::vector<double>* values : {&ms, &iterations})
  {
    std::nth_element(values->begin(), values->begin() + STEPS / 2, values->end());
  }
  return {ms[STEPS / 2], iterations[STEPS / 2]};
}
}  // namespace

Table equalAccuracy()
{
  Table table = Table::array();
  for (const Elasticity elasticity : {Elasticity::LINEAR, Elasticity::COROTATED})
  {
    const char* const law = elasticity == Elasticity::LINEAR ? "linear" : "corotated";
    progress(std::string(law) + " elasticity, reference");
    const ClampedBar reference = clampedBar({12, 12, 24}, Element::QUADRATIC, true);
    const State solution = equilibrium(reference, elasticity, reference.model.rest);
    const double deflection = reference.deflection(solution.x);

    double quadratic_ms = 0;
    for (const Element element : {Element::QUADRATIC, Element::LINEAR})
    {
      int across = 1;
      while (true)
      {
        const ClampedBar bar = clampedBar(cubicCells(across), element);
        progress(std::string(law) + " elasticity, " + std::to_string(bar.model.num_tets) + " " + test::name(element) +
                 " tets");
        const State state = equilibrium(bar, elasticity, transfer(reference, solution.x, bar));
        const double error = std::abs(bar.deflection(state.x) / deflection - 1);
        if (error > WANTED)
        {
          // No element converges faster than with its fourth power of h: never past the coarsest mesh that will do.
          const double finer = across * std::pow(error / WANTED, 0.25);
          across = std::max(across + 1, static_cast<int>(finer));
          continue;
        }
        const StepCost cost = swing(bar, elasticity);
        if (element == Element::QUADRATIC) quadratic_ms = cost.ms;
        table.push_back({{"elasticity", law},
                         {"element", test::name(element)},
                         {"cells_across", across},
                         {"tets", bar.model.num_tets},
                         {"nodes", bar.model.num_nodes},
                         {"tip_error", error},
                         {"iterations", cost.iterations},
                         {"ms_per_step", cost.ms},
                         {"ratio", cost.ms / quadratic_ms}});
        break;
      }
    }
  }
  return table;
}

}  // namespace bezier_fem::bench
