#include "inputs.h"

#include <ros/console.h>

#include <algorithm>
#include <cmath>

#include "conversions.h"
#include "topics.h"

namespace bezier_fem
{
namespace
{
constexpr std::size_t LARGEST_QUEUE = 1000;     // messages
constexpr double TRANSFORM_GRACE = 0.2;         // s, real: tf often arrives a little later than what it places
constexpr std::uint32_t LARGEST_STAMP = 4.2e9;  // s; ros::Time ends at 2^32

PointLoad loadOf(const geometry_msgs::Point& point, const geometry_msgs::Wrench& wrench)
{
  PointLoad load;
  load.point = toEigen(point);
  load.wrench = {toEigen(wrench.force), toEigen(wrench.torque)};
  return load;
}

bool isFinite(const PointLoad& load)
{
  return load.point.allFinite() && load.wrench.force.allFinite() && load.wrench.torque.allFinite() &&
         load.normal.allFinite();
}

std::string inMetres(double value)
{
  std::array<char, 32> text{};
  std::snprintf(text.data(), text.size(), "%.3g m", value);
  return text.data();
}

Eigen::Matrix3Xd currentSurface(const Simulation& simulation)
{
  Eigen::Matrix3Xd positions;
  simulation.evaluateSurface(positions, nullptr);
  return positions;
}

}  // namespace

Inputs::Inputs(ros::NodeHandle& private_handle, const Scene& scene, const Frames& frames, const Simulation& simulation,
               std::function<void()> wake)
    : settings_(scene.node),
      frames_(frames),
      simulation_(simulation),
      wake_(std::move(wake)),
      tree_(simulation.surface().triangles, currentSurface(simulation))
{
  const auto hints = ros::TransportHints().tcpNoDelay();
  const auto subscribe = [&](const char* topic, auto callback) {
    subscribers_.push_back(private_handle.subscribe(topic, 100, callback, this, hints));
  };
  subscribe(topics::WRENCH, &Inputs::onWrench);
  subscribe(topics::POINT_WRENCH, &Inputs::onPointWrench);
  subscribe(topics::CONTACTS, &Inputs::onContacts);
}

void Inputs::onWrench(const ros::MessageEvent<const geometry_msgs::WrenchStamped>& event)
{
  const auto& message = *event.getMessage();
  handOver(event, topics::WRENCH, message.header.frame_id, false, {loadOf(geometry_msgs::Point(), message.wrench)});
}

void Inputs::onPointWrench(const ros::MessageEvent<const PointWrench>& event)
{
  const auto& message = *event.getMessage();
  handOver(event, topics::POINT_WRENCH, message.header.frame_id + '\n' + message.id, false,
           {loadOf(message.point, message.wrench)});
}

void Inputs::onContacts(const ros::MessageEvent<const ContactArray>& event)
{
  std::vector<PointLoad> loads;
  for (const Contact& contact : event.getMessage()->contacts)
  {
    PointLoad load;
    load.point = toEigen(contact.point);
    load.wrench.force = toEigen(contact.force);
    load.normal = toEigen(contact.normal);
    loads.push_back(load);
  }
  handOver(event, topics::CONTACTS, "", true, std::move(loads));
}

template <class M>
void Inputs::handOver(const ros::MessageEvent<const M>& event, const char* topic, const std::string& id, bool contacts,
                      std::vector<PointLoad> loads)
{
  const auto& header = event.getMessage()->header;
  Message message;
  message.key = event.getPublisherName() + '\n' + topic + '\n' + id;
  message.name = std::string("~") + topic + " of " + event.getPublisherName();
  message.frame = header.frame_id;
  message.stamp = header.stamp;
  message.receipt = event.getReceiptTime();
  message.arrival = ros::SteadyTime::now();
  message.contacts = contacts;
  message.loads = std::move(loads);
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    message.sequence = ++sequence_;
    // One more than fits, so that the loop learns that there are too many
    if (handed_over_.size() <= LARGEST_QUEUE) handed_over_.push_back(std::move(message));
  }
  wake_();
}

void Inputs::collect()
{
  std::vector<Message> messages;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    messages.swap(handed_over_);
  }
  for (Message& message : messages)
  {
    const auto bad = std::find_if_not(message.loads.begin(), message.loads.end(), isFinite);
    if (bad != message.loads.end())
      refuse(NOT_FINITE, message.name, "a component is not a finite number");
    else if (message.stamp.sec > LARGEST_STAMP)
      refuse(BAD_STAMP, message.name, "the stamp " + std::to_string(message.stamp.sec) + " s is out of range");
    else if (waiting_.size() >= LARGEST_QUEUE)
      refuse(TOO_MANY, message.name, "more than " + std::to_string(LARGEST_QUEUE) + " messages wait");
    else
      waiting_.push_back(std::move(message));
  }
  if (settings_.mode != Scene::Node::Mode::LOCKSTEP) return;
  // Publishers run side by side, stamps say what came first. Zero, which means now, stays in front.
  std::stable_sort(waiting_.begin(), waiting_.end(),
                   [](const Message& a, const Message& b) { return a.stamp < b.stamp; });
}

std::optional<ros::Time> Inputs::waiting() const
{
  if (waiting_.empty()) return {};
  return waiting_.front().stamp;
}

double Inputs::expiry(const Message& message, double now) const
{
  if (settings_.mode != Scene::Node::Mode::LOCKSTEP) return message.receipt.toSec() + settings_.wrench.timeout;
  return (message.stamp.isZero() ? now : message.stamp.toSec()) + settings_.wrench.timeout;
}

void Inputs::accept(double now, const ros::Time& until)
{
  struct Placed
  {
    Message message;  // numbered from 1
    Eigen::Isometry3d pose;
  };
  std::map<std::string, Placed> placed;  // the last of each key: only that one acts
  std::deque<Message> still_waiting;
  for (Message& message : waiting_)
  {
    if (message.stamp >= until)
    {
      still_waiting.push_back(std::move(message));
      continue;
    }
    if (expiry(message, now) <= now)
    {
      refuse(BAD_STAMP, message.name, "it is older than node.wrench.timeout");
      continue;
    }
    std::string why;
    const auto pose = frames_.lookup(message.frame, message.stamp, why);
    if (pose)
    {
      Placed& last = placed[message.key];
      if (last.message.sequence < message.sequence) last = {std::move(message), *pose};
    }
    else if ((ros::SteadyTime::now() - message.arrival).toSec() < TRANSFORM_GRACE)
      still_waiting.push_back(std::move(message));
    else
      refuse(NO_TRANSFORM, message.name, why);
  }
  waiting_.swap(still_waiting);
  if (placed.empty()) return;

  simulation_.evaluateSurface(positions_, nullptr);
  tree_.refit(positions_);
  for (const auto& [key, entry] : placed)
  {
    const auto old = active_.find(key);
    // One that waited for its transform does not replace a newer one that had it at once
    if (old != active_.end() && old->second.sequence > entry.message.sequence) continue;
    activate(entry.message, entry.pose, expiry(entry.message, now));
  }
}

void Inputs::activate(const Message& message, const Eigen::Isometry3d& pose, double expires)
{
  Active active{message.contacts, expires, message.sequence, {}};
  const std::vector<MaterialPoint>& points = simulation_.surface().points;
  for (const PointLoad& load : message.loads)
  {
    const Eigen::Vector3d point = pose * load.point;
    const SurfaceTree::Nearest spot = tree_.nearest(point);
    if (!(spot.distance <= settings_.wrench.max_distance))
    {
      refuse(TOO_FAR, message.name,
             "its point is " + inMetres(spot.distance) +
                 " from the surface, above node.wrench.max_distance = " + inMetres(settings_.wrench.max_distance));
      continue;
    }
    ActiveLoad acting;
    acting.wrench = {pose.linear() * load.wrench.force, pose.linear() * load.wrench.torque};
    acting.torque = acting.wrench.torque;
    acting.normal = pose.linear() * load.normal;
    if (message.contacts)
    {
      acting.patch = pointPatch(tree_, points, spot);
    }
    else
    {
      acting.patch = patchAround(tree_, points, spot, settings_.wrench.radius);
      acting.wrench =
          acting.wrench.about(point - patchCentre(simulation_.model(), simulation_.state().x, acting.patch));
    }
    active.loads.push_back(std::move(acting));
  }
  active_.insert_or_assign(message.key, std::move(active));
}

void Inputs::apply(double now, NodalField& forces)
{
  forces.setZero();
  for (auto entry = active_.begin(); entry != active_.end();)
  {
    if (entry->second.expires <= now)
    {
      entry = active_.erase(entry);
      continue;
    }
    for (const ActiveLoad& load : entry->second.loads)
      addWrench(simulation_.model(), simulation_.state().x, load.patch, load.wrench, forces);
    ++entry;
  }
}

void Inputs::clear()
{
  collect();
  waiting_.clear();
  active_.clear();
}

void Inputs::refuse(Refusal refusal, const std::string& name, const std::string& why)
{
  ++refused_[refusal];
  last_refusal_ = name + ": " + why;
  ROS_WARN_THROTTLE(1.0, "Dropped %s", last_refusal_.c_str());
}

}  // namespace bezier_fem
