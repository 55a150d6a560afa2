#pragma once

#include <Eigen/Geometry>
#include <string>
#include <utility>
#include <vector>

#include "bezier_fem/conjugate_gradient.h"
#include "bezier_fem/model.h"
#include "bezier_fem/nodal_field.h"
#include "bezier_fem/scene.h"

namespace bezier_fem
{
/** Nodes that are held where they started, or led along a path. */
struct HeldRegion
{
  std::string name;
  std::vector<int> nodes;
  std::array<bool, 3> axes;
  std::vector<MotionSample> motion;  // pose relative to the start; empty: held
  std::string frame;                 // tf frame that leads it; empty: none

  // Of a region that follows a frame: its pose relative to the start at the begin and the end of the coming step.
  Eigen::Isometry3d begin = Eigen::Isometry3d::Identity();
  Eigen::Isometry3d end = Eigen::Isometry3d::Identity();
};

/** Force in N and torque in N m about the world's origin, of the support on the body. */
struct Reaction
{
  Eigen::Vector3d force = Eigen::Vector3d::Zero();
  Eigen::Vector3d torque = Eigen::Vector3d::Zero();
};

struct Supports
{
  std::vector<HeldRegion> regions;
  HeldAxes held;  // of all regions
  std::vector<std::array<int, 3>>
      region;        // of each node and axis the region that holds it, the last that names it; or -1
  NodalField start;  // where regions are held: the initial positions, m
};

/** Pose at a time: linear and spherical linear between samples, the first one's before it and the last one's after. */
Eigen::Isometry3d motionAt(const std::vector<MotionSample>& motion, double time);

/**
 * Positions of the held components at a time.
 * @param fraction  how much of the step has passed at that time, 0 to 1, for regions that follow a frame
 * @param x         its held components are set, the others stay
 */
void applySupports(const Supports& supports, double time, double fraction, NodalField& x);

/** What each region takes up, from the forces (N) on all control points that keep the body in balance. */
std::vector<Reaction> reactions(const Supports& supports, const NodalField& x, const NodalField& balance);

/** A load with its time window: forces on control points that do not change, or a pressure on faces. */
struct AppliedLoad
{
  double from, until;                                  // s; acts while from <= t < until
  std::vector<std::pair<int, Eigen::Vector3d>> nodal;  // N
  double pressure = 0;                                 // Pa, into the body
  std::vector<Model::Face> faces;                      // that the pressure acts on
};

/** Adds the loads that act at `time` to f, in N; pressure along the normals of the current positions x. */
void addLoads(const Model& model, const std::vector<AppliedLoad>& loads, double time, const NodalField& x,
              NodalField& f);

}  // namespace bezier_fem
