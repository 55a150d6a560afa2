#pragma once

#include <vector>

#include "bezier_fem/scene.h"
#include "bezier_fem/sizing.h"
#include "bezier_fem/variant.h"

namespace bezier_fem
{
/**
 * How large the elements of a meshed surface should be where, so that as many of them as the scene's mesh has make the
 * least error: the scene is run as it is, and every element's error taken from how far its stress is from the nodes'
 * mean (Zienkiewicz and Zhu, A simple error estimator and adaptive procedure for practical engineering analysis, Int.
 * J. Numer. Methods Eng. 24, 1987), summed over up to 20 times of a motion. With an error density c h^(2p), p the order
 * of the element, and 1/h^3 elements in a unit of volume, the total is least where h goes like c^(-1/(2p+3)).
 * @return a point at each element's centroid; sizes in the measure of model.cell_size
 * @throws InputError
 */
std::vector<SizePoint> balancedSizes(const Scene& scene, const RunPlan& plan);

}  // namespace bezier_fem
