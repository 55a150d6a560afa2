#include <cmath>
#include <stdexcept>
#include <vector>

#include "accuracy.h"
#include "bezier_fem/embedding.h"
#include "bezier_fem/measures.h"
#include "clamped_bar.h"
#include "core/bar.h"
#include "core/manufactured.h"

namespace bezier_fem::bench
{
namespace
{
using Eigen::Vector3d;

constexpr double POISSONS[] = {0.3, 0.45, 0.49, 0.499, 0.4999};

struct Formulation
{
  Element element;
  Dilatation dilatation;
  const char* name() const { return dilatation == Dilatation::MEAN ? "mean" : "full"; }
};
constexpr Formulation LINEAR{Element::LINEAR, Dilatation::FULL}, FULL{Element::QUADRATIC, Dilatation::FULL},
    MEAN{Element::QUADRATIC, Dilatation::MEAN};

Material withPoisson(double poisson)
{
  return {test::RUBBER.young, poisson, test::RUBBER.density};
}

/** A box that is held at z = 0, and at its upper end, if that is led, moved from there. */
struct Body
{
  const char* name;
  Elasticity elasticity;
  Vector3d size, gravity, moved;  // m, m/s^2, m
  bool led;
  Eigen::Vector3i cells;      // of the coarsest quadratic mesh; linear ones have twice as many along each axis
  Eigen::Vector3i reference;  // cells, which become smaller towards held edges
};
const Body BODIES[] = {
    {"bar", Elasticity::LINEAR, {0.4, 0.4, 1}, {0, -9.81, 0}, {0, 0, 0}, false, {2, 2, 5}, {10, 10, 20}},
    {"bar", Elasticity::COROTATED, {0.4, 0.4, 1}, {0, -9.81, 0}, {0, 0, 0}, false, {2, 2, 5}, {10, 10, 20}},
    {"bonded block", Elasticity::LINEAR, {1, 1, 0.3}, {0, 0, 0}, {0, 0, -0.003}, true, {4, 4, 2}, {16, 16, 10}}};

struct Problem
{
  Model model;
  Supports supports;
  StepSettings settings;
};

Problem problem(const Body& body, const Formulation& f, const Eigen::Vector3i& cells, bool graded, double poisson)
{
  TetMesh mesh = test::kuhnBox(cells, body.size);
  const auto toBothEnds = [](double t) {
    const double inward = std::min(t, 1 - t), moved = 2 * inward * inward;
    return t < 0.5 ? moved : 1 - moved;
  };
  for (Eigen::Index i = 0; graded && i < mesh.corners.cols(); ++i)
  {
    const Vector3d s = mesh.corners.col(i).cwiseQuotient(body.size);
    const double z = body.led ? toBothEnds(s.z()) : s.z() * s.z();
    mesh.corners.col(i) = body.size.cwiseProduct(Vector3d(toBothEnds(s.x()), toBothEnds(s.y()), z));
  }
  Problem result{test::boxModel(mesh, f.element, withPoisson(poisson), f.dilatation), {}, {}};
  std::vector<int> held;
  for (int i = 0; i < result.model.num_nodes; ++i)
  {
    const double z = result.model.rest[i].z();
    if (z < 1e-9 || (body.led && z > body.size.z() - 1e-9)) held.push_back(i);
  }
  result.supports = test::holdAt(
      result.model, held, [&](const Vector3d& X) { return X.z() < 1e-9 ? Vector3d::Zero().eval() : body.moved; });
  result.settings = barSettings(body.elasticity, 1e-6);
  result.settings.gravity = body.gravity;
  return result;
}

/** Displacements and stresses at points inside, away from held edges, where the stress has no limit. */
struct Field
{
  Eigen::Matrix3Xd displacement;
  Eigen::Matrix<double, 6, Eigen::Dynamic> stress;
};

Field solve(const Body& body, const Problem& p)
{
  const NodalField no_force(p.model.num_nodes);
  Workspace workspace(p.model, p.settings, 1);
  State state = startState(p.model, p.settings, p.supports, p.model.rest, Vector3d::Zero(), workspace);
  if (!solveStatic(p.model, p.settings, p.supports, {}, no_force, state, workspace, {}).converged)
  {
    throw std::runtime_error(std::string("no equilibrium of the ") + body.name);
  }
  const auto nodal = nodalStress(p.model, state.rotations, state.x);
  const PointLocator locator(p.model);
  Field field{Eigen::Matrix3Xd(3, 64), Eigen::Matrix<double, 6, Eigen::Dynamic>::Zero(6, 64)};
  for (int k = 0; k < 64; ++k)
  {
    constexpr double ACROSS[] = {0.19, 0.43, 0.67, 0.83}, ALONG[] = {0.31, 0.47, 0.61, 0.73};
    const Vector3d X = body.size.cwiseProduct(Vector3d(ACROSS[k % 4], ACROSS[3 - k / 4 % 4], ALONG[k / 16]));
    const MaterialPoint point = locator.locate(X);
    field.displacement.col(k) = position(p.model, state.x, point) - X;
    for (int c = 0; c < CORNERS; ++c)
    {
      field.stress.col(k) += point.lambda[c] * nodal.col(p.model.nodesOf(point.tet)[c]);
    }
  }
  return field;
}

/** The median iterations of ten steps of 20 ms from rest. */
int iterations(Problem& p, Scene::Solver::Preconditioner preconditioner)
{
  p.settings.solver.tolerance = Scene::Solver{}.tolerance;
  p.settings.solver.preconditioner = preconditioner;
  Workspace workspace(p.model, p.settings, 1);
  State state = startState(p.model, p.settings, p.supports, p.model.rest, Vector3d::Zero(), workspace);
  const NodalField no_force(p.model.num_nodes);
  std::vector<int> counts;
  for (int k = 0; k < 10; ++k)
  {
    counts.push_back(implicitEulerStep(p.model, p.settings, p.supports, {}, no_force, state, workspace).iterations);
  }
  std::nth_element(counts.begin(), counts.begin() + 5, counts.end());
  return counts[5];
}

void addRow(const char* name, Elasticity elasticity, double poisson, const Formulation& f, const Model& model,
            double displacement, double stress, Table& table)
{
  table.push_back({{"problem", name},
                   {"elasticity", elasticity == Elasticity::LINEAR ? "linear" : "corotated"},
                   {"poisson", poisson},
                   {"element", test::name(f.element)},
                   {"dilatation", f.name()},
                   {"tets", model.num_tets},
                   {"nodes", model.num_nodes},
                   {"displacement_error", displacement},
                   {"stress_error", stress},
                   {"iterations_block_jacobi", nullptr},
                   {"iterations_pmultigrid", nullptr}});
  progress(table.back().dump());
}

void addPointForce(const Formulation& f, int cells, double poisson, Table& table)
{
  const Model model = test::boxModel(test::irregularBox({cells, cells, cells}, {1, 1, 1}), f.element,
                                     withPoisson(poisson), f.dilatation);
  const test::FieldErrors errors = test::solveKelvin(model);
  addRow("point force", Elasticity::LINEAR, poisson, f, model, errors.displacement, errors.shown_stress, table);
}

void addBody(const Body& body, double poisson, Table& table)
{
  progress(std::string("reference of the ") + body.name);
  const Problem finest = problem(body, MEAN, body.reference, true, poisson);
  const Field exact = solve(body, finest);
  const auto add = [&](const Formulation& f, const Eigen::Vector3i& cells, bool graded) {
    Problem p = problem(body, f, cells, graded, poisson);
    const Field field = solve(body, p);
    addRow(graded ? (std::string(body.name) + ", reference's mesh").c_str() : body.name, body.elasticity, poisson, f,
           p.model, (field.displacement - exact.displacement).norm() / exact.displacement.norm(),
           (field.stress - exact.stress).norm() / exact.stress.norm(), table);
    if (graded || body.elasticity == Elasticity::LINEAR) return;
    table.back()["iterations_block_jacobi"] = iterations(p, Scene::Solver::Preconditioner::BLOCK_JACOBI);
    table.back()["iterations_pmultigrid"] = iterations(p, Scene::Solver::Preconditioner::PMULTIGRID);
  };
  for (const int times : {1, 2})
  {
    add(LINEAR, 2 * times * body.cells, false);
    add(FULL, times * body.cells, false);
    add(MEAN, times * body.cells, false);
  }
  add(FULL, body.reference, true);
}
}  // namespace

Table locking()
{
  Table table = Table::array();
  for (const double poisson : POISSONS)
  {
    for (const int cells : {2, 4, 8})
    {
      addPointForce(LINEAR, 2 * cells, poisson, table);
      addPointForce(FULL, cells, poisson, table);
      addPointForce(MEAN, cells, poisson, table);
    }
  }
  for (const Body& body : BODIES)
  {
    for (const double poisson : POISSONS) addBody(body, poisson, table);
  }
  return table;
}

}  // namespace bezier_fem::bench
