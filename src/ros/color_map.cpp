#include "color_map.h"

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>

namespace bezier_fem
{
namespace
{
constexpr int COLORS = 256;

/** Linear sRGB of a colour given in Oklab (Ottosson 2020, "A perceptual color space for image processing"). */
Eigen::Vector3d linearFromOklab(double lightness, double a, double b)
{
  Eigen::Matrix3d lms_from_lab, rgb_from_lms;
  lms_from_lab << 1, 0.3963377774, 0.2158037573, 1, -0.1055613458, -0.0638541728, 1, -0.0894841775, -1.2914855480;
  rgb_from_lms << 4.0767416621, -3.3077115913, 0.2309699292, -1.2684380046, 2.6097574011, -0.3413193965, -0.0041960863,
      -0.7034186147, 1.7076147010;
  return rgb_from_lms * (lms_from_lab * Eigen::Vector3d(lightness, a, b)).array().cube().matrix();
}

float gammaEncoded(double linear)
{
  const double value = std::clamp(linear, 0.0, 1.0);
  return static_cast<float>(value <= 0.0031308 ? 12.92 * value : 1.055 * std::pow(value, 1 / 2.4) - 0.055);
}

std::array<Eigen::Vector3f, COLORS> makeMap()
{
  constexpr double DEGREE = 3.14159265358979323846 / 180;
  std::array<Eigen::Vector3f, COLORS> map;
  for (int i = 0; i < COLORS; ++i)
  {
    const double t = static_cast<double>(i) / (COLORS - 1);
    const double lightness = 0.47 + 0.45 * t;
    const double hue = (275 + (443 - 275) * t) * DEGREE;
    double chroma = 0.20;
    Eigen::Vector3d rgb;
    do  // towards grey until the screen has it
    {
      rgb = linearFromOklab(lightness, chroma * std::cos(hue), chroma * std::sin(hue));
      chroma -= 0.002;
    } while (chroma > 0 && (rgb.minCoeff() < 0 || rgb.maxCoeff() > 1));
    for (int k = 0; k < 3; ++k) map[i][k] = gammaEncoded(rgb[k]);
  }
  return map;
}

}  // namespace

Eigen::Vector3f colorOf(double value)
{
  static const auto map = makeMap();
  return map[static_cast<int>(std::lround(std::clamp(value, 0.0, 1.0) * (COLORS - 1)))];
}

}  // namespace bezier_fem
