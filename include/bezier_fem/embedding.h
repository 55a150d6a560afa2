#pragma once

#include <Eigen/Core>
#include <memory>
#include <vector>

#include "bezier_fem/model.h"
#include "bezier_fem/nodal_field.h"
#include "bezier_fem/partition.h"

namespace bezier_fem
{
/** A material point: the element that it moves with and its barycentric coordinates there, negative if outside. */
struct MaterialPoint
{
  int tet;
  Eigen::Vector4d lambda;
};

/** Finds elements by position in the rest shape. */
class PointLocator
{
public:
  explicit PointLocator(const Model& model);
  ~PointLocator();
  PointLocator(const PointLocator&) = delete;
  PointLocator& operator=(const PointLocator&) = delete;

  /** The element that holds the point or is nearest to it; `distance` (m, 0 inside) may be null. */
  MaterialPoint locate(const Eigen::Vector3d& rest, double* distance = nullptr) const;

private:
  struct Tree;
  const Model& model_;
  std::unique_ptr<Tree> tree_;
};

/** Current position of a material point, m: sum_I B_I(lambda) x_I. */
Eigen::Vector3d position(const Model& model, const NodalField& x, const MaterialPoint& point);

/** Deformation gradient at a material point. */
Eigen::Matrix3d deformationGradient(const Model& model, const NodalField& x, const MaterialPoint& point);

/** Adds a force (N) at a material point to the control points: the transpose of position(). */
void addForce(const Model& model, const MaterialPoint& point, const Eigen::Vector3d& force, NodalField& f);

/**
 * Current positions of many points, m, and unit normals from those at rest: cof(F) n, exact for the field.
 * @param rest_normals  3 x points
 * @param positions, normals  3 x points, resized where needed; normals may be null
 */
void evaluate(const Model& model, const Partition& partition, const NodalField& x,
              const std::vector<MaterialPoint>& points, const Eigen::Matrix3Xd& rest_normals,
              Eigen::Matrix3Xd& positions, Eigen::Matrix3Xd* normals);

}  // namespace bezier_fem
