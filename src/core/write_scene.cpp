#include "bezier_fem/write_scene.h"

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <sstream>

#include "bezier_fem/error.h"
#include "bezier_fem/scene.h"
#include "yaml_tree.h"

namespace bezier_fem
{
namespace
{
namespace fs = std::filesystem;

YamlNode* find(YamlNode& node, const std::string& key)
{
  const auto found = std::find(node.keys.begin(), node.keys.end(), key);
  return found == node.keys.end() ? nullptr : &node.items[found - node.keys.begin()];
}

/** A path relative to one folder as it is relative to another. */
void move(YamlNode* node, const fs::path& from, const fs::path& to)
{
  if (!node || node->text.rfind("package://", 0) == 0 || fs::path(node->text).is_absolute()) return;
  node->text = (from / node->text).lexically_normal().lexically_proximate(to).string();
}

void movePaths(YamlNode& root, const fs::path& from, const fs::path& to)
{
  const std::vector<std::pair<const char*, const char*>> keys{
      {"model", "file"}, {"model", "sizing"}, {"initial", "positions"}, {"surface", "file"}};
  for (const auto& [map, key] : keys)
  {
    if (YamlNode* node = find(root, map)) move(find(*node, key), from, to);
  }
  if (YamlNode* fixed = find(root, "fixed"))
  {
    for (YamlNode& region : fixed->items) move(find(region, "motion"), from, to);
  }
}

fs::path folderOf(const std::string& path)
{
  return fs::absolute(fs::path(path)).parent_path().lexically_normal();
}
}  // namespace

void writeScene(const std::string& from, const std::vector<std::string>& overrides, const std::string& to,
                const std::vector<std::string>& comments)
{
  loadScene(from, overrides);  // throws where something is wrong
  std::ifstream file(from, std::ios::binary);
  std::ostringstream text;
  text << file.rdbuf();
  YamlNode root = parseYaml(text.str(), from);
  for (const std::string& assignment : overrides) assignYaml(root, assignment);
  movePaths(root, folderOf(from), folderOf(to));

  std::ofstream out(to, std::ios::binary);
  for (const std::string& line : comments) out << "# " << line << '\n';
  if (!comments.empty()) out << '\n';
  out << printYaml(root);
  out.close();
  if (!out) throw InputError(to + ": cannot be written");
}

}  // namespace bezier_fem
