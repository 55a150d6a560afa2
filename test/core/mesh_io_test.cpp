#include "bezier_fem/mesh_io.h"

#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <locale>
#include <map>
#include <random>
#include <set>
#include <sstream>
#include <vector>

#include "bezier_fem/error.h"

namespace bezier_fem
{
namespace
{
namespace fs = std::filesystem;

std::string dataFile(const std::string& name)
{
  return std::string(TEST_DATA_DIR) + "/" + name;
}

std::string contentOf(const std::string& path)
{
  std::ifstream stream(path, std::ios::binary);
  return std::string(std::istreambuf_iterator<char>(stream), {});
}

/** A folder of its own, gone afterwards. */
class TemporaryFolder
{
public:
  TemporaryFolder()
  {
    std::string pattern = (fs::temp_directory_path() / "mesh_io_test_XXXXXX").string();
    path_ = mkdtemp(pattern.data());
  }
  ~TemporaryFolder() { fs::remove_all(path_); }
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;

  std::string path(const std::string& name) const { return (path_ / name).string(); }
  std::string write(const std::string& name, const std::string& content) const
  {
    fs::remove(path(name));  // file systems wait for the disk where a file is cut and rewritten
    std::ofstream(path(name), std::ios::binary) << content;
    return path(name);
  }

private:
  fs::path path_;
};

class MeshIo : public testing::Test
{
protected:
  TetMesh read(const std::string& name, const std::string& content) const
  {
    return readTetMesh(folder_.write(name, content));
  }
  /** The message without the folder, or "" if there is no InputError. */
  std::string errorOf(const std::string& path) const
  {
    try
    {
      readTetMesh(path);
    }
    catch (const InputError& error)
    {
      const std::string message = error.what();
      EXPECT_EQ(message.find('\n'), std::string::npos) << message;
      EXPECT_LT(message.size(), 300u) << message;
      EXPECT_EQ(message.rfind(fs::path(path).replace_extension().string(), 0), 0u) << message;
      return message;
    }
    return "";
  }
  void expectError(const std::string& path, const std::vector<std::string>& parts) const
  {
    const std::string message = errorOf(path);
    EXPECT_NE(message, "") << path;
    for (const std::string& part : parts)
      EXPECT_NE(message.find(part), std::string::npos) << message << "\n  lacks " << part;
  }

  TemporaryFolder folder_;
};

std::string replaced(std::string text, const std::string& from, const std::string& to)
{
  const std::size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return at == std::string::npos ? text : text.replace(at, from.size(), to);
}

Eigen::Vector3d corner(const TetMesh& mesh, int tet, int i)
{
  return mesh.corners.col(mesh.tets(i, tet));
}

double volume(const TetMesh& mesh, int tet)
{
  const Eigen::Vector3d a = corner(mesh, tet, 0);
  return (corner(mesh, tet, 1) - a).cross(corner(mesh, tet, 2) - a).dot(corner(mesh, tet, 3) - a) / 6;
}

double volume(const TetMesh& mesh)
{
  double sum = 0;
  for (int t = 0; t < mesh.tets.cols(); ++t) sum += volume(mesh, t);
  return sum;
}

const MeshGroup& group(const TetMesh& mesh, const std::string& name)
{
  for (const MeshGroup& candidate : mesh.groups)
  {
    if (candidate.name == name) return candidate;
  }
  ADD_FAILURE() << "no group " << name;
  static const MeshGroup NONE;
  return NONE;
}

std::set<std::pair<int, int>> edgesOf(const TetMesh& mesh)
{
  std::set<std::pair<int, int>> edges;
  for (int t = 0; t < mesh.tets.cols(); ++t)
  {
    for (int i = 0; i < 4; ++i)
    {
      for (int j = 0; j < i; ++j) edges.insert(std::minmax({mesh.tets(i, t), mesh.tets(j, t)}));
    }
  }
  return edges;
}

/** What TetMesh promises of every mesh. */
void expectConsistent(const TetMesh& mesh)
{
  ASSERT_GT(mesh.tets.cols(), 0);
  ASSERT_EQ(mesh.corners.cols(), static_cast<Eigen::Index>(mesh.corner_ids.size()));
  EXPECT_EQ(mesh.tets.minCoeff(), 0);
  EXPECT_EQ(mesh.tets.maxCoeff(), mesh.corners.cols() - 1);
  EXPECT_EQ(std::set<int>(mesh.tets.data(), mesh.tets.data() + mesh.tets.size()).size(), mesh.corner_ids.size());
  for (int t = 0; t < mesh.tets.cols(); ++t) EXPECT_GT(volume(mesh, t), 0) << t;
  EXPECT_TRUE(mesh.corners.allFinite());

  std::set<std::int64_t> ids(mesh.corner_ids.begin(), mesh.corner_ids.end());
  EXPECT_EQ(ids.size(), mesh.corner_ids.size());
  EXPECT_TRUE(std::is_sorted(mesh.corner_ids.begin(), mesh.corner_ids.end()));
  std::set<std::pair<int, int>> edges;
  for (const MidEdgeNode& mid : mesh.mid_edges)
  {
    EXPECT_LT(mid.corner_a, mid.corner_b);
    EXPECT_TRUE(edges.empty() || *edges.rbegin() < std::pair(mid.corner_a, mid.corner_b));
    EXPECT_TRUE(edges.emplace(mid.corner_a, mid.corner_b).second);
    EXPECT_TRUE(ids.insert(mid.id).second) << mid.id;
  }
  EXPECT_EQ(edges, mesh.mid_edges.empty() ? decltype(edges)() : edgesOf(mesh));
  EXPECT_LE(*ids.rbegin(), mesh.largest_id);
  for (const MeshGroup& g : mesh.groups)
  {
    EXPECT_TRUE(std::is_sorted(g.corners.begin(), g.corners.end(), std::less_equal<>())) << g.name;
    EXPECT_TRUE(std::is_sorted(g.tets.begin(), g.tets.end(), std::less_equal<>())) << g.name;
  }
}

// Files of the model two_boxes --------------------------------------------------------------------------------------

std::vector<std::string> twoBoxes()
{
  std::vector<std::string> names;
  for (const fs::directory_entry& entry : fs::directory_iterator(TEST_DATA_DIR))
  {
    const std::string name = entry.path().filename().string();
    if (name.rfind("two_boxes", 0) == 0 && isTetMeshFile(name)) names.push_back(name);
  }
  std::sort(names.begin(), names.end());
  return names;
}

std::string testName(const testing::TestParamInfo<std::string>& test)
{
  std::string name = test.param;
  std::replace(name.begin(), name.end(), '.', '_');
  return name;
}

class TwoBoxes : public testing::TestWithParam<std::string>
{
protected:
  bool second_order_ = GetParam().find("_o2") != std::string::npos;
  bool is_vtk_ = GetParam().find(".vt") != std::string::npos;
  bool is_gmsh_ = GetParam().find(".msh") != std::string::npos;
  std::int64_t first_id_ = is_vtk_ ? 0 : 1;
  TetMesh mesh_ = readTetMesh(dataFile(GetParam()));
};

TEST_P(TwoBoxes, isTheModel)
{
  expectConsistent(mesh_);
  ASSERT_EQ(mesh_.tets.cols(), 12);
  EXPECT_NEAR(volume(mesh_), 3, 1e-12);
  EXPECT_EQ(mesh_.flipped, 0);
  // The point of no tetrahedron counts for the largest id only.
  EXPECT_EQ(mesh_.largest_id, (second_order_ ? 45 : 12) + first_id_);
  Eigen::Matrix3Xd expected(3, 12);
  expected << 0, 2, 2, 0, 0, 2, 2, 0, 0, 2, 2, 0,  //
      0, 0, 1, 1, 0, 0, 1, 1, 0, 0, 1, 1,          //
      0, 0, 0, 0, .5, .5, .5, .5, 1.5, 1.5, 1.5, 1.5;
  ASSERT_EQ(mesh_.corners.cols(), 12);
  EXPECT_EQ(mesh_.corners, expected);
  for (int i = 0; i < 12; ++i) EXPECT_EQ(mesh_.corner_ids[i], i + first_id_);
  EXPECT_EQ(mesh_.mid_edges.size(), second_order_ ? 33u : 0u);
  EXPECT_LT(mesh_.largest_curvature, 1e-11);  // Gmsh puts points on curves to that accuracy
}

TEST_P(TwoBoxes, agreesWithTheOthers)
{
  const TetMesh other = readTetMesh(dataFile(second_order_ ? "two_boxes_o2.vtk" : "two_boxes.vtk"));
  const bool reordered = GetParam().find("partitioned") != std::string::npos;
  EXPECT_TRUE(reordered || mesh_.tets == other.tets);
  ASSERT_EQ(mesh_.mid_edges.size(), other.mid_edges.size());
  for (std::size_t i = 0; i < mesh_.mid_edges.size(); ++i)
  {
    EXPECT_EQ(mesh_.mid_edges[i].corner_a, other.mid_edges[i].corner_a);
    EXPECT_EQ(mesh_.mid_edges[i].corner_b, other.mid_edges[i].corner_b);
    EXPECT_EQ(mesh_.mid_edges[i].id, other.mid_edges[i].id + first_id_);
  }
}

TEST_P(TwoBoxes, hasItsGroups)
{
  if (is_vtk_)
  {
    EXPECT_TRUE(mesh_.groups.empty());
    return;
  }
  const auto expectVolume = [&](const std::string& name, double expected, double z_min, double z_max) {
    const MeshGroup& g = group(mesh_, name);
    double sum = 0;
    std::set<int> corners;
    for (const int t : g.tets)
    {
      sum += volume(mesh_, t);
      for (int i = 0; i < 4; ++i) corners.insert(mesh_.tets(i, t));
    }
    EXPECT_NEAR(sum, expected, 1e-12) << name;
    EXPECT_EQ(std::vector<int>(corners.begin(), corners.end()), g.corners) << name;
    for (const int c : g.corners)
    {
      EXPECT_GE(mesh_.corners(2, c), z_min) << name;
      EXPECT_LE(mesh_.corners(2, c), z_max) << name;
    }
  };
  const std::vector<int> bottom{0, 1, 2, 3}, front{0, 1}, none;
  if (is_gmsh_)
  {
    expectVolume("lower", 1, 0, 0.5);
    expectVolume("12", 2, 0.5, 1.5);
    expectVolume("both", 3, 0, 1.5);
    EXPECT_EQ(group(mesh_, "bottom face").corners, bottom);
    EXPECT_EQ(group(mesh_, "bottom face").tets, none);
    EXPECT_EQ(group(mesh_, "front").corners, front);
    EXPECT_EQ(group(mesh_, "origin").corners, std::vector<int>{0});
    EXPECT_EQ(group(mesh_, "lost").corners, none);
  }
  else  // one reference an element: Gmsh writes the last of its groups
  {
    expectVolume("1", 1, 0, 0.5);
    expectVolume("3", 2, 0.5, 1.5);
    EXPECT_EQ(group(mesh_, "4").corners, bottom);
    EXPECT_EQ(group(mesh_, "5").corners, front);
    EXPECT_EQ(mesh_.groups.size(), 4u);
  }
}

INSTANTIATE_TEST_SUITE_P(Files, TwoBoxes, testing::ValuesIn(twoBoxes()), testName);

TEST(MeshIoData, isComplete)
{
  EXPECT_EQ(twoBoxes().size(), 31u);
}

TEST(MeshIoData, idsAreThoseOfTheFile)
{
  // Read by other means: every id's position is where the mesh has it.
  std::ifstream stream(dataFile("two_boxes_o2.vtk"));
  std::string word;
  while (word != "POINTS") stream >> word;
  std::size_t count;
  stream >> count >> word;
  std::vector<Eigen::Vector3d> points(count);
  for (Eigen::Vector3d& p : points) stream >> p.x() >> p.y() >> p.z();
  ASSERT_TRUE(stream);

  const TetMesh mesh = readTetMesh(dataFile("two_boxes_o2.vtk"));
  for (int c = 0; c < mesh.corners.cols(); ++c) EXPECT_EQ(mesh.corners.col(c), points.at(mesh.corner_ids[c]));
  for (const MidEdgeNode& mid : mesh.mid_edges)
  {
    const Eigen::Vector3d middle = (mesh.corners.col(mid.corner_a) + mesh.corners.col(mid.corner_b)) / 2;
    EXPECT_LT((points.at(mid.id) - middle).norm(), 1e-11) << mid.id;
  }
}

// TetGen ------------------------------------------------------------------------------------------------------------

TEST(MeshIoTetgen, readsWhatTetgenWrites)
{
  for (const std::string name : {"two_regions.node", "two_regions.ele", "two_regions_o2.node", "two_regions_o2.ele"})
  {
    SCOPED_TRACE(name);
    const bool second_order = name.find("_o2") != std::string::npos;  // and numbered from 0
    const TetMesh mesh = readTetMesh(dataFile(name));
    expectConsistent(mesh);
    EXPECT_NEAR(volume(mesh), 2, 1e-12);
    EXPECT_EQ(mesh.flipped, 0);
    EXPECT_TRUE(mesh.warnings.empty());
    EXPECT_EQ(mesh.corner_ids.front(), second_order ? 0 : 1);
    EXPECT_EQ(mesh.largest_id, second_order ? 44 : 12);
    EXPECT_EQ(mesh.mid_edges.size(), second_order ? 33u : 0u);
    EXPECT_EQ(mesh.largest_curvature, 0);
    ASSERT_EQ(mesh.groups.size(), 2u);
    for (const auto& [region, z] : {std::pair("10", 0.5), {"20", 1.5}})
    {
      const MeshGroup& g = group(mesh, region);
      double sum = 0;
      for (const int t : g.tets) sum += volume(mesh, t);
      EXPECT_NEAR(sum, 1, 1e-12);
      EXPECT_EQ(g.corners.size(), 8u);
      for (const int c : g.corners) EXPECT_LE(std::abs(mesh.corners(2, c) - z), 0.5);
    }
  }
}

TEST_F(MeshIo, tetgenAttributesAreNumbers)
{
  folder_.write("a.node", "# a comment\n\n4 3 1 1\n 5 0 0 0  7.5 -1\n6 1 0 0 0 0 # behind\n\n7 0 1 0 0 0\n8 0 0 1 0 0");
  const auto nameFor = [&](const std::string& attribute) {
    return read("a.ele", "1 4 2\n1 5 6 7 8 " + attribute + " 9").groups.at(0).name;
  };
  EXPECT_EQ(nameFor("3"), "3");
  EXPECT_EQ(nameFor("3.0"), "3");
  EXPECT_EQ(nameFor("-1000000"), "-1000000");
  EXPECT_EQ(nameFor("2.5"), "2.5");
}

TEST_F(MeshIo, tetgenNamesTheFileThatIsWrong)
{
  const std::string nodes = "4 3 0 0\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n", elements = "1 4 0\n1 1 2 3 4\n";
  expectError(folder_.write("lonely.ele", elements), {"lonely.node: there is no such file"});
  const std::string ele = folder_.write("a.ele", elements), node = folder_.write("a.node", nodes);
  EXPECT_EQ(errorOf(node), "");
  EXPECT_EQ(errorOf(ele), "");

  folder_.write("a.node", replaced(nodes, "0 1 0", "0 x 0"));
  expectError(ele, {"a.node, line 4", "'x'"});
  folder_.write("a.node", replaced(nodes, "0 1 0", "0 inf 0"));
  expectError(ele, {"a.node, line 4", "(0, inf, 0)", "node 3"});
  folder_.write("a.node", replaced(nodes, "0 1 0", "0 1"));
  expectError(ele, {"a.node, line 4: the line ends where a coordinate is expected"});
  folder_.write("a.node", replaced(nodes, "4 3 0 0", "1000000000 3 0 0"));
  expectError(ele, {"a.node, line 1", "1000000000"});
  folder_.write("a.node", replaced(nodes, "4 3 0 0", "4 2 0 0"));
  expectError(ele, {"a.node, line 1", "dimension 2; 3 is allowed"});
  folder_.write("a.node", nodes);
  folder_.write("a.ele", replaced(elements, "2 3 4", "2 3 5"));
  expectError(node, {"a.ele, line 2", "tetrahedron 1", "node 5", "1 to 4"});
  folder_.write("a.ele", replaced(elements, "1 4 0", "1 5 0"));
  expectError(node, {"a.ele, line 1", "5 nodes in a tetrahedron; 4 or 10 are allowed"});
  folder_.write("a.ele", replaced(elements, "2 3 4", "2 3 4 1"));
  expectError(node, {"a.ele, line 2", "'1' where the line should end"});
}

// Small meshes written here -----------------------------------------------------------------------------------------

using Points = std::vector<Eigen::Vector3d>;

/** Gmsh 2.2 with nodes from 1 and elements of type 4 or 11 from 1. */
std::string gmshText(const Points& points, const std::vector<std::vector<int>>& elements)
{
  std::ostringstream text;
  text.precision(17);
  text << "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n" << points.size() << "\n";
  for (std::size_t i = 0; i < points.size(); ++i) text << i + 1 << " " << points[i].transpose() << "\n";
  text << "$EndNodes\n$Elements\n" << elements.size() << "\n";
  for (std::size_t e = 0; e < elements.size(); ++e)
  {
    text << e + 1 << (elements[e].size() == 4 ? " 4" : " 11") << " 2 0 1";
    for (const int node : elements[e]) text << " " << node;
    text << "\n";
  }
  text << "$EndElements\n";
  return text.str();
}

const Points UNIT{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
const std::string GMSH = gmshText(UNIT, {{1, 2, 3, 4}});

std::string warningsOf(const TetMesh& mesh)
{
  std::string all;
  for (const std::string& warning : mesh.warnings)
  {
    EXPECT_EQ(warning.find('\n'), std::string::npos);
    all += warning + "\n";
  }
  return all;
}

TEST_F(MeshIo, readsTheUnitTetrahedron)
{
  const TetMesh mesh = read("a.msh", GMSH);
  expectConsistent(mesh);
  EXPECT_DOUBLE_EQ(volume(mesh), 1.0 / 6);
  EXPECT_TRUE(mesh.warnings.empty());
  EXPECT_TRUE(mesh.groups.empty());
  EXPECT_EQ(read("A.MSH", GMSH).tets, mesh.tets);
  std::string dos;
  for (const char c : GMSH) dos += c == '\n' ? std::string("\r\n") : std::string(1, c);
  EXPECT_EQ(read("a.msh", dos).tets, mesh.tets);
}

TEST_F(MeshIo, turnsInvertedElementsRound)
{
  Points points = UNIT;
  // A second tetrahedron on the slanted face, inverted; middles of its edges in Gmsh's order.
  points.push_back({1, 1, 1});
  const std::vector<std::vector<int>> corners{{1, 2, 3, 4}, {2, 3, 4, 5}};
  const int pairs[6][2] = {{0, 1}, {1, 2}, {0, 2}, {0, 3}, {2, 3}, {1, 3}};
  std::map<std::pair<int, int>, int> middles;
  std::vector<std::vector<int>> elements = corners;
  for (std::vector<int>& element : elements)
  {
    if (element[3] == 5) std::swap(element[0], element[1]);
    for (const auto& [i, j] : pairs)
    {
      const int a = element[i], b = element[j];
      const auto [middle, added] = middles.try_emplace(std::minmax(a, b), static_cast<int>(points.size()) + 1);
      if (added) points.push_back((points[a - 1] + points[b - 1]) / 2);
      element.push_back(middle->second);
    }
  }
  const TetMesh mesh = read("a.msh", gmshText(points, elements));
  expectConsistent(mesh);
  EXPECT_EQ(mesh.flipped, 1);
  EXPECT_NE(warningsOf(mesh).find("1 of 2 elements were inverted and have been turned round: tetrahedron 2"),
            std::string::npos)
      << warningsOf(mesh);
  EXPECT_EQ(mesh.largest_curvature, 0);
  ASSERT_EQ(mesh.mid_edges.size(), 9u);
  for (const MidEdgeNode& mid : mesh.mid_edges)
  {
    EXPECT_EQ(mid.id, middles.at({mid.corner_a + 1, mid.corner_b + 1}));
  }
}

class SecondOrder : public MeshIo
{
protected:
  SecondOrder()
  {
    points_ = UNIT;
    const int pairs[6][2] = {{0, 1}, {1, 2}, {0, 2}, {0, 3}, {2, 3}, {1, 3}};
    for (const auto& [a, b] : pairs) points_.push_back((UNIT[a] + UNIT[b]) / 2);
  }
  Points points_;
  std::vector<int> element_{1, 2, 3, 4, 5, 6, 7, 8, 9, 10};
};

TEST_F(SecondOrder, curvedEdgesAreTold)
{
  EXPECT_TRUE(read("a.msh", gmshText(points_, {element_})).warnings.empty());
  points_[6] += Eigen::Vector3d(0, 0, 0.125);
  points_[8] += Eigen::Vector3d(1e-7, 0, 0);  // round-off of single precision
  const TetMesh mesh = read("a.msh", gmshText(points_, {element_}));
  EXPECT_DOUBLE_EQ(mesh.largest_curvature, 0.125);
  EXPECT_NE(warningsOf(mesh).find("1 of 6 edges are curved"), std::string::npos) << warningsOf(mesh);
  EXPECT_NE(warningsOf(mesh).find("0.125: 7\n"), std::string::npos) << warningsOf(mesh);
}

TEST_F(SecondOrder, badMiddlesAreErrors)
{
  points_.push_back({1, 1, 1});
  for (const auto& [a, b] : {std::pair(1, 2), {1, 3}, {1, 4}}) points_.push_back((points_[4] + points_[a]) / 2);
  std::vector<int> beside{3, 2, 4, 11, 6, 10, 9, 13, 14, 12};
  EXPECT_EQ(read("a.msh", gmshText(points_, {element_, beside})).mid_edges.size(), 9u);

  std::vector<int> other = beside;
  points_.push_back((points_[1] + points_[2]) / 2);
  other[4] = 15;
  expectError(folder_.write("a.msh", gmshText(points_, {element_, other})),
              {"nodes 2 and 3", "node 6", "tetrahedron 1", "15 in tetrahedron 2", "line 25"});
  other = beside;
  other[7] = 5;
  expectError(folder_.write("a.msh", gmshText(points_, {element_, other})),
              {"node 5 is in the middle of two edges", "nodes 1 and 2", "nodes 3 and 11"});
  other = beside;
  other[7] = 1;
  expectError(folder_.write("a.msh", gmshText(points_, {element_, other})),
              {"node 1 is a corner of tetrahedron 1 and in the middle of an edge of tetrahedron 2"});
  expectError(folder_.write("a.msh", gmshText(points_, {element_, {3, 2, 4, 11}})),
              {"line 25", "tetrahedron 2 has 4 nodes", "10", "all must be of one order"});
}

TEST_F(MeshIo, elementsWithoutVolumeAreErrors)
{
  Points points = UNIT;
  points[3] = {0.1 + 0.2, 0.7, 0};  // in one plane
  expectError(folder_.write("a.msh", gmshText(points, {{1, 2, 3, 4}})),
              {"a.msh, line 13", "tetrahedron 1 has no volume", "nodes 1, 2, 3 and 4"});
  points = UNIT;
  for (Eigen::Vector3d& p : points) p = 1e-6 * p + Eigen::Vector3d::Constant(0.1);  // small, but no smaller than it is
  EXPECT_NEAR(volume(read("a.msh", gmshText(points, {{1, 2, 3, 4}}))), 1e-18 / 6, 1e-23);
  points = UNIT;
  points[3].z() = 1e-6;  // a sliver
  EXPECT_NEAR(volume(read("a.msh", gmshText(points, {{1, 2, 3, 4}}))), 1e-6 / 6, 1e-20);
}

TEST_F(MeshIo, badTopologyIsAnError)
{
  Points points = UNIT;
  points.insert(points.end(), {{1, 1, 1}, {2, 1, 1}, {1, 2, 1}});
  const std::vector<int> first{1, 2, 3, 4};
  expectError(folder_.write("a.msh", gmshText(points, {first, {1, 2, 2, 4}})),
              {"line 17", "tetrahedron 2 names node 2 twice"});
  expectError(folder_.write("a.msh", gmshText(points, {first, {1, 2, 3, 8}})),
              {"line 17", "tetrahedron 2 names node 8, which the file lacks", "from 1 to 7"});
  expectError(folder_.write("a.msh", gmshText(points, {first, {2, 3, 4, 5}, {2, 1, 3, 4}})),
              {"line 18", "tetrahedron 3 has the same four corners as tetrahedron 1"});
  expectError(folder_.write("a.msh", gmshText(points, {first, {2, 3, 4, 5}, {2, 3, 4, 6}})),
              {"nodes 2, 3 and 4", "belongs to 3 elements, tetrahedron 1, 2 and 3"});
}

TEST_F(MeshIo, looseMeshesAreWarnedOf)
{
  Points points = UNIT;
  for (const Eigen::Vector3d& p : UNIT) points.push_back(p + Eigen::Vector3d(5, 0, 0));
  TetMesh mesh = read("a.msh", gmshText(points, {{1, 2, 3, 4}, {5, 6, 7, 8}}));
  ASSERT_EQ(mesh.warnings.size(), 1u) << warningsOf(mesh);
  EXPECT_NE(mesh.warnings[0].find("a.msh: the mesh is in 2 pieces that do not touch: 1 element with tetrahedron 1 and "
                                  "1 element with tetrahedron 2"),
            std::string::npos)
      << mesh.warnings[0];

  points[4] = UNIT[1] + Eigen::Vector3d(1e-12, -1e-12, 0);  // at the place of node 2, but not connected
  points[5] = {2, 0, -0.5};
  mesh = read("a.msh", gmshText(points, {{1, 2, 3, 4}, {5, 6, 7, 8}}));
  ASSERT_EQ(mesh.warnings.size(), 2u) << warningsOf(mesh);
  EXPECT_NE(mesh.warnings[1].find("1 duplicate node,"), std::string::npos) << mesh.warnings[1];
  EXPECT_NE(mesh.warnings[1].find(": 2 and 5"), std::string::npos) << mesh.warnings[1];

  mesh = read("a.msh", gmshText(points, {{1, 2, 3, 4}, {2, 6, 7, 8}}));
  ASSERT_EQ(mesh.warnings.size(), 1u) << warningsOf(mesh);
  EXPECT_NE(mesh.warnings[0].find("1 corner, about which they turn freely: node 2"), std::string::npos);

  points[5] = {1, 1, 1};
  points[6] = {1, 1, 2};
  mesh = read("a.msh", gmshText(points, {{1, 2, 3, 4}, {3, 2, 6, 7}}));
  ASSERT_EQ(mesh.warnings.size(), 1u) << warningsOf(mesh);
  EXPECT_NE(mesh.warnings[0].find("1 edge, about which they turn freely: node 2 to 3"), std::string::npos);
}

TEST_F(MeshIo, overlappingElementsAreWarnedOf)
{
  Points points = UNIT;
  points.push_back({0.1, 0.1, 0.5});
  const TetMesh mesh = read("a.msh", gmshText(points, {{1, 2, 3, 4}, {1, 2, 3, 5}}));
  ASSERT_EQ(mesh.warnings.size(), 1u) << warningsOf(mesh);
  EXPECT_NE(mesh.warnings[0].find("1 pair of elements overlap"), std::string::npos) << mesh.warnings[0];
}

TEST_F(MeshIo, idsMayBeSparseAndInAnyOrder)
{
  const std::string text =
      "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n1 5 7 4000000000000\n3 1 0 "
      "5\n4000000000000\n9\n7\n11\n3000000000000\n"
      "0 0 1\n1 0 0\n0 0 0\n0 1 0\n8 8 8\n$EndNodes\n$Elements\n1 1 1 1\n3 1 4 1\n1 7 9 11 "
      "4000000000000\n$EndElements\n";
  const TetMesh mesh = read("a.msh", text);
  expectConsistent(mesh);
  EXPECT_EQ(mesh.corner_ids, (std::vector<std::int64_t>{7, 9, 11, 4000000000000}));
  EXPECT_EQ(mesh.largest_id, 4000000000000);
  EXPECT_EQ(mesh.corners.col(3), Eigen::Vector3d(0, 0, 1));
  EXPECT_EQ(mesh.tets.col(0), Eigen::Vector4i(0, 1, 2, 3));
  expectError(folder_.write("a.msh", replaced(text, "\n4000000000000\n", "\n9223372036854775807\n")),
              {"line 12", "node id 9223372036854775807 is out of range"});
}

TEST_F(MeshIo, readsWhateverTheLocale)
{
  struct German : std::numpunct<char>
  {
    char do_decimal_point() const override { return ','; }
    char do_thousands_sep() const override { return '.'; }
    std::string do_grouping() const override { return "\3"; }
  };
  const TetMesh before = readTetMesh(dataFile("two_boxes_o2_41.msh"));
  const std::locale usual = std::locale::global(std::locale(std::locale(), new German));
  const char* const c_locale = setlocale(LC_ALL, "de_DE.UTF-8");  // where there is one
  const TetMesh after = readTetMesh(dataFile("two_boxes_o2_41.msh"));
  const std::string message = errorOf(folder_.write("a.msh", replaced(GMSH, "\n4\n", "\n123456\n")));
  std::locale::global(usual);
  if (c_locale != nullptr) setlocale(LC_ALL, "C");
  EXPECT_EQ(before.corners, after.corners);
  EXPECT_NE(message.find("123456"), std::string::npos) << message;
}

// Gmsh --------------------------------------------------------------------------------------------------------------

TEST_F(MeshIo, gmshErrorsNameTheLine)
{
  const std::vector<std::tuple<std::string, std::string, std::vector<std::string>>> cases{
      {"2.2 0 8", "2.1 0 8", {"line 2", "version '2.1'", "2.2 and 4.1"}},
      {"2.2 0 8", "4 0 8", {"line 2", "version '4'"}},
      {"2.2 0 8", "2.2 2 8", {"line 2", "file type 2"}},
      {"$MeshFormat", "$NOD", {"line 1", "'$NOD' comes before '$MeshFormat'"}},
      {"$EndMeshFormat", "$EndMesh", {"line 3", "'$EndMesh' where '$EndMeshFormat' is expected"}},
      {"$Nodes\n4", "$Nodes\n1000000000", {"line 5", "1000000000 as the number of nodes"}},
      {"$Nodes\n4", "$Nodes\n-1", {"line 5", "-1", "0 or more"}},
      {"$Nodes\n4", "$Nodes\nfour", {"line 5", "'four' where the number of nodes is expected"}},
      {"$Nodes\n4", "$Nodes\n5", {"line 10", "'$EndNodes' where a node id is expected"}},
      {"3 0 1 0", "2 0 1 0", {"line 8", "node 2 is given twice", "line 7"}},
      {"3 0 1 0", "3 0 nan 0", {"line 8", "(0, nan, 0) of node 3"}},
      {"3 0 1 0", "3 0 1e200 0", {"line 8", "(0, 1e+200, 0) of node 3"}},
      {"3 0 1 0", "3 0 1", {"line 8", "the line ends where a coordinate is expected"}},
      {"3 0 1 0", "3 0 1 0 0", {"line 8", "'0' where the line should end"}},
      {"3 0 1 0", "3 0 1,5 0", {"line 8", "'1,5'"}},
      {"3 0 1 0", "-3 0 1 0", {"line 8", "node id -3 is out of range"}},
      {"$Elements\n1", "$Elements\n1000000000", {"line 12", "1000000000 as the number of elements"}},
      {"1 4 2 0 1 1 2 3 4", "1 4 2 0 1 1 2 3", {"line 13", "the line ends where a node of an element is expected"}},
      {"1 4 2 0 1 1 2 3 4", "1 4 -1 1 2 3 4", {"line 13", "-1 tags"}},
      {"1 4 2 0 1 1 2 3 4", "1 4 2 0 1 1 2 3 4.5", {"line 13", "'4.5'"}},
      {"1 4 2 0 1 1 2 3 4", "1 4 2 0 1 1 2 3 5", {"line 13", "names node 5"}},
      {"1 4 2 0 1 1 2 3 4", "1 4 2 0 1 1 2 3 3", {"line 13", "names node 3 twice"}},
      {"1 4 2 0 1 1 2 3 4", "1 40 2 0 1 1 2 3 3", {"line 13", "element type 40"}},
      {"1 4 2 0 1 1 2 3 4", "1 2 2 0 1 1 2 3", {"there are no tetrahedra"}},
      {"1 4 2 0 1 1 2 3 4", "1 5 2 0 1 1 2 3 4 1 2 3 4", {"there are no tetrahedra", "1 of Gmsh element type 5"}},
      {"$EndElements\n", "", {"the file ends where '$EndElements' is expected"}},
      {GMSH.substr(GMSH.find("$Elements")), "", {"line 11", "the file ends without '$Elements'"}},
      {GMSH.substr(GMSH.find("$Elements")), "$Periodic\n", {"without '$EndPeriodic'"}}};
  for (const auto& [from, to, parts] : cases)
  {
    SCOPED_TRACE(to);
    expectError(folder_.write("a.msh", replaced(GMSH, from, to)), parts);
  }
}

TEST_F(MeshIo, gmshSectionsThatAreNotNeededAreSkipped)
{
  const std::string text = replaced(GMSH, "$Nodes", "$Comments\n$Nodes are here\n$EndComments\n\n$Nodes");
  EXPECT_EQ(read("a.msh", text + "$NodeData\n1\n\"x\"\n$EndNodeData\n").tets.cols(), 1);
}

TEST_F(MeshIo, gmshGroupsOfOneName)
{
  const std::string elements =
      "$Elements\n3\n1 2 2 1 1 1 2 5\n2 4 2 1 1 1 2 3 4\n3 5 2 1 1 1 2 3 4 1 2 3 4\n4 4 2 2 1 2 3 4 5\n$EndElements\n";
  std::string text = GMSH.substr(0, GMSH.find("$Elements")) + replaced(elements, "\n3\n", "\n4\n");
  text = replaced(replaced(text, "$Nodes\n4\n", "$Nodes\n5\n"), "4 0 0 1\n", "4 0 0 1\n5 1 1 1\n");
  TetMesh mesh = read("a.msh", text);
  ASSERT_EQ(mesh.groups.size(), 2u);
  EXPECT_EQ(mesh.groups[0].corners, (std::vector<int>{0, 1, 2, 3}));  // the volume's, not the surface's
  EXPECT_EQ(mesh.groups[0].tets, std::vector<int>{0});
  ASSERT_EQ(mesh.warnings.size(), 2u) << warningsOf(mesh);
  EXPECT_NE(mesh.warnings[0].find("left out: 1 of Gmsh element type 5"), std::string::npos) << mesh.warnings[0];
  EXPECT_NE(mesh.warnings[1].find("stands for the one of the highest dimension: '1'"), std::string::npos);

  const auto named = [&](const std::string& surface, const std::string& volume) {
    return replaced(text, "$Nodes",
                    "$PhysicalNames\n2\n2 1 \"" + surface + "\"\n3 1 \"" + volume + "\"\n$EndPhysicalNames\n$Nodes");
  };
  mesh = read("a.msh", named("the \"skin\"", "it"));
  ASSERT_EQ(mesh.groups.size(), 3u);
  EXPECT_EQ(group(mesh, "the \"skin\"").corners, (std::vector<int>{0, 1, 4}));
  EXPECT_EQ(group(mesh, "it").corners, (std::vector<int>{0, 1, 2, 3}));
  mesh = read("a.msh", named("it", "it"));
  ASSERT_EQ(mesh.groups.size(), 2u);
  EXPECT_EQ(group(mesh, "it").corners, (std::vector<int>{0, 1, 2, 3, 4}));
  EXPECT_EQ(group(mesh, "it").tets, std::vector<int>{0});
  EXPECT_NE(warningsOf(mesh).find("stands for all of them: 'it'"), std::string::npos) << warningsOf(mesh);
}

template <class T>
void put(std::string& bytes, T value, bool swapped)
{
  char raw[sizeof(T)];
  std::memcpy(raw, &value, sizeof(T));
  if (swapped) std::reverse(raw, raw + sizeof(T));
  bytes.append(raw, sizeof(T));
}

std::string binaryGmsh(bool swapped, std::int32_t announced = 1)
{
  std::string bytes = "$MeshFormat\n2.2 1 8\n";
  put<std::int32_t>(bytes, 1, swapped);
  bytes += "\n$EndMeshFormat\n$Nodes\n4\n";
  for (int i = 0; i < 4; ++i)
  {
    put<std::int32_t>(bytes, i + 1, swapped);
    for (const double x : UNIT[i]) put(bytes, x, swapped);
  }
  bytes += "\n$EndNodes\n$Elements\n1\n";
  for (const std::int32_t i : {4, announced, 2}) put(bytes, i, swapped);
  for (const std::int32_t i : {1, -3, 1, 1, 2, 3, 4}) put(bytes, i, swapped);
  return bytes + "\n$EndElements\n";
}

TEST_F(MeshIo, gmshBinaryInBothByteOrders)
{
  for (const bool swapped : {false, true})
  {
    const TetMesh mesh = read("a.msh", binaryGmsh(swapped));
    EXPECT_DOUBLE_EQ(volume(mesh), 1.0 / 6);
    EXPECT_EQ(group(mesh, "3").tets.size(), 1u);  // a negative number is of elements turned round
    expectError(folder_.write("a.msh", binaryGmsh(swapped, 1000000000)), {"a.msh, byte", "1000000000"});
    expectError(folder_.write("a.msh", binaryGmsh(swapped, 0)), {"a.msh, byte", "0 elements in a block"});
  }
  expectError(folder_.write("a.msh", replaced(binaryGmsh(false), "2.2 1 8", "2.2 0 8")), {"line 3"});
  expectError(folder_.write("a.msh", replaced(GMSH, "2.2 0 8", "2.2 1 8")), {"byte 20", "byte order"});
  expectError(folder_.write("a.msh", replaced(binaryGmsh(false), "2.2 1 8", "2.2 1 4")), {"data size 4; 8 is allowed"});
}

// VTK, legacy -------------------------------------------------------------------------------------------------------

const std::string VTK =
    "# vtk DataFile Version 3.0\na title\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 5 float\n0 0 0 1 0 0\n0 1 0\n0 0 1\n"
    "9 9 9\nCELLS 2 8\n4 0 1 2 3\n2 0 1\nCELL_TYPES 2\n10 3\n";

TEST_F(MeshIo, vtkErrorsNameTheLine)
{
  const TetMesh mesh = read("a.vtk", VTK);
  EXPECT_DOUBLE_EQ(volume(mesh), 1.0 / 6);
  EXPECT_EQ(mesh.largest_id, 4);
  const std::vector<std::tuple<std::string, std::string, std::vector<std::string>>> cases{
      {"# vtk DataFile", "<VTKFile>", {"line 1", "'# vtk DataFile Version'"}},
      {"Version 3.0", "Version 5.2", {"line 1", "version '5.2'; 1.0 to 5.1"}},
      {"ASCII", "TEXT", {"line 3", "'TEXT' where 'ASCII' or 'BINARY' is expected"}},
      {"UNSTRUCTURED_GRID", "POLYDATA", {"line 4", "'POLYDATA'", "UNSTRUCTURED_GRID"}},
      {"POINTS 5", "POINTS 1000000000", {"line 5", "1000000000"}},
      {"POINTS 5", "POINTS 6", {"line 10", "'CELLS' where a coordinate is expected"}},
      {"float", "string", {"line 5", "data type 'string'"}},
      {"0 0 1\n", "0 0 -inf\n", {"line 8", "(0, 0, -inf) of point 3"}},
      {"CELLS 2 8", "CELLS 1000000000 8", {"line 10", "1000000000"}},
      {"CELLS 2 8", "CELLS 2 9", {"the list of cells has 8 entries", "9"}},
      {"CELLS 2 8", "CELLS 2 7", {"line 12", "cell 1 of 2 points does not fit"}},
      {"4 0 1 2 3", "4 0 1 2 5", {"line 11", "cell 0 names point 5; 0 to 4 is allowed"}},
      {"4 0 1 2 3", "4 0 1 2 -1", {"line 11", "cell 0 names point -1"}},
      {"4 0 1 2 3\n2 0 1", "3 0 1 2\n3 0 1 2", {"line 11", "cell 0 of type 10 has 3 points; 4 are allowed"}},
      {"4 0 1 2 3", "-4 0 1 2 3", {"line 11", "cell 0 of -4 points"}},
      {"CELL_TYPES 2", "CELL_TYPES 1", {"'3' where"}},
      {"CELL_TYPES 2\n10 3", "CELL_TYPES 1\n10", {"1 CELL_TYPES for 2 CELLS"}},
      {"10 3\n", "3 3\n", {"there are no tetrahedra"}},
      {"10 3\n", "12 3\n", {"1 of VTK cell type 12"}},
      {"CELL_TYPES 2\n10 3\n", "", {"without CELL_TYPES"}}};
  for (const auto& [from, to, parts] : cases)
  {
    SCOPED_TRACE(to);
    expectError(folder_.write("a.vtk", replaced(VTK, from, to)), parts);
  }
}

TEST_F(MeshIo, vtkOffsetsAndConnectivity)
{
  const std::string text =
      replaced(replaced(VTK, "3.0", "5.1"), "CELLS 2 8\n4 0 1 2 3\n2 0 1\n",
               "CELLS 3 6\nOFFSETS vtktypeint64\n0 4 6\nCONNECTIVITY vtktypeint64\n0 1 2 3\n0 1\n");
  EXPECT_DOUBLE_EQ(volume(read("a.vtk", text)), 1.0 / 6);
  expectError(folder_.write("a.vtk", replaced(text, "0 4 6", "0 7 6")), {"line 12", "offset 7; 0 to 6 is allowed"});
  expectError(folder_.write("a.vtk", replaced(text, "0 4 6", "0 4 3")), {"line 12", "offset 3; 4 to 6 is allowed"});
  expectError(folder_.write("a.vtk", replaced(text, "0 4 6", "0 4 5")), {"end at 5"});
  expectError(folder_.write("a.vtk", replaced(text, "0 1 2 3\n", "0 1 2 8\n")), {"line 14", "names point 8"});
  expectError(folder_.write("a.vtk", replaced(text, "CELLS 3", "CELLS 999999999")), {"line 10", "999999999"});
}

// VTK, XML ----------------------------------------------------------------------------------------------------------

const std::string VTU =
    "<?xml version=\"1.0\"?>\n<VTKFile type=\"UnstructuredGrid\" version=\"1.0\" byte_order=\"LittleEndian\" "
    "header_type=\"UInt64\">\n<UnstructuredGrid>\n<Piece NumberOfPoints=\"4\" NumberOfCells=\"1\">\n<Points>\n"
    "<DataArray type=\"Float32\" NumberOfComponents=\"3\" format=\"ascii\">\n0 0 0  1 0 0\n0 1 0  0 0 1\n</DataArray>\n"
    "</Points>\n<Cells>\n<DataArray type=\"Int32\" Name=\"connectivity\" format=\"ascii\">0 1 2 3</DataArray>\n"
    "<DataArray type=\"Int32\" Name=\"offsets\" format=\"ascii\">4</DataArray>\n"
    "<DataArray type=\"UInt8\" Name=\"types\" format=\"ascii\">10</DataArray>\n"
    "</Cells>\n</Piece>\n</UnstructuredGrid>\n</VTKFile>\n";

TEST_F(MeshIo, vtuErrorsNameTheLine)
{
  EXPECT_DOUBLE_EQ(volume(read("a.vtu", VTU)), 1.0 / 6);
  const std::string ascii_points = "format=\"ascii\">\n0 0 0  1 0 0\n0 1 0  0 0 1\n";
  const std::vector<std::tuple<std::string, std::string, std::vector<std::string>>> cases{
      {"type=\"UnstructuredGrid\"", "type=\"PolyData\"", {"line 2", "'PolyData'"}},
      {"version=\"1.0\" byte", "version=\"7.0\" byte", {"line 2", "version '7.0'"}},
      {"LittleEndian", "Middle", {"line 2", "'Middle'"}},
      {"UInt64\">", "UInt16\">", {"line 2", "header_type 'UInt16'"}},
      {"UInt64\">", "UInt64\" compressor=\"vtkLZMADataCompressor\">", {"line 2", "'vtkLZMADataCompressor'", "ZLib"}},
      {"</Cells>", "</Cell>", {"not well-formed XML"}},
      {"NumberOfPoints=\"4\"", "", {"line 4", "NumberOfPoints is ''"}},
      {"NumberOfPoints=\"4\"", "NumberOfPoints=\"1000000000\"", {"line 6", "12 values, but 3000000000 are expected"}},
      {"NumberOfCells=\"1\"", "NumberOfCells=\"1000000000\"", {"line 14", "1 values, but 1000000000"}},
      {"NumberOfComponents=\"3\"", "NumberOfComponents=\"2\"", {"line 6", "'2' components"}},
      {"Float32", "String", {"line 6", "type 'String'"}},
      {"0 1 0  0 0 1", "0 1 0  0 0 l", {"line 8", "'l'"}},
      {"0 1 0  0 0 1", "0 1 0  0 0 inf", {"line 6", "(0, 0, inf) of point 3"}},
      {"0 1 2 3", "0 1 2 4", {"line 12", "cell 0 names point 4; 0 to 3 is allowed"}},
      {">4<", ">5<", {"line 13", "offset 5 of cell 0; 0 to 4 is allowed"}},
      {">4<", ">-1<", {"line 13", "offset -1 of cell 0"}},
      {"Name=\"types\"", "Name=\"kinds\"", {"there is no DataArray types in Cells"}},
      {"\"Int32\" Name=\"offsets\"", "\"Float32\" Name=\"offsets\"", {"line 13", "whole numbers"}},
      {">10<", ">12<", {"1 of VTK cell type 12"}},
      {"\"ascii\">10", "\"hex\">10", {"line 14", "format 'hex'"}},
      {ascii_points, "format=\"binary\">gAAAAAAAAAA=", {"line 6", "128 bytes are announced"}},
      {ascii_points, "format=\"binary\">gA!AAAAAAAA=", {"line 6", "not base64"}},
      {ascii_points, "format=\"appended\" offset=\"9\">", {"line 6", "offset '9'"}}};
  for (const auto& [from, to, parts] : cases)
  {
    SCOPED_TRACE(to);
    expectError(folder_.write("a.vtu", replaced(VTU, from, to)), parts);
  }
}

TEST_F(MeshIo, vtuPiecesAreOneMesh)
{
  const std::size_t begin = VTU.find("<Piece"), end = VTU.find("</UnstructuredGrid>");
  const std::string piece = VTU.substr(begin, end - begin);
  const std::string other = replaced(replaced(piece, "0 0 0  1 0 0", "5 0 0  6 0 0"), "0 1 0  0 0 1", "5 1 0  5 0 1");
  const TetMesh mesh = read("a.vtu", VTU.substr(0, end) + other + VTU.substr(end));
  expectConsistent(mesh);
  EXPECT_EQ(mesh.tets.col(1), Eigen::Vector4i(4, 5, 6, 7));
  EXPECT_EQ(mesh.corners.col(5), Eigen::Vector3d(6, 0, 0));
}

// Medit -------------------------------------------------------------------------------------------------------------

const std::string MEDIT =
    "MeshVersionFormatted 2\n# made by hand\nDimension 3\nVertices\n4\n0 0 0 1\n1 0 0 1\n0 1 0 1\n0 0 1 1\n"
    "Corners 2 1 2\nTriangles\n1\n1 2 3 8\nTetrahedra\n1\n1 2 3 4 7\nEnd\n";

TEST_F(MeshIo, meditErrorsNameTheLine)
{
  const TetMesh mesh = read("a.mesh", MEDIT);
  EXPECT_DOUBLE_EQ(volume(mesh), 1.0 / 6);
  ASSERT_EQ(mesh.groups.size(), 2u);  // none from the vertices
  EXPECT_EQ(group(mesh, "8").corners, (std::vector<int>{0, 1, 2}));
  EXPECT_EQ(group(mesh, "7").tets, std::vector<int>{0});
  EXPECT_TRUE(read("a.mesh", replaced(MEDIT, "4 7", "4 0")).groups.at(0).tets.empty());  // 0 is no reference

  const std::vector<std::tuple<std::string, std::string, std::vector<std::string>>> cases{
      {"MeshVersionFormatted", "MFEM mesh", {"line 1", "'MFEM'"}},
      {"Formatted 2", "Formatted 5", {"line 1", "version 5; 1 to 4 are read"}},
      {"Dimension 3", "Dimension 2", {"line 3", "dimension 2; 3 is allowed"}},
      {"Vertices\n4", "Vertices\n1000000000", {"line 5", "1000000000"}},
      {"Vertices\n4", "Vertices\n5", {"line 10", "'Corners' where a coordinate is expected"}},
      {"Vertices\n4", "Vertices\n3", {"line 9", "'0' where a keyword"}},
      {"0 0 1 1", "0 0 nan 1", {"line 9", "(0, 0, nan) of node 4"}},
      {"1 2 3 4 7", "1 2 3 0 7", {"line 16", "tetrahedron 1 names node 0", "1 to 4"}},
      {"1 2 3 8", "1 2 9 8", {"an element of group '8' names node 9, which the file lacks"}},
      {"1 2 3 4 7", "1 2 3 4", {"line 17", "'End' where an element's reference is expected"}},
      {"Tetrahedra", "Hexahedra", {"line 15", "the file is cut short"}},
      {"Tetrahedra\n1\n1 2 3 4 7\n", "Hexahedra 1 1 2 3 4 1 2 3 4 1\n", {"1 of Hexahedra"}},
      {"Triangles", "TetrahedraP2Ordering", {"line 11", "not supported"}},
      {"Corners 2 1 2", "Vertices 0", {"line 10", "'Vertices' a second time"}},
      {"Tetrahedra\n1\n1 2 3 4 7\nEnd\n", "", {"there are no tetrahedra"}}};
  for (const auto& [from, to, parts] : cases)
  {
    SCOPED_TRACE(to);
    expectError(folder_.write("a.mesh", replaced(MEDIT, from, to)), parts);
  }
}

// Any file ----------------------------------------------------------------------------------------------------------

TEST(MeshIoNames, extensionsInEitherCase)
{
  for (const char* name : {"a.msh", "a.node", "a.ele", "a.vtk", "a.vtu", "a.mesh", "/b.c/a.b.MSH", "a.Vtu"})
  {
    EXPECT_TRUE(isTetMeshFile(name)) << name;
  }
  for (const char* name : {"", "msh", ".msh", "a.off", "a.meshb", "a.msh/", "a.msh.gz", "b.msh/a"})
  {
    EXPECT_FALSE(isTetMeshFile(name)) << name;
  }
}

TEST_F(MeshIo, filesThatAreNone)
{
  expectError(folder_.write("a.stl", "solid"), {"not a tetrahedral mesh format", ".msh", ".mesh"});
  for (const std::string extension : {".msh", ".node", ".vtk", ".vtu", ".mesh"})
  {
    SCOPED_TRACE(extension);
    expectError(folder_.path("missing" + extension), {"there is no such file"});
    expectError(folder_.write("empty" + extension, ""), {"the file is empty"});
    expectError(folder_.write("blank" + extension, "\n \n"), {""});
    fs::create_directory(folder_.path("folder" + extension));
    expectError(folder_.path("folder" + extension), {"is a directory"});
    ASSERT_EQ(mkfifo(folder_.path("pipe" + extension).c_str(), 0600), 0);
    expectError(folder_.path("pipe" + extension), {"is not a regular file"});
    std::string noise(1000, '\0');
    std::mt19937 random(1);
    for (char& c : noise) c = static_cast<char>(random());
    expectError(folder_.write("noise" + extension, noise), {""});
    expectError(folder_.write("zeros" + extension, std::string(1000, '\0')), {""});
    if (geteuid() != 0)
    {
      fs::permissions(folder_.write("locked" + extension, GMSH), fs::perms::none);
      expectError(folder_.path("locked" + extension), {"cannot be opened"});
    }
  }
}

/** All files of the data folder; of a TetGen pair the .ele, with its .node beside it. */
std::vector<std::string> allFiles()
{
  std::vector<std::string> names = twoBoxes();
  names.insert(names.end(), {"two_regions.ele", "two_regions_o2.ele", "two_regions.node", "two_regions_o2.node"});
  return names;
}

class Damaged : public MeshIo, public testing::WithParamInterface<std::string>
{
protected:
  void SetUp() override
  {
    if (GetParam().rfind("two_regions", 0) == 0)
    {
      for (const char* extension : {".node", ".ele"})
      {
        const std::string name = fs::path(GetParam()).replace_extension(extension).string();
        fs::copy_file(dataFile(name), folder_.path(name), fs::copy_options::overwrite_existing);
      }
    }
  }
  std::string content_ = contentOf(dataFile(GetParam()));
};

TEST_P(Damaged, cutsAreNoticed)
{
  const TetMesh whole = readTetMesh(dataFile(GetParam()));
  const bool binary = content_.find('\0') != std::string::npos;
  const auto isBlank = [](char c) { return c == ' ' || c == '\n'; };
  int errors = 0;
  // At all bytes near the end, where a file is nearly whole.
  for (std::size_t size = 0; size<content_.size(); size += content_.size() - size> 70 ? 7 : 1)
  {
    TetMesh mesh;
    try
    {
      mesh = read(GetParam(), content_.substr(0, size));
    }
    catch (const InputError&)
    {
      ++errors;
      continue;
    }
    // In a text file that needs no word at its end a number that is cut short is another number.
    if (!binary && size > 0 && !isBlank(content_[size - 1]) && !isBlank(content_[size])) continue;
    ASSERT_EQ(mesh.tets, whole.tets) << size;
    ASSERT_EQ(mesh.corners, whole.corners) << size;
    ASSERT_EQ(mesh.mid_edges.size(), whole.mid_edges.size()) << size;
  }
  EXPECT_GT(errors, static_cast<int>(content_.size() / 7 / 4));
}

TEST_P(Damaged, noiseIsHarmless)
{
  std::mt19937 random(2);
  for (int i = 0; i < 100; ++i)
  {
    std::string content = content_;
    for (unsigned k = 0; k <= random() % 3; ++k)
    {
      char& c = content[random() % content.size()];
      c = random() % 2 == 0 ? static_cast<char>(c ^ (1 << random() % 8)) : "09-.e \n<\xff"[random() % 9];
    }
    try
    {
      const TetMesh mesh = read(GetParam(), content);
      ASSERT_NO_FATAL_FAILURE(expectConsistent(mesh));
    }
    catch (const InputError&)
    {
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Files, Damaged, testing::ValuesIn(allFiles()), testName);

}  // namespace
}  // namespace bezier_fem
