// A scene run with what the package does not do, because it breaks: explicit steps of a fixed length, whatever is
// stable, and co-rotation by the plain polar decomposition, whose rotation of an inverted element is a reflection.
// Only what the atlas of failure (scripts/stability) needs: no damping by stiffness, no regions that follow a frame.

#include <CLI/CLI.hpp>
#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <fstream>
#include <iostream>
#include <nlohmann/json.hpp>
#include <numeric>

#include "bezier_fem/error.h"
#include "bezier_fem/green_strain.h"
#include "bezier_fem/measures.h"
#include "bezier_fem/simulation.h"

namespace
{
using namespace bezier_fem;

class Run
{
public:
  explicit Run(const Simulation& simulation)
      : scene_(simulation.scene()),
        model_(simulation.model()),
        supports_(simulation.supports()),
        loads_(simulation.loads()),
        state_(simulation.state()),
        partition_(model_, 1),
        solver_(model_, partition_),
        force_(model_.num_nodes),
        rhs_(model_.num_nodes),
        change_(model_.num_nodes),
        led_(model_.num_nodes)
  {
  }

  /** Velocity Verlet with the consistent mass matrix, one step a time step. */
  void explicitStep()
  {
    const double h = scene_.time_step;
    const MatrixFreeSystem<Rotations> mass(model_, partition_, state_.rotations, 1, 0);
    solver_.prepare(mass, model_, partition_, supports_.held, 1e-3 * h);
    NodalField& goal = led_;
    goal.matrix() = state_.x.matrix();
    applySupports(supports_, time() + h, 1, goal);
    for (int i = 0; i < model_.num_nodes; ++i)
    {
      for (int axis = 0; axis < 3; ++axis)
      {
        const bool held = supports_.held[i] >> axis & 1;
        led_[i][axis] = held ? (goal[i][axis] - state_.x[i][axis]) / h - state_.v[i][axis] : 0;
      }
    }
    kick(mass, h / 2, time());
    state_.x.matrix() += h * state_.v.matrix();
    if (scene_.elasticity == Elasticity::COROTATED)
    {
      const Rotations before = state_.rotations;
      AlignedVector<double> turned(before.flags.size());
      updateRotations(model_, partition_, state_.x, before, state_.rotations, turned);
    }
    led_.setZero();
    kick(mass, h / 2, time() + h);
    ++state_.steps;
  }

  /** Linearised implicit Euler with the rotations U W^T of F = U S W^T, S >= 0; no sub-steps. */
  void plainPolarStep()
  {
    const double h = scene_.time_step, damp = scene_.damping.mass;
    takePlainRotations();
    load(time() + h / 2);
    change_.matrix() = state_.x.matrix() + h * state_.v.matrix();
    elasticForce(model_, partition_, state_.rotations, change_, force_);
    rhs_.matrix() = h * (rhs_.matrix() - force_.matrix());
    systemProduct(model_, partition_, state_.rotations, h * damp, 0, state_.v, force_);
    rhs_.matrix() -= force_.matrix();

    const MatrixFreeSystem<Rotations> system(model_, partition_, state_.rotations, 1 + h * damp, h * h);
    solver_.prepare(system, model_, partition_, supports_.held, 1e-3 * h);
    led_.matrix() = change_.matrix();
    applySupports(supports_, time() + h, 1, led_);
    led_.matrix() = (led_.matrix() - change_.matrix()) / h;
    system.product(led_, force_);
    rhs_.matrix() -= force_.matrix();
    solve(system);
    state_.v.matrix() += change_.matrix() + led_.matrix();
    state_.x.matrix() += h * state_.v.matrix();
    ++state_.steps;
  }

  double time() const { return scene_.time_step * static_cast<double>(state_.steps); }
  bool finite() const
  {
    return state_.x.matrix().allFinite() && state_.v.matrix().allFinite() && std::isfinite(residual_);
  }
  bool converged() const { return residual_ <= scene_.solver.tolerance; }

  void writeRow(std::ostream& out, const std::vector<int>& order) const
  {
    for (const int i : order)
    {
      const Eigen::Vector3d p = nodePosition(model_, state_.x, i);
      out << time() << ',' << model_.ids[i] << ',' << p.x() << ',' << p.y() << ',' << p.z() << '\n';
    }
  }

  nlohmann::ordered_json summary() const
  {
    return {{"elements", model_.num_tets},
            {"steps", state_.steps},
            {"status", !finite()     ? "diverged"
                       : converged() ? "ok"
                                     : "not_converged"},
            {"residual", finite() ? nlohmann::ordered_json(residual_) : nlohmann::ordered_json()},
            {"inverted_elements", invertedElements(model_, state_.x)},
            {"energy", {{"kinetic", finite() ? kineticEnergy(model_, state_.v) : INFINITY}}}};
  }

private:
  const Scene& scene_;
  const Model& model_;
  const Supports& supports_;
  const std::vector<AppliedLoad>& loads_;
  State state_;
  Partition partition_;
  ConjugateGradient solver_;
  NodalField force_, rhs_, change_, led_;
  double residual_ = 0;

  /** Gravity and loads, into rhs_. */
  void load(double time)
  {
    for (int i = 0; i < model_.num_nodes; ++i) rhs_[i] = model_.node_mass[i] * scene_.gravity;
    addLoads(model_, loads_, time, state_.x, rhs_);
  }

  void solve(const SystemOperator& system)
  {
    change_.setZero();
    const SolveReport solved =
        solver_.solve(system, partition_, rhs_, change_, scene_.solver.tolerance, scene_.solver.max_iterations);
    residual_ = std::max(solved.residual, residual_);  // what is no number stays
  }

  /** v += k M^-1 f where free, v += led elsewhere. */
  void kick(const SystemOperator& mass, double k, double time)
  {
    load(time);
    if (scene_.elasticity == Elasticity::GREEN)
    {
      greenForce(model_, partition_, state_.x, force_);
    }
    else
    {
      elasticForce(model_, partition_, state_.rotations, state_.x, force_);
    }
    rhs_.matrix() = k * (rhs_.matrix() - force_.matrix());
    change_.matrix() = k * scene_.damping.mass * state_.v.matrix() + led_.matrix();
    mass.product(change_, force_);
    rhs_.matrix() -= force_.matrix();
    solve(mass);
    state_.v.matrix() += change_.matrix() + led_.matrix();
  }

  void takePlainRotations()
  {
    for (int t = 0; t < model_.num_tets; ++t)
    {
      const int* nodes = model_.nodesOf(t);
      const Eigen::Matrix3d g = model_.gradients.middleCols<3>(3 * t);
      Eigen::Matrix3d edges;
      for (int k = 0; k < 3; ++k) edges.col(k) = state_.x[nodes[k + 1]] - state_.x[nodes[0]];
      const Eigen::JacobiSVD<Eigen::Matrix3d> svd(edges * g.transpose(), Eigen::ComputeFullU | Eigen::ComputeFullV);
      const Eigen::Matrix3d R = svd.matrixU() * svd.matrixV().transpose();
      const Eigen::Matrix3d turned = (R * g).transpose();
      const std::ptrdiff_t first = static_cast<std::ptrdiff_t>(t / LANES) * 9 * LANES + t % LANES;
      for (int k = 0; k < 9; ++k)
      {
        state_.rotations.matrices[first + k * LANES] = R(k / 3, k % 3);
        state_.rotations.gradients[first + k * LANES] = turned(k / 3, k % 3);
      }
    }
  }
};
}  // namespace

int main(int argc, char** argv)
{
  std::string scene, nodes, summary;
  std::vector<std::string> overrides;
  std::string method;
  long steps = 0, every = 1;
  CLI::App app{"Runs a scene by a method that breaks, for comparison; files as run_scene writes them."};
  app.add_option("SCENE", scene, "Scene file")->required();
  app.add_option("--method", method, "explicit: fixed steps; plain_polar: reflections where elements are inverted")
      ->required()
      ->check(CLI::IsMember({"explicit", "plain_polar"}));
  app.add_option("--set", overrides, "KEY=VALUE")->take_all()->allow_extra_args(false);
  app.add_option("--steps", steps, "Steps")->required()->check(CLI::PositiveNumber);
  app.add_option("--every", every, "Rows only for every K-th step, and the last")->check(CLI::PositiveNumber);
  app.add_option("--nodes", nodes, "CSV file for the positions of all nodes, m")->required();
  app.add_option("--summary", summary, "JSON file for what came out")->required();
  CLI11_PARSE(app, argc, argv);
  try
  {
    const Simulation simulation(loadScene(scene, overrides), 1, [](const std::string&) {});
    const std::vector<std::int64_t>& ids = simulation.model().ids;
    std::vector<int> order(ids.size());
    std::iota(order.begin(), order.end(), 0);
    std::sort(order.begin(), order.end(), [&](int a, int b) { return ids[a] < ids[b]; });
    std::ofstream rows(nodes), result(summary);
    rows.precision(17);
    rows << "time,node,x,y,z\n";
    Run run(simulation);
    run.writeRow(rows, order);
    for (long step = 1; step <= steps && run.finite(); ++step)
    {
      method == "explicit" ? run.explicitStep() : run.plainPolarStep();
      if (step % every == 0 || step == steps || !run.finite()) run.writeRow(rows, order);
    }
    result << run.summary().dump(2) << '\n';
    rows.close();
    result.close();
    if (!rows || !result) throw std::runtime_error(nodes + " or " + summary + " cannot be written");
  }
  catch (const InputError& error)
  {
    std::cerr << error.what() << std::endl;
    return 2;
  }
  catch (const std::exception& error)
  {
    std::cerr << "bench_stability: " << error.what() << std::endl;
    return 1;
  }
}
