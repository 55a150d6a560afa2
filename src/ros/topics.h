#pragma once

/** Names of the node's topics and services, all private but the last; parameters are the scene's keys. */
namespace bezier_fem::topics
{
constexpr const char* WRENCH = "wrench";
constexpr const char* POINT_WRENCH = "point_wrench";
constexpr const char* CONTACTS = "contacts";

constexpr const char* SURFACE = "surface";
constexpr const char* STRESS = "stress";
constexpr const char* FORCES = "forces";
constexpr const char* TOPOLOGY = "topology";
constexpr const char* STATE = "state";
constexpr const char* REACTION = "reaction/";  // and the region's name

constexpr const char* RESET = "reset";
constexpr const char* SET_PAUSED = "set_paused";
constexpr const char* STEP = "step";

constexpr const char* LIVE = "live";  // namespace of dynamic_reconfigure

}  // namespace bezier_fem::topics
