#pragma once

#include <Eigen/Geometry>
#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>
#include <sstream>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "bezier_fem/surface_mesh.h"

namespace bezier_fem
{
/** A fresh directory that goes away with its owner. */
class TemporaryDirectory
{
public:
  TemporaryDirectory()
  {
    std::string name = (std::filesystem::temp_directory_path() / "bezier_fem_test_XXXXXX").string();
    if (!mkdtemp(name.data())) throw std::runtime_error("no temporary directory");
    path_ = name;
  }
  ~TemporaryDirectory()
  {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  std::string operator/(const std::string& name) const { return (path_ / name).string(); }
  std::string write(const std::string& name, const std::string& content) const
  {
    std::ofstream(path_ / name, std::ios::binary) << content;
    return *this / name;
  }

private:
  std::filesystem::path path_;
};

inline std::string contentOf(const std::string& path)
{
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

/** Points and polygons, to be written to any format and joined. */
struct Shape
{
  std::vector<Eigen::Vector3d> points;
  std::vector<std::vector<int>> polygons;

  Shape moved(double x, double y, double z, double scale = 1) const
  {
    Shape shape = *this;
    for (Eigen::Vector3d& p : shape.points) p = scale * p + Eigen::Vector3d(x, y, z);
    return shape;
  }
  Shape reversed() const
  {
    Shape shape = *this;
    for (auto& polygon : shape.polygons) std::reverse(polygon.begin(), polygon.end());
    return shape;
  }
  Shape operator+(const Shape& other) const
  {
    Shape shape = *this;
    const int offset = static_cast<int>(points.size());
    shape.points.insert(shape.points.end(), other.points.begin(), other.points.end());
    for (auto polygon : other.polygons)
    {
      for (int& corner : polygon) corner += offset;
      shape.polygons.push_back(polygon);
    }
    return shape;
  }
};

/** [0, 1]^3 with square faces. */
inline Shape cube()
{
  Shape shape;
  for (int i = 0; i < 8; ++i) shape.points.emplace_back(i & 1, i >> 1 & 1, i >> 2);
  shape.polygons = {{0, 2, 3, 1}, {4, 5, 7, 6}, {0, 1, 5, 4}, {2, 6, 7, 3}, {0, 4, 6, 2}, {1, 3, 7, 5}};
  return shape;
}

/** A sphere of radius 1 around the origin: an octahedron, each triangle cut into four `levels` times. */
inline Shape sphere(int levels)
{
  Shape shape;
  shape.points = {{1, 0, 0}, {-1, 0, 0}, {0, 1, 0}, {0, -1, 0}, {0, 0, 1}, {0, 0, -1}};
  shape.polygons = {{0, 2, 4}, {2, 1, 4}, {1, 3, 4}, {3, 0, 4}, {2, 0, 5}, {1, 2, 5}, {3, 1, 5}, {0, 3, 5}};
  for (int level = 0; level < levels; ++level)
  {
    std::map<std::pair<int, int>, int> middles;
    const auto middle = [&](int a, int b) {
      const auto [entry, is_new] = middles.emplace(std::minmax(a, b), static_cast<int>(shape.points.size()));
      if (is_new) shape.points.push_back((shape.points[a] + shape.points[b]).normalized());
      return entry->second;
    };
    std::vector<std::vector<int>> finer;
    for (const auto& t : shape.polygons)
    {
      const int ab = middle(t[0], t[1]), bc = middle(t[1], t[2]), ca = middle(t[2], t[0]);
      finer.insert(finer.end(), {{t[0], ab, ca}, {t[1], bc, ab}, {t[2], ca, bc}, {ab, bc, ca}});
    }
    shape.polygons = finer;
  }
  return shape;
}

inline std::string offText(const Shape& shape)
{
  std::ostringstream text;
  text.precision(17);
  text << "OFF\n" << shape.points.size() << ' ' << shape.polygons.size() << " 0\n";
  for (const auto& p : shape.points) text << p.x() << ' ' << p.y() << ' ' << p.z() << '\n';
  for (const auto& polygon : shape.polygons)
  {
    text << polygon.size();
    for (const int corner : polygon) text << ' ' << corner;
    text << '\n';
  }
  return text.str();
}

/** Enclosed volume, positive if the triangles face outwards. */
inline double enclosedVolume(const SurfaceMesh& mesh)
{
  double volume = 0;
  for (const auto& t : mesh.triangles.colwise())
    volume += mesh.points.col(t[0]).dot(mesh.points.col(t[1]).cross(mesh.points.col(t[2]))) / 6;
  return volume;
}

}  // namespace bezier_fem
