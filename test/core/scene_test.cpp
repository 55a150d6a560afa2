#include "bezier_fem/scene.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <set>
#include <sstream>

#include "bezier_fem/error.h"
#include "bezier_fem/sizing.h"

namespace bezier_fem
{
namespace
{
namespace fs = std::filesystem;

const fs::path PACKAGE = fs::path(TEST_DATA_DIR).parent_path().parent_path();

/** A folder of its own, gone at the end of the test. */
class SceneTest : public testing::Test
{
protected:
  void SetUp() override
  {
    std::string name = (fs::temp_directory_path() / "scene_test.XXXXXX").string();
    ASSERT_NE(mkdtemp(name.data()), nullptr);
    folder_ = name;
    write("body.msh", "");
    write("skin.off", "");
    write("hand.csv", "");
    write("start.csv", "");
    write("sizes.csv", "");
  }
  void TearDown() override { fs::remove_all(folder_); }

  std::string write(const std::string& name, const std::string& text) const
  {
    const fs::path path = folder_ / name;
    fs::create_directories(path.parent_path());
    std::ofstream(path, std::ios::binary) << text;
    return path.string();
  }

  Scene parse(const std::string& yaml) const { return parseScene(yaml, folder_.string(), "SOURCE"); }

  /** The smallest scene, with overrides. */
  Scene load(const std::vector<std::string>& overrides = {}) const
  {
    return loadScene(write("scene.yaml", "model: {file: body.msh}\nmaterial: {young: 2, poisson: 0.3, density: 4}\n"),
                     overrides);
  }

  /** What the call throws; fails unless that is one line. */
  template <typename Call>
  static std::string errorOf(Call call)
  {
    try
    {
      call();
    }
    catch (const InputError& error)
    {
      const std::string what = error.what();
      EXPECT_EQ(what.find_first_of("\n\r"), std::string::npos) << what;
      return what;
    }
    ADD_FAILURE() << "no InputError";
    return {};
  }

  /** Fails unless the scene with the override is refused in words that hold all of these. */
  void expectRefused(const std::string& override, const std::vector<std::string>& words) const
  {
    SCOPED_TRACE(override);
    const std::string what = errorOf([&] { load({override}); });
    EXPECT_EQ(what.rfind((folder_ / "scene.yaml").string() + ": ", 0), 0u) << what;
    for (const std::string& word : words)
      EXPECT_NE(what.find(word), std::string::npos) << word << " is not in: " << what;
  }

  void expectParseError(const std::string& yaml, const std::vector<std::string>& words) const
  {
    SCOPED_TRACE(yaml.substr(0, 200));
    const std::string what = errorOf([&] { parse(yaml); });
    EXPECT_EQ(what.rfind("SOURCE: ", 0), 0u) << what;
    for (const std::string& word : words)
      EXPECT_NE(what.find(word), std::string::npos) << word << " is not in: " << what;
  }

  fs::path folder_;
};

const std::string MINIMAL = "model: {file: body.msh}\nmaterial: {young: 2, poisson: 0.3, density: 4}\n";

TEST_F(SceneTest, DefaultsAreThoseOfTheFormat)
{
  const Scene scene = parse(MINIMAL);
  EXPECT_EQ(scene.model.file, (folder_ / "body.msh").string());
  EXPECT_FALSE(scene.model.cell_size);
  EXPECT_EQ(scene.model.refine, 0);
  EXPECT_FALSE(scene.model.sizing);
  EXPECT_EQ(scene.model.refine, 0);
  EXPECT_EQ(scene.model.scale, 1);
  EXPECT_FALSE(scene.model.longest_side);
  EXPECT_EQ(scene.model.xyz, Eigen::Vector3d(0, 0, 0));
  EXPECT_EQ(scene.model.rpy, Eigen::Vector3d(0, 0, 0));
  EXPECT_EQ(scene.element, Element::QUADRATIC);
  EXPECT_EQ(scene.elasticity, Elasticity::COROTATED);
  EXPECT_EQ(scene.dilatation, Dilatation::AUTO);
  EXPECT_EQ(scene.material.young, 2);
  EXPECT_EQ(scene.material.poisson, 0.3);
  EXPECT_EQ(scene.material.density, 4);
  EXPECT_TRUE(scene.material_regions.empty());
  EXPECT_EQ(scene.damping.mass, 0);
  EXPECT_EQ(scene.damping.stiffness, 0);
  EXPECT_EQ(scene.gravity, Eigen::Vector3d(0, 0, -9.81));
  EXPECT_EQ(scene.time_step, 0.02);
  EXPECT_EQ(scene.integrator, Integrator::IMPLICIT_EULER);
  EXPECT_EQ(scene.solver.tolerance, 1e-4);
  EXPECT_EQ(scene.solver.max_iterations, 500);
  EXPECT_FALSE(scene.initial.positions);
  EXPECT_EQ(scene.initial.velocity, Eigen::Vector3d(0, 0, 0));
  EXPECT_EQ(scene.initial.spin, Eigen::Vector3d(0, 0, 0));
  EXPECT_TRUE(scene.fixed.empty());
  EXPECT_TRUE(scene.loads.empty());
  EXPECT_FALSE(scene.surface_file);
  EXPECT_TRUE(scene.probes.empty());
  EXPECT_EQ(scene.frame_id, "world");
  EXPECT_EQ(scene.node.mode, Scene::Node::Mode::REALTIME);
  EXPECT_EQ(scene.node.publish_rate, 30);
  EXPECT_EQ(scene.node.wrench.radius, 0.05);
  EXPECT_EQ(scene.node.wrench.max_distance, 0.1);
  EXPECT_EQ(scene.node.wrench.timeout, 0.5);
}

TEST_F(SceneTest, ReadsEveryKey)
{
  const Scene scene = parse(R"(
model:
  {file: skin.off, cell_size: 0.08, sizing: sizes.csv, refine: 2, longest_side: 1.5,
   pose: {xyz: [1, 2, 3], rpy: [0.1, 0.2, 0.3]}}
element: linear
elasticity: linear
rotation: corners
dilatation: mean
material:
  young: 2.0e+5
  poisson: 0.45
  density: 500
  regions:
    - {group: bone, young: 1.0e+7}
    - {box: {min: [0, 0, 0], max: [1, 1, 1]}, poisson: 0.1, density: 900}
damping: {mass: 0.5, stiffness: 0.25}
gravity: [1, -2, 3.5]
time_step: 0.01
integrator: static
solver: {preconditioner: block_jacobi, operator: matrix_free, tolerance: 1.0e-6, max_iterations: 7}
initial: {positions: start.csv, velocity: [4, 5, 6], spin: [7, 8, 9]}
fixed:
  - {name: feet, box: {min: [-1, -1, -1], max: [1, 1, 0.05]}}
  - {sphere: {center: [1, 2, 3], radius: 4}, axes: [z, x]}
  - {group: wall, motion: hand.csv}
  - {group: 12, frame: gripper_link}
loads:
  - {nodes: [3, 9223372036854775807], force: [0, 0, 10]}
  - {group: top, traction: [1, 2, 3], from: 0.5, until: 1}
  - {group: side, pressure: -20}
surface: {file: skin.off}
probes: {nose: [0.1, 0.5, 0.9], ear: [1, 1, 1]}
frame_id: base_link
node: {mode: lockstep, publish_rate: 12.5, wrench: {radius: 1, max_distance: 2, timeout: 3}}
)");
  EXPECT_EQ(scene.model.file, (folder_ / "skin.off").string());
  EXPECT_EQ(scene.model.cell_size, 0.08);
  EXPECT_EQ(scene.model.refine, 2);
  EXPECT_EQ(scene.model.sizing, (folder_ / "sizes.csv").string());
  EXPECT_EQ(scene.model.refine, 2);
  EXPECT_EQ(scene.model.longest_side, 1.5);
  EXPECT_EQ(scene.model.xyz, Eigen::Vector3d(1, 2, 3));
  EXPECT_EQ(scene.model.rpy, Eigen::Vector3d(0.1, 0.2, 0.3));
  EXPECT_EQ(scene.element, Element::LINEAR);
  EXPECT_EQ(scene.elasticity, Elasticity::LINEAR);
  EXPECT_EQ(scene.dilatation, Dilatation::MEAN);
  EXPECT_EQ(scene.material.young, 2e5);
  EXPECT_EQ(scene.material.poisson, 0.45);
  EXPECT_EQ(scene.material.density, 500);

  ASSERT_EQ(scene.material_regions.size(), 2u);
  EXPECT_EQ(scene.material_regions[0].key, "material.regions[0]");
  EXPECT_EQ(scene.material_regions[0].region.group, "bone");
  EXPECT_EQ(scene.material_regions[0].young, 1e7);
  EXPECT_FALSE(scene.material_regions[0].poisson);
  EXPECT_FALSE(scene.material_regions[0].density);
  EXPECT_EQ(scene.material_regions[1].key, "material.regions[1]");
  EXPECT_TRUE(scene.material_regions[1].region.box);
  EXPECT_FALSE(scene.material_regions[1].young);
  EXPECT_EQ(scene.material_regions[1].poisson, 0.1);
  EXPECT_EQ(scene.material_regions[1].density, 900);

  EXPECT_EQ(scene.damping.mass, 0.5);
  EXPECT_EQ(scene.damping.stiffness, 0.25);
  EXPECT_EQ(scene.gravity, Eigen::Vector3d(1, -2, 3.5));
  EXPECT_EQ(scene.time_step, 0.01);
  EXPECT_EQ(scene.integrator, Integrator::STATIC);
  EXPECT_EQ(scene.solver.tolerance, 1e-6);
  EXPECT_EQ(scene.solver.max_iterations, 7);
  EXPECT_EQ(scene.initial.positions, (folder_ / "start.csv").string());
  EXPECT_EQ(scene.initial.velocity, Eigen::Vector3d(4, 5, 6));
  EXPECT_EQ(scene.initial.spin, Eigen::Vector3d(7, 8, 9));

  using Axes = std::array<bool, 3>;
  ASSERT_EQ(scene.fixed.size(), 4u);
  EXPECT_EQ(scene.fixed[0].key, "fixed[0]");
  EXPECT_EQ(scene.fixed[0].name, "feet");
  ASSERT_TRUE(scene.fixed[0].region.box);
  EXPECT_EQ(scene.fixed[0].region.box->min, Eigen::Vector3d(-1, -1, -1));
  EXPECT_EQ(scene.fixed[0].region.box->max, Eigen::Vector3d(1, 1, 0.05));
  EXPECT_EQ(scene.fixed[0].axes, (Axes{true, true, true}));
  EXPECT_EQ(scene.fixed[1].name, "fixed_1");
  ASSERT_TRUE(scene.fixed[1].region.sphere);
  EXPECT_EQ(scene.fixed[1].region.sphere->center, Eigen::Vector3d(1, 2, 3));
  EXPECT_EQ(scene.fixed[1].region.sphere->radius, 4);
  EXPECT_EQ(scene.fixed[1].axes, (Axes{true, false, true}));
  EXPECT_EQ(scene.fixed[2].region.group, "wall");
  EXPECT_EQ(scene.fixed[2].motion, (folder_ / "hand.csv").string());
  EXPECT_EQ(scene.fixed[3].region.group, "12");
  EXPECT_EQ(scene.fixed[3].frame, "gripper_link");

  ASSERT_EQ(scene.loads.size(), 3u);
  EXPECT_EQ(scene.loads[0].key, "loads[0]");
  EXPECT_EQ(scene.loads[0].region.nodes, (std::vector<std::int64_t>{3, 9223372036854775807}));
  EXPECT_EQ(scene.loads[0].force, Eigen::Vector3d(0, 0, 10));
  EXPECT_FALSE(scene.loads[0].traction);
  EXPECT_FALSE(scene.loads[0].pressure);
  EXPECT_EQ(scene.loads[0].from, 0);
  EXPECT_EQ(scene.loads[0].until, std::numeric_limits<double>::infinity());
  EXPECT_EQ(scene.loads[1].traction, Eigen::Vector3d(1, 2, 3));
  EXPECT_EQ(scene.loads[1].from, 0.5);
  EXPECT_EQ(scene.loads[1].until, 1);
  EXPECT_EQ(scene.loads[2].pressure, -20);

  EXPECT_EQ(scene.surface_file, (folder_ / "skin.off").string());
  ASSERT_EQ(scene.probes.size(), 2u);
  EXPECT_EQ(scene.probes[0].first, "nose");  // the file's order, not the alphabet's
  EXPECT_EQ(scene.probes[0].second, Eigen::Vector3d(0.1, 0.5, 0.9));
  EXPECT_EQ(scene.probes[1].first, "ear");
  EXPECT_EQ(scene.frame_id, "base_link");
  EXPECT_EQ(scene.node.mode, Scene::Node::Mode::LOCKSTEP);
  EXPECT_EQ(scene.node.publish_rate, 12.5);
  EXPECT_EQ(scene.node.wrench.radius, 1);
  EXPECT_EQ(scene.node.wrench.max_distance, 2);
  EXPECT_EQ(scene.node.wrench.timeout, 3);
  EXPECT_EQ(load({"model.scale=0.001"}).model.scale, 0.001);
  EXPECT_EQ(load({"node.mode=free_run"}).node.mode, Scene::Node::Mode::FREE_RUN);
  EXPECT_NO_THROW(load({"solver.preconditioner=auto"}));
}

TEST_F(SceneTest, EmptyCollectionsAndUselessKeysAreAccepted)
{
  const Scene scene = parse(MINIMAL + R"(
fixed: []
loads: []
probes: {}
damping: {}
solver: {}
initial: {}
node: {wrench: {}}
elasticity: linear
rotation: corners
dilatation: mean
)");
  EXPECT_TRUE(scene.fixed.empty());
  EXPECT_EQ(load({"model.cell_size=0.1"}).model.cell_size, 0.1);  // of no use to a file of tetrahedra
}

TEST_F(SceneTest, NumbersOfBothYamlVersions)
{
  const std::vector<std::pair<std::string, double>> numbers{
      {"200000", 2e5},   {"2.0e5", 2e5},   {"2.0e+5", 2e5}, {"2e5", 2e5},     {"2E+05", 2e5},
      {"+2.5", 2.5},     {"'2.0e5'", 2e5}, {"\"3\"", 3},    {".5", 0.5},      {"5.", 5},
      {"1.0e+12", 1e12}, {"1e-3", 1e-3},   {"0.1", 0.1},    {"!!float 2", 2}, {"1e308", 1e308}};
  for (const auto& [text, number] : numbers)
  {
    SCOPED_TRACE(text);
    EXPECT_EQ(load({"material.young=" + text}).material.young, number);
  }
  for (const char* text : {".nan", ".inf", "-.inf", "nan",    "inf",   "Infinity", "'.inf'", "1e999", "true",
                           "yes",  "2,5",  "2 5",   "0x10",   "1_000", "++1",      "+-1",    "e5",    "2.0e",
                           "five", "''",   "[1]",   "{a: 1}", "null",  "~",        "2.0 Pa"})
    expectRefused(std::string("material.young=") + text, {"material.young is ", "must be a finite number above 0"});
}

TEST_F(SceneTest, RangesHoldAtTheirEnds)
{
  EXPECT_EQ(load({"material.poisson=0.4999"}).material.poisson, 0.4999);
  EXPECT_EQ(load({"material.poisson=0"}).material.poisson, 0);
  EXPECT_EQ(load({"material.poisson=-0.9"}).material.poisson, -0.9);
  EXPECT_EQ(load({"damping.mass=0"}).damping.mass, 0);
  EXPECT_EQ(load({"solver.max_iterations=1"}).solver.max_iterations, 1);
  for (const char* text : {"0.5", "-1", "0.50000001", "2"})
    expectRefused(std::string("material.poisson=") + text, {std::string("material.poisson is ") + text, "below 0.5"});
  for (const char* key :
       {"material.young", "material.density", "time_step", "model.scale", "model.longest_side", "model.cell_size",
        "node.publish_rate", "node.wrench.radius", "node.wrench.max_distance", "node.wrench.timeout"})
    for (const char* text : {"0", "-1"})
      expectRefused(std::string(key) + "=" + text,
                    {std::string(key) + " is " + text, "must be a finite number above 0"});
  for (const char* key : {"damping.mass", "damping.stiffness"})
    expectRefused(std::string(key) + "=-0.1", {std::string(key) + " is -0.1", "0 or above"});
  for (const char* text : {"0", "1", "-1", "2"})
    expectRefused(std::string("solver.tolerance=") + text, {"solver.tolerance is ", "above 0 and below 1"});
  for (const char* text : {"0", "-3", "2.5", "1e3", "3000000000", "many", "true"})
    expectRefused(std::string("solver.max_iterations=") + text,
                  {"solver.max_iterations is ", "an integer, 1 or above"});
  EXPECT_EQ(load({"model.refine=4"}).model.refine, 4);
  for (const char* text : {"-1", "5", "0.5", "[1]"})
    expectRefused(std::string("model.refine=") + text, {"model.refine is ", "must be an integer from 0 to 4"});
}

TEST_F(SceneTest, WrongTypesNameKeyValueAndWhatIsAllowed)
{
  for (const char* key :
       {"model", "material", "damping", "solver", "initial", "surface", "probes", "node", "node.wrench", "model.pose"})
  {
    expectRefused(std::string(key) + "=7", {std::string(key) + " is 7, must be a map"});
    expectRefused(std::string(key) + "=[1]", {std::string(key) + " is [1], must be a map"});
    expectRefused(std::string(key) + "=null", {std::string(key) + " is null, must be a map"});
  }
  for (const char* key : {"fixed", "loads", "material.regions"})
  {
    expectRefused(std::string(key) + "={a: 1}", {std::string(key) + " is {a: 1}, must be a list"});
    expectRefused(std::string(key) + "=null", {std::string(key) + " is null, must be a list"});
    expectRefused(std::string(key) + "=[3]", {std::string(key) + "[0] is 3, must be a map"});
  }
  for (const char* key :
       {"gravity", "initial.velocity", "initial.spin", "model.pose.xyz", "model.pose.rpy", "probes.nose"})
  {
    expectRefused(std::string(key) + "=1", {std::string(key) + " is 1, must be a list of three numbers"});
    expectRefused(std::string(key) + "=[1, 2]", {std::string(key) + " is [1, 2], must be a list of three numbers"});
    expectRefused(std::string(key) + "=[1, 2, 3, 4]", {std::string(key) + " is [1, 2, 3, 4]"});
    expectRefused(std::string(key) + "=[1, no, 3]", {std::string(key) + "[1] is no, must be a finite number"});
    expectRefused(std::string(key) + "=[1, null, 3]", {std::string(key) + "[1] is null, must be a finite number"});
    expectRefused(std::string(key) + "=[1, 2, .nan]", {std::string(key) + "[2] is .nan, must be a finite number"});
  }
  for (const char* text : {"5", "true", "no", "[a]", "{a: b}", "''", "null", "/world", "a b"})
    expectRefused(std::string("frame_id=") + text, {"frame_id is ", "must be a tf frame"});
  EXPECT_EQ(load({"frame_id='no'"}).frame_id, "no");
  EXPECT_EQ(load({"frame_id=robot/base"}).frame_id, "robot/base");
}

TEST_F(SceneTest, UnknownKeysAreNamedAndTheNearestIsSuggested)
{
  expectRefused("materail=3", {"materail is 3", "no such key", "allowed: model, element", "did you mean material?"});
  expectRefused("material.yuong=3",
                {"material.yuong is 3", "allowed: young, poisson, density, regions", "did you mean young?"});
  expectRefused("model.cellsize=3", {"model.cellsize", "did you mean cell_size?"});
  expectRefused("model.pose.rpu=[0, 0, 0]", {"model.pose.rpu", "allowed: xyz, rpy", "did you mean rpy?"});
  for (const char* parent : {"damping", "solver", "initial", "node", "node.wrench"})
    expectRefused(std::string(parent) + ".zzzzz=1", {std::string(parent) + ".zzzzz is 1", "no such key; allowed: "});
  expectRefused("surface={file: skin.off, colour: red}", {"surface.colour is red", "allowed: file"});
  expectRefused("fixed=[{group: a, axis: [x]}]", {"fixed[0].axis", "did you mean axes?"});
  expectRefused("fixed=[{box: {min: [0, 0, 0], mx: [1, 1, 1]}}]", {"fixed[0].box.mx", "did you mean max?"});
  expectRefused("fixed=[{sphere: {centre: [0, 0, 0], radius: 1}}]", {"fixed[0].sphere.centre", "did you mean center?"});
  expectRefused("loads=[{group: a, force: [0, 0, 1], til: 2}]", {"loads[0].til", "until"});
  expectRefused("material.regions=[{nodes: [1], young: 1}]",
                {"material.regions[0].nodes", "allowed: box, sphere, group"});
  expectParseError(MINIMAL + "1: 2\n", {"1 is 2", "no such key"});
}

TEST_F(SceneTest, RequiredKeys)
{
  expectParseError("material: {young: 2, poisson: 0.3, density: 4}\n", {"model is missing"});
  expectParseError("model: {file: body.msh}\n", {"material is missing", "young, poisson, density"});
  expectParseError("model: {}\nmaterial: {young: 2, poisson: 0.3, density: 4}\n", {"model.file is missing"});
  expectParseError("model: {file: body.msh}\nmaterial: {young: 2, poisson: 0.3}\n",
                   {"material.density is missing", "above 0"});
  expectRefused("surface={}", {"surface.file is missing"});
  expectRefused("fixed=[{box: {max: [1, 1, 1]}}]", {"fixed[0].box.min is missing"});
  expectRefused("fixed=[{sphere: {center: [1, 1, 1]}}]", {"fixed[0].sphere.radius is missing"});
}

TEST_F(SceneTest, Choices)
{
  expectRefused("element=cubic", {"element is cubic, must be one of linear, quadratic"});
  expectRefused("element=quadratc", {"did you mean quadratic?"});
  expectRefused("element=2", {"element is 2, must be one of linear, quadratic"});
  expectRefused("element=[linear]", {"element is [linear]"});
  expectRefused("elasticity=plastic", {"elasticity is plastic, must be one of corotated, green, linear"});
  expectRefused("integrator=euler",
                {"integrator is euler, must be one of implicit_euler, sdirk2, auto, explicit, static"});
  expectRefused("rotation=polar", {"rotation is polar, must be one of corners, centroid, four"});
  expectRefused("dilatation=none", {"dilatation is none, must be one of auto, full, mean"});
  expectRefused("solver.preconditioner=ilu",
                {"solver.preconditioner is ilu, must be one of auto, block_jacobi, pmultigrid, direct"});
  expectRefused("solver.operator=dense", {"solver.operator is dense, must be one of matrix_free, assembled"});
  expectRefused("node.mode=fast", {"node.mode is fast, must be one of realtime, lockstep, free_run"});
}

TEST_F(SceneTest, WhatIsNotAvailableYetSaysSo)
{
  expectRefused("environment.urdf=scene.urdf", {"environment is {urdf: scene.urdf}", "not available yet"});
  expectRefused("contact.friction=0.5", {"contact is {friction: 0.5}", "not available yet"});
}

TEST_F(SceneTest, ModelCombinations)
{
  expectRefused("model={file: skin.off}", {"model.cell_size is missing", "surface", "cell_size: 0.08"});
  expectRefused("model={file: body.msh, scale: 1, longest_side: 2}", {"model has scale and longest_side"});
  expectRefused("model.file=body.step",
                {"model.file is body.step", ".msh .node .ele .vtk .vtu .mesh", ".off .obj .stl .ply"});
  expectRefused("model.file=gone.msh", {"model.file is gone.msh", (folder_ / "gone.msh").string() + " is not a file"});
  expectRefused("model.file=5", {"model.file is 5"});
  expectRefused("surface.file=body.msh", {"surface.file is body.msh", ".off .obj .stl .ply"});
  expectRefused("model={file: skin.off, cell_size: 0.1, sizing: gone.csv}",
                {"model.sizing is gone.csv", (folder_ / "gone.csv").string() + " is not a file"});
  expectRefused("model={file: skin.off, cell_size: 0.1, sizing: 0.05}", {"model.sizing is 0.05", "path of a file"});
  expectRefused("surface.file=gone.off", {"surface.file is gone.off", (folder_ / "gone.off").string()});
  expectRefused("initial.positions=gone.csv", {"initial.positions is gone.csv", (folder_ / "gone.csv").string()});
  fs::create_directory(folder_ / "folder.msh");
  expectRefused("model.file=folder.msh", {"model.file is folder.msh", "is not a file"});
}

TEST_F(SceneTest, Regions)
{
  expectRefused("fixed=[{name: a}]", {"fixed[0] has none, must have exactly one of box, sphere, group, nodes"});
  expectRefused("fixed=[{group: a, nodes: [1]}]", {"fixed[0] has group, nodes, must have exactly one of"});
  expectRefused("loads=[{force: [0, 0, 1]}]",
                {"loads[0] has none, must have exactly one of box, sphere, group, nodes"});
  expectRefused("fixed=[{box: {min: [0, 2, 0], max: [1, 1, 1]}}]", {"fixed[0].box has min above max in y"});
  EXPECT_EQ(load({"fixed=[{box: {min: [0, 0, 0], max: [1, 1, 0]}}]"}).fixed[0].region.box->max[2], 0);  // a plane
  for (const char* radius : {"0", "-1", ".inf"})
    expectRefused(std::string("fixed=[{sphere: {center: [0, 0, 0], radius: ") + radius + "}}]",
                  {"fixed[0].sphere.radius is "});
  expectRefused("fixed=[{nodes: []}]", {"fixed[0].nodes is [], must be a list of node ids"});
  expectRefused("fixed=[{nodes: 3}]", {"fixed[0].nodes is 3"});
  expectRefused("fixed=[{nodes: [1, 2.5]}]", {"fixed[0].nodes[1] is 2.5, must be a node id"});
  expectRefused("fixed=[{nodes: [4, 5, 4]}]", {"fixed[0].nodes[2] is 4, must be given once"});
  expectRefused("fixed=[{nodes: [9223372036854775808]}]", {"fixed[0].nodes[0] is 9223372036854775808"});
  expectRefused("fixed=[{group: true}]", {"fixed[0].group is true"});
  expectRefused("fixed=[{group: a, axes: [x, w]}]", {"fixed[0].axes[1] is w, must be one of x, y, z"});
  for (const char* axes : {"[]", "[x, x]", "z", "null"})
    expectRefused(std::string("fixed=[{group: a, axes: ") + axes + "}]", {"fixed[0].axes is ", "x, y and z"});
  expectRefused("fixed=[{group: a, motion: hand.csv, frame: b}]", {"fixed[0] has motion and frame"});
  expectRefused("fixed=[{group: a, motion: gone.csv}]",
                {"fixed[0].motion is gone.csv", (folder_ / "gone.csv").string()});
  expectRefused("fixed=[{group: a, frame: /b}]", {"fixed[0].frame is /b"});
  expectRefused("material.regions=[{group: a}]", {"material.regions[0] changes nothing", "young, poisson, density"});
  expectRefused("material.regions=[{group: a, poisson: 0.5}]", {"material.regions[0].poisson is 0.5", "below 0.5"});
  expectRefused("material.regions=[{young: 1}]",
                {"material.regions[0] has none, must have exactly one of box, sphere, group"});
}

TEST_F(SceneTest, Loads)
{
  expectRefused("loads=[{group: a}]", {"loads[0] has none, must have exactly one of force, traction, pressure"});
  expectRefused("loads=[{group: a, force: [0, 0, 1], pressure: 1}]", {"loads[0] has force, pressure"});
  expectRefused("loads=[{group: a, pressure: [0, 0, 1]}]", {"loads[0].pressure is [0, 0, 1], must be a finite number"});
  expectRefused("loads=[{group: a, pressure: 1, from: 2, until: 1}]",
                {"loads[0].until is 1, must be later than from", "2"});
  expectRefused("loads=[{group: a, pressure: 1, until: 0}]", {"loads[0].until is 0"});
  expectRefused("loads=[{group: a, pressure: 1, from: 1, until: 1}]", {"loads[0].until is 1"});
  expectRefused("loads=[{group: a, pressure: 1, until: .inf}]", {"loads[0].until is .inf, must be a finite number"});
  EXPECT_EQ(load({"loads=[{nodes: [1], traction: [0, 0, 1]}]"}).loads.size(), 1u);
}

TEST_F(SceneTest, Names)
{
  const Scene scene =
      load({"fixed=[{group: a, name: y}, {group: a}, {group: a, name: B_2}]", "probes={y: [0, 0, 0], n: [1, 1, 1]}"});
  EXPECT_EQ(scene.fixed[0].name, "y");
  EXPECT_EQ(scene.fixed[1].name, "fixed_1");
  EXPECT_EQ(scene.fixed[2].name, "B_2");
  EXPECT_EQ(scene.probes[1].first, "n");
  for (const char* name : {"1a", "_a", "a-b", "a b", "'a.b'", "'é'", "''", "5", "no", "On", "true", "[a]", "null"})
    expectRefused(std::string("fixed=[{group: a, name: ") + name + "}]",
                  {"fixed[0].name is ", "a letter, then letters, digits and _"});
  EXPECT_EQ(load({"fixed=[{group: a, name: 'no'}]"}).fixed[0].name, "no");
  expectRefused("fixed=[{group: a, name: b}, {group: c, name: b}]", {"fixed[1] is named b", "fixed[0]"});
  expectRefused("fixed=[{group: a, name: fixed_1}, {group: c}]", {"fixed[1] is named fixed_1", "fixed[0]"});
  expectRefused("fixed=[{group: a}, {group: c, name: fixed_0}]", {"fixed[1] is named fixed_0", "fixed[0]"});
  expectRefused("probes={1a: [0, 0, 0]}", {"probes", "1a", "a letter, then letters, digits and _"});
  expectRefused("probes={'': [0, 0, 0]}", {"probes", "a letter, then letters, digits and _"});
  expectParseError(MINIMAL + "probes: {no: [0, 0, 0]}\n", {"line 3", "the key no is a boolean", "quotes"});
  EXPECT_EQ(parse(MINIMAL + "probes: {'no': [0, 0, 0]}\n").probes[0].first, "no");
}

TEST_F(SceneTest, BrokenYaml)
{
  expectParseError(MINIMAL + "time_step: 1\ntime_step: 2\n", {"line 4", "the key time_step is given twice"});
  expectParseError("model: {file: body.msh, file: body.msh}\n", {"line 1", "the key file is given twice"});
  expectParseError(MINIMAL + "probes: {a: [0, 0, 0], a: [0, 0, 0]}\n", {"the key a is given twice"});
  expectParseError(MINIMAL + "time_step:\n", {"time_step is null"});
  expectParseError(MINIMAL + "fixed:\n", {"fixed is null"});
  expectParseError(MINIMAL + "~: 1\n", {"line 3", "the key null is not text"});
  expectParseError(MINIMAL + "[a, b]: 1\n", {"line 3", "the key [a, b] is not text"});
  expectParseError(MINIMAL + "true: 1\n", {"line 3", "the key true is a boolean"});
  expectParseError("", {"empty"});
  expectParseError("# nothing\n", {"empty"});
  expectParseError("---\n", {"is null, must be a map"});
  expectParseError("hello", {"is hello, must be a map"});
  expectParseError("[1, 2]", {"is [1, 2], must be a map"});
  expectParseError(MINIMAL + "---\n" + MINIMAL, {"more than one YAML document"});
  expectParseError("model: {file: body.msh\n", {"line ", "not valid YAML"});
  expectParseError("model:\n\tfile: body.msh\n", {"line 2", "not valid YAML"});
  expectParseError("a: *b\n", {"line 1", "not valid YAML"});
  expectParseError("a: !!python/object:os.system x\n", {"line 1", "tag"});
  expectParseError(std::string("a: \0b\n", 6), {"not UTF-8 text"});
  expectParseError("\"a\\nb\": 1\n", {"a b is 1", "no such key"});
}

TEST_F(SceneTest, HostileYamlEndsInAnError)
{
  for (const char* opening : {"[", "{a: ", "- ", "? "})
  {
    std::string nested;
    for (int i = 0; i < 100000; ++i) nested += opening;
    expectParseError(nested, {"line 1", "nested deeper than"});
  }
  expectParseError("a: &a [*a]\n", {"line 1", "alias stands inside the value"});
  std::string laughs = "a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]\n";
  for (int i = 1; i < 30; ++i)
  {
    const std::string below = "*a" + std::to_string(i - 1);
    laughs += "a" + std::to_string(i) + ": &a" + std::to_string(i) + " [" + below;
    for (int j = 1; j < 10; ++j) laughs += ", " + below;
    laughs += "]\n";
  }
  expectParseError(laughs, {"more than 1000000 values"});
  expectParseError(std::string(100000, 'x') + ": 1\n", {"line 1"});
  const std::string what = errorOf([&] { parse(MINIMAL + "frame_id: '/" + std::string(100000, 'x') + "'\n"); });
  EXPECT_LT(what.size(), 300u);
}

TEST_F(SceneTest, AliasesAndMergeKeys)
{
  const std::string yaml = MINIMAL + R"(
fixed:
  - &left
    name: left
    box: {min: [0, 0, 0], max: &corner [1, 1, 1]}
    axes: [x]
  - {<<: *left, name: right}
  - {<<: [{name: third, axes: [y]}, *left]}
probes: {tip: *corner}
)";
  const Scene scene = parse(yaml);
  ASSERT_EQ(scene.fixed.size(), 3u);
  EXPECT_EQ(scene.fixed[1].name, "right");
  EXPECT_EQ(scene.fixed[1].region.box->max, Eigen::Vector3d(1, 1, 1));
  EXPECT_FALSE(scene.fixed[1].axes[1]);
  EXPECT_EQ(scene.fixed[2].name, "third");  // of several merged maps the first wins
  EXPECT_TRUE(scene.fixed[2].axes[1]);
  EXPECT_TRUE(scene.fixed[2].region.box);
  EXPECT_EQ(scene.probes[0].second, Eigen::Vector3d(1, 1, 1));
  const Scene overridden = loadScene(write("scene.yaml", yaml), {"probes.tip[0]=5"});
  EXPECT_EQ(overridden.probes[0].second, Eigen::Vector3d(5, 1, 1));
  EXPECT_EQ(overridden.fixed[0].region.box->max, Eigen::Vector3d(1, 1, 1));  // an alias is a copy
  expectParseError(MINIMAL + "<<: 3\n", {"line 3", "<< takes a map"});
}

TEST_F(SceneTest, UnreadableSceneFiles)
{
  const auto error = [this](const std::string& path) { return errorOf([&] { loadScene(path); }); };
  EXPECT_NE(error(folder_.string()).find(folder_.string() + ": is not a file that can be read"), std::string::npos);
  EXPECT_NE(error((folder_ / "gone.yaml").string()).find("gone.yaml: is not a file that can be read"),
            std::string::npos);
  EXPECT_NE(error("").find("is not a file that can be read"), std::string::npos);
  const std::string program = error(write("program", std::string("ELF\0\1\2", 6)));
  EXPECT_NE(program.find("program: is not UTF-8 text"), std::string::npos) << program;
  EXPECT_NE(error("/dev/zero").find("larger than"), std::string::npos);
  EXPECT_NE(error(write("empty.yaml", "")).find("empty.yaml: is empty"), std::string::npos);
  EXPECT_NE(error(write("a\nb.yaml", "")).find("a b.yaml: is empty"), std::string::npos);
}

TEST_F(SceneTest, Overrides)
{
  EXPECT_EQ(load({"material.young=1.0e+6"}).material.young, 1e6);
  EXPECT_EQ(load({"material={young: 1, poisson: 0.2, density: 3}"}).material.density, 3);
  EXPECT_EQ(load({"node.wrench.radius=2"}).node.wrench.radius, 2);  // the maps on the way are made
  EXPECT_EQ(load({"gravity=[0, 0, 0]", "gravity[2]=-1"}).gravity, Eigen::Vector3d(0, 0, -1));
  const std::vector<std::string> regions{"fixed=[{group: a}, {group: b}]"};
  for (const char* axes : {"fixed[1].axes=[z]", "fixed.1.axes=[z]"})
  {
    const Scene scene = load({regions[0], axes});
    EXPECT_TRUE(scene.fixed[0].axes[0]);
    EXPECT_FALSE(scene.fixed[1].axes[0]);
  }
  EXPECT_EQ(load({"time_step=1", "time_step=2"}).time_step, 2);  // the last one wins
  EXPECT_EQ(load({"frame_id='a=b'"}).frame_id, "a=b");
  EXPECT_EQ(load({"model.file=" + write("elsewhere/other.vtk", "")}).model.file,
            (folder_ / "elsewhere/other.vtk").string());

  for (const char* malformed : {"", "time_step", "=1", ".a=1", "a.=1", "a..b=1", "fixed[=1", "fixed[]=1", "fixed[x]=1",
                                "fixed[0]a=1", "a b=1", "[0]=1", "-=["})
  {
    SCOPED_TRACE(malformed);
    EXPECT_EQ(errorOf([&] { load({malformed}); }).rfind(std::string("override ") + malformed, 0), 0u);
  }
  const auto error = [this](const std::string& text) { return errorOf([&] { load({text}); }); };
  EXPECT_NE(error("time_step").find("must be KEY=VALUE"), std::string::npos);
  EXPECT_NE(error("time_step=").find("override time_step=: is empty"), std::string::npos);
  EXPECT_NE(error("gravity=[0").find("override gravity=[0: line 1: not valid YAML"), std::string::npos);
  EXPECT_NE(error("material.young.x=1").find("material.young is 2, not a map"), std::string::npos);
  EXPECT_NE(error("fixed[0].axes=[z]").find("fixed is not a list"), std::string::npos);
  EXPECT_NE(error("model[0]=1").find("model is not a list"), std::string::npos);
  const std::string outside = errorOf([&] { load({regions[0], "fixed[2].axes=[z]"}); });
  EXPECT_NE(outside.find("fixed has 2 entries"), std::string::npos) << outside;
  EXPECT_THROW(load({regions[0], "fixed[99999999999999999999].axes=[z]"}), InputError);
  EXPECT_THROW(load({regions[0], "fixed.name=a"}), InputError);
}

class ScenePathTest : public SceneTest
{
protected:
  void SetUp() override
  {
    SceneTest::SetUp();
    unsetenv("ROS_PACKAGE_PATH");
    unsetenv("CMAKE_PREFIX_PATH");
  }

  /** A package whose folder has another name than the package. */
  std::string makePackage(const std::string& folder, const std::string& name) const
  {
    write(folder + "/package.xml", "<?xml version=\"1.0\"?>\n<package format=\"3\">\n  <name> " + name +
                                       " </name>\n  <author>A</author>\n</package>\n");
    return write(folder + "/mesh/body.msh", "");
  }

  std::string fileOf(const std::string& path) const { return load({"model.file=" + path}).model.file; }
};

TEST_F(ScenePathTest, RelativeToTheSceneOrAbsolute)
{
  write("scenes/one.yaml", "model: {file: ../body.msh}\nmaterial: {young: 2, poisson: 0.3, density: 4}\n");
  EXPECT_EQ(loadScene((folder_ / "scenes/one.yaml").string()).model.file, (folder_ / "body.msh").string());
  EXPECT_EQ(fileOf((folder_ / "body.msh").string()), (folder_ / "body.msh").string());
  const fs::path before = fs::current_path();
  fs::current_path(folder_);
  EXPECT_EQ(fs::path(loadScene("scenes/one.yaml").model.file), fs::current_path() / "body.msh");
  fs::current_path(before);
  expectRefused("model.file=~/body.msh", {"model.file is ~/body.msh", (folder_ / "~/body.msh").string()});
}

TEST_F(ScenePathTest, PackagesBelowRosPackagePath)
{
  const std::string direct = makePackage("itself", "direct_one");
  const std::string below = makePackage("source/some_folder", "below_one");
  const std::string deep = makePackage("source/stack/other_folder", "deep_one");
  makePackage("source/ignored/package", "ignored_one");
  write("source/ignored/CATKIN_IGNORE", "");
  setenv("ROS_PACKAGE_PATH",
         ((folder_ / "gone").string() + "::" + (folder_ / "itself").string() + ":" + (folder_ / "source").string())
             .c_str(),
         1);
  EXPECT_EQ(fileOf("package://direct_one/mesh/body.msh"), direct);
  EXPECT_EQ(fileOf("package://below_one/mesh/body.msh"), below);
  EXPECT_EQ(fileOf("package://deep_one/mesh/body.msh"), deep);
  expectRefused("model.file=package://ignored_one/mesh/body.msh", {"no package ignored_one"});
  expectRefused("model.file=package://some_folder/mesh/body.msh", {"no package some_folder", "ROS_PACKAGE_PATH"});
  expectRefused("model.file=package://deep_one/gone.msh", {"model.file is package://deep_one/gone.msh",
                                                           (folder_ / "source/stack/other_folder/gone.msh").string()});
  for (const char* path : {"package:///mesh/body.msh", "package://../source.msh", "package://deep_one.msh"})
    expectRefused(std::string("model.file=") + path, {path, "no package"});
}

TEST_F(ScenePathTest, PackagesOfPrefixes)
{
  const std::string installed = makePackage("install/share/installed_one", "installed_one");
  const std::string developed = makePackage("workspace/src/developed_one", "developed_one");
  write("workspace/devel/.catkin", (folder_ / "workspace/src").string());
  setenv("CMAKE_PREFIX_PATH", ((folder_ / "workspace/devel").string() + ":" + (folder_ / "install").string()).c_str(),
         1);
  EXPECT_EQ(fileOf("package://installed_one/mesh/body.msh"), installed);
  EXPECT_EQ(fileOf("package://developed_one/mesh/body.msh"), developed);
}

// Run by the test below, as a copy of this program in another place.
TEST_F(ScenePathTest, DISABLED_PrintOwnPackage)
{
  write("own.yaml",
        "model: {file: package://bezier_fem/mesh/body.msh}\nmaterial: {young: 2, poisson: 0.3, density: 4}\n");
  std::ofstream(std::getenv("SCENE_TEST_OUT")) << loadScene((folder_ / "own.yaml").string()).model.file;
}

TEST_F(ScenePathTest, OwnPackageIsFoundFromTheProgramsPlace)
{
  const std::string source = makePackage("tree", "bezier_fem");
  const std::string installed = makePackage("prefix/share/bezier_fem", "bezier_fem");
  const std::string developed = makePackage("workspace/src/clone", "bezier_fem");
  write("workspace/devel/.catkin", (folder_ / "workspace/src").string());
  const std::vector<std::pair<std::string, std::string>> places{{"tree/build/lib/bezier_fem", source},
                                                                {"prefix/lib/bezier_fem", installed},
                                                                {"workspace/devel/lib/bezier_fem", developed}};
  for (const auto& [place, file] : places)
  {
    SCOPED_TRACE(place);
    fs::create_directories(folder_ / place);
    const fs::path program = folder_ / place / "program";
    fs::copy_file("/proc/self/exe", program);
    setenv("SCENE_TEST_OUT", (folder_ / "out").c_str(), 1);
    unsetenv("GTEST_OUTPUT");  // the copy must not write over this program's results
    const std::string command =
        program.string() + " --gtest_also_run_disabled_tests --gtest_filter=*DISABLED_PrintOwnPackage > /dev/null 2>&1";
    ASSERT_EQ(std::system(command.c_str()), 0);
    std::string found;
    std::getline(std::ifstream(folder_ / "out"), found);
    EXPECT_EQ(found, file);
    fs::remove(program);
  }
}

const char* const MOTION_HEADER = "time,x,y,z,qx,qy,qz,qw\n";

TEST_F(SceneTest, ReadsMotion)
{
  const auto samples = readMotion(write("hand.csv", std::string("\xEF\xBB\xBFtime, x, y ,z,qx,qy,qz,qw\r\n") +
                                                        "-1,0,0,0,0,0,0,1\r\n 0.5 , 1.5,-2,+3e-1, 0,0,3,4\r\n\r\n\n"));
  ASSERT_EQ(samples.size(), 2u);
  EXPECT_EQ(samples[0].time, -1);
  EXPECT_EQ(samples[1].time, 0.5);
  EXPECT_EQ(samples[1].translation, Eigen::Vector3d(1.5, -2, 0.3));
  EXPECT_TRUE(samples[1].quaternion.isApprox(Eigen::Vector4d(0, 0, 0.6, 0.8), 1e-15));
  EXPECT_EQ(readMotion(write("one.csv", std::string(MOTION_HEADER) + "0,0,0,0,0,0,0,1")).size(), 1u);
}

TEST_F(SceneTest, RefusesBrokenMotion)
{
  const auto error = [this](const std::string& text) { return errorOf([&] { readMotion(write("hand.csv", text)); }); };
  const std::string file = (folder_ / "hand.csv").string();
  const auto expect = [&](const std::string& text, const std::vector<std::string>& words) {
    SCOPED_TRACE(text);
    const std::string what = error(text);
    EXPECT_EQ(what.rfind(file, 0), 0u) << what;
    for (const std::string& word : words)
      EXPECT_NE(what.find(word), std::string::npos) << word << " is not in: " << what;
  };
  const std::string first = std::string(MOTION_HEADER) + "1,0,0,0,0,0,0,1\n";
  expect("", {"empty"});
  expect(MOTION_HEADER, {"no row"});
  expect("time,x,y,z,qw,qx,qy,qz\n0,0,0,0,1,0,0,0\n",
         {":1: ", "time,x,y,z,qw,qx,qy,qz", "must be time,x,y,z,qx,qy,qz,qw"});
  expect("0,0,0,0,0,0,0,1\n", {":1: ", "must be time,x,y,z"});
  expect(first + "1,0,0,0,0,0,0,1\n", {":3: time is 1, must be later"});
  expect(first + "0.5,0,0,0,0,0,0,1\n", {":3: time is 0.5, must be later"});
  expect(first + "2,0,0,0,0,0,1\n", {":3: ", "7 fields"});
  expect(first + "2,0,0,0,0,0,0,1,\n", {":3: ", "9 fields"});
  expect(first + "2,0,0,0,0,0,0,0\n", {":3: qx,qy,qz,qw", "length 0"});
  expect(first + "2,0,nan,0,0,0,0,1\n", {":3: y is 'nan', must be a finite number"});
  expect(first + "inf,0,0,0,0,0,0,1\n", {":3: time is 'inf'"});
  expect(first + "2,0,0,0,0,0,0,1e999\n", {":3: qw is '1e999'"});
  expect(first + "2,0,0,0,,0,0,1\n", {":3: qx is ''"});
  expect(first + "2,0,0,0.5m,0,0,0,1\n", {":3: z is '0.5m'"});
  expect(first + "\n2,0,0,0,0,0,0,1\n", {":3: an empty line"});
  EXPECT_NE(errorOf([&] { readMotion((folder_ / "gone.csv").string()); }).find("gone.csv"), std::string::npos);
  EXPECT_NE(errorOf([&] { readMotion(folder_.string()); }).find(folder_.string()), std::string::npos);
}

TEST_F(SceneTest, ReadsPositions)
{
  const auto positions = readPositions(write("start.csv", "node,x,y,z\n12,1,2,3\n9000000000,-1e-3,0,4.5\n"));
  ASSERT_EQ(positions.size(), 2u);
  EXPECT_EQ(positions.at(12), Eigen::Vector3d(1, 2, 3));
  EXPECT_EQ(positions.at(9000000000), Eigen::Vector3d(-1e-3, 0, 4.5));
  const auto error = [this](const std::string& text) {
    return errorOf([&] { readPositions(write("start.csv", text)); });
  };
  EXPECT_NE(error("node,x,y,z\n1,0,0,0\n2,0,0,0\n1,1,1,1\n").find("start.csv:4: node 1 is given twice"),
            std::string::npos);
  EXPECT_NE(error("node,x,y,z\n1.5,0,0,0\n").find("start.csv:2: node is '1.5', must be a node id"), std::string::npos);
  EXPECT_NE(error("node,x,y,z\n1,0,0,-inf\n").find("start.csv:2: z is '-inf', must be a finite number"),
            std::string::npos);
  EXPECT_NE(error("time,node,x,y,z\n0,1,0,0,0\n").find("start.csv:1: "), std::string::npos);
  EXPECT_NE(error("node,x,y,z\n").find("start.csv: has no row"), std::string::npos);
}

TEST_F(SceneTest, ReadsAndWritesSizing)
{
  const auto points = readSizing(write("sizes.csv", "x,y,z,size\n1,-2,3,0.05\n1,-2,3,1e-3\n"));
  ASSERT_EQ(points.size(), 2u);
  EXPECT_EQ(points[0].position, Eigen::Vector3d(1, -2, 3));
  EXPECT_EQ(points[0].size, 0.05);
  const std::vector<SizePoint> odd{{{1. / 3, -1e-300, 2e20}, 0.1 + 0.2}};
  writeSizing((folder_ / "sizes.csv").string(), odd);
  const auto back = readSizing((folder_ / "sizes.csv").string());
  ASSERT_EQ(back.size(), 1u);
  EXPECT_EQ(back[0].position, odd[0].position);
  EXPECT_EQ(back[0].size, odd[0].size);
  EXPECT_NE(errorOf([&] { writeSizing((folder_ / "nowhere/sizes.csv").string(), odd); }).find("cannot be written"),
            std::string::npos);

  const std::pair<std::string, std::string> cases[] = {
      {"", "sizes.csv: cannot be read, or is empty"},
      {"x,y,z\n0,0,0\n", "sizes.csv:1: the header is 'x,y,z', must be x,y,z,size"},
      {"x,y,z,size\n", "sizes.csv: has no row"},
      {"x,y,z,size\n0,0,0\n", "sizes.csv:2: '0,0,0' has 3 fields"},
      {"x,y,z,size\n0,0,0,1\n0,nan,0,1\n", "sizes.csv:3: y is 'nan', must be a finite number"},
      {"x,y,z,size\n0,0,0,inf\n", "sizes.csv:2: size is 'inf', must be a finite number above 0"},
      {"x,y,z,size\n0,0,0,0\n", "sizes.csv:2: size is '0', must be a finite number above 0"},
      {"x,y,z,size\n0,0,0,-0.1\n", "sizes.csv:2: size is '-0.1', must be a finite number above 0"}};
  for (const auto& [text, says] : cases)
  {
    const std::string what = errorOf([&, &content = text] { readSizing(write("sizes.csv", content)); });
    EXPECT_NE(what.find(says), what.npos) << what;
  }
}

TEST(ExampleScenes, AllLoad)
{
  std::set<std::string> names;
  for (const auto& entry : fs::directory_iterator(PACKAGE / "config"))
  {
    if (entry.path().extension() != ".yaml") continue;
    SCOPED_TRACE(entry.path());
    names.insert(entry.path().stem());
    try
    {
      const Scene scene = loadScene(entry.path().string());
      EXPECT_FALSE(scene.fixed.empty());
      EXPECT_FALSE(scene.probes.empty());
    }
    catch (const InputError& error)
    {
      ADD_FAILURE() << error.what()
                    << (fs::exists(PACKAGE / "models") ? "" : " (run scripts/install_dependencies for models/)");
    }
  }
  for (const char* name : {"bar", "bear", "bunny", "armadillo"}) EXPECT_EQ(names.count(name), 1u) << name;
}

TEST(ExampleScenes, BarIsTheOneOfThePaper)
{
  const Scene bar = loadScene((PACKAGE / "config/bar.yaml").string());
  EXPECT_EQ(bar.material.young, 2e5);
  EXPECT_EQ(bar.material.poisson, 0.34);
  EXPECT_EQ(bar.material.density, 500);
  EXPECT_EQ(bar.gravity, Eigen::Vector3d(0, -9.81, 0));
  EXPECT_EQ(bar.time_step, 0.02);
}

/** Reads the nodes and tetrahedra of what make_bar writes: node ids 1, 2, ... in order, tetrahedra with two tags. */
void readBar(const std::string& path, std::vector<Eigen::Vector3d>& points, std::vector<std::array<int, 4>>& tets)
{
  std::ifstream file(path);
  std::string line;
  std::size_t count = 0;
  while (std::getline(file, line) && line != "$Nodes") continue;
  file >> count;
  points.resize(count);
  for (std::size_t i = 0, id = 0; i < count; ++i)
  {
    file >> id >> points[i][0] >> points[i][1] >> points[i][2];
    ASSERT_EQ(id, i + 1);
  }
  while (std::getline(file, line) && line != "$Elements") continue;
  file >> count;
  tets.resize(count);
  for (auto& tet : tets)
  {
    int id = 0, type = 0, tags = 0, physical = 0, entity = 0;
    file >> id >> type >> tags >> physical >> entity;
    ASSERT_EQ(type, 4);
    ASSERT_EQ(tags, 2);
    for (int& corner : tet)
    {
      file >> corner;
      --corner;
    }
  }
  ASSERT_TRUE(file.good());
}

TEST_F(SceneTest, MakeBarFillsTheBarWithConformingTetrahedra)
{
  const std::string out = (folder_ / "bar.msh").string();
  const std::string make_bar = "python3 '" + (PACKAGE / "scripts/make_bar").string() + "' '" + out + "'";
  ASSERT_EQ(std::system((make_bar + " --cells 3 1 2 --size 0.3 0.4 1.5").c_str()), 0);
  std::vector<Eigen::Vector3d> points;
  std::vector<std::array<int, 4>> tets;
  ASSERT_NO_FATAL_FAILURE(readBar(out, points, tets));
  EXPECT_EQ(points.size(), 24u);
  ASSERT_EQ(tets.size(), 36u);
  EXPECT_EQ(points.front(), Eigen::Vector3d(0, 0, 0));
  EXPECT_EQ(points.back(), Eigen::Vector3d(0.3, 0.4, 1.5));
  double volume = 0;
  std::map<std::set<int>, int> faces;
  for (const auto& tet : tets)
  {
    const Eigen::Vector3d a = points[tet[1]] - points[tet[0]], b = points[tet[2]] - points[tet[0]],
                          c = points[tet[3]] - points[tet[0]];
    EXPECT_GT(a.dot(b.cross(c)), 0);
    volume += a.dot(b.cross(c)) / 6;
    for (int left_out : tet)
    {
      std::set<int> face(tet.begin(), tet.end());
      face.erase(left_out);
      ++faces[face];
    }
  }
  EXPECT_NEAR(volume, 0.3 * 0.4 * 1.5, 1e-12);
  int boundary = 0;
  for (const auto& [face, count] : faces)
  {
    EXPECT_LE(count, 2);
    boundary += count == 1;
  }
  EXPECT_EQ(boundary, 2 * 2 * (3 * 1 + 3 * 2 + 1 * 2));  // two triangles a square: neighbours meet face to face

  ASSERT_EQ(std::system(make_bar.c_str()), 0);
  const auto text = [](const fs::path& path) {
    std::stringstream all;
    all << std::ifstream(path).rdbuf();
    return all.str();
  };
  EXPECT_EQ(text(out), text(PACKAGE / "config/bar.msh"));
}

}  // namespace
}  // namespace bezier_fem
