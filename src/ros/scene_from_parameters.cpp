#include "scene_from_parameters.h"

#include <array>
#include <cmath>
#include <cstdio>

#include "bezier_fem/error.h"
#include "topics.h"

namespace bezier_fem
{
namespace
{
using XmlRpc::XmlRpcValue;

std::string quoted(const std::string& text)
{
  std::string result = "\"";
  for (const char c : text)
  {
    if (c == '"' || c == '\\') result += '\\';
    if (static_cast<unsigned char>(c) >= ' ')
    {
      result += c;
      continue;
    }
    std::array<char, 5> escaped{};
    std::snprintf(escaped.data(), escaped.size(), "\\x%02x", static_cast<unsigned>(c));
    result += escaped.data();
  }
  return result + '"';
}

std::string number(double value)
{
  if (std::isnan(value)) return ".nan";
  if (std::isinf(value)) return value > 0 ? ".inf" : "-.inf";
  std::array<char, 32> text{};
  std::snprintf(text.data(), text.size(), "%.17g", value);
  const std::string digits = text.data();
  return digits.find_first_of(".e") == std::string::npos ? digits + ".0" : digits;  // 3.0 does not become an integer
}

/** Takes a parameter out of the struct; invalid if it is not there. */
XmlRpcValue take(XmlRpcValue& parameters, const std::string& name)
{
  XmlRpcValue rest, taken;
  rest.begin();  // makes it a struct
  for (const auto& [key, value] : parameters) (key == name ? taken : rest[key]) = value;
  parameters = rest;
  return taken;
}

}  // namespace

std::string toYaml(const XmlRpcValue& value)
{
  std::string text;
  switch (value.getType())
  {
    case XmlRpcValue::TypeBoolean:
      return static_cast<const bool&>(value) ? "true" : "false";
    case XmlRpcValue::TypeInt:
      return std::to_string(static_cast<const int&>(value));
    case XmlRpcValue::TypeDouble:
      return number(static_cast<const double&>(value));
    case XmlRpcValue::TypeString:
      return quoted(static_cast<const std::string&>(value));
    case XmlRpcValue::TypeArray:
      for (int i = 0; i < value.size(); ++i) text += (i == 0 ? "" : ", ") + toYaml(value[i]);
      return "[" + text + "]";
    case XmlRpcValue::TypeStruct:
      for (const auto& [key, member] : value) text += (text.empty() ? "" : ", ") + quoted(key) + ": " + toYaml(member);
      return "{" + text + "}";
    default:  // dates and binary data, which no key takes
      return "null";
  }
}

NodeParameters readParameters(const ros::NodeHandle& private_handle)
{
  const std::string source = "parameters of " + private_handle.getNamespace();
  XmlRpcValue parameters;
  private_handle.getParam("", parameters);
  parameters.begin();  // makes it a struct where there are none

  take(parameters, topics::LIVE);         // dynamic_reconfigure's
  take(parameters, "diagnostic_period");  // diagnostic_updater's
  NodeParameters result;
  if (const XmlRpcValue threads = take(parameters, "threads"); threads.valid())
  {
    if (threads.getType() != XmlRpcValue::TypeInt || static_cast<const int&>(threads) < 1)
      throw InputError(source + ": threads is " + toYaml(threads) + ", must be an integer, 1 or above");
    result.threads = static_cast<const int&>(threads);
  }
  std::string directory;
  if (const XmlRpcValue value = take(parameters, "scene_directory"); value.valid())
  {
    if (value.getType() != XmlRpcValue::TypeString)
      throw InputError(source + ": scene_directory is " + toYaml(value) + ", must be the path of a folder");
    directory = static_cast<const std::string&>(value);
  }
  result.scene = parseScene(toYaml(parameters), directory, source);
  if (result.scene.integrator == Integrator::STATIC)
    throw InputError(source +
                     ": integrator is static, which moves in no time; for the node it must be implicit_euler, "
                     "sdirk2, auto or explicit");
  return result;
}

}  // namespace bezier_fem
