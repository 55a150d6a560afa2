#include "outputs.h"

#include <bezier_fem/SurfaceTopology.h>
#include <geometry_msgs/WrenchStamped.h>

#include "bezier_fem/measures.h"
#include "conversions.h"
#include "topics.h"

namespace bezier_fem
{
namespace
{
constexpr double SMALLEST_SCALE = 1e-9;  // of Young's modulus: below it a stress is rounding noise

Eigen::AlignedBox3d boxOf(const NodalField& x)
{
  return {Eigen::Vector3d(x.matrix().topRows<3>().rowwise().minCoeff()),
          Eigen::Vector3d(x.matrix().topRows<3>().rowwise().maxCoeff())};
}

SurfaceTopology topologyOf(const Surface& surface, const std::string& frame_id)
{
  SurfaceTopology message;
  message.header.stamp = ros::Time::now();
  message.header.frame_id = frame_id;
  message.points = static_cast<std::uint32_t>(surface.points.size());
  message.triangles.assign(surface.triangles.data(), surface.triangles.data() + surface.triangles.size());
  return message;
}

template <class Derived>
void toFloats(const Eigen::DenseBase<Derived>& values, std::vector<float>& floats)
{
  floats.resize(values.size());
  for (Eigen::Index i = 0; i < values.size(); ++i) floats[i] = static_cast<float>(values.derived().data()[i]);
}

}  // namespace

Outputs::Outputs(ros::NodeHandle& private_handle, const Simulation& simulation)
    : simulation_(simulation),
      body_(boxOf(simulation.model().rest)),
      surface_(private_handle.advertise<visualization_msgs::Marker>(topics::SURFACE, 1)),
      stress_(private_handle.advertise<visualization_msgs::MarkerArray>(topics::STRESS, 1)),
      forces_(private_handle.advertise<visualization_msgs::MarkerArray>(topics::FORCES, 1)),
      topology_(private_handle.advertise<SurfaceTopology>(topics::TOPOLOGY, 1, true)),
      state_(private_handle.advertise<BodyState>(topics::STATE, 10)),
      stress_scale_(SMALLEST_SCALE * simulation.scene().material.young),
      force_markers_(body_.sizes().maxCoeff())
{
  for (const HeldRegion& region : simulation.supports().regions)
    reactions_.push_back(private_handle.advertise<geometry_msgs::WrenchStamped>(topics::REACTION + region.name, 10));
  topology_.publish(topologyOf(simulation.surface(), simulation.scene().frame_id));
}

void Outputs::publish(const StepResult& result, const std::map<std::string, Inputs::Active>& active, double elapsed)
{
  const bool surface = surface_.getNumSubscribers() > 0, stress = stress_.getNumSubscribers() > 0;
  const bool state = state_.getNumSubscribers() > 0;
  std_msgs::Header header;
  header.stamp = result.stamp;
  header.frame_id = simulation_.scene().frame_id;

  if (surface || stress || state) simulation_.evaluateSurface(positions_, stress || state ? &normals_ : nullptr);
  if (stress || state) simulation_.evaluateSurfaceStress(von_mises_);
  if (surface)
  {
    surface_marker_.header = header;
    fillSurface(simulation_.surface(), positions_, surface_marker_);
    surface_.publish(surface_marker_);
    ++published_;
  }
  if (stress)
  {
    stress_scale_.update(scaleOf(von_mises_), elapsed);
    stress_markers_.markers.resize(1);
    stress_markers_.markers[0].header = header;
    fillStress(simulation_.surface(), positions_, normals_, von_mises_, stress_scale_.value(),
               stress_markers_.markers[0]);
    addLegend(header, body_, stress_scale_.value(), stress_markers_);
    stress_.publish(stress_markers_);
    ++published_;
  }
  if (forces_.getNumSubscribers() > 0)
  {
    visualization_msgs::MarkerArray markers;
    force_markers_.fill(header, simulation_, active, elapsed, markers);
    forces_.publish(markers);
    ++published_;
  }
  if (state) publishState(result);
  publishReactions(result.stamp);
}

void Outputs::publishState(const StepResult& result)
{
  BodyState& message = state_message_;
  message.header.stamp = result.stamp;
  message.header.frame_id = simulation_.scene().frame_id;
  message.step = static_cast<std::uint64_t>(simulation_.state().steps);
  message.time = simulation_.time();
  toFloats(positions_, message.points);
  toFloats(normals_, message.normals);
  toFloats(von_mises_, message.von_mises);

  message.probe_names.clear();
  message.probes.clear();
  for (const auto& [name, rest] : simulation_.scene().probes) message.probe_names.push_back(name);
  for (const Eigen::Vector3d& probe : simulation_.probes()) message.probes.push_back(toPoint(probe));

  const Energies energies = simulation_.energies();
  message.kinetic_energy = energies.kinetic;
  message.elastic_energy = energies.elastic;
  message.gravity_energy = energies.gravity;
  message.inverted_elements = static_cast<std::uint32_t>(invertedElements(simulation_.model(), simulation_.state().x));

  message.substeps = static_cast<std::uint32_t>(result.report.substeps);
  message.iterations = static_cast<std::uint32_t>(result.report.iterations);
  message.residual = result.report.residual;
  message.converged = result.report.converged;
  message.step_ms = result.report.ms.total;
  message.real_time_factor = result.real_time_factor;
  state_.publish(message);
  ++published_;
}

void Outputs::publishReactions(const ros::Time& stamp)
{
  bool heard = false;
  for (const ros::Publisher& publisher : reactions_) heard = heard || publisher.getNumSubscribers() > 0;
  if (!heard) return;
  const std::vector<Reaction> reactions = simulation_.reactions();
  for (std::size_t i = 0; i < reactions_.size(); ++i)
  {
    if (reactions_[i].getNumSubscribers() == 0) continue;
    geometry_msgs::WrenchStamped message;
    message.header.stamp = stamp;
    message.header.frame_id = simulation_.scene().frame_id;  // the torque is about its origin
    message.wrench.force = toVector3(reactions[i].force);
    message.wrench.torque = toVector3(reactions[i].torque);
    reactions_[i].publish(message);
    ++published_;
  }
}

}  // namespace bezier_fem
