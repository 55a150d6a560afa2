#pragma once

#include <Eigen/Core>

namespace bezier_fem
{
/**
 * A colour from blue-violet for 0 by way of red to a light orange for 1; values outside are clamped. Lightness rises in
 * proportion to the value as the eye sees it, so the map also reads in grey and by colour-blind eyes.
 * @return red, green and blue of sRGB, 0 to 1
 */
Eigen::Vector3f colorOf(double value);

}  // namespace bezier_fem
