// SPDX-License-Identifier: GPL-3.0-or-later
#include "solid_mesh.h"

#include <CGAL/Polygon_mesh_processing/compute_normal.h>

#include <cmath>
#include <optional>
#include <string>
#include <utility>

#include "bezier_fem/error.h"
#include "element_count.h"
#include "volume_fit.h"

namespace make_model
{
namespace
{
namespace PMP = CGAL::Polygon_mesh_processing;
using bezier_fem::InputError;

constexpr double NOTABLE_VOLUME = 5;  // per cent more or less than the surface's: worth a warning
constexpr double LOST_VOLUME = 25;    // the same: not this solid any more

void fitTo(const Solid& solid, double cell_size, Model& model)
{
  const SurfaceTree tree(solid.surface.faces_begin(), solid.surface.faces_end(), solid.surface);
  const auto closest = [&](const Eigen::Vector3d& p) {
    const auto [q, face] = tree.closest_point_and_primitive(Point(p.x(), p.y(), p.z()));
    const auto n = PMP::compute_face_normal(face, solid.surface);
    return std::make_pair(toEigen(q), Eigen::Vector3d(n.x(), n.y(), n.z()));
  };
  fitVolume(model.mesh, model.topology.boundary, closest, FACET_DISTANCE * cell_size, SLIVER);
  model.quality = measureQuality(model.mesh);
}

int handles(int shells, int euler)
{
  return shells - euler / 2;
}

/** Over the tetrahedra. */
double meanSize(const SizingField& sizes, const Tets& mesh)
{
  double sum = 0;
  for (const auto& tet : mesh.tets.colwise()) sum += sizes(mesh.points(Eigen::all, tet).rowwise().mean());
  return sum / static_cast<double>(mesh.tets.cols());
}

void checkAgainst(const Options& options, const Solid& solid, const SizingField& sizes,
                  const std::optional<Model>& model, Remarks& remarks)
{
  const double h = options.cell_size;
  const std::string& file = options.surface;
  const auto refuse = [&](const std::string& why) {
    throw InputError(
        file +
        text(": cell size %g m is too coarse for this surface (longest side %.4g m): ", h, longestSide(solid.box)) +
        why + "; try half of it");
  };
  if (!model) refuse("the mesh does not become a solid");
  const Topology& topology = model->topology;
  if (topology.bodies != solid.bodies) refuse(text("the mesh has %d bodies, not %d", topology.bodies, solid.bodies));
  const double excess = excessVolume(solid, *model);
  if (std::abs(excess) > LOST_VOLUME) refuse(text("the mesh's volume is off by %+.0f %%", excess));

  const auto warn = [&](const std::string& warning) { remarks.warnings.push_back(file + ": " + warning); };
  const int shells = static_cast<int>(solid.shells.size());
  if (topology.shells != shells)
    warn(text("%d of %d cavities are filled; a cell size below %g m keeps them", shells - topology.shells,
              shells - solid.bodies, h));
  if (handles(topology.shells, topology.euler) != handles(shells, solid.euler))
    warn(text("the surface has %d handles, the mesh %d: cell size %g m closes gaps or opens holes",
              handles(shells, solid.euler), handles(topology.shells, topology.euler), h));
  if (std::abs(excess) > NOTABLE_VOLUME)
    warn(text("cell size %g m is coarse: the volume is off by %+.1f %%", h, excess));
  if (const double size = meanSize(sizes, model->mesh); model->quality.mean_edge < 0.4 * size)
    warn(text("is thinner than the cell size %g m: the elements are smaller, their mean edge is %.3g m", size,
              model->quality.mean_edge));
}
}  // namespace

double excessVolume(const Solid& solid, const Model& model)
{
  return 100 * (model.quality.volume / solid.volume - 1);
}

Model meshSolid(const Options& options, const Solid& solid, const SizingField& sizes, Remarks& remarks,
                const Progress& progress)
{
  refuseTooFine(options, solid, sizes);
  std::optional<Model> model = bestMesh(solid, sizes, progress);
  progress.show("fitting the volume ...");
  if (model) fitTo(solid, options.cell_size, *model);
  checkAgainst(options, solid, sizes, model, remarks);
  return *std::move(model);
}

}  // namespace make_model
