#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <limits>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace bezier_fem
{
enum class Element
{
  LINEAR,
  QUADRATIC
};

enum class Elasticity
{
  COROTATED,
  GREEN,  // Green's strain, St. Venant-Kirchhoff
  LINEAR  // small strain, no rotation
};

/** Where a co-rotated quadratic element takes its rotation from; for linear elements all are the same. */
enum class RotationRule
{
  FROM_CORNERS,   // the gradient of the corner control points (Weber et al. 2011)
  FROM_CENTROID,  // the gradient at the centroid
  FOUR_POINTS     // four rotations, at the points of the rule of degree 2 (after Mezger et al. 2008)
};

/** The change of volume that quadratic elements resist; linear ones have one only, and Green's strain has FULL. */
enum class Dilatation
{
  AUTO,  // MEAN in nearly incompressible elements
  FULL,  // that at every point: locks as Poisson's ratio goes to 0.5
  MEAN   // in part its mean over the element (model.h)
};

enum class Integrator
{
  IMPLICIT_EULER,
  SDIRK2,  // of second order, implicit (Alexander 1977)
  AUTO,    // SDIRK2, or implicit Euler in steps that the former does not get through
  EXPLICIT,
  STATIC
};

/** Selects points, faces or elements of the rest shape, in frame_id, after scale and pose. Exactly one member is set.
 */
struct Region
{
  struct Box
  {
    Eigen::Vector3d min, max;  // m
  };
  struct Sphere
  {
    Eigen::Vector3d center;  // m
    double radius;           // m
  };
  std::optional<Box> box;
  std::optional<Sphere> sphere;
  std::optional<std::string> group;
  std::optional<std::vector<std::int64_t>> nodes;  // the file's ids
};

struct Material
{
  double young;    // Pa
  double poisson;  // -1 < poisson < 0.5
  double density;  // kg/m^3
};

/**
 * A simulation as the user describes it, with every default. SI units, right-handed, z up; each member is the key of
 * the same name in the scene file (doc/scene_file.md).
 */
struct Scene
{
  struct Model
  {
    std::string file;                               // absolute
    std::optional<double> cell_size;                // m, after scaling; for surfaces
    std::optional<std::string> sizing;              // absolute path of a CSV file, see sizing.h; in frame_id, at rest
    int refine = 0;                                 // times that every tetrahedron is cut into eight, 0 to 4
    double scale = 1;                               // 1 where longest_side is set
    std::optional<double> longest_side;             // m
    Eigen::Vector3d xyz = Eigen::Vector3d::Zero();  // m
    Eigen::Vector3d rpy = Eigen::Vector3d::Zero();  // rad, fixed axes: R = Rz(yaw) Ry(pitch) Rx(roll)
  } model;

  Element element = Element::QUADRATIC;
  Elasticity elasticity = Elasticity::COROTATED;
  RotationRule rotation = RotationRule::FROM_CORNERS;
  Dilatation dilatation = Dilatation::AUTO;

  Material material;
  struct MaterialOverride  // later ones win
  {
    std::string key;  // where it stands in the scene, for messages: "material.regions[0]"
    Region region;
    std::optional<double> young, poisson, density;
  };
  std::vector<MaterialOverride> material_regions;

  struct Damping
  {
    double mass = 0;       // 1/s
    double stiffness = 0;  // s
  } damping;

  Eigen::Vector3d gravity{0, 0, -9.81};  // m/s^2
  double time_step = 0.02;               // s
  Integrator integrator = Integrator::IMPLICIT_EULER;

  struct Solver
  {
    double tolerance = 1e-4;
    int max_iterations = 500;
    enum class Preconditioner
    {
      AUTO,
      BLOCK_JACOBI,
      PMULTIGRID,
      DIRECT
    } preconditioner = Preconditioner::AUTO;
    enum class Operator
    {
      MATRIX_FREE,
      ASSEMBLED
    } system_operator = Operator::MATRIX_FREE;
  } solver;

  struct Initial
  {
    std::optional<std::string> positions;                // absolute path of a CSV file: node,x,y,z
    Eigen::Vector3d velocity = Eigen::Vector3d::Zero();  // m/s
    Eigen::Vector3d spin = Eigen::Vector3d::Zero();      // rad/s, about the centre of mass
  } initial;

  struct Fixed
  {
    std::string key;   // "fixed[0]", for messages
    std::string name;  // unique; fixed_0, fixed_1, ... by position where the file gives none
    Region region;
    std::array<bool, 3> axes{true, true, true};
    std::optional<std::string> motion;  // absolute path of a CSV file
    std::optional<std::string> frame;   // tf frame; only the node has one
  };
  std::vector<Fixed> fixed;

  struct Load
  {
    std::string key;  // "loads[0]", for messages
    Region region;
    std::optional<Eigen::Vector3d> force;                    // N in all
    std::optional<Eigen::Vector3d> traction;                 // Pa; exactly one of force, traction and pressure is set
    std::optional<double> pressure;                          // Pa, into the body
    double from = 0;                                         // s
    double until = std::numeric_limits<double>::infinity();  // s
  };
  std::vector<Load> loads;

  std::optional<std::string> surface_file;  // absolute

  std::vector<std::pair<std::string, Eigen::Vector3d>> probes;  // name and rest position in m, in the file's order

  std::string frame_id = "world";

  struct Node  // read by the ROS node only
  {
    enum class Mode
    {
      REALTIME,
      LOCKSTEP,
      FREE_RUN
    };
    Mode mode = Mode::REALTIME;
    double publish_rate = 30;  // Hz
    struct Wrench
    {
      double radius = 0.05;       // m
      double max_distance = 0.1;  // m
      double timeout = 0.5;       // s
    } wrench;
  } node;
};

/**
 * Reads and checks a scene file.
 * @param overrides  "KEY=VALUE" with a dotted key ("material.young=1.0e+6", "fixed[0].axes=[z]", "loads[1].until=2")
 *                   and a YAML value; applied before the checks
 * @throws InputError that names the key, its value and what is allowed
 */
Scene loadScene(const std::string& path, const std::vector<std::string>& overrides = {});

/** The same from YAML text; relative paths are relative to `directory`, and messages begin with `source`. */
Scene parseScene(const std::string& yaml, const std::string& directory, const std::string& source);

/** One row of a motion file: the region's pose relative to rest. */
struct MotionSample
{
  double time;                  // s
  Eigen::Vector3d translation;  // m
  Eigen::Vector4d quaternion;   // x, y, z, w; unit
};

/** Reads time,x,y,z,qx,qy,qz,qw with that header; times strictly increasing, quaternions normalised on reading. */
std::vector<MotionSample> readMotion(const std::string& path);

/** Reads node,x,y,z with that header: positions of material points by the mesh file's node id. Ids are unique. */
std::map<std::int64_t, Eigen::Vector3d> readPositions(const std::string& path);

}  // namespace bezier_fem
