#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "bezier_fem/boundary_conditions.h"
#include "bezier_fem/embedding.h"
#include "bezier_fem/measures.h"
#include "bezier_fem/model.h"
#include "bezier_fem/rest_watch.h"
#include "bezier_fem/scene.h"
#include "bezier_fem/step.h"

namespace bezier_fem
{
/** The surface that a body shows: triangles over material points. */
struct Surface
{
  std::vector<MaterialPoint> points;
  Eigen::Matrix3Xi triangles;     // 3 x triangles, counter-clockwise from outside
  Eigen::Matrix3Xd rest_normals;  // 3 x points, unit, weighted by area
};

struct Energies  // J
{
  double kinetic, elastic, gravity;
};

/**
 * A scene made ready to run: what the command-line tools and the ROS node share. Not thread-safe. Steps allocate no
 * memory after the first.
 */
class Simulation
{
public:
  using Log = std::function<void(const std::string&)>;

  /**
   * Loads the model and everything that the scene names.
   * @param threads  at least 1
   * @param log      gets a line for everything worth telling that is not an error
   * @throws InputError
   */
  Simulation(Scene scene, int threads, const Log& log);

  /**
   * One time step of the scene's length. A body that has come to rest (RestWatch) sleeps: time goes on, its speed is
   * zero, and everything else stays as it is, until a load, a support, the material or the state changes.
   */
  StepReport step();

  /**
   * Moves the body to the static equilibrium of the loads of the current time.
   * @param progress  called before each iteration with its number and the relative residual; may be empty
   * @throws InputError if a piece of the body can move freely, because there is no one equilibrium then
   */
  StepReport solveStatic(const std::function<void(int, double)>& progress = {});

  /** Back to the initial state at time 0; live settings stay. */
  void reset();

  const Scene& scene() const { return scene_; }
  const Model& model() const { return model_; }
  const State& state() const { return state_; }
  const std::vector<AppliedLoad>& loads() const { return loads_; }
  double time() const { return state_.time; }  // s

  // What acts from outside, beside the scene's own loads

  /** Forces on control points (N), num_nodes rows, that act in every step until changed. */
  NodalField& externalForces() { return external_forces_; }

  /** Pose of supports().regions[region], which follows a frame, at the end of the next step, relative to its start. */
  void setRegionPose(int region, const Eigen::Isometry3d& pose) { supports_.regions[region].end = pose; }
  const Supports& supports() const { return supports_; }

  // Live settings; values are those that a scene may have, not checked again

  void setGravity(const Eigen::Vector3d& gravity) { settings_.gravity = gravity; }
  void setDamping(const Scene::Damping& damping) { settings_.damping = damping; }
  /** Material of the body, with the scene's regional overrides on top. */
  void setMaterial(const Material& material);

  // What can be seen

  const Surface& surface() const { return surface_; }
  /** Current surface points, m, and, if not null, unit normals; 3 x points. */
  void evaluateSurface(Eigen::Matrix3Xd& positions, Eigen::Matrix3Xd* normals) const;
  /** Stress at the nodes' material points, Pa, the mean over the elements that meet there: 6 x nodes. */
  Eigen::Matrix<double, 6, Eigen::Dynamic> nodalStress() const;
  /** Von Mises stress at material points, Pa: of the nodes' mean stress, linear in between. */
  void evaluateStress(const std::vector<MaterialPoint>& points, Eigen::VectorXd& von_mises) const;
  /** The same at the surface points. */
  void evaluateSurfaceStress(Eigen::VectorXd& von_mises) const;
  /** Current position of each of the scene's probes, m. */
  std::vector<Eigen::Vector3d> probes() const;
  Energies energies() const;
  /** What each of supports().regions took up in the last step or static solve, at the current positions. */
  std::vector<Reaction> reactions() const;

private:
  Scene scene_;
  Model model_;
  std::vector<std::vector<int>> override_tets_;  // mesh tets of each of the scene's material regions
  Supports supports_;
  NodalField initial_;  // control points, m
  std::vector<AppliedLoad> loads_;
  NodalField external_forces_;
  Surface surface_;
  std::vector<MaterialPoint> probes_;
  StepSettings settings_;
  State state_;
  std::unique_ptr<Workspace> workspace_;
  std::unique_ptr<RestWatch> rest_;
  int inverted_ = 0;  // elements, after the last step that was computed

  std::vector<Material> materials(const Material& base) const;
  void checkExplicit() const;
  bool staysAsleep();
  void addSpin();
};

}  // namespace bezier_fem
