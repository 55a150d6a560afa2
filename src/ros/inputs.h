#pragma once

#include <bezier_fem/ContactArray.h>
#include <bezier_fem/PointWrench.h>
#include <geometry_msgs/WrenchStamped.h>
#include <ros/message_event.h>
#include <ros/node_handle.h>
#include <ros/subscriber.h>

#include <array>
#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "bezier_fem/simulation.h"
#include "bezier_fem/surface_tree.h"
#include "bezier_fem/wrench.h"
#include "frames.h"

namespace bezier_fem
{
/** What a message asks for, in the message's frame. */
struct PointLoad
{
  Eigen::Vector3d point = Eigen::Vector3d::Zero();   // m
  Wrench wrench;                                     // about the point
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();  // of a contact, out of the obstacle; not necessarily unit
};

/** What acts on the body: a load that has found its place on the surface. World frame. */
struct ActiveLoad
{
  SurfacePatch patch;
  Wrench wrench;           // about the patch's centre
  Eigen::Vector3d torque;  // N m, as it was given
  Eigen::Vector3d normal;  // of a contact, as it was given
};

/**
 * Wrenches and contacts from other nodes, from their messages to the forces on control points. Callbacks hand messages
 * over; everything else is for the loop's thread.
 */
class Inputs
{
public:
  enum Refusal
  {
    NOT_FINITE,
    NO_TRANSFORM,
    TOO_FAR,
    BAD_STAMP,
    TOO_MANY,
    REFUSALS
  };
  static constexpr std::array<const char*, REFUSALS> REFUSAL_NAMES{
      "not finite", "no transform", "too far from the surface", "too old or out of range", "queue full"};

  /** One message acts until the next one of the same key. */
  struct Active
  {
    bool contacts;
    double expires;  // s, ROS time; in lockstep the time of the stamps
    std::uint64_t sequence;
    std::vector<ActiveLoad> loads;
  };

  /** @param wake  called from other threads when there is a new message */
  Inputs(ros::NodeHandle& private_handle, const Scene& scene, const Frames& frames, const Simulation& simulation,
         std::function<void()> wake);

  /** Takes what the callbacks have handed over. */
  void collect();

  /** Stamp of the message that waits first, in the order of stamps where the mode is lockstep. Zero: means now. */
  std::optional<ros::Time> waiting() const;

  /**
   * Finds the places on the surface of all messages stamped before `until`. Those whose transform may still arrive go
   * on waiting for a moment, the others that have none are refused.
   * @param now  the time that expiry is measured from in this mode, s
   */
  void accept(double now, const ros::Time& until);

  /** Forgets what has expired and puts the rest on control points. */
  void apply(double now, NodalField& forces);

  /** Forgets everything that acts or waits. */
  void clear();

  const std::map<std::string, Active>& active() const { return active_; }
  const std::array<std::uint64_t, REFUSALS>& refused() const { return refused_; }
  const std::string& lastRefusal() const { return last_refusal_; }

private:
  struct Message
  {
    std::string key;   // publisher, topic and what else tells messages of one publisher apart
    std::string name;  // for people
    std::string frame;
    ros::Time stamp, receipt;
    ros::SteadyTime arrival;
    bool contacts = false;
    std::uint64_t sequence = 0;
    std::vector<PointLoad> loads;
  };

  void onWrench(const ros::MessageEvent<const geometry_msgs::WrenchStamped>& event);
  void onPointWrench(const ros::MessageEvent<const PointWrench>& event);
  void onContacts(const ros::MessageEvent<const ContactArray>& event);
  template <class M>
  void handOver(const ros::MessageEvent<const M>& event, const char* topic, const std::string& id, bool contacts,
                std::vector<PointLoad> loads);

  double expiry(const Message& message, double now) const;
  void activate(const Message& message, const Eigen::Isometry3d& pose, double expires);
  void refuse(Refusal refusal, const std::string& name, const std::string& why);

  Scene::Node settings_;
  const Frames& frames_;
  const Simulation& simulation_;
  std::function<void()> wake_;

  std::mutex mutex_;  // of the next two
  std::vector<Message> handed_over_;
  std::uint64_t sequence_ = 0;

  std::deque<Message> waiting_;
  std::map<std::string, Active> active_;
  std::array<std::uint64_t, REFUSALS> refused_{};
  std::string last_refusal_;

  SurfaceTree tree_;
  Eigen::Matrix3Xd positions_;  // scratch

  std::vector<ros::Subscriber> subscribers_;  // last, so that callbacks end before what they use does
};

}  // namespace bezier_fem
