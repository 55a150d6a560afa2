#include "bezier_fem/surface_mesh.h"

#include <gtest/gtest.h>

#include <cstdint>
#include <cstring>
#include <sstream>

#include "bezier_fem/error.h"
#include "core/surface_fixtures.h"

namespace bezier_fem
{
namespace
{
std::string objText(const Shape& shape)
{
  std::ostringstream text;
  text << "# made by a test\nmtllib nowhere.mtl\no thing\nvt 0 0\nvn 0 0 1\n";
  for (const auto& p : shape.points) text << "v " << p.x() << ' ' << p.y() << ' ' << p.z() << " 1.0\n";
  text << "usemtl nothing\ns off\n";
  for (const auto& polygon : shape.polygons)
  {
    text << 'f';
    for (const int corner : polygon) text << ' ' << corner + 1 << "/1/1";
    text << '\n';
  }
  return text.str();
}

/** For shapes of triangles. */
std::string stlText(const Shape& shape)
{
  std::ostringstream text;
  text << "solid thing\n";
  for (const auto& polygon : shape.polygons)
  {
    text << "facet normal 0 0 0\n outer loop\n";
    for (const int corner : polygon) text << "  vertex " << shape.points[corner].transpose() << '\n';
    text << " endloop\nendfacet\n";
  }
  text << "endsolid thing\n";
  return text.str();
}

template <class Number>
void append(std::string& bytes, Number number, bool reverse = false)
{
  char raw[sizeof(number)];
  std::memcpy(raw, &number, sizeof(number));
  if (reverse) std::reverse(raw, raw + sizeof(raw));
  bytes.append(raw, sizeof(raw));
}

/** The header begins with "solid", as many writers have it. */
std::string stlBytes(const Shape& shape)
{
  std::string bytes = "solid in a binary file";
  bytes.resize(80, ' ');
  append(bytes, static_cast<std::uint32_t>(shape.polygons.size()));
  for (const auto& polygon : shape.polygons)
  {
    bytes.append(12, '\0');
    for (const int corner : polygon)
      for (const double x : shape.points[corner]) append(bytes, static_cast<float>(x));
    bytes.append(2, '\0');
  }
  return bytes;
}

std::string plyBytes(const Shape& shape, const std::string& format)
{
  const bool swap = format == "binary_big_endian";
  std::ostringstream head;
  head << "ply\nformat " << format << " 1.0\ncomment of no # use\nelement vertex " << shape.points.size()
       << "\nproperty double x\nproperty double y\nproperty double z\nproperty uchar red\nelement face "
       << shape.polygons.size() << "\nproperty list uchar int vertex_indices\nend_header\n";
  std::ostringstream text;
  std::string bytes;
  for (const auto& p : shape.points)
  {
    text << p.transpose() << " 200\n";
    for (const double x : p) append(bytes, x, swap);
    append(bytes, static_cast<std::uint8_t>(200));
  }
  for (const auto& polygon : shape.polygons)
  {
    text << polygon.size();
    append(bytes, static_cast<std::uint8_t>(polygon.size()));
    for (const int corner : polygon)
    {
      text << ' ' << corner;
      append(bytes, static_cast<std::int32_t>(corner), swap);
    }
    text << '\n';
  }
  return head.str() + (format == "ascii" ? text.str() : bytes);
}

TEST(SurfaceMesh, EveryFormatGivesTheSameSurface)
{
  const TemporaryDirectory directory;
  const Shape ball = sphere(2);
  const std::vector<std::pair<std::string, std::string>> files = {
      {"ball.off", offText(ball)},
      {"ball.OBJ", objText(ball)},
      {"text.stl", stlText(ball)},
      {"bytes.stl", stlBytes(ball)},
      {"text.ply", plyBytes(ball, "ascii")},
      {"little.ply", plyBytes(ball, "binary_little_endian")},
      {"big.ply", plyBytes(ball, "binary_big_endian")}};
  for (const auto& [name, content] : files)
  {
    const std::string path = directory.write(name, content);
    EXPECT_TRUE(isSurfaceFile(path)) << name;
    const SurfaceMesh mesh = readSurfaceMesh(path);
    // 66 points: those of an .stl file, three for each triangle, have been merged.
    ASSERT_EQ(mesh.points.cols(), 66) << name;
    ASSERT_EQ(mesh.triangles.cols(), 128) << name;
    for (Eigen::Index t = 0; t < 128; ++t)
      for (int i = 0; i < 3; ++i)
        EXPECT_LT((mesh.points.col(mesh.triangles(i, t)) - ball.points[ball.polygons[t][i]]).norm(), 1e-5) << name;
  }
  EXPECT_FALSE(isSurfaceFile("ball.msh"));
  EXPECT_FALSE(isSurfaceFile("off"));
}

TEST(SurfaceMesh, KeepsDoublePrecisionFarFromTheOrigin)
{
  const TemporaryDirectory directory;
  const Shape far = cube().moved(4321000.125, 5432000.0625, 0, 1e-3);
  const SurfaceMesh mesh = readSurfaceMesh(directory.write("far.off", offText(far)));
  EXPECT_EQ(mesh.points.cols(), 8);
  EXPECT_NEAR((mesh.points.rowwise().maxCoeff() - mesh.points.rowwise().minCoeff())[0], 1e-3, 1e-8);
}

TEST(SurfaceMesh, MergesPointsAndDropsWhatIsNotUsed)
{
  const TemporaryDirectory directory;
  // Two triangles with their own points, one of them -0; an unused point; a triangle that is a line.
  const SurfaceMesh mesh = readSurfaceMesh(directory.write("patch.off",
                                                           "OFF 8 3 0\n0 0 0\n1 0 0\n0 1 0\n\n# the second\n1 0 -0.0\n"
                                                           "1 1 0\n0 1 -0\n9 9 9\n0 0 0\n"
                                                           "3 0 1 2 # grey\n3 3 4 5 0.5 0.5 0.5\n3 0 7 1\n"));
  EXPECT_EQ(mesh.points.cols(), 4);
  ASSERT_EQ(mesh.triangles.cols(), 2);
  EXPECT_EQ(mesh.triangles.col(0), Eigen::Vector3i(0, 1, 2));
  EXPECT_EQ(mesh.triangles.col(1), Eigen::Vector3i(1, 3, 2));
}

TEST(SurfaceMesh, CutsPolygonsIntoTriangles)
{
  const TemporaryDirectory directory;
  EXPECT_NEAR(enclosedVolume(readSurfaceMesh(directory.write("cube.off", offText(cube())))), 1, 1e-15);

  // A prism over an arrow head and one over a staircase with points in the middle of its sides: concave, and lines.
  const std::vector<std::vector<Eigen::Vector2d>> outlines = {
      {{0, 0}, {2, 0}, {2, 2}, {1, 0.25}, {0, 2}},
      {{0, 0}, {1, 0}, {3, 0}, {3, 1}, {2, 1}, {2, 2}, {1, 2}, {1, 3}, {0, 3}, {0, 1}}};
  const double areas[] = {2.25, 6};
  for (std::size_t i = 0; i < outlines.size(); ++i)
  {
    Shape prism;
    const int n = static_cast<int>(outlines[i].size());
    std::vector<int> bottom, top;
    for (const double z : {0., 1.})
      for (const auto& p : outlines[i]) prism.points.emplace_back(p.x(), p.y(), z);
    for (int k = 0; k < n; ++k)
    {
      bottom.insert(bottom.begin(), k);
      top.push_back(n + k);
      prism.polygons.push_back({k, (k + 1) % n, n + (k + 1) % n, n + k});
    }
    prism.polygons.push_back(bottom);
    prism.polygons.push_back(top);
    const SurfaceMesh mesh = readSurfaceMesh(directory.write("prism.off", offText(prism)));
    EXPECT_EQ(mesh.triangles.cols(), 2 * (n - 2) + 2 * n);
    double area = 0;
    for (const auto& t : mesh.triangles.colwise())
      area +=
          (mesh.points.col(t[1]) - mesh.points.col(t[0])).cross(mesh.points.col(t[2]) - mesh.points.col(t[0])).norm() /
          2;
    double outline = 0;
    for (int k = 0; k < n; ++k) outline += (outlines[i][(k + 1) % n] - outlines[i][k]).norm();
    EXPECT_NEAR(enclosedVolume(mesh), areas[i], 1e-14);
    EXPECT_NEAR(area, 2 * areas[i] + outline, 1e-14);  // no triangle lies outside its polygon
  }
}

TEST(SurfaceMesh, ReadsObjAsWritersWriteIt)
{
  const TemporaryDirectory directory;
  const SurfaceMesh mesh = readSurfaceMesh(directory.write(
      "thing.obj", "v 0 0 0\r\nv +1 0 0\r\nv 1 1 .0\nv 0 1e0 0 0.5 0.5 0.5\nl 1 2\np 3\nf -4 -3 \\\n -2//7 -1\n"));
  EXPECT_EQ(mesh.triangles.cols(), 2);
  EXPECT_EQ(mesh.points.cols(), 4);
}

struct BadFile
{
  std::string name, content, says;
};

TEST(SurfaceMesh, RefusesInOneLineThatNamesTheFileAndTheFault)
{
  const TemporaryDirectory directory;
  const std::string square = "v 0 0 0\nv 1 0 0\nv 1 1 0\n";
  const std::string ply = plyBytes(cube(), "ascii"), bytes = plyBytes(cube(), "binary_little_endian");
  const auto replaced = [](std::string text, const std::string& what, const std::string& by) {
    return text.replace(text.find(what), what.size(), by);
  };
  std::string noise;
  for (int i = 0; i < 5000; ++i) noise += static_cast<char>(i * i % 251);
  const std::vector<BadFile> files = {
      {"empty.off", "", "is empty"},
      {"blank.off", "\n\n", "is empty"},
      {"noise.off", noise, "OFF"},
      {"noise.obj", noise, "no triangles"},
      {"noise.stl", noise, "cut short"},
      {"noise.ply", noise, "ply"},
      {"short.stl", "solid", "no endsolid"},
      {"tiny.stl", "sol", "neither a text nor a binary"},
      {"word.off", "OFF\n3 1 0\n0 0 x\n", ":3: 'x' is not a coordinate"},
      {"nan.off", "OFF\n3 1 0\n0 0 nan\n1 0 0\n0 1 0\n3 0 1 2\n", ":3: the coordinate nan is not finite"},
      {"inf.obj", "v 0 0 1e999\n", ":1: '1e999' is not a coordinate"},
      {"index.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n", ":6: the point index 3 is not in 0..2"},
      {"negative.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 -1\n", "-1 is not in 0..2"},
      {"points.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n", "after 2 of 3 points"},
      {"faces.off", "OFF\n3 2 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", "after 1 of 2 faces"},
      {"many.off", "OFF\n99999999999 1 0\n0 0 0\n", "more than the file can hold"},
      {"lines.off", "OFF\n2 1 0\n0 0 0\n1 0 0\n2 0 1\n", "no triangles"},
      {"flat.off", "OFF\n3 1 0\n0 0 0\n0 0 0\n0 1 0\n3 0 1 2\n", "no triangles"},
      {"zero.obj", square + "f 0 1 2\n", ":4: the point index 0"},
      {"index.obj", square + "f 1 2 4\n", ":4: the point index 4 is not one of the 3"},
      {"back.obj", square + "f -1 -2 -4\n", "index -4"},
      {"two.obj", square + "f 1 2\n", ":4: a face needs three corners"},
      {"points.obj", square, "no triangles"},
      {"cut.stl", stlText(sphere(0)).substr(0, 300), "cut short"},
      {"cutbytes.stl", stlBytes(sphere(0)).substr(0, 300), "484 bytes, the file has 300"},
      {"nan.stl", replaced(stlText(sphere(0)), "vertex 1 0 0", "vertex nan 0 0"), "not finite"},
      {"cut.ply", ply.substr(0, ply.size() - 5), "face 5 of 6"},
      {"cutbytes.ply", bytes.substr(0, bytes.size() - 5), "face 5 of 6"},
      {"index.ply", replaced(ply, "4 0 2 3 1", "4 0 2 3 8"), "index 8 is not in 0..7"},
      {"negative.ply", replaced(ply, "4 0 2 3 1", "4 0 2 3 -1"), "index -1"},
      {"list.ply", replaced(ply, "4 0 2 3 1", "1e9 0 2 3 1"), "longer than the file"},
      {"many.ply", replaced(ply, "vertex 8", "vertex 8888888888"), "more than the file can hold"},
      {"type.ply", replaced(ply, "double x", "quad x"), "'quad' is not a property type"},
      {"format.ply", replaced(ply, "ascii", "morse"), "'morse' is not ascii"},
      {"axis.ply", replaced(ply, "double x", "double u"), "x, y and z"},
      {"header.ply", ply.substr(0, 30), "ends within the header"},
      {"mesh.msh", "$MeshFormat\n", "'.msh' is not one of .off, .obj, .stl, .ply"}};
  for (const BadFile& file : files)
  {
    const std::string path = directory.write(file.name, file.content);
    try
    {
      readSurfaceMesh(path);
      ADD_FAILURE() << file.name << " was read";
    }
    catch (const InputError& error)
    {
      const std::string message = error.what();
      EXPECT_EQ(message.find(path), 0u) << message;
      EXPECT_NE(message.find(file.says), message.npos) << message;
      EXPECT_EQ(message.find('\n'), message.npos) << message;
    }
  }
  EXPECT_THROW(readSurfaceMesh(directory / "missing.off"), InputError);
  std::filesystem::create_directory(directory / "folder.off");
  EXPECT_THROW(readSurfaceMesh(directory / "folder.off"), InputError);
}

TEST(SurfaceMesh, NoDamagedFileDoesAnythingButThrowInputError)
{
  const TemporaryDirectory directory;
  const Shape ball = sphere(1);
  const std::vector<std::pair<std::string, std::string>> files = {
      {"a.off", offText(ball)},  {"a.obj", objText(ball)},           {"a.stl", stlText(ball)},
      {"b.stl", stlBytes(ball)}, {"a.ply", plyBytes(ball, "ascii")}, {"b.ply", plyBytes(ball, "binary_little_endian")}};
  std::uint32_t random = 1;
  const auto next = [&](std::size_t below) { return (random = random * 1664525 + 1013904223) / 65536 % below; };
  for (const auto& [name, content] : files)
    for (int i = 0; i < 300; ++i)
    {
      std::string damaged = content.substr(0, i % 3 == 0 ? next(content.size()) : content.size());
      for (int k = 0; k < 3 && !damaged.empty(); ++k)
        damaged[next(damaged.size())] = i % 2 ? static_cast<char>(next(256)) : "0123456789-e. \n"[next(15)];
      const std::string path = directory.write(name, damaged);
      try
      {
        const SurfaceMesh mesh = readSurfaceMesh(path);
        EXPECT_TRUE(mesh.points.allFinite());
        EXPECT_GE(mesh.triangles.minCoeff(), 0);
        EXPECT_LT(mesh.triangles.maxCoeff(), mesh.points.cols());
      }
      catch (const InputError& error)
      {
        EXPECT_EQ(std::string(error.what()).find('\n'), std::string::npos) << error.what();
      }
    }
}

}  // namespace
}  // namespace bezier_fem
