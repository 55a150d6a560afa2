// SPDX-License-Identifier: GPL-3.0-or-later
#include "element_count.h"

#include <CGAL/Side_of_triangle_mesh.h>

#include <Eigen/Geometry>
#include <cmath>

#include "bezier_fem/error.h"

namespace make_model
{
using bezier_fem::InputError;

Amount amountOf(const Solid& solid, const ScaledField& sizes)
{
  if (sizes.field.isUniform())
  {
    const double h = sizes(Eigen::Vector3d::Zero());
    return {solid.volume / (h * h * h), solid.area / (h * h)};
  }
  Amount amount{0, 0};
  for (const auto face : solid.surface.faces())
  {
    Eigen::Matrix3d corners;
    Eigen::Index i = 0;
    for (const auto v : solid.surface.vertices_around_face(solid.surface.halfedge(face)))
      corners.col(i++) = toEigen(solid.surface.point(v));
    amount.surface += integralOverTriangle(sizes, corners, MOST_ELEMENTS - amount.surface);
    if (amount.surface > MOST_ELEMENTS) return amount;
  }
  const SurfaceTree tree(solid.surface.faces_begin(), solid.surface.faces_end(), solid.surface);
  const CGAL::Side_of_triangle_mesh<Surface, Kernel> side(solid.surface);
  const auto depth = [&](const Eigen::Vector3d& p) {
    const Point point(p.x(), p.y(), p.z());
    return (side(point) == CGAL::ON_UNBOUNDED_SIDE ? -1 : 1) * std::sqrt(tree.squared_distance(point));
  };
  const CGAL::Bbox_3& box = solid.box;
  const Eigen::AlignedBox3d around(Eigen::Vector3d(box.xmin(), box.ymin(), box.zmin()),
                                   Eigen::Vector3d(box.xmax(), box.ymax(), box.zmax()));
  amount.solid = integralOverSolid(sizes, around, depth, MOST_ELEMENTS);
  return amount;
}

void refuseTooFine(const Options& options, const Solid& solid, const SizingField& sizes)
{
  // What the criteria of mesher.cpp give for a compact and for a thin body, within some tens of per cent.
  const auto elements = [&](const SizingField& field) {
    const Amount amount = amountOf(solid, {field});
    return 5 * amount.solid + 1.5 * amount.surface;
  };
  const auto expected = [&](double h) { return elements(SizingField(h)); };
  if (expected(options.cell_size) < MOST_ELEMENTS)
  {
    if (sizes.isUniform() || elements(sizes) < MOST_ELEMENTS) return;
    throw InputError(options.surface + text(": the sizing, down to %.3g m, asks for more than %.0g elements; larger "
                                            "sizes, or small ones in fewer places, make fewer",
                                            sizes.smallest(), MOST_ELEMENTS));
  }
  double h = options.cell_size;
  while (expected(h) > MOST_ELEMENTS) h *= 1.1;
  throw InputError(options.surface + text(": cell size %g m is too small for a longest side of %.4g m: about %.1g "
                                          "elements; from %.2g m on there are fewer than %.0g",
                                          options.cell_size, longestSide(solid.box), expected(options.cell_size), h,
                                          MOST_ELEMENTS));
}

}  // namespace make_model
