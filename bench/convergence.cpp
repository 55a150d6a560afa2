#include <cmath>

#include "accuracy.h"
#include "clamped_bar.h"
#include "core/bar.h"
#include "core/manufactured.h"

namespace bezier_fem::bench
{
namespace
{
nlohmann::json order(double coarse_error, double fine_error, double coarse_h, double fine_h)
{
  if (coarse_error == 0) return nullptr;
  return std::log(coarse_error / fine_error) / std::log(coarse_h / fine_h);
}

void addSmoothProblem(Element element, const std::vector<int>& cells, Table& table)
{
  test::FieldErrors last{};
  double last_h = 0;
  for (const int n : cells)
  {
    const Model model = test::boxModel(test::irregularBox({n, n, n}, {1, 1, 1}), element);
    progress("smooth problem, " + std::to_string(model.num_tets) + " " + test::name(element) + " tets");
    const double h = 1.0 / n;
    const test::FieldErrors errors = test::solveWaves(model);
    table.push_back({{"problem", "smooth"},
                     {"element", test::name(element)},
                     {"h", h},
                     {"tets", model.num_tets},
                     {"nodes", model.num_nodes},
                     {"displacement_error", errors.displacement},
                     {"displacement_order", order(last.displacement, errors.displacement, last_h, h)},
                     {"stress_error", errors.stress},
                     {"stress_order", order(last.stress, errors.stress, last_h, h)}});
    last = errors;
    last_h = h;
  }
}

void addClampedBar(Element element, const std::vector<int>& cells, double reference, Table& table)
{
  double last = 0, last_h = 0;
  for (const int n : cells)
  {
    const ClampedBar bar = clampedBar({2 * n, 2 * n, 5 * n}, element);
    progress("clamped bar, " + std::to_string(bar.model.num_tets) + " " + test::name(element) + " tets");
    const double h = 0.2 / n;
    const State state = equilibrium(bar, Elasticity::LINEAR, bar.model.rest);
    const double error = std::abs(bar.deflection(state.x) / reference - 1);
    table.push_back({{"problem", "clamped bar"},
                     {"element", test::name(element)},
                     {"h", h},
                     {"tets", bar.model.num_tets},
                     {"nodes", bar.model.num_nodes},
                     {"displacement_error", error},
                     {"displacement_order", order(last, error, last_h, h)},
                     {"stress_error", nullptr},
                     {"stress_order", nullptr}});
    last = error;
    last_h = h;
  }
}
}  // namespace

Table convergence()
{
  Table table = Table::array();
  addSmoothProblem(Element::LINEAR, {4, 8, 16, 32}, table);
  addSmoothProblem(Element::QUADRATIC, {3, 6, 12, 24}, table);

  progress("clamped bar, reference");
  const ClampedBar reference = clampedBar({16, 16, 32}, Element::QUADRATIC, true);
  const double deflection = reference.deflection(equilibrium(reference, Elasticity::LINEAR, reference.model.rest).x);
  addClampedBar(Element::LINEAR, {1, 2, 4, 8}, deflection, table);
  addClampedBar(Element::QUADRATIC, {1, 2, 4, 6}, deflection, table);
  return table;
}

}  // namespace bezier_fem::bench
