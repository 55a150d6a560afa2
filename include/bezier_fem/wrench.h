#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

#include "bezier_fem/embedding.h"
#include "bezier_fem/model.h"
#include "bezier_fem/nodal_field.h"
#include "bezier_fem/surface_tree.h"

/** Forces and torques that act on a spot of the surface. */
namespace bezier_fem
{
/** Acts at a point that goes with it. */
struct Wrench
{
  Eigen::Vector3d force = Eigen::Vector3d::Zero();   // N
  Eigen::Vector3d torque = Eigen::Vector3d::Zero();  // N m, about that point

  /** The same wrench told about another point: `from` is the old one minus the new one. */
  Wrench about(const Eigen::Vector3d& from) const { return {force, torque + from.cross(force)}; }
};

/** Weighted samples of a surface. They are made of material and go where the body goes. */
struct SurfacePatch
{
  struct Sample
  {
    std::array<int, 3> points;    // indices into SurfacePatch::points: the corners of the sample's triangle
    Eigen::Vector3d barycentric;  // in the triangle
    double weight;                // positive; those of a patch add up to 1
  };
  std::vector<MaterialPoint> points;  // corners of triangles
  std::vector<Sample> samples;
};

/** A single point: it takes up forces and no torque. */
SurfacePatch pointPatch(const SurfaceTree& tree, const std::vector<MaterialPoint>& points,
                        const SurfaceTree::Nearest& spot);

/**
 * The surface within `radius` of a spot of it, in its current shape. The weight of a bit of area falls with the
 * distance d from the spot like (1 - (d/radius)^2)^2, so it changes smoothly when the spot wanders. Triangles that are
 * large against the radius are cut up, so a patch may lie within one of them. It always has area enough for a torque:
 * where the surface has none within `radius`, the radius grows.
 *
 * @param tree    fitted to the current positions of `points`
 * @param points  of the surface
 * @param radius  m, positive
 */
SurfacePatch patchAround(const SurfaceTree& tree, const std::vector<MaterialPoint>& points,
                         const SurfaceTree::Nearest& spot, double radius);

/** Weighted mean of a patch's current positions, m. */
Eigen::Vector3d patchCentre(const Model& model, const NodalField& x, const SurfacePatch& patch);

/**
 * Adds a wrench about the patch's centre to the forces on control points, as forces on the patch:
 *
 *     f_i = w_i (F + alpha x d_i),   J alpha = T,   J = sum_i w_i (|d_i|^2 1 - d_i d_i^T),   d_i = p_i - centre,
 *
 * which have the resultants F and T exactly and, of all that have, the least sum of |f_i|^2 / w_i. The control points
 * get them through the transpose of the interpolation, so forces on them have the same resultants.
 */
void addWrench(const Model& model, const NodalField& x, const SurfacePatch& patch, const Wrench& wrench, NodalField& f);

}  // namespace bezier_fem
