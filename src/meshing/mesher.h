// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <optional>

#include "mesh_checks.h"
#include "messages.h"
#include "sizing_field.h"
#include "solid.h"

namespace make_model
{
constexpr double FACET_DISTANCE = 0.2;  // times the cell size: from a boundary triangle's circumcentre to the surface
constexpr double SLIVER = 12;           // degrees: dihedral angles below are improved; 20 takes ten times as long

struct Model
{
  Tets mesh;
  Topology topology;
  Quality quality;
};

/**
 * The mesh of a solid, by Delaunay refinement and the removal of slivers; with the solid's sharp edges where they are
 * worth their elements. Its boundary points lie on the surface.
 * @return  nothing where the mesh does not become that of a solid. It need not have as many bodies as the solid
 */
std::optional<Model> bestMesh(const Solid& solid, const SizingField& sizes, const Progress& progress);

}  // namespace make_model
