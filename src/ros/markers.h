#pragma once

#include <visualization_msgs/Marker.h>
#include <visualization_msgs/MarkerArray.h>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <map>
#include <string>

#include "bezier_fem/simulation.h"
#include "inputs.h"

/** What rviz shows of a body. */
namespace bezier_fem
{
/** The upper end of a scale that follows what it shows, quickly up and slowly down, so that nothing flickers. */
class SmoothedScale
{
public:
  explicit SmoothedScale(double smallest) : smallest_(smallest) {}
  /** @param elapsed  s since the last update */
  void update(double largest, double elapsed);
  double value() const { return std::max(value_, smallest_); }

private:
  double value_ = 0, smallest_;
};

/** The 99th percentile: a few corners where stress has a pole do not darken all the rest. */
double scaleOf(const Eigen::VectorXd& values);

/** Triangles without colours of their own, which rviz shades. */
void fillSurface(const Surface& surface, const Eigen::Matrix3Xd& points, visualization_msgs::Marker& marker);

/** Triangles coloured by values in [0, largest], with shading in the colours: rviz does not shade such markers. */
void fillStress(const Surface& surface, const Eigen::Matrix3Xd& points, const Eigen::Matrix3Xd& normals,
                const Eigen::VectorXd& values, double largest, visualization_msgs::Marker& marker);

/**
 * A column in the colours of fillStress() beside the body, with a title and round values.
 * @param body  box around the body at rest
 */
void addLegend(const std_msgs::Header& header, const Eigen::AlignedBox3d& body, double largest,
               visualization_msgs::MarkerArray& markers);

/** Arrows, as long as the forces are large against `largest`, and dots where the body is held. */
class ForceMarkers
{
public:
  explicit ForceMarkers(double size) : size_(size), largest_(1e-12) {}
  void fill(const std_msgs::Header& header, const Simulation& simulation,
            const std::map<std::string, Inputs::Active>& active, double elapsed,
            visualization_msgs::MarkerArray& markers);

private:
  class Painter;

  double size_;  // of the body, m
  SmoothedScale largest_;
  std::map<std::string, int> shown_;  // markers of each namespace in the last message, to delete those left over
};

}  // namespace bezier_fem
