// Bullet's deformable body on the bar of config/bar.yaml: what a step costs there, and how it moves.
//
// One line of JSON a run. Linear tetrahedra with lumped masses (Bullet knows no others), co-rotated linear elasticity
// (btDeformableLinearElasticityForce, the law of `elasticity: corotated`) or stable Neo-Hookean
// (btDeformableNeoHookean- Force), backward Euler, no damping but the integrator's in a swing, no collisions.
//
// Settings: `default` is what Bullet's demos of implicit deformables set (VolumetricDeformable, LargeDeformation): one
// Newton iteration of at most 300 conjugate-gradient iterations, without line search, with projections. `converged`
// takes four of as many as they need: the tip moves by less than 1e-6 m with more. The end of Newton's iterations by
// residual cannot be used, since Bullet counts the forces that hold the bar; nor can line search, whose energy knows no
// rotation. Both take rotations from Bullet, which iterates to 0.01 rad (btSoftBody::updateDeformation).
#include <BulletCollision/BroadphaseCollision/btDbvtBroadphase.h>
#include <BulletSoftBody/btDeformableBodySolver.h>
#include <BulletSoftBody/btDeformableLinearElasticityForce.h>
#include <BulletSoftBody/btDeformableMultiBodyConstraintSolver.h>
#include <BulletSoftBody/btDeformableMultiBodyDynamicsWorld.h>
#include <BulletSoftBody/btDeformableNeoHookeanForce.h>
#include <BulletSoftBody/btSoftBodyHelpers.h>
#include <BulletSoftBody/btSoftBodyRigidBodyCollisionConfiguration.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "clamped_bar.h"
#include "core/bar.h"

namespace bezier_fem::bench
{
namespace
{
using Json = nlohmann::ordered_json;

const Eigen::Vector3d SIZE(0.4, 0.4, 1);  // m

struct Settings
{
  std::string name;
  int newton_iterations;  // each step
  int cg_iterations;      // at most, each Newton iteration
};

/** Bullet's solver with its limits set, which it has no functions for. */
class Solver : public btDeformableBodySolver
{
public:
  explicit Solver(const Settings& settings)
  {
    m_maxNewtonIterations = settings.newton_iterations;
    m_newtonTolerance = 0;  // cannot be met: the residual counts what holds the bar
    m_cg.m_maxIterations = settings.cg_iterations;
  }
};

/** Bullet's world with the bar in it; `damping` in s, of the elastic law as Rayleigh's of the stiffness. */
class World
{
public:
  World(const TetMesh& mesh, const std::string& law, double damping, const Settings& settings)
      : solver_(settings),
        dispatcher_(&configuration_),
        world_(&dispatcher_, &broadphase_, &constraints_, &configuration_, &solver_)
  {
    constraints_.setDeformableSolver(&solver_);
    const btVector3 down(0, btScalar(-9.81), 0);
    world_.setGravity(down);
    world_.getWorldInfo().m_gravity = down;
    world_.setImplicit(true);
    world_.setLineSearch(false);
    world_.setUseProjection(true);

    std::vector<btVector3> points;
    for (const auto& p : mesh.corners.colwise()) points.emplace_back(btScalar(p.x()), btScalar(p.y()), btScalar(p.z()));
    body_ =
        std::make_unique<btSoftBody>(&world_.getWorldInfo(), static_cast<int>(points.size()), points.data(), nullptr);
    std::vector<double> masses(points.size(), 0);
    for (const auto& tet : mesh.tets.colwise())
    {
      body_->appendTetra(tet[0], tet[1], tet[2], tet[3]);
      for (int i = 0; i < 4; ++i)
        for (int j = i + 1; j < 4; ++j) body_->appendLink(tet[i], tet[j], nullptr, true);
      const Eigen::Vector3d origin = mesh.corners.col(tet[0]);
      const double volume = (mesh.corners.col(tet[1]) - origin)
                                .cross(mesh.corners.col(tet[2]) - origin)
                                .dot(mesh.corners.col(tet[3]) - origin) /
                            6;
      for (const int corner : tet) masses[corner] += test::RUBBER.density * volume / 4;
    }
    btSoftBodyHelpers::generateBoundaryFaces(body_.get());
    body_->initializeDmInverse();
    body_->m_tetraScratches.resize(body_->m_tetras.size());
    body_->m_tetraScratchesTn.resize(body_->m_tetras.size());
    for (Eigen::Index i = 0; i < mesh.corners.cols(); ++i)
    {
      const bool held = mesh.corners(2, i) == 0;
      body_->setMass(static_cast<int>(i), btScalar(held ? 0 : masses[i]));
      const Eigen::Vector3d from_tip = mesh.corners.col(i) - Eigen::Vector3d(0, 0, SIZE.z());
      if (from_tip.norm() < 1e-9) tip_ = static_cast<int>(i);
    }
    body_->m_cfg.collisions = 0;
    body_->m_sleepingThreshold = 0;
    body_->setActivationState(DISABLE_DEACTIVATION);
    world_.addSoftBody(body_.get());

    const Material& m = test::RUBBER;
    const double mu = m.young / (2 * (1 + m.poisson));
    const double lambda = m.young * m.poisson / ((1 + m.poisson) * (1 - 2 * m.poisson));
    if (law == "neo_hookean")
    {
      // So that small strains see these Lame parameters: Smith, de Goes and Kim 2018, section 3.4.
      elasticity_ = std::make_unique<btDeformableNeoHookeanForce>(btScalar(4 * mu / 3), btScalar(lambda + 5 * mu / 6),
                                                                  btScalar(damping));
    }
    else
    {
      elasticity_ = std::make_unique<btDeformableLinearElasticityForce>(btScalar(mu), btScalar(lambda), btScalar(0),
                                                                        btScalar(damping));
    }
    gravity_ = std::make_unique<btDeformableGravityForce>(down);
    world_.addForce(body_.get(), gravity_.get());
    world_.addForce(body_.get(), elasticity_.get());
  }
  World(const World&) = delete;
  World& operator=(const World&) = delete;
  ~World() { world_.removeSoftBody(body_.get()); }

  void step(double time_step) { world_.stepSimulation(btScalar(time_step), 0); }

  Eigen::Vector3d tip() const
  {
    const btVector3& p = body_->m_nodes[tip_].m_x;
    return {p.x(), p.y(), p.z()};
  }

  double fastest() const  // m/s
  {
    double speed = 0;
    for (int i = 0; i < body_->m_nodes.size(); ++i)
      speed = std::max(speed, static_cast<double>(body_->m_nodes[i].m_v.length()));
    return speed;
  }

private:
  Solver solver_;
  btSoftBodyRigidBodyCollisionConfiguration configuration_;
  btCollisionDispatcher dispatcher_;
  btDbvtBroadphase broadphase_;
  btDeformableMultiBodyConstraintSolver constraints_;
  btDeformableMultiBodyDynamicsWorld world_;
  std::unique_ptr<btSoftBody> body_;
  std::unique_ptr<btDeformableLagrangianForce> gravity_, elasticity_;
  int tip_ = -1;
};

Json described(const TetMesh& mesh, const std::string& law, const Settings& settings, double time_step)
{
  return {{"program", "bullet"},
          {"version", btGetVersion()},
          {"precision", sizeof(btScalar) == 8 ? "double" : "single"},
          {"law", law},
          {"settings", settings.name},
          {"newton_iterations", settings.newton_iterations},
          {"cg_iterations_at_most", settings.cg_iterations},
          {"cg_tolerance_of_squared_residual", SIMD_EPSILON},
          {"tets", mesh.tets.cols()},
          {"nodes", mesh.corners.cols()},
          {"line_search", false},
          {"time_step", time_step}};
}

/** Swings the bar from rest, without damping. */
Json swing(const TetMesh& mesh, const std::string& law, const Settings& settings, double time_step, double duration)
{
  World world(mesh, law, 0, settings);
  std::vector<double> ms;
  Json trajectory = Json::array();
  const auto record = [&](double time) {
    const Eigen::Vector3d p = world.tip();
    trajectory.push_back({time, p.x(), p.y(), p.z()});
  };
  record(0);
  const int steps = static_cast<int>(std::lround(duration / time_step));
  for (int k = 1; k <= steps; ++k)
  {
    const auto start = std::chrono::steady_clock::now();
    world.step(time_step);
    ms.push_back(std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count());
    record(k * time_step);
  }
  std::nth_element(ms.begin(), ms.begin() + steps / 2, ms.end());
  Json row = described(mesh, law, settings, time_step);
  row["run"] = "swing";
  row["damping"] = 0;
  row["steps"] = steps;
  row["ms_per_step"] = ms[steps / 2];
  row["ms_per_simulated_second"] = ms[steps / 2] / time_step;
  row["tip"] = std::move(trajectory);
  return row;
}

/** Lets the bar come to rest, damped about critically. */
Json settle(const TetMesh& mesh, const std::string& law, const Settings& settings)
{
  constexpr double TIME_STEP = 0.02, DAMPING = 0.25, LONGEST = 20, REST = 1e-5;  // s, s, s, m/s
  World world(mesh, law, DAMPING, settings);
  double time = 0;
  const auto start = std::chrono::steady_clock::now();
  do
  {
    world.step(TIME_STEP);
    time += TIME_STEP;
  } while (time < LONGEST && (time < 1 || world.fastest() > REST));
  const Eigen::Vector3d p = world.tip();
  Json row = described(mesh, law, settings, TIME_STEP);
  row["run"] = "static";
  row["damping"] = DAMPING;
  row["simulated_seconds"] = time;
  row["fastest"] = world.fastest();
  row["settled"] = world.fastest() <= REST;
  row["ms"] = std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
  row["tip"] = {p.x(), p.y(), p.z()};
  return row;
}

}  // namespace
}  // namespace bezier_fem::bench

int main(int argc, char** argv)
{
  using namespace bezier_fem;
  using namespace bezier_fem::bench;
  std::vector<int> across{2, 4, 6, 8};
  std::vector<double> time_steps{0.02, 0.01, 0.005, 0.0025};
  std::vector<std::string> laws{"corotated"}, names{"default", "converged"};
  double duration = 0.9;
  CLI::App app(
      "The bar of config/bar.yaml as Bullet's deformable body: a line of JSON for each way that it swings, with the "
      "tip\n"
      "(t, x, y, z of the lower free corner, every step), and for each mesh one with the tip at rest (run: static).");
  app.add_option("--across", across, "Cells across the bar, each value a mesh")->expected(1, -1)->capture_default_str();
  app.add_option("--time-step", time_steps, "s")->expected(1, -1)->capture_default_str();
  app.add_option("--law", laws, "corotated, neo_hookean")
      ->expected(1, -1)
      ->check(CLI::IsMember({"corotated", "neo_hookean"}))
      ->capture_default_str();
  app.add_option("--settings", names, "default, converged")
      ->expected(1, -1)
      ->check(CLI::IsMember({"default", "converged"}))
      ->capture_default_str();
  app.add_option("--duration", duration, "s, of a swing")->capture_default_str();
  CLI11_PARSE(app, argc, argv);

  for (const int cells : across)
  {
    const TetMesh mesh = test::kuhnBox(cubicCells(cells), SIZE);
    for (const std::string& law : laws)
      for (const std::string& name : names)
      {
        const Settings settings = name == "default" ? Settings{name, 1, 300} : Settings{name, 4, 10000};
        const auto print = [](const Json& row) { std::printf("%s\n", row.dump().c_str()), std::fflush(stdout); };
        print(settle(mesh, law, settings));
        for (const double time_step : time_steps) print(swing(mesh, law, settings, time_step, duration));
      }
  }
  return 0;
}
