#include "bezier_fem/scene.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <initializer_list>
#include <limits>
#include <set>
#include <string_view>

#include "bezier_fem/error.h"
#include "bezier_fem/mesh_io.h"
#include "bezier_fem/surface_mesh.h"
#include "package_path.h"
#include "yaml_tree.h"

namespace bezier_fem
{
namespace
{
using Names = std::vector<std::string>;

constexpr std::size_t LARGEST_FILE = std::size_t{16} << 20;  // bytes; a scene needs some thousand

std::string joined(const Names& names)
{
  std::string out;
  for (const std::string& name : names) out += (out.empty() ? "" : ", ") + name;
  return out;
}

/** Edits, each an insertion, deletion, exchange or swap of neighbours, that lead from one word to the other. */
std::size_t editDistance(const std::string& a, const std::string& b)
{
  std::vector<std::vector<std::size_t>> d(a.size() + 1, std::vector<std::size_t>(b.size() + 1));
  for (std::size_t i = 0; i <= a.size(); ++i)
  {
    for (std::size_t j = 0; j <= b.size(); ++j)
    {
      if (i == 0 || j == 0)
      {
        d[i][j] = i + j;
        continue;
      }
      d[i][j] = std::min({d[i - 1][j] + 1, d[i][j - 1] + 1, d[i - 1][j - 1] + (a[i - 1] != b[j - 1])});
      if (i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1])
        d[i][j] = std::min(d[i][j], d[i - 2][j - 2] + 1);
    }
  }
  return d[a.size()][b.size()];
}

/** "; did you mean X?" where a name is close enough to be what was meant. */
std::string suggestion(const std::string& word, const Names& names)
{
  constexpr std::size_t LONGEST_KEY = 40;
  if (word.size() > LONGEST_KEY) return {};
  std::string nearest;
  std::size_t least = std::max<std::size_t>(2, word.size() / 3 + 1);
  for (const std::string& name : names)
  {
    const std::size_t distance = editDistance(word, name);
    if (distance >= least || distance >= word.size()) continue;
    least = distance;
    nearest = name;
  }
  return nearest.empty() ? "" : "; did you mean " + nearest + "?";
}

/** What holds for a whole scene. */
struct Origin
{
  std::string source;     // messages begin with it
  std::string directory;  // of relative paths
};

/** A value of the scene and the way to it. */
struct Value
{
  const YamlNode& node;
  std::string key;  // "fixed[0].box.min"
  const Origin& origin;

  [[noreturn]] void error(const std::string& what) const
  {
    throw InputError(origin.source + ": " + (key.empty() ? "" : key + " ") + what);
  }
  [[noreturn]] void mustBe(const std::string& allowed) const { error("is " + describe(node) + ", must be " + allowed); }
  bool isScalar() const { return node.kind == YamlNode::Kind::SCALAR; }
};

/** The numbers that a key may have. */
struct Range
{
  bool (*holds)(double);
  const char* text;
};
constexpr Range ANY{[](double) { return true; }, "a finite number"};
constexpr Range POSITIVE{[](double v) { return v > 0; }, "a finite number above 0"};
constexpr Range NOT_NEGATIVE{[](double v) { return v >= 0; }, "a finite number, 0 or above"};
constexpr Range FRACTION{[](double v) { return v > 0 && v < 1; }, "a number above 0 and below 1"};
constexpr Range POISSON{[](double v) { return v > -1 && v < 0.5; }, "a number above -1 and below 0.5"};

/** Decimal text in full, YAML 1.1 or 1.2, with quotes or without: rosparam hands 2.0e5 on as text. */
template <typename T>
std::optional<T> toNumber(std::string_view text)
{
  if (text.size() > 1 && text[0] == '+' && text[1] != '-') text.remove_prefix(1);
  T value;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size()) return {};
  if (!std::isfinite(static_cast<double>(value))) return {};
  return value;
}

double readNumber(const Value& value, const Range& range)
{
  const auto number = value.isScalar() ? toNumber<double>(value.node.text) : std::nullopt;
  if (!number || !range.holds(*number)) value.mustBe(range.text);
  return *number;
}

std::int64_t readInteger(const Value& value, std::int64_t least, std::int64_t largest, const char* allowed)
{
  const auto number = value.isScalar() ? toNumber<std::int64_t>(value.node.text) : std::nullopt;
  if (!number || *number < least || *number > largest) value.mustBe(allowed);
  return *number;
}

std::vector<Value> readList(const Value& value, const char* allowed)
{
  if (value.node.kind != YamlNode::Kind::LIST) value.mustBe(allowed);
  std::vector<Value> entries;
  for (std::size_t i = 0; i < value.node.items.size(); ++i)
    entries.push_back({value.node.items[i], value.key + "[" + std::to_string(i) + "]", value.origin});
  return entries;
}

Eigen::Vector3d readVector(const Value& value)
{
  constexpr const char* ALLOWED = "a list of three numbers [x, y, z]";
  const std::vector<Value> entries = readList(value, ALLOWED);
  if (entries.size() != 3) value.mustBe(ALLOWED);
  Eigen::Vector3d vector;
  for (int i = 0; i < 3; ++i) vector[i] = readNumber(entries[i], ANY);
  return vector;
}

std::string readText(const Value& value, const std::string& allowed)
{
  const bool other_type = value.node.plain && (isYamlBoolean(value.node.text) || toNumber<double>(value.node.text));
  if (!value.isScalar() || value.node.text.empty() || other_type)
    value.mustBe(allowed + (other_type ? " (in quotes, if it reads as a number or boolean)" : ""));
  return value.node.text;
}

std::string readName(const Value& value)
{
  constexpr const char* ALLOWED = "a name: a letter, then letters, digits and _";
  std::string name = readText(value, ALLOWED);
  const auto letter = [](char c) { return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z'); };
  const auto any = [&](char c) { return letter(c) || (c >= '0' && c <= '9') || c == '_'; };
  if (!letter(name.front()) || !std::all_of(name.begin(), name.end(), any)) value.mustBe(ALLOWED);
  return name;
}

std::string readFrame(const Value& value)
{
  constexpr const char* ALLOWED = "a tf frame: text without spaces that does not begin with /";
  std::string frame = readText(value, ALLOWED);
  if (frame.front() == '/' || frame.find_first_of(" \t\n") != std::string::npos) value.mustBe(ALLOWED);
  return frame;
}

/** The absolute path of an existing file; the scene may give it relative to its own folder or as package://NAME/... */
std::string readFile(const Value& value)
{
  namespace fs = std::filesystem;
  constexpr std::string_view PACKAGE = "package://";
  const std::string text = readText(value, "the path of a file");
  fs::path path = fs::path(value.origin.directory) / text;
  if (text.compare(0, PACKAGE.size(), PACKAGE) == 0)
  {
    const std::size_t slash = std::min(text.find('/', PACKAGE.size()), text.size());
    const std::string name = text.substr(PACKAGE.size(), slash - PACKAGE.size());
    const auto folder = findPackage(name);
    if (!folder)
      value.error("is " + excerpt(text) + ", but no package " + excerpt(name) +
                  " is below ROS_PACKAGE_PATH, in CMAKE_PREFIX_PATH or around this program");
    path = *folder + text.substr(slash);
  }
  std::error_code failed;
  path = fs::absolute(path, failed).lexically_normal();
  if (!fs::is_regular_file(path, failed))
    value.error("is " + excerpt(text) + ", but " + excerpt(path.string(), std::string::npos) + " is not a file");
  return path.string();
}

template <typename T>
T readChoice(const Value& value, const std::vector<std::pair<std::string, T>>& choices)
{
  Names names;
  for (const auto& [name, choice] : choices)
  {
    if (value.isScalar() && value.node.text == name) return choice;
    names.push_back(name);
  }
  const std::string allowed = (names.size() > 1 ? "one of " : "") + joined(names);
  value.mustBe(allowed + suggestion(value.isScalar() ? value.node.text : "", names));
}

/** A map all of whose keys are known. */
class Map
{
public:
  Map(const Value& value, const Names& keys) : value_(value)
  {
    if (value.node.kind != YamlNode::Kind::MAP) value.mustBe("a map with the keys " + joined(keys));
    for (std::size_t i = 0; i < value.node.keys.size(); ++i)
    {
      const std::string& key = value.node.keys[i];
      if (std::find(keys.begin(), keys.end(), key) == keys.end())
        member(key).error("is " + describe(value.node.items[i]) +
                          ", but there is no such key; allowed: " + joined(keys) + suggestion(key, keys));
    }
  }

  bool has(const std::string& key) const { return find(key).has_value(); }

  std::optional<Value> find(const std::string& key) const
  {
    const auto& keys = value_.node.keys;
    const auto found = std::find(keys.begin(), keys.end(), key);
    if (found == keys.end()) return {};
    return Value{value_.node.items[found - keys.begin()], pathOf(key), value_.origin};
  }

  Value require(const std::string& key, const std::string& allowed) const
  {
    if (const auto found = find(key)) return *found;
    member(key).error("is missing, must be " + allowed);
  }

  /** Calls read(Value, args...) for the key and keeps the target's default where the map does not have it. */
  template <typename T, typename Read, typename... Args>
  void get(const std::string& key, T& target, Read read, const Args&... args) const
  {
    if (const auto found = find(key)) target = read(*found, args...);
  }

  void requireOneOf(const Names& keys) const
  {
    Names given;
    for (const std::string& key : keys)
      if (has(key)) given.push_back(key);
    if (given.size() != 1)
      value_.error("has " + (given.empty() ? "none" : joined(given)) + ", must have exactly one of " + joined(keys));
  }

private:
  std::string pathOf(const std::string& key) const
  {
    return value_.key + (value_.key.empty() ? "" : ".") + excerpt(key);
  }

  /** A stand-in for messages about a key that has no value. */
  Value member(const std::string& key) const { return {value_.node, pathOf(key), value_.origin}; }

  Value value_;
};

const Names POINT_SELECTORS{"box", "sphere", "group", "nodes"};
const Names ELEMENT_SELECTORS{"box", "sphere", "group"};

Names with(const Names& selectors, std::initializer_list<const char*> others)
{
  Names names = selectors;
  names.insert(names.end(), others.begin(), others.end());
  return names;
}

Region::Box readBox(const Value& value)
{
  const Map map(value, {"min", "max"});
  Region::Box box{readVector(map.require("min", "[x, y, z]")), readVector(map.require("max", "[x, y, z]"))};
  for (int i = 0; i < 3; ++i)
    if (box.min[i] > box.max[i])
      value.error(std::string("has min above max in ") + "xyz"[i] + ": " + describe(value.node) +
                  ", must be min <= max");
  return box;
}

Region::Sphere readSphere(const Value& value)
{
  const Map map(value, {"center", "radius"});
  return {readVector(map.require("center", "[x, y, z]")), readNumber(map.require("radius", POSITIVE.text), POSITIVE)};
}

/** A Gmsh group may be known by its number only. */
std::string readGroup(const Value& value)
{
  if (value.isScalar() && toNumber<std::int64_t>(value.node.text)) return value.node.text;
  return readText(value, "the name or number of a group of the mesh file");
}

std::vector<std::int64_t> readNodes(const Value& value)
{
  constexpr const char* ALLOWED = "a list of node ids, each once";
  std::vector<std::int64_t> nodes;
  std::set<std::int64_t> seen;
  for (const Value& entry : readList(value, ALLOWED))
  {
    nodes.push_back(readInteger(entry, std::numeric_limits<std::int64_t>::min(),
                                std::numeric_limits<std::int64_t>::max(), "a node id, an integer"));
    if (!seen.insert(nodes.back()).second) entry.mustBe("given once");
  }
  if (nodes.empty()) value.mustBe(ALLOWED);
  return nodes;
}

Region readRegion(const Map& map, const Names& selectors)
{
  map.requireOneOf(selectors);
  Region region;
  map.get("box", region.box, readBox);
  map.get("sphere", region.sphere, readSphere);
  map.get("group", region.group, readGroup);
  map.get("nodes", region.nodes, readNodes);
  return region;
}

Scene::Model readModel(const Value& value)
{
  const Map map(value, {"file", "cell_size", "sizing", "refine", "scale", "longest_side", "pose"});
  Scene::Model model;
  const Value file = map.require("file", "the path of a mesh or surface");
  const bool surface = isSurfaceFile(readText(file, "the path of a mesh or surface"));
  if (!surface && !isTetMeshFile(file.node.text))
    file.mustBe("a file of tetrahedra (.msh .node .ele .vtk .vtu .mesh) or a surface (.off .obj .stl .ply)");
  model.file = readFile(file);
  map.get("cell_size", model.cell_size, readNumber, POSITIVE);
  if (surface && !model.cell_size)
    map.require("cell_size", "given for a surface: the size of its tetrahedra in m, for instance cell_size: 0.08");
  map.get("sizing", model.sizing, readFile);
  map.get("refine", model.refine,
          [](const Value& levels) { return static_cast<int>(readInteger(levels, 0, 4, "an integer from 0 to 4")); });
  map.get("scale", model.scale, readNumber, POSITIVE);
  map.get("longest_side", model.longest_side, readNumber, POSITIVE);
  if (map.has("scale") && map.has("longest_side"))
    value.error("has scale and longest_side, must have at most one of them");
  if (const auto pose = map.find("pose"))
  {
    const Map pose_map(*pose, {"xyz", "rpy"});
    pose_map.get("xyz", model.xyz, readVector);
    pose_map.get("rpy", model.rpy, readVector);
  }
  return model;
}

void readMaterial(const Value& value, Scene& scene)
{
  const Map map(value, {"young", "poisson", "density", "regions"});
  scene.material.young = readNumber(map.require("young", POSITIVE.text), POSITIVE);
  scene.material.poisson = readNumber(map.require("poisson", POISSON.text), POISSON);
  scene.material.density = readNumber(map.require("density", POSITIVE.text), POSITIVE);
  const auto regions = map.find("regions");
  if (!regions) return;
  for (const Value& entry : readList(*regions, "a list of regions"))
  {
    const Map region(entry, with(ELEMENT_SELECTORS, {"young", "poisson", "density"}));
    Scene::MaterialOverride& material = scene.material_regions.emplace_back();
    material.key = entry.key;
    material.region = readRegion(region, ELEMENT_SELECTORS);
    region.get("young", material.young, readNumber, POSITIVE);
    region.get("poisson", material.poisson, readNumber, POISSON);
    region.get("density", material.density, readNumber, POSITIVE);
    if (!material.young && !material.poisson && !material.density)
      entry.error("changes nothing, must have at least one of young, poisson, density");
  }
}

std::array<bool, 3> readAxes(const Value& value)
{
  constexpr const char* ALLOWED = "a list of x, y and z, each at most once, at least one";
  std::array<bool, 3> axes{};
  for (const Value& entry : readList(value, ALLOWED))
  {
    bool& axis = axes[readChoice<std::size_t>(entry, {{"x", 0}, {"y", 1}, {"z", 2}})];
    if (axis) value.mustBe(ALLOWED);
    axis = true;
  }
  if (axes == std::array<bool, 3>{}) value.mustBe(ALLOWED);
  return axes;
}

std::vector<Scene::Fixed> readFixed(const Value& value)
{
  std::vector<Scene::Fixed> fixed;
  std::map<std::string, std::string> names;  // to the key that took them
  for (const Value& entry : readList(value, "a list of regions"))
  {
    const Map map(entry, with(POINT_SELECTORS, {"name", "axes", "motion", "frame"}));
    Scene::Fixed& region = fixed.emplace_back();
    region.key = entry.key;
    region.region = readRegion(map, POINT_SELECTORS);
    map.get("name", region.name, readName);
    map.get("axes", region.axes, readAxes);
    map.get("motion", region.motion, readFile);
    map.get("frame", region.frame, readFrame);
    if (region.motion && region.frame) entry.error("has motion and frame, must have at most one of them");
    if (region.name.empty()) region.name = "fixed_" + std::to_string(fixed.size() - 1);
    const auto [other, added] = names.emplace(region.name, region.key);
    if (!added)
      entry.error("is named " + excerpt(region.name) + (map.has("name") ? "" : " for want of a name") +
                  ", must have a name of its own: " + other->second + " has this one");
  }
  return fixed;
}

std::vector<Scene::Load> readLoads(const Value& value)
{
  std::vector<Scene::Load> loads;
  for (const Value& entry : readList(value, "a list of loads"))
  {
    const Map map(entry, with(POINT_SELECTORS, {"force", "traction", "pressure", "from", "until"}));
    Scene::Load& load = loads.emplace_back();
    load.key = entry.key;
    load.region = readRegion(map, POINT_SELECTORS);
    map.requireOneOf({"force", "traction", "pressure"});
    map.get("force", load.force, readVector);
    map.get("traction", load.traction, readVector);
    map.get("pressure", load.pressure, readNumber, ANY);
    map.get("from", load.from, readNumber, ANY);
    map.get("until", load.until, readNumber, ANY);
    if (load.from >= load.until)
      map.find("until")->mustBe("later than from, which is " + std::to_string(load.from) + " s");
  }
  return loads;
}

std::vector<std::pair<std::string, Eigen::Vector3d>> readProbes(const Value& value)
{
  if (value.node.kind != YamlNode::Kind::MAP) value.mustBe("a map of names to points [x, y, z]");
  std::vector<std::pair<std::string, Eigen::Vector3d>> probes;
  for (std::size_t i = 0; i < value.node.items.size(); ++i)
  {
    YamlNode name;
    name.kind = YamlNode::Kind::SCALAR;
    name.text = value.node.keys[i];
    std::string text = readName({name, "a name in " + value.key, value.origin});
    const Value point{value.node.items[i], value.key + "." + text, value.origin};
    probes.emplace_back(std::move(text), readVector(point));
  }
  return probes;
}

Scene::Node readNode(const Value& value)
{
  const Map map(value, {"mode", "publish_rate", "wrench"});
  Scene::Node node;
  using Mode = Scene::Node::Mode;
  map.get("mode", node.mode, [](const Value& mode) {
    return readChoice<Mode>(mode,
                            {{"realtime", Mode::REALTIME}, {"lockstep", Mode::LOCKSTEP}, {"free_run", Mode::FREE_RUN}});
  });
  map.get("publish_rate", node.publish_rate, readNumber, POSITIVE);
  if (const auto found = map.find("wrench"))
  {
    const Map wrench(*found, {"radius", "max_distance", "timeout"});
    wrench.get("radius", node.wrench.radius, readNumber, POSITIVE);
    wrench.get("max_distance", node.wrench.max_distance, readNumber, POSITIVE);
    wrench.get("timeout", node.wrench.timeout, readNumber, POSITIVE);
  }
  return node;
}

void readSolver(const Value& value, Scene::Solver& solver)
{
  const Map map(value, {"preconditioner", "operator", "tolerance", "max_iterations"});
  map.get("preconditioner", solver.preconditioner, [](const Value& name) {
    using Preconditioner = Scene::Solver::Preconditioner;
    return readChoice<Preconditioner>(name, {{"auto", Preconditioner::AUTO},
                                             {"block_jacobi", Preconditioner::BLOCK_JACOBI},
                                             {"pmultigrid", Preconditioner::PMULTIGRID},
                                             {"direct", Preconditioner::DIRECT}});
  });
  map.get("operator", solver.system_operator, [](const Value& form) {
    using Operator = Scene::Solver::Operator;
    return readChoice<Operator>(form, {{"matrix_free", Operator::MATRIX_FREE}, {"assembled", Operator::ASSEMBLED}});
  });
  map.get("tolerance", solver.tolerance, readNumber, FRACTION);
  map.get("max_iterations", solver.max_iterations, [](const Value& count) {
    return static_cast<int>(readInteger(count, 1, std::numeric_limits<int>::max(), "an integer, 1 or above"));
  });
}

Scene readScene(const YamlNode& root, const Origin& origin)
{
  const Map map({root, "", origin},
                {"model",   "element",     "elasticity", "rotation", "dilatation", "material", "damping",
                 "gravity", "time_step",   "integrator", "solver",   "initial",    "fixed",    "loads",
                 "surface", "environment", "contact",    "probes",   "frame_id",   "node"});
  for (const char* key : {"environment", "contact"})
    if (const auto found = map.find(key))
      found->error("is " + describe(found->node) + ", which is not available yet; leave it out");

  Scene scene;
  scene.model = readModel(map.require("model", "a map with the key file"));
  map.get("element", scene.element, [](const Value& value) {
    return readChoice<Element>(value, {{"linear", Element::LINEAR}, {"quadratic", Element::QUADRATIC}});
  });
  map.get("elasticity", scene.elasticity, [](const Value& value) {
    return readChoice<Elasticity>(
        value, {{"corotated", Elasticity::COROTATED}, {"green", Elasticity::GREEN}, {"linear", Elasticity::LINEAR}});
  });
  map.get("rotation", scene.rotation, [](const Value& value) {
    return readChoice<RotationRule>(value, {{"corners", RotationRule::FROM_CORNERS},
                                            {"centroid", RotationRule::FROM_CENTROID},
                                            {"four", RotationRule::FOUR_POINTS}});
  });
  map.get("dilatation", scene.dilatation, [](const Value& value) {
    return readChoice<Dilatation>(value,
                                  {{"auto", Dilatation::AUTO}, {"full", Dilatation::FULL}, {"mean", Dilatation::MEAN}});
  });
  readMaterial(map.require("material", "a map with the keys young, poisson, density"), scene);
  if (const auto found = map.find("damping"))
  {
    const Map damping(*found, {"mass", "stiffness"});
    damping.get("mass", scene.damping.mass, readNumber, NOT_NEGATIVE);
    damping.get("stiffness", scene.damping.stiffness, readNumber, NOT_NEGATIVE);
  }
  map.get("gravity", scene.gravity, readVector);
  map.get("time_step", scene.time_step, readNumber, POSITIVE);
  map.get("integrator", scene.integrator, [](const Value& value) {
    return readChoice<Integrator>(value, {{"implicit_euler", Integrator::IMPLICIT_EULER},
                                          {"sdirk2", Integrator::SDIRK2},
                                          {"auto", Integrator::AUTO},
                                          {"explicit", Integrator::EXPLICIT},
                                          {"static", Integrator::STATIC}});
  });
  if (const auto found = map.find("solver")) readSolver(*found, scene.solver);
  if (const auto found = map.find("initial"))
  {
    const Map initial(*found, {"positions", "velocity", "spin"});
    initial.get("positions", scene.initial.positions, readFile);
    initial.get("velocity", scene.initial.velocity, readVector);
    initial.get("spin", scene.initial.spin, readVector);
  }
  map.get("fixed", scene.fixed, readFixed);
  map.get("loads", scene.loads, readLoads);
  if (const auto found = map.find("surface"))
  {
    const Value file = Map(*found, {"file"}).require("file", "the path of a surface");
    if (!isSurfaceFile(readText(file, "the path of a surface"))) file.mustBe("a surface (.off .obj .stl .ply)");
    scene.surface_file = readFile(file);
  }
  map.get("probes", scene.probes, readProbes);
  map.get("frame_id", scene.frame_id, readFrame);
  map.get("node", scene.node, readNode);
  return scene;
}

std::string readSceneText(const std::string& path, const std::string& source)
{
  std::error_code failed;
  std::ifstream file(path, std::ios::binary);
  if (!file || std::filesystem::is_directory(path, failed))
    throw InputError(source + ": is not a file that can be read");
  std::string text;
  std::array<char, 65536> block;
  do
  {
    file.read(block.data(), block.size());
    text.append(block.data(), static_cast<std::size_t>(file.gcount()));
  } while (file && text.size() <= LARGEST_FILE);
  if (text.size() > LARGEST_FILE) throw InputError(source + ": is larger than 16 MiB, which no scene file is");
  return text;
}

}  // namespace

Scene loadScene(const std::string& path, const std::vector<std::string>& overrides)
{
  const Origin origin{path.empty() ? "''" : excerpt(path, std::string::npos),
                      std::filesystem::path(path).parent_path().string()};
  YamlNode root = parseYaml(readSceneText(path, origin.source), origin.source);
  for (const std::string& assignment : overrides) assignYaml(root, assignment);
  return readScene(root, origin);
}

Scene parseScene(const std::string& yaml, const std::string& directory, const std::string& source)
{
  const Origin origin{source, directory};
  return readScene(parseYaml(yaml, source), origin);
}

}  // namespace bezier_fem
