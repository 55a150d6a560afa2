// The program make_model, as a user runs it.
#include <gtest/gtest.h>

#include <cmath>
#include <set>
#include <sstream>

#include "core/surface_fixtures.h"

namespace bezier_fem
{
namespace
{
struct Result
{
  int status;
  std::string out, err;
};

/** `arguments` as in a shell, without redirections. A run that does not end has status 124. */
Result makeModel(const TemporaryDirectory& directory, const std::string& arguments)
{
  const std::string out = directory / "stdout", err = directory / "stderr";
  const int status = std::system(("cd '" + directory / "" + "' && timeout 120 '" BIN_DIR "/make_model' " + arguments +
                                  " >'" + out + "' 2>'" + err + "'")
                                     .c_str());
  return {WIFEXITED(status) ? WEXITSTATUS(status) : -1, contentOf(out), contentOf(err)};
}

/** What is in a file of Gmsh's format 2.2; read independently of the library. */
struct Msh
{
  std::vector<std::string> groups;
  std::vector<Eigen::Vector3d> points;
  std::vector<std::array<int, 4>> tets;
  std::vector<int> group;  // one a tetrahedron, from 1

  explicit Msh(const std::string& path)
  {
    std::istringstream file(contentOf(path));
    std::string word;
    int count = 0, id = 0;
    while (file >> word)
    {
      if (word == "$PhysicalNames")
      {
        file >> count;
        for (int i = 0; i < count; ++i)
        {
          int dimension = 0;
          file >> dimension >> id >> word;
          EXPECT_EQ(dimension, 3);
          EXPECT_EQ(id, i + 1);
          groups.push_back(word);
        }
      }
      if (word == "$Nodes")
      {
        file >> count;
        for (int i = 0; i < count; ++i)
        {
          points.emplace_back();
          file >> id >> points.back().x() >> points.back().y() >> points.back().z();
          EXPECT_EQ(id, i + 1);
        }
      }
      if (word == "$Elements")
      {
        file >> count;
        for (int i = 0; i < count; ++i)
        {
          int type = 0, tags = 0, elementary = 0;
          tets.emplace_back();
          group.emplace_back();
          file >> id >> type >> tags >> group.back() >> elementary;
          EXPECT_EQ(std::make_pair(type, tags), std::make_pair(4, 2));
          for (int& corner : tets.back())
          {
            file >> corner;
            --corner;
          }
        }
      }
    }
    EXPECT_EQ(word, "$EndElements");
    EXPECT_FALSE(tets.empty());
  }

  double volume(int of_group = 0) const
  {
    double sum = 0;
    for (std::size_t t = 0; t < tets.size(); ++t)
      if (of_group == 0 || group[t] == of_group) sum += tetVolume(t);
    return sum;
  }

  double tetVolume(std::size_t t) const
  {
    const auto& v = tets[t];
    return (points[v[1]] - points[v[0]]).cross(points[v[2]] - points[v[0]]).dot(points[v[3]] - points[v[0]]) / 6;
  }

  double smallestDihedral() const
  {
    double smallest = M_PI;
    for (const auto& v : tets)
      for (int i = 0; i < 4; ++i)
        for (int j = i + 1; j < 4; ++j)
        {
          // Between the two faces at edge ij: the angle of the other corners, seen along the edge.
          const int k = i == 0 ? (j == 1 ? 2 : 1) : 0, l = 6 - i - j - k;
          const Eigen::Vector3d axis = (points[v[j]] - points[v[i]]).normalized();
          const Eigen::Vector3d a = axis.cross(points[v[k]] - points[v[i]]),
                                b = axis.cross(points[v[l]] - points[v[i]]);
          smallest = std::min(smallest, std::atan2(a.cross(b).norm(), a.dot(b)));
        }
    return smallest * 180 / M_PI;
  }

  /** Points - edges + triangles of the boundary, which must be closed: every edge in two of its triangles. */
  int eulerCharacteristic() const
  {
    std::map<std::array<int, 3>, int> faces;
    for (const auto& v : tets)
      for (int i = 0; i < 4; ++i)
      {
        std::array<int, 3> face{v[(i + 1) % 4], v[(i + 2) % 4], v[(i + 3) % 4]};
        std::sort(face.begin(), face.end());
        ++faces[face];
      }
    std::map<std::pair<int, int>, int> edges;
    std::set<int> corners;
    int triangles = 0;
    for (const auto& [face, count] : faces)
    {
      EXPECT_LE(count, 2);
      if (count == 2) continue;
      ++triangles;
      corners.insert(face.begin(), face.end());
      for (const auto& edge :
           {std::make_pair(face[0], face[1]), std::make_pair(face[1], face[2]), std::make_pair(face[0], face[2])})
        ++edges[edge];
    }
    for (const auto& edge : edges) EXPECT_EQ(edge.second, 2);
    return static_cast<int>(corners.size()) - static_cast<int>(edges.size()) + triangles;
  }
};

void expectSound(const Msh& mesh)
{
  std::set<int> used;
  for (std::size_t t = 0; t < mesh.tets.size(); ++t)
  {
    EXPECT_GT(mesh.tetVolume(t), 0);
    used.insert(mesh.tets[t].begin(), mesh.tets[t].end());
  }
  EXPECT_EQ(used.size(), mesh.points.size());
  EXPECT_GT(mesh.smallestDihedral(), 9.9);
}

int linesOf(const std::string& text)
{
  return static_cast<int>(std::count(text.begin(), text.end(), '\n'));
}

TEST(MakeModel, KeepsTheEdgesOfACube)
{
  const TemporaryDirectory directory;
  directory.write("cube.off", offText(cube()));
  const Result run = makeModel(directory, "cube.off cube.msh --cell-size 0.25 --density 500");
  ASSERT_EQ(run.status, 0) << run.err;
  EXPECT_EQ(run.err, "");
  EXPECT_NE(run.out.find("1 x 1 x 1 m"), run.out.npos) << run.out;
  EXPECT_NE(run.out.find("mass 500 kg"), run.out.npos) << run.out;
  const Msh mesh(directory / "cube.msh");
  expectSound(mesh);
  EXPECT_EQ(mesh.groups, std::vector<std::string>{"\"body\""});
  EXPECT_NEAR(mesh.volume(), 1, 1e-12);
  EXPECT_EQ(mesh.eulerCharacteristic(), 2);
  for (const Eigen::Vector3d& corner : cube().points)
    EXPECT_TRUE(std::any_of(mesh.points.begin(), mesh.points.end(),
                            [&](const auto& p) { return (p - corner).norm() < 1e-12; }));
  // The largest circumradius is the cell size: no edge is longer than twice that.
  for (const auto& v : mesh.tets)
    for (int i = 0; i < 4; ++i) EXPECT_LT((mesh.points[v[i]] - mesh.points[v[(i + 1) % 4]]).norm(), 0.5);
}

// A manifold boundary with rounded edges needs ever more points at such corners, down to the rounding of coordinates.
TEST(MakeModel, SharpCornersDoNotKeepItBusyForEver)
{
  const TemporaryDirectory directory;
  Shape corner;  // of a cube, cut off
  corner.points = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  corner.polygons = {{0, 2, 1}, {0, 1, 3}, {0, 3, 2}, {1, 2, 3}};
  Shape wedge;  // thinner than the cell size near its edge
  const double height = 0.25;
  wedge.points = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}, {1, 1, height}, {0, 1, height}};
  wedge.polygons = {{0, 3, 2, 1}, {0, 1, 4, 5}, {1, 2, 4}, {0, 5, 3}, {3, 5, 4, 2}};
  const struct
  {
    Shape shape;
    double volume;
    std::string cell_size;
  } cases[] = {{corner, 1. / 6, "0.3"}, {corner, 1. / 6, "0.06"}, {wedge, height / 2, "0.2"}};
  for (const auto& c : cases)
  {
    SCOPED_TRACE(std::to_string(c.shape.points.size()) + " corners, cell size " + c.cell_size);
    directory.write("sharp.off", offText(c.shape));
    const Result run = makeModel(directory, "sharp.off sharp.msh --cell-size " + c.cell_size);
    ASSERT_EQ(run.status, 0) << run.err;
    const Msh mesh(directory / "sharp.msh");
    expectSound(mesh);
    EXPECT_NEAR(mesh.volume() / c.volume, 1, 1e-9);
    EXPECT_EQ(mesh.eulerCharacteristic(), 2);
  }
}

TEST(MakeModel, ACoarseSphereHasTheVolumeOfItsSurface)
{
  const TemporaryDirectory directory;
  const Shape ball = sphere(4);
  const double volume = enclosedVolume(readSurfaceMesh(directory.write("ball.off", offText(ball))));
  std::size_t last = 0;
  for (const double cell_size : {0.8, 0.4, 0.2})
  {
    const Result run = makeModel(directory, "ball.off ball.msh --cell-size " + std::to_string(cell_size));
    ASSERT_EQ(run.status, 0) << run.err;
    const Msh mesh(directory / "ball.msh");
    expectSound(mesh);
    EXPECT_NEAR(mesh.volume() / volume, 1, 0.005);  // with its points on the sphere it would lose 15 % at first
    EXPECT_EQ(mesh.eulerCharacteristic(), 2);
    EXPECT_GT(mesh.tets.size(), 3 * last);
    last = mesh.tets.size();
  }
}

TEST(MakeModel, TheSameInputGivesTheSameBytes)
{
  const TemporaryDirectory directory;
  directory.write("ball.off", offText(sphere(3)));
  ASSERT_EQ(makeModel(directory, "ball.off a.msh --cell-size 0.3").status, 0);
  ASSERT_EQ(makeModel(directory, "ball.off b.msh --cell-size 0.3").status, 0);
  EXPECT_EQ(contentOf(directory / "a.msh"), contentOf(directory / "b.msh"));
}

TEST(MakeModel, Scales)
{
  const TemporaryDirectory directory;
  directory.write("block.off", offText(cube().moved(10, 20, 30, 170)));
  const Result large = makeModel(directory, "block.off a.msh --cell-size 40");
  EXPECT_EQ(large.status, 0);
  EXPECT_EQ(linesOf(large.err), 1) << large.err;
  EXPECT_NE(large.err.find("millimetres"), large.err.npos) << large.err;
  const Result scaled = makeModel(directory, "block.off b.msh --cell-size 0.04 --scale 0.001");
  const Result sized = makeModel(directory, "block.off c.msh --cell-size 0.04 --longest-side 0.17");
  EXPECT_EQ(scaled.err + sized.err, "");
  for (const char* name : {"b.msh", "c.msh"})
  {
    const Msh mesh(directory / name);
    EXPECT_NEAR(mesh.volume(), std::pow(0.17, 3), 1e-12);
    Eigen::Vector3d low = mesh.points[0];
    for (const auto& p : mesh.points) low = low.cwiseMin(p);
    EXPECT_LT((low - Eigen::Vector3d(0.01, 0.02, 0.03)).norm(), 1e-12);
  }
}

TEST(MakeModel, RepairsWhatIsSafe)
{
  const TemporaryDirectory directory;
  Shape half_turned = cube(), doubled = cube(), split = sphere(3), flat = sphere(3);
  for (std::size_t i = 0; i < 6; i += 2) std::reverse(half_turned.polygons[i].begin(), half_turned.polygons[i].end());
  doubled.polygons.push_back(doubled.polygons[2]);
  doubled.points.emplace_back(9, 9, 9);
  // Every triangle with points of its own that rounding has moved apart.
  const Shape whole = sphere(3);
  split.points.clear();
  for (auto& polygon : split.polygons)
    for (int& corner : polygon)
    {
      split.points.push_back(whole.points[corner] * (1 + 1e-8 * static_cast<double>(split.points.size() % 3)));
      corner = static_cast<int>(split.points.size()) - 1;
    }
  // A triangle without area in the middle of an edge of another one.
  const auto t = flat.polygons[0];
  flat.points.push_back((flat.points[t[0]] + flat.points[t[1]]) / 2);
  const int middle = static_cast<int>(flat.points.size()) - 1;
  flat.polygons[0] = {t[0], middle, t[2]};
  flat.polygons.push_back({middle, t[1], t[2]});
  flat.polygons.push_back({t[0], t[1], middle});

  const struct
  {
    Shape shape;
    std::string says;
    double volume;
  } cases[] = {{cube().reversed(), "did not face outwards", 1},
               {half_turned, "did not face outwards", 1},
               {doubled, "given twice", 1},
               {split, "joined", 4 * M_PI / 3},
               {flat, "without area", 4 * M_PI / 3}};
  for (const auto& c : cases)
  {
    directory.write("thing.off", offText(c.shape));
    std::remove((directory / "thing.msh").c_str());
    const Result run = makeModel(directory, "thing.off thing.msh --cell-size 0.4");
    ASSERT_EQ(run.status, 0) << run.err;
    EXPECT_NE(run.out.find(c.says), run.out.npos) << run.out;
    const Msh mesh(directory / "thing.msh");
    expectSound(mesh);
    EXPECT_NEAR(mesh.volume() / c.volume, 1, 0.03);
    EXPECT_EQ(mesh.eulerCharacteristic(), 2);
  }
}

TEST(MakeModel, MeshesSeveralBodiesAndCavities)
{
  const TemporaryDirectory directory;
  directory.write("two.off", offText(cube().moved(3, 0, 0, 0.5) + sphere(3).moved(0, 0, 0)));
  Result run = makeModel(directory, "two.off two.msh --cell-size 0.3");
  ASSERT_EQ(run.status, 0) << run.err;
  EXPECT_NE(run.err.find("2 separate bodies"), run.err.npos) << run.err;
  const Msh two(directory / "two.msh");
  expectSound(two);
  EXPECT_EQ(two.groups, (std::vector<std::string>{"\"body_1\"", "\"body_2\""}));
  EXPECT_NEAR(two.volume(1), 4 * M_PI / 3, 0.1);  // the largest first
  EXPECT_NEAR(two.volume(2), 0.125, 0.002);
  EXPECT_EQ(two.eulerCharacteristic(), 4);

  // However the inner surface is oriented: a shell, and a core inside its cavity.
  for (const Shape& inner : {cube().moved(1, 1, 1), cube().moved(1, 1, 1).reversed()})
  {
    directory.write("hollow.off", offText(cube().moved(0, 0, 0, 3) + inner + sphere(2).moved(1.5, 1.5, 1.5, 0.3)));
    run = makeModel(directory, "hollow.off hollow.msh --cell-size 0.5");
    ASSERT_EQ(run.status, 0) << run.err;
    EXPECT_NE(run.out.find("cavity"), run.out.npos) << run.out;
    const Msh hollow(directory / "hollow.msh");
    EXPECT_NEAR(hollow.volume(1), 26, 0.1);
    EXPECT_NEAR(hollow.volume(2), 4 * M_PI / 3 * 0.027, 0.01);
    EXPECT_EQ(hollow.eulerCharacteristic(), 6);
  }
}

TEST(MakeModel, RefusesWhatIsNotASolidAndSaysWhere)
{
  const TemporaryDirectory directory;
  Shape open = cube(), poked = sphere(3), klein;
  open.polygons.erase(open.polygons.begin() + 1);
  poked.points[0] = {-1.5, 0.01, 0.01};
  constexpr int N = 24;
  for (int i = 0; i < N; ++i)
    for (int j = 0; j < N; ++j)
    {
      const double u = 2 * M_PI * i / N, v = 2 * M_PI * j / N;
      const double r = 2 + std::cos(u / 2) * std::sin(v) - std::sin(u / 2) * std::sin(2 * v);
      klein.points.emplace_back(r * std::cos(u), r * std::sin(u),
                                std::sin(u / 2) * std::sin(v) + std::cos(u / 2) * std::sin(2 * v));
      const auto at = [&](int a, int b) { return a < N ? a * N + b % N : (2 * N - b) % N; };  // the end is turned over
      klein.polygons.push_back({at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)});
    }
  const struct
  {
    Shape shape;
    std::string says;
  } cases[] = {{open, "open: 4 boundary edges in 1 hole, the longest (4 edges) around (0.5, 0.5, 1)"},
               {cube() + cube().moved(1, 0, 0), "4 edges are shared by more than two triangles"},
               {cube() + cube().moved(1, 1, 0), "1 edge is shared by more than two triangles, one around (1, 1, 0.5)"},
               {cube() + cube().moved(1, 1, 1), "touches itself at the point (1, 1, 1)"},
               {cube() + cube().moved(0.5, 0.5, 0.5), "cuts or touches itself"},
               {cube() + cube().moved(1, 0.25, 0.25, 0.5), "cuts or touches itself"},
               {poked, "cuts or touches itself"},
               {klein, "one side only"}};
  for (const auto& c : cases)
  {
    directory.write("thing.off", offText(c.shape));
    const Result run = makeModel(directory, "thing.off thing.msh --cell-size 0.4");
    EXPECT_EQ(run.status, 2) << c.says;
    EXPECT_EQ(linesOf(run.err), 1) << run.err;
    EXPECT_EQ(run.err.find("thing.off: "), 0u) << run.err;
    EXPECT_NE(run.err.find(c.says), run.err.npos) << run.err;
    EXPECT_EQ(run.out, "");
    EXPECT_FALSE(std::filesystem::exists(directory / "thing.msh"));
  }
}

TEST(MakeModel, RefusesCellSizesThatCannotWork)
{
  const TemporaryDirectory directory;
  directory.write("ball.off", offText(sphere(3)));
  Shape rod = cube();
  for (auto& p : rod.points) p.tail<2>() *= 0.02;
  directory.write("rod.off", offText(rod));
  const std::pair<std::string, std::string> cases[] = {{"ball.off ball.msh --cell-size 1e-4", "too small"},
                                                       {"rod.off rod.msh --cell-size 0.2", "too coarse"}};
  for (const auto& [arguments, says] : cases)
  {
    const Result run = makeModel(directory, arguments);
    EXPECT_EQ(run.status, 2);
    EXPECT_EQ(linesOf(run.err), 1) << run.err;
    EXPECT_NE(run.err.find(says), run.err.npos) << run.err;
  }
}

using Sizes = std::vector<std::pair<Eigen::Vector3d, double>>;

std::string sizingText(const Sizes& sizes)
{
  std::ostringstream text;
  text << "x,y,z,size\n";
  for (const auto& [p, size] : sizes) text << p.x() << "," << p.y() << "," << p.z() << "," << size << "\n";
  return text.str();
}

/** The size that is asked for at a point. */
double gradedSize(const Sizes& sizes, double cell_size, const Eigen::Vector3d& at)
{
  double least = cell_size;
  for (const auto& [p, size] : sizes) least = std::min(least, size + 0.3 * (at - p).norm());
  return least;
}

TEST(MakeModel, ASizingGradesTheMesh)
{
  const TemporaryDirectory directory;
  const Shape ball = sphere(4);
  const double volume = enclosedVolume(readSurfaceMesh(directory.write("ball.off", offText(ball))));
  const double coarse = 0.4, fine = 0.1;
  // One place on the surface, one inside, and a crowd of points that ask for nothing there that these do not.
  Sizes sizes{{{0, 0.9, 0}, fine}, {{-0.4, -0.4, 0}, 1.5 * fine}};
  for (int i = 0; i < 1000; ++i) sizes.push_back({{std::sin(i), 0.7 * std::sin(3.7 * i), std::sin(5.3 * i)}, 0.9});
  for (int i = 0; i < 100; ++i)
  {
    const Eigen::Vector3d at(0.2 * std::sin(i), 0.9 + 0.2 * std::sin(2.3 * i), 0.2 * std::sin(4.1 * i));
    sizes.push_back({at, gradedSize({sizes[0]}, coarse, at)});
  }
  directory.write("sizes.csv", sizingText(sizes));

  std::map<std::string, std::size_t> tets;
  for (const auto& [name, arguments] : std::map<std::string, std::string>{{"fine", "0.1"},
                                                                          {"coarse", "0.4"},
                                                                          {"graded", "0.4 --sizing sizes.csv"},
                                                                          {"again", "0.4 --sizing sizes.csv"}})
  {
    const Result run = makeModel(directory, "ball.off " + name + ".msh --cell-size " + arguments);
    ASSERT_EQ(run.status, 0) << run.err;
    EXPECT_EQ(run.err, "");
    const Msh mesh(directory / name + ".msh");
    expectSound(mesh);
    EXPECT_EQ(mesh.eulerCharacteristic(), 2);
    EXPECT_NEAR(mesh.volume() / volume, 1, 0.005);
    tets[name] = mesh.tets.size();
  }
  EXPECT_EQ(contentOf(directory / "graded.msh"), contentOf(directory / "again.msh"));
  EXPECT_GT(tets["graded"], 1.5 * tets["coarse"]);
  EXPECT_LT(tets["graded"], 0.2 * tets["fine"]);

  // Edges have the same length in terms of the size asked for as in a uniform mesh, in every band of sizes.
  const auto ratios = [&](const std::string& name, const Sizes& asked, double cell_size) {
    const Msh mesh(directory / name);
    std::array<double, 3> sum{}, count{};
    for (const auto& v : mesh.tets)
    {
      double edge = 0;
      for (int i = 0; i < 4; ++i)
        for (int j = i + 1; j < 4; ++j) edge += (mesh.points[v[i]] - mesh.points[v[j]]).norm() / 6;
      const double wanted = gradedSize(
          asked, cell_size, (mesh.points[v[0]] + mesh.points[v[1]] + mesh.points[v[2]] + mesh.points[v[3]]) / 4);
      const auto band = static_cast<std::size_t>(std::min(2., std::log(wanted / fine) / std::log(coarse / fine) * 3));
      sum[band] += edge / wanted;
      ++count[band];
    }
    for (std::size_t band = 0; band < 3; ++band) sum[band] /= count[band];
    return sum;
  };
  const double uniform = ratios("fine.msh", {}, fine)[0];
  for (const double ratio : ratios("graded.msh", sizes, coarse)) EXPECT_NEAR(ratio / uniform, 1, 0.12);
}

TEST(MakeModel, ASizingKeepsSharpEdges)
{
  const TemporaryDirectory directory;
  directory.write("cube.off", offText(cube()));
  const Sizes sizes{{{0, 0, 0}, 0.04}, {{1, 1, 0.5}, 0.06}};
  directory.write("sizes.csv", sizingText(sizes));
  const Result run = makeModel(directory, "cube.off cube.msh --cell-size 0.3 --sizing sizes.csv");
  ASSERT_EQ(run.status, 0) << run.err;
  const Msh mesh(directory / "cube.msh");
  expectSound(mesh);
  EXPECT_NEAR(mesh.volume(), 1, 1e-12);
  EXPECT_EQ(mesh.eulerCharacteristic(), 2);
  EXPECT_GT(std::count_if(mesh.points.begin(), mesh.points.end(), [](const auto& p) { return p.norm() < 0.1; }), 8);
  EXPECT_LE(std::count_if(mesh.points.begin(), mesh.points.end(),
                          [](const auto& p) { return (p - Eigen::Vector3d(0, 1, 1)).norm() < 0.1; }),
            1);
}

TEST(MakeModel, ASizingThatAsksForNoSmallerElementsChangesNothing)
{
  const TemporaryDirectory directory;
  directory.write("ball.off", offText(sphere(3)));
  directory.write("sizes.csv", sizingText({{{0, 0, 0}, 0.3}, {{1, 0, 0}, 5}}));
  ASSERT_EQ(makeModel(directory, "ball.off a.msh --cell-size 0.3").status, 0);
  ASSERT_EQ(makeModel(directory, "ball.off b.msh --cell-size 0.3 --sizing sizes.csv").status, 0);
  EXPECT_EQ(contentOf(directory / "a.msh"), contentOf(directory / "b.msh"));
}

// Far from it a sizing may be as fine as it likes; one point costs little, many of them are refused in time.
TEST(MakeModel, RefusesASizingThatMakesTooManyElements)
{
  const TemporaryDirectory directory;
  directory.write("ball.off", offText(sphere(3)));
  const std::string run_it = "ball.off ball.msh --cell-size 0.5 --sizing sizes.csv";
  Sizes inside, outside;
  for (int i = 0; i < 1000; ++i)
  {
    const Eigen::Vector3d p(std::sin(i), std::sin(3.7 * i), std::sin(5.3 * i));
    inside.push_back({0.5 * p, 1e-6});
    outside.push_back({p + Eigen::Vector3d(8, 0, 0), 1e-6});
  }
  directory.write("sizes.csv", sizingText(inside));
  Result run = makeModel(directory, run_it);
  EXPECT_EQ(run.status, 2);
  EXPECT_EQ(linesOf(run.err), 1) << run.err;
  EXPECT_NE(run.err.find("ball.off: the sizing, down to 1e-06 m, asks for more than 5e+06 elements"), run.err.npos)
      << run.err;
  directory.write("sizes.csv", sizingText(outside));
  run = makeModel(directory, run_it);
  EXPECT_EQ(run.status, 0) << run.err;
  const Msh far(directory / "ball.msh");
  directory.write("sizes.csv", sizingText({{{0.3, 0.2, 0}, 1e-3}}));
  run = makeModel(directory, run_it);
  EXPECT_EQ(run.status, 0) << run.err;
  const Msh point(directory / "ball.msh");
  expectSound(point);
  EXPECT_LT(point.tets.size(), far.tets.size() + 20000);
}

TEST(MakeModel, RefusesWrongArgumentsInOneLine)
{
  const TemporaryDirectory directory;
  directory.write("cube.off", offText(cube()));
  directory.write("junk.stl", "not a surface at all");
  directory.write("zero.csv", "x,y,z,size\n0,0,0,0\n");
  for (const std::string arguments : {"",
                                      "cube.off",
                                      "cube.off a.msh",
                                      "cube.off a.msh --cell-size",
                                      "cube.off a.msh --cell-size x",
                                      "cube.off a.msh --cell-size 0",
                                      "cube.off a.msh --cell-size=-1",
                                      "cube.off a.msh --cell-size nan",
                                      "cube.off a.msh --cell-size inf",
                                      "cube.off a.msh --cell-size 0.3 --scale 0",
                                      "cube.off a.msh b --cell-size 0.3",
                                      "cube.off a.msh --cell-size 0.3 --scale 2 --longest-side 1",
                                      "cube.off a.msh --cell-size 0.3 --density -5",
                                      "cube.off a.msh --cell-size 0.3 --colour red",
                                      "cube.off a.vtk --cell-size 0.3",
                                      "cube.off nowhere/a.msh --cell-size 0.3",
                                      "missing.off a.msh --cell-size 0.3",
                                      ". a.msh --cell-size 0.3",
                                      "junk.stl a.msh --cell-size 0.3",
                                      "cube.off a.msh --cell-size 0.3 --sizing",
                                      "cube.off a.msh --cell-size 0.3 --sizing missing.csv",
                                      "cube.off a.msh --cell-size 0.3 --sizing zero.csv"})
  {
    const Result run = makeModel(directory, arguments);
    EXPECT_EQ(run.status, 2) << arguments;
    EXPECT_EQ(linesOf(run.err), 1) << arguments << ": " << run.err;
    EXPECT_EQ(run.out, "") << arguments;
  }
  EXPECT_FALSE(std::filesystem::exists(directory / "a.msh"));
}

TEST(MakeModel, HelpNamesOptionsAndUnits)
{
  const TemporaryDirectory directory;
  const Result run = makeModel(directory, "--help");
  EXPECT_EQ(run.status, 0);
  EXPECT_EQ(run.err, "");
  for (const std::string word :
       {"SURFACE", "OUT.msh", "--cell-size", "--scale", "--longest-side", "--density", "--sizing", "kg/m3", " m "})
    EXPECT_NE(run.out.find(word), run.out.npos) << word;
}

}  // namespace
}  // namespace bezier_fem
