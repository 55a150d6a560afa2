#pragma once

#include <string>

#include "bezier_fem/tuning.h"

namespace bezier_fem
{
/** What was tried, a row a model in the order of the runs; header in the first line. Throws InputError. */
void writeTuningCsv(const std::string& path, const Tuning& tuning);

/**
 * The same as a picture (SVG): estimated error over cost, both logarithmic, with the wanted error, the budget and the
 * chosen model marked. Throws InputError.
 */
void writeTuningChart(const std::string& path, const Tuning& tuning, const TuneRequest& request);

}  // namespace bezier_fem
