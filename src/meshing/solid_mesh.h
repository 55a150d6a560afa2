// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "mesher.h"
#include "messages.h"
#include "options.h"
#include "sizing_field.h"
#include "solid.h"

namespace make_model
{
/**
 * The mesh of a solid, fitted to its volume and checked against its surface.
 * @param remarks  gets what of the surface the mesh does not keep
 * @throws bezier_fem::InputError if the cell size is too small for a mesh of sensible size, or too large for this solid
 */
Model meshSolid(const Options& options, const Solid& solid, const SizingField& sizes, Remarks& remarks,
                const Progress& progress);

/** The volume that the mesh has more than the surface, in per cent. */
double excessVolume(const Solid& solid, const Model& model);

}  // namespace make_model
