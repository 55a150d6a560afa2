#pragma once

#include <string>
#include <vector>

namespace bezier_fem
{
/** A YAML value with its aliases and merge keys resolved, and the order of its keys kept. */
struct YamlNode
{
  enum class Kind
  {
    EMPTY,  // null
    SCALAR,
    LIST,
    MAP
  };
  Kind kind = Kind::EMPTY;
  std::string text;               // of a scalar
  bool plain = false;             // a scalar without quotes: a number or boolean is one only if it is plain
  std::vector<std::string> keys;  // of a map, unique
  std::vector<YamlNode> items;    // of a list, or of a map: one a key
};

/**
 * Parses a single YAML document. Depth and size, after the aliases, are bounded.
 * @throws InputError that begins with `source` for broken syntax, duplicate, null, boolean or structured keys, no or
 *         several documents, and text that is not UTF-8.
 */
YamlNode parseYaml(const std::string& text, const std::string& source);

/**
 * Sets one value, making the maps that are missing on the way.
 * @param assignment  "KEY=VALUE", KEY like material.young, fixed[0].axes or fixed.0.axes, VALUE in YAML
 * @throws InputError that names the assignment
 */
void assignYaml(YamlNode& root, const std::string& assignment);

/** YAML that parseYaml() reads back as the same tree: a key a line, what lies deeper than two levels in one. */
std::string printYaml(const YamlNode& root);

/** True for the words that YAML 1.1 (rosparam) reads as booleans: true, no, On, ... */
bool isYamlBoolean(const std::string& text);

/** The value in one line of bounded length, for messages. */
std::string describe(const YamlNode& node);

/** Text from outside as it may stand in a message: without line breaks, of bounded length. */
std::string excerpt(const std::string& text, std::size_t limit = 80);

}  // namespace bezier_fem
