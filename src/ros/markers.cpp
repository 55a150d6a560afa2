#include "markers.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>

#include "bezier_fem/measures.h"
#include "color_map.h"
#include "conversions.h"

namespace bezier_fem
{
namespace
{
using visualization_msgs::Marker;
using visualization_msgs::MarkerArray;

constexpr double PI = 3.14159265358979323846;

std_msgs::ColorRGBA color(double r, double g, double b, double a = 1)
{
  std_msgs::ColorRGBA result;
  result.r = static_cast<float>(r);
  result.g = static_cast<float>(g);
  result.b = static_cast<float>(b);
  result.a = static_cast<float>(a);
  return result;
}

std_msgs::ColorRGBA color(const Eigen::Vector3f& rgb)
{
  return color(rgb[0], rgb[1], rgb[2]);
}

Marker newMarker(const std_msgs::Header& header, const std::string& ns, int id, int type)
{
  Marker marker;
  marker.header = header;
  marker.ns = ns;
  marker.id = id;
  marker.type = type;
  marker.action = Marker::ADD;
  marker.pose.orientation.w = 1;
  marker.scale.x = marker.scale.y = marker.scale.z = 1;
  marker.color = color(1, 1, 1);
  return marker;
}

Marker text(const std_msgs::Header& header, const std::string& ns, int id, const Eigen::Vector3d& position,
            double height, const std::string& words)
{
  Marker marker = newMarker(header, ns, id, Marker::TEXT_VIEW_FACING);
  marker.pose.position = toPoint(position);
  marker.scale.z = height;
  marker.color = color(0.92, 0.92, 0.92);
  marker.text = words;
  return marker;
}

std::string format(const char* pattern, double value)
{
  std::array<char, 64> words{};
  std::snprintf(words.data(), words.size(), pattern, value);
  return words.data();
}

/** The largest of 1, 2, 5, 10, ... times a power of ten that is not above a value. */
double roundStep(double value)
{
  const double power = std::pow(10, std::floor(std::log10(value)));
  for (const double step : {5.0, 2.0})
    if (step * power <= value) return step * power;
  return power;
}

struct Prefix
{
  const char* unit;
  double factor;
};

Prefix pascals(double largest)
{
  if (largest >= 1e9) return {"GPa", 1e9};
  if (largest >= 1e6) return {"MPa", 1e6};
  if (largest >= 1e3) return {"kPa", 1e3};
  if (largest >= 1) return {"Pa", 1};
  return {"mPa", 1e-3};
}

}  // namespace

void SmoothedScale::update(double largest, double elapsed)
{
  constexpr double RISE = 0.2, FALL = 2;  // s
  constexpr double JUMP = 100;            // beyond that factor there is nothing to be smooth about
  if (!std::isfinite(largest)) return;
  if (value_ > JUMP * largest || largest > JUMP * value_) value_ = largest;
  value_ += (1 - std::exp(-elapsed / (largest > value_ ? RISE : FALL))) * (largest - value_);
}

double scaleOf(const Eigen::VectorXd& values)
{
  Eigen::VectorXd sorted = values;
  double* const nth = sorted.data() + (sorted.size() - 1) * 99 / 100;
  std::nth_element(sorted.data(), nth, sorted.data() + sorted.size());
  return *nth;
}

void fillSurface(const Surface& surface, const Eigen::Matrix3Xd& points, Marker& marker)
{
  marker.type = Marker::TRIANGLE_LIST;
  marker.ns = "surface";
  marker.pose.orientation.w = 1;
  marker.scale.x = marker.scale.y = marker.scale.z = 1;
  marker.color = color(0.80, 0.66, 0.52);
  marker.points.resize(surface.triangles.size());
  for (Eigen::Index i = 0; i < surface.triangles.size(); ++i)
    marker.points[i] = toPoint(points.col(surface.triangles.data()[i]));
}

void fillStress(const Surface& surface, const Eigen::Matrix3Xd& points, const Eigen::Matrix3Xd& normals,
                const Eigen::VectorXd& values, double largest, Marker& marker)
{
  static const Eigen::Vector3d key = Eigen::Vector3d(0.8, -0.3, 0.9).normalized();  // where the light comes from
  fillSurface(surface, points, marker);
  marker.ns = "stress";
  std::vector<std_msgs::ColorRGBA> colors(points.cols());
  for (Eigen::Index i = 0; i < points.cols(); ++i)
  {
    const Eigen::Vector3d n = normals.col(i);
    const double shade = 0.52 + 0.13 * (1 + n.z()) / 2 + 0.35 * std::max(0.0, n.dot(key));  // ambient, sky, light
    colors[i] = color((colorOf(values[i] / largest) * static_cast<float>(shade)).eval());
  }
  marker.colors.resize(surface.triangles.size());
  for (Eigen::Index i = 0; i < surface.triangles.size(); ++i) marker.colors[i] = colors[surface.triangles.data()[i]];
}

void addLegend(const std_msgs::Header& header, const Eigen::AlignedBox3d& body, double largest, MarkerArray& markers)
{
  constexpr int SEGMENTS = 32, SIDES = 8, LARGEST_TICKS = 8;
  const double size = body.sizes().maxCoeff();
  const double height = 0.7 * size, radius = 0.02 * size, text_height = 0.05 * size;
  const Eigen::Vector3d foot(body.center().x(), body.max().y() + 0.3 * size, body.center().z() - height / 2);

  // A round column looks the same from everywhere
  Marker column = newMarker(header, "legend", 0, Marker::TRIANGLE_LIST);
  const auto add = [&](double angle, double z) {
    column.points.push_back(
        toPoint(foot + Eigen::Vector3d(radius * std::cos(angle), radius * std::sin(angle), z * height)));
    column.colors.push_back(color(colorOf(z)));
  };
  for (int i = 0; i < SEGMENTS; ++i)
  {
    const double low = static_cast<double>(i) / SEGMENTS, high = static_cast<double>(i + 1) / SEGMENTS;
    for (int k = 0; k < SIDES; ++k)
    {
      const double a = 2 * PI * k / SIDES, b = 2 * PI * (k + 1) / SIDES;
      add(a, low), add(b, low), add(b, high);
      add(a, low), add(b, high), add(a, high);
    }
  }
  markers.markers.push_back(column);

  const Prefix prefix = pascals(largest);
  markers.markers.push_back(text(header, "legend", 1, foot + Eigen::Vector3d(0, 0, height + 1.6 * text_height),
                                 text_height, std::string("von Mises [") + prefix.unit + "]"));
  const double step = roundStep(largest / 3);
  for (int i = 0; i < LARGEST_TICKS; ++i)
  {
    const double value = i * step;
    // rviz centres text: spaces in front put the number to the right of the column wherever one looks from
    Marker tick = text(header, "legend", 2 + i, foot + Eigen::Vector3d(0, 0, value / largest * height), text_height,
                       "        " + format("%.4g", value / prefix.factor));
    if (value > largest) tick.action = Marker::DELETE;
    markers.markers.push_back(tick);
  }
}

/** Adds markers with ids that count up in each namespace. */
class ForceMarkers::Painter
{
public:
  Painter(const std_msgs::Header& header, double size, MarkerArray& markers)
      : header_(header), size_(size), markers_(markers)
  {
  }

  /** Pulls out of the surface or pushes onto it. */
  void addForce(const char* ns, const Eigen::Vector3d& at, const Eigen::Vector3d& arrow, bool pulls,
                const std_msgs::ColorRGBA& paint)
  {
    addArrow(ns, pulls ? at : Eigen::Vector3d(at - arrow), arrow, 0.015, paint);
  }

  void addLabel(const Eigen::Vector3d& at, double newtons)
  {
    markers_.markers.push_back(
        text(header_, "newtons", count_["newtons"]++, at, 0.045 * size_, format("%.3g N", newtons)));
  }

  /** Three quarters of a circle about the torque's axis. */
  void addTorque(const Eigen::Vector3d& at, const Eigen::Vector3d& axis, const std_msgs::ColorRGBA& paint)
  {
    const Eigen::Vector3d u = axis.unitOrthogonal(), v = axis.normalized().cross(u);
    const double radius = 0.08 * size_;
    Marker& arc = add("torques", Marker::LINE_STRIP, paint);
    arc.scale.x = 0.012 * size_;
    for (int i = 0; i <= 24; ++i)
    {
      const double angle = 1.5 * PI * i / 24;
      arc.points.push_back(toPoint(at + radius * (std::cos(angle) * u + std::sin(angle) * v)));
    }
    addArrow("torques", at - radius * v, 0.055 * size_ * u, 0.012, paint);
  }

  /** The tangent plane of an obstacle. */
  void addPlane(const Eigen::Vector3d& at, const Eigen::Vector3d& normal, const std_msgs::ColorRGBA& paint)
  {
    Marker& disc = add("contact_planes", Marker::CYLINDER, paint);
    const auto q = Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitZ(), normal);
    disc.pose.position = toPoint(at);
    disc.pose.orientation.x = q.x();
    disc.pose.orientation.y = q.y();
    disc.pose.orientation.z = q.z();
    disc.pose.orientation.w = q.w();
    disc.scale.x = disc.scale.y = 0.05 * size_;
    disc.scale.z = 0.004 * size_;
  }

  void addDots(const char* ns, const std_msgs::ColorRGBA& paint, std::vector<geometry_msgs::Point> points)
  {
    Marker& dots = add(ns, Marker::SPHERE_LIST, paint);
    dots.scale.x = dots.scale.y = dots.scale.z = 0.012 * size_;
    dots.points = std::move(points);
  }

  /** Takes away what the last message had more of. */
  std::map<std::string, int> finish(const std::map<std::string, int>& shown)
  {
    for (const auto& [ns, last] : shown)
      for (int id = count_[ns]; id < last; ++id)
      {
        markers_.markers.push_back(newMarker(header_, ns, id, Marker::ARROW));
        markers_.markers.back().action = Marker::DELETE;
      }
    return count_;
  }

private:
  Marker& add(const char* ns, int type, const std_msgs::ColorRGBA& paint)
  {
    markers_.markers.push_back(newMarker(header_, ns, count_[ns]++, type));
    markers_.markers.back().color = paint;
    return markers_.markers.back();
  }

  void addArrow(const char* ns, const Eigen::Vector3d& tail, const Eigen::Vector3d& arrow, double shaft,
                const std_msgs::ColorRGBA& paint)
  {
    Marker& marker = add(ns, Marker::ARROW, paint);
    marker.points = {toPoint(tail), toPoint(tail + arrow)};
    marker.scale.x = shaft * size_;
    marker.scale.y = 2.4 * shaft * size_;                                // width of the head
    marker.scale.z = std::min(3.4 * shaft * size_, 0.5 * arrow.norm());  // and its length
  }

  const std_msgs::Header& header_;
  double size_;
  MarkerArray& markers_;
  std::map<std::string, int> count_;
};

void ForceMarkers::fill(const std_msgs::Header& header, const Simulation& simulation,
                        const std::map<std::string, Inputs::Active>& active, double elapsed, MarkerArray& markers)
{
  const std_msgs::ColorRGBA green = color(0.25, 0.85, 0.45), orange = color(1, 0.55, 0.1);
  const std_msgs::ColorRGBA grey = color(0.55, 0.6, 0.68), blue = color(0.35, 0.65, 0.95);
  const NodalField& x = simulation.state().x;
  const Eigen::Vector3d middle = x.matrix().topRows<3>().rowwise().mean();

  double largest = 0;
  for (const auto& [key, input] : active)
    for (const ActiveLoad& load : input.loads) largest = std::max(largest, load.wrench.force.stableNorm());
  largest_.update(largest, elapsed);

  Painter painter(header, size_, markers);
  for (const auto& [key, input] : active)
  {
    const std_msgs::ColorRGBA& paint = input.contacts ? orange : green;
    for (const ActiveLoad& load : input.loads)
    {
      const Eigen::Vector3d at = patchCentre(simulation.model(), x, load.patch);
      if (const double force = load.wrench.force.stableNorm(); force > 0)
      {
        const Eigen::Vector3d arrow =
            load.wrench.force / force * size_ * std::clamp(0.3 * force / largest_.value(), 0.04, 0.4);
        const bool pulls = arrow.dot(at - middle) > 0;
        painter.addForce(input.contacts ? "contacts" : "wrenches", at, arrow, pulls, paint);
        if (!input.contacts)
          painter.addLabel(at + (pulls ? 1.1 : -1.1) * arrow + Eigen::Vector3d(0, 0, 0.04 * size_), force);
      }
      if (!load.torque.isZero()) painter.addTorque(at, load.torque, paint);
      if (!load.normal.isZero()) painter.addPlane(at, load.normal, paint);
    }
  }
  for (const HeldRegion& region : simulation.supports().regions)
  {
    std::vector<geometry_msgs::Point> points;
    for (const int node : region.nodes) points.push_back(toPoint(nodePosition(simulation.model(), x, node)));
    const bool moves = !region.motion.empty() || !region.frame.empty();
    if (!points.empty()) painter.addDots("fixed", moves ? blue : grey, std::move(points));
  }
  shown_ = painter.finish(shown_);
}

}  // namespace bezier_fem
