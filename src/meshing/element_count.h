// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "options.h"
#include "sizing_field.h"
#include "solid.h"

namespace make_model
{
constexpr double MOST_ELEMENTS = 5e6;  // some GB and hours

/** What decides on the number of elements: the integral of 1/h^3 over a solid and that of 1/h^2 over its surface. */
struct Amount
{
  double solid, surface;  // no more than some MOST_ELEMENTS, where the size h differs from place to place
};

/** To some tens of per cent. */
Amount amountOf(const Solid& solid, const ScaledField& sizes);

/** @throws bezier_fem::InputError if the cell size or the sizing asks for more than MOST_ELEMENTS */
void refuseTooFine(const Options& options, const Solid& solid, const SizingField& sizes);

}  // namespace make_model
