#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <memory>
#include <string>
#include <vector>

#include "bezier_fem/boundary_conditions.h"
#include "bezier_fem/embedding.h"
#include "bezier_fem/measures.h"
#include "bezier_fem/model.h"
#include "bezier_fem/scene.h"
#include "bezier_fem/step.h"
#include "bezier_fem/surface_mesh.h"

namespace bezier_fem
{
/** The surface that a body shows: triangles over material points. */
struct Surface
{
  std::vector<MaterialPoint> points;
  Eigen::Matrix3Xi triangles;     // 3 x triangles, counter-clockwise from outside
  Eigen::Matrix3Xd rest_normals;  // 3 x points, unit, area-weighted
};

struct Energies  // J
{
  double kinetic, elastic, gravity;
};

/**
 * A scene made ready to run: what the command-line tools and the ROS node share. Not thread-safe; steps allocate no
 * memory after the first.
 */
class Simulation
{
public:
  /**
   * Loads the model and everything that the scene names.
   * @param threads  at least 1
   * @param log      gets a line for everything worth telling that is not an error: warnings of the mesh, meshing
   * @throws InputError
   */
  Simulation(const Scene& scene, int threads, const std::function<void(const std::string&)>& log);

  /** One time step of the scene's length. */
  StepReport step();

  /** Puts the state at the static equilibrium of the loads of the current time. */
  StepReport solveStatic();

  /** Back to the initial state at time 0; live settings stay. */
  void reset();

  const Scene& scene() const { return scene_; }
  const Model& model() const { return model_; }
  const State& state() const { return state_; }
  double time() const { return state_.time; }  // s

  // What acts from outside, beside the scene's own loads ---------------------------------------------------------

  /** Forces on control points (N) that act in every step until changed; num_nodes rows. */
  NodalField& externalForces() { return external_forces_; }

  /** Pose of a region that follows a frame, at the end of the next step, relative to where it started. */
  void setRegionPose(int region, const Eigen::Isometry3d& pose);
  const Supports& supports() const { return supports_; }

  /** Live settings; values as Scene allows them, not checked again. The material of the whole body, then regions. */
  void setGravity(const Eigen::Vector3d& gravity) { settings_.gravity = gravity; }
  void setDamping(const Scene::Damping& damping) { settings_.damping = damping; }
  void setMaterial(const Material& material);

  // What can be seen -----------------------------------------------------------------------------------------------

  const Surface& surface() const { return surface_; }
  /** Current surface points and, if not null, unit normals; 3 x points. */
  void evaluateSurface(Eigen::Matrix3Xd& positions, Eigen::Matrix3Xd* normals) const;
  /** Von Mises stress at the surface points, Pa. */
  void evaluateSurfaceStress(Eigen::VectorXd& von_mises) const;
  /** Current positions of the scene's probes, m, in its order. */
  std::vector<Eigen::Vector3d> probes() const;
  Energies energies() const;
  /** Force and torque that each of supports().regions takes up, of the last step. */
  std::vector<Reaction> reactions() const;

private:
  // ...
};

}  // namespace bezier_fem
