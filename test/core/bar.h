#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <random>

#include "bezier_fem/bernstein.h"
#include "bezier_fem/boundary_conditions.h"
#include "bezier_fem/mesh.h"
#include "bezier_fem/model.h"

namespace bezier_fem::test
{
/** A box from the origin, its cells cut into six tetrahedra along one diagonal (Kuhn 1960). */
inline TetMesh kuhnBox(const Eigen::Vector3i& cells, const Eigen::Vector3d& size)
{
  TetMesh mesh;
  const Eigen::Vector3i points = cells.array() + 1;
  const auto index = [&](const Eigen::Vector3i& p) { return (p.z() * points.y() + p.y()) * points.x() + p.x(); };
  mesh.corners.resize(3, points.prod());
  Eigen::Vector3i p;
  for (p.z() = 0; p.z() < points.z(); ++p.z())
  {
    for (p.y() = 0; p.y() < points.y(); ++p.y())
    {
      for (p.x() = 0; p.x() < points.x(); ++p.x())
      {
        mesh.corners.col(index(p)) = p.cast<double>().cwiseQuotient(cells.cast<double>()).cwiseProduct(size);
      }
    }
  }
  mesh.tets.resize(4, 6 * cells.prod());
  int count = 0;
  for (p.z() = 0; p.z() < cells.z(); ++p.z())
  {
    for (p.y() = 0; p.y() < cells.y(); ++p.y())
    {
      for (p.x() = 0; p.x() < cells.x(); ++p.x())
      {
        std::array<int, 3> path{0, 1, 2};
        do
        {
          Eigen::Vector3i q = p;
          Eigen::Vector4i tet;
          tet[0] = index(q);
          for (int k = 0; k < 3; ++k)
          {
            ++q[path[k]];
            tet[k + 1] = index(q);
          }
          const bool odd = (path[0] > path[1]) ^ (path[1] > path[2]) ^ (path[0] > path[2]);
          if (odd) std::swap(tet[2], tet[3]);
          mesh.tets.col(count++) = tet;
        } while (std::next_permutation(path.begin(), path.end()));
      }
    }
  }
  for (int i = 0; i < points.prod(); ++i) mesh.corner_ids.push_back(i + 1);
  mesh.largest_id = points.prod();
  return mesh;
}

/** The same with inner corners moved at random by up to `amount` of a cell: an irregular mesh. */
inline TetMesh irregularBox(const Eigen::Vector3i& cells, const Eigen::Vector3d& size, double amount = 0.2)
{
  TetMesh mesh = kuhnBox(cells, size);
  std::mt19937 random(7);
  std::uniform_real_distribution<double> uniform(-amount, amount);
  const Eigen::Vector3d cell = size.cwiseQuotient(cells.cast<double>());
  for (Eigen::Index c = 0; c < mesh.corners.cols(); ++c)
  {
    for (int axis = 0; axis < 3; ++axis)
    {
      const double at = mesh.corners(axis, c);
      if (at > 1e-9 && at < size[axis] - 1e-9) mesh.corners(axis, c) += uniform(random) * cell[axis];
    }
  }
  return mesh;
}

constexpr Material RUBBER{2e5, 0.34, 500};

inline Model boxModel(const TetMesh& mesh, Element element, const Material& material = RUBBER,
                      Dilatation dilatation = Dilatation::FULL)
{
  return buildModel(mesh, element, std::vector<Material>(mesh.tets.cols(), material), dilatation);
}

/** Holds what is at z = 0 at rest, where it starts. */
inline Supports holdFoot(const Model& model, const NodalField& start)
{
  Supports supports;
  supports.held.assign(model.num_nodes, 0);
  supports.region.assign(model.num_nodes, {-1, -1, -1});
  supports.start = start;
  HeldRegion region;
  region.axes = {true, true, true};
  for (int i = 0; i < model.num_nodes; ++i)
  {
    if (model.rest[i].z() > 1e-9) continue;
    region.nodes.push_back(i);
    supports.held[i] = 7;
    supports.region[i] = {0, 0, 0};
  }
  supports.regions.push_back(region);
  return supports;
}

/** A field of random numbers in [-1, 1]. */
inline NodalField randomField(int size, unsigned seed, int rows = 0)
{
  NodalField field(std::max(size, rows));
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> uniform(-1, 1);
  for (int i = 0; i < size; ++i) field[i] = Eigen::Vector3d(uniform(random), uniform(random), uniform(random));
  return field;
}

inline Eigen::Matrix3d randomRotation(std::mt19937& random)
{
  std::normal_distribution<double> normal;
  return Eigen::Quaterniond(normal(random), normal(random), normal(random), normal(random))
      .normalized()
      .toRotationMatrix();
}

/** Holds the nodes whose rest positions are inside where they are at rest, or leads them along a motion. */
template <class Inside>
Supports hold(const Model& model, const Inside& inside, std::vector<MotionSample> motion = {})
{
  Supports supports;
  supports.held.assign(model.num_nodes, 0);
  supports.region.assign(model.num_nodes, {-1, -1, -1});
  supports.start = model.rest;
  HeldRegion region;
  region.name = "held";
  region.axes = {true, true, true};
  region.motion = std::move(motion);
  for (int i = 0; i < model.num_nodes; ++i)
  {
    if (!inside(Eigen::Vector3d(model.rest[i]))) continue;
    region.nodes.push_back(i);
    supports.held[i] = 7;
    supports.region[i] = {0, 0, 0};
  }
  supports.regions.push_back(region);
  return supports;
}
inline Supports holdFoot(const Model& model, std::vector<MotionSample> motion = {})
{
  return hold(
      model, [](const Eigen::Vector3d& X) { return X.z() < 1e-9; }, std::move(motion));
}
inline Supports holdNothing(const Model& model)
{
  return hold(model, [](const Eigen::Vector3d&) { return false; });
}

inline const char* name(Element element)
{
  return element == Element::LINEAR ? "linear" : "quadratic";
}

}  // namespace bezier_fem::test
