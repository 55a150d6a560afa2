#include "yaml_tree.h"

#include <yaml-cpp/eventhandler.h>
#include <yaml-cpp/exceptions.h>
#include <yaml-cpp/mark.h>
#include <yaml-cpp/parser.h>

#include <algorithm>
#include <charconv>
#include <map>
#include <optional>
#include <set>
#include <sstream>
#include <utility>

#include "bezier_fem/error.h"

namespace bezier_fem
{
namespace
{
constexpr std::size_t MAX_DEPTH = 64;         // a scene needs 5
constexpr std::size_t MAX_VALUES = 1000000;   // a `nodes` list may be long
constexpr std::size_t DESCRIBED_LENGTH = 60;  // characters of a value in a message

struct Extent
{
  std::size_t values;
  std::size_t depth;
};

Extent extentOf(const YamlNode& node)
{
  Extent extent{1, 0};
  for (const YamlNode& item : node.items)
  {
    const Extent inner = extentOf(item);
    extent.values += inner.values;
    extent.depth = std::max(extent.depth, inner.depth);
  }
  ++extent.depth;
  return extent;
}

/**
 * Builds the tree from yaml-cpp's events: its own YAML::Node neither reports duplicate keys nor bounds what aliases
 * expand to.
 */
class TreeBuilder : public YAML::EventHandler
{
public:
  explicit TreeBuilder(const std::string& source) : source_(source) {}

  YamlNode root() && { return std::move(root_); }

  void OnDocumentStart(const YAML::Mark&) override {}
  void OnDocumentEnd() override {}

  void OnNull(const YAML::Mark& mark, YAML::anchor_t anchor) override { add(mark, YamlNode{}, anchor, {1, 1}); }

  void OnScalar(const YAML::Mark& mark, const std::string& tag, YAML::anchor_t anchor,
                const std::string& value) override
  {
    checkTag(mark, tag);
    YamlNode node;
    node.kind = YamlNode::Kind::SCALAR;
    node.text = value;
    node.plain = tag == "?";
    add(mark, std::move(node), anchor, {1, 1});
  }

  void OnAlias(const YAML::Mark& mark, YAML::anchor_t anchor) override
  {
    const auto target = anchors_.find(anchor);
    if (target == anchors_.end()) fail(mark, "an alias stands inside the value that it refers to");
    const Extent extent = extentOf(target->second);
    checkExtent(mark, extent);  // before the copy
    add(mark, target->second, YAML::NullAnchor, extent);
  }

  void OnSequenceStart(const YAML::Mark& mark, const std::string& tag, YAML::anchor_t anchor,
                       YAML::EmitterStyle::value) override
  {
    open(mark, tag, anchor, YamlNode::Kind::LIST);
  }
  void OnSequenceEnd() override { close(); }

  void OnMapStart(const YAML::Mark& mark, const std::string& tag, YAML::anchor_t anchor,
                  YAML::EmitterStyle::value) override
  {
    open(mark, tag, anchor, YamlNode::Kind::MAP);
  }
  void OnMapEnd() override { close(); }

private:
  /** A list or map whose end has not come yet. */
  struct Open
  {
    YAML::Mark mark;
    YAML::anchor_t anchor;
    YamlNode node;
    std::optional<std::string> key;  // of the map value that comes next
    std::set<std::string> keys;      // the map's keys so far
    std::vector<YamlNode> merges;    // maps that `<<` brings in
  };

  [[noreturn]] void fail(const YAML::Mark& mark, const std::string& what) const
  {
    throw InputError(source_ + ": line " + std::to_string(mark.line + 1) + ": " + what);
  }

  void checkTag(const YAML::Mark& mark, const std::string& tag) const
  {
    static const std::set<std::string> KNOWN{"",
                                             "?",
                                             "!",
                                             "tag:yaml.org,2002:str",
                                             "tag:yaml.org,2002:int",
                                             "tag:yaml.org,2002:float",
                                             "tag:yaml.org,2002:seq",
                                             "tag:yaml.org,2002:map"};
    if (KNOWN.count(tag) == 0) fail(mark, "the tag " + excerpt(tag) + " has no meaning here; leave it out");
  }

  void checkExtent(const YAML::Mark& mark, const Extent& extent) const
  {
    if (open_.size() + extent.depth > MAX_DEPTH) fail(mark, "nested deeper than " + std::to_string(MAX_DEPTH));
    if (values_ + extent.values > MAX_VALUES) fail(mark, "more than " + std::to_string(MAX_VALUES) + " values");
  }

  void open(const YAML::Mark& mark, const std::string& tag, YAML::anchor_t anchor, YamlNode::Kind kind)
  {
    checkTag(mark, tag);
    checkExtent(mark, {1, 1});
    Open opened;
    opened.mark = mark;
    opened.anchor = anchor;
    opened.node.kind = kind;
    open_.push_back(std::move(opened));
  }

  void close()
  {
    Open done = std::move(open_.back());
    open_.pop_back();
    for (YamlNode& merged : done.merges)
    {
      for (std::size_t i = 0; i < merged.keys.size(); ++i)
      {
        if (!done.keys.insert(merged.keys[i]).second) continue;  // the map's own keys and earlier merges win
        done.node.keys.push_back(std::move(merged.keys[i]));
        done.node.items.push_back(std::move(merged.items[i]));
      }
    }
    add(done.mark, std::move(done.node), done.anchor, {1, 1});  // its items are counted already
  }

  void add(const YAML::Mark& mark, YamlNode node, YAML::anchor_t anchor, const Extent& extent)
  {
    checkExtent(mark, extent);
    values_ += extent.values;
    if (anchor != YAML::NullAnchor)
    {
      values_ += extentOf(node).values;  // the copy that is kept for the aliases
      anchors_[anchor] = node;
    }
    if (open_.empty())
      root_ = std::move(node);
    else if (open_.back().node.kind == YamlNode::Kind::LIST)
      open_.back().node.items.push_back(std::move(node));
    else if (!open_.back().key)
      addKey(mark, node);
    else
      addMapValue(mark, std::move(node));
  }

  void addKey(const YAML::Mark& mark, const YamlNode& key)
  {
    Open& map = open_.back();
    if (key.kind != YamlNode::Kind::SCALAR) fail(mark, "the key " + describe(key) + " is not text");
    if (key.plain && isYamlBoolean(key.text))
      fail(mark, "the key " + key.text + " is a boolean, not text; a name that reads so needs quotes");
    if (!isMerge(key.text) && !map.keys.insert(key.text).second)
      fail(mark, "the key " + excerpt(key.text) + " is given twice");
    map.key = key.text;
  }

  void addMapValue(const YAML::Mark& mark, YamlNode value)
  {
    Open& map = open_.back();
    const std::string key = *std::exchange(map.key, std::nullopt);
    if (!isMerge(key))
    {
      map.node.keys.push_back(key);
      map.node.items.push_back(std::move(value));
      return;
    }
    std::vector<YamlNode> merges;
    if (value.kind == YamlNode::Kind::LIST)
      merges = std::move(value.items);
    else
      merges.push_back(std::move(value));
    for (YamlNode& merge : merges)
    {
      if (merge.kind != YamlNode::Kind::MAP) fail(mark, "<< takes a map or a list of maps, not " + describe(merge));
      map.merges.push_back(std::move(merge));
    }
  }

  static bool isMerge(const std::string& key) { return key == "<<"; }

  std::string source_;
  YamlNode root_;
  std::vector<Open> open_;
  std::map<YAML::anchor_t, YamlNode> anchors_;
  std::size_t values_ = 0;
};

void describe(const YamlNode& node, std::string& out)
{
  if (out.size() > DESCRIBED_LENGTH) return;
  switch (node.kind)
  {
    case YamlNode::Kind::EMPTY:
      out += "null";
      return;
    case YamlNode::Kind::SCALAR:
      out += node.text.empty() ? "''" : node.text;
      return;
    case YamlNode::Kind::LIST:
      out += '[';
      break;
    case YamlNode::Kind::MAP:
      out += '{';
      break;
  }
  const bool map = node.kind == YamlNode::Kind::MAP;
  for (std::size_t i = 0; i < node.items.size() && out.size() <= DESCRIBED_LENGTH; ++i)
  {
    if (i > 0) out += ", ";
    if (map) out += node.keys[i] + ": ";
    describe(node.items[i], out);
  }
  out += map ? '}' : ']';
}

bool isDigits(const std::string& text)
{
  return !text.empty() && text.find_first_not_of("0123456789") == std::string::npos;
}

/** One part of a dotted key. */
struct Step
{
  std::string text;
  bool index;  // written as [N]
};

/** Splits "fixed[0].axes"; nothing if it is malformed. */
std::vector<Step> splitKey(const std::string& key)
{
  std::vector<Step> steps;
  std::size_t at = 0;
  while (at <= key.size())
  {
    const std::size_t end = std::min(key.find_first_of(".[]", at), key.size());
    steps.push_back({key.substr(at, end - at), false});
    if (steps.back().text.empty() || key.find_first_of(" \t\n") != std::string::npos) return {};
    at = end;
    while (at < key.size() && key[at] == '[')
    {
      const std::size_t close = std::min(key.find(']', at), key.size());
      steps.push_back({key.substr(at + 1, close - at - 1), true});
      if (close == key.size() || !isDigits(steps.back().text)) return {};
      at = close + 1;
    }
    if (at < key.size() && key[at] != '.') return {};
    ++at;
  }
  return steps;
}

/** As a plain scalar where that is read back as what it is, else in double quotes. */
void printText(const std::string& text, bool plain, std::string& out)
{
  constexpr const char* SAFE = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_./+-";
  if (plain && !text.empty() && text.find_first_not_of(SAFE) == std::string::npos)
  {
    out += text;
    return;
  }
  out += '"';
  for (const char c : text)
  {
    if (c == '"' || c == '\\') out += '\\';
    if (static_cast<unsigned char>(c) >= ' ' && c != '\x7f')
    {
      out += c;
      continue;
    }
    constexpr const char* DIGITS = "0123456789abcdef";
    out += {'\\', 'x', DIGITS[c >> 4 & 15], DIGITS[c & 15]};
  }
  out += '"';
}

void printInLine(const YamlNode& node, std::string& out)
{
  if (node.kind == YamlNode::Kind::EMPTY) out += "null";
  if (node.kind == YamlNode::Kind::SCALAR) printText(node.text, node.plain, out);
  if (node.kind != YamlNode::Kind::LIST && node.kind != YamlNode::Kind::MAP) return;
  const bool map = node.kind == YamlNode::Kind::MAP;
  out += map ? '{' : '[';
  for (std::size_t i = 0; i < node.items.size(); ++i)
  {
    if (i > 0) out += ", ";
    if (map)
    {
      printText(node.keys[i], true, out);
      out += ": ";
    }
    printInLine(node.items[i], out);
  }
  out += map ? '}' : ']';
}

}  // namespace

YamlNode parseYaml(const std::string& text, const std::string& source)
{
  if (text.find('\0') != std::string::npos)
    throw InputError(source + ": is not UTF-8 text; a scene is written in YAML");
  TreeBuilder builder(source);
  try
  {
    std::istringstream stream(text);
    YAML::Parser parser(stream);
    if (!parser.HandleNextDocument(builder)) throw InputError(source + ": is empty");
    if (parser) throw InputError(source + ": holds more than one YAML document");
  }
  catch (const YAML::Exception& error)
  {
    throw InputError(source + ": line " + std::to_string(error.mark.line + 1) +
                     ": not valid YAML: " + excerpt(error.msg));
  }
  return std::move(builder).root();
}

void assignYaml(YamlNode& root, const std::string& assignment)
{
  const std::string source = "override " + excerpt(assignment);
  const std::size_t equals = assignment.find('=');
  const std::vector<Step> steps = splitKey(assignment.substr(0, equals));
  if (equals == std::string::npos || steps.empty())
    throw InputError(source + ": must be KEY=VALUE, for instance material.young=2.0e+5 or fixed[0].axes=[z]");
  YamlNode value = parseYaml(assignment.substr(equals + 1), source);

  YamlNode* node = &root;
  std::string way;
  for (const Step& step : steps)
  {
    const std::string here = way.empty() ? "the scene" : excerpt(way);
    if (node->kind == YamlNode::Kind::LIST)
    {
      std::size_t index = node->items.size();
      if (isDigits(step.text)) std::from_chars(step.text.data(), step.text.data() + step.text.size(), index);
      if (index >= node->items.size())
        throw InputError(source + ": " + here + " has " + std::to_string(node->items.size()) +
                         " entries, counted from 0; " + step.text + " is none of them");
      node = &node->items[index];
      way += '[' + step.text + ']';
      continue;
    }
    if (step.index) throw InputError(source + ": " + here + " is not a list");
    if (node->kind == YamlNode::Kind::SCALAR)
      throw InputError(source + ": " + here + " is " + describe(*node) + ", not a map");
    node->kind = YamlNode::Kind::MAP;
    const auto found = std::find(node->keys.begin(), node->keys.end(), step.text);
    const auto position = static_cast<std::size_t>(found - node->keys.begin());
    if (found == node->keys.end())
    {
      node->keys.push_back(step.text);
      node->items.emplace_back();
    }
    node = &node->items[position];
    way += (way.empty() ? "" : ".") + step.text;
  }
  *node = std::move(value);
}

std::string printYaml(const YamlNode& root)
{
  std::string out;
  for (std::size_t i = 0; i < root.items.size(); ++i)
  {
    const YamlNode& value = root.items[i];
    printText(root.keys[i], true, out);
    out += ':';
    const bool maps =
        value.kind == YamlNode::Kind::LIST && !value.items.empty() && value.items.front().kind == YamlNode::Kind::MAP;
    const bool map = value.kind == YamlNode::Kind::MAP && !value.items.empty();
    if (!maps && !map)
    {
      out += ' ';
      printInLine(value, out);
      out += '\n';
      continue;
    }
    out += '\n';
    for (std::size_t k = 0; k < value.items.size(); ++k)
    {
      out += maps ? "  - " : "  ";
      if (map)
      {
        printText(value.keys[k], true, out);
        out += ": ";
      }
      printInLine(value.items[k], out);
      out += '\n';
    }
  }
  return out;
}

bool isYamlBoolean(const std::string& text)
{
  static const std::set<std::string> WORDS{"true", "True", "TRUE", "false", "False", "FALSE", "yes", "Yes", "YES",
                                           "no",   "No",   "NO",   "on",    "On",    "ON",    "off", "Off", "OFF"};
  return WORDS.count(text) != 0;
}

std::string describe(const YamlNode& node)
{
  std::string out;
  describe(node, out);
  return excerpt(out, DESCRIBED_LENGTH);
}

std::string excerpt(const std::string& text, std::size_t limit)
{
  std::string out = text.substr(0, limit);
  if (text.size() > limit)
  {
    while (!out.empty() && (text[out.size()] & 0xC0) == 0x80) out.pop_back();  // no half of a UTF-8 character
    out += "...";
  }
  for (char& c : out)
    if (static_cast<unsigned char>(c) < 0x20 || c == 0x7f) c = ' ';
  return out;
}

}  // namespace bezier_fem
