#include "package_path.h"

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <sstream>
#include <vector>

namespace bezier_fem
{
namespace
{
namespace fs = std::filesystem;

constexpr int LEVELS_BELOW_PACKAGE_PATH = 2;

std::string readText(const fs::path& path)
{
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

std::vector<std::string> split(const std::string& text, char separator)
{
  std::vector<std::string> parts;
  std::istringstream stream(text);
  for (std::string part; std::getline(stream, part, separator);)
    if (!part.empty()) parts.push_back(part);
  return parts;
}

std::string environment(const char* name)
{
  const char* value = std::getenv(name);
  return value ? value : "";
}

/** The name in the folder's package.xml; empty if it has none. */
std::string packageName(const fs::path& folder)
{
  std::error_code ignored;
  const fs::path manifest = folder / "package.xml";
  if (!fs::is_regular_file(manifest, ignored)) return {};
  const std::string text = readText(manifest);
  const std::string tag = "<name>";
  const std::size_t open = text.find(tag);
  const std::size_t close = text.find('<', open == std::string::npos ? open : open + tag.size());
  if (close == std::string::npos) return {};
  std::istringstream words(text.substr(open + tag.size(), close - open - tag.size()));
  std::string name;
  words >> name;
  return name;
}

/** Like rospack: a package holds no further packages, CATKIN_IGNORE and hidden folders hold none either. */
std::optional<fs::path> searchBelow(const fs::path& folder, const std::string& name, int levels)
{
  const std::string own_name = packageName(folder);
  if (own_name == name) return folder;
  std::error_code error;
  if (!own_name.empty() || levels == 0 || fs::exists(folder / "CATKIN_IGNORE", error)) return {};
  if (packageName(folder / name) == name) return folder / name;  // spares the walk through a whole share/

  std::vector<fs::path> folders;
  for (fs::directory_iterator entry(folder, fs::directory_options::skip_permission_denied, error), end;
       !error && entry != end; entry.increment(error))
  {
    std::error_code ignored;
    if (entry->path().filename().string().front() != '.' && entry->is_directory(ignored))
      folders.push_back(entry->path());
  }
  std::sort(folders.begin(), folders.end());  // the file system's order is arbitrary
  for (const fs::path& below : folders)
    if (auto found = searchBelow(below, name, levels - 1)) return found;
  return {};
}

/** Looks into an install prefix, or a devel space, whose .catkin names the source folders. */
std::optional<fs::path> searchPrefix(const fs::path& prefix, const std::string& name)
{
  const fs::path share = prefix / "share" / name;
  if (packageName(share) == name) return share;
  for (const std::string& sources : split(readText(prefix / ".catkin"), ';'))
    if (auto found = searchBelow(sources, name, LEVELS_BELOW_PACKAGE_PATH)) return found;
  return {};
}

std::optional<fs::path> search(const std::string& name)
{
  for (const std::string& folder : split(environment("ROS_PACKAGE_PATH"), ':'))
    if (auto found = searchBelow(folder, name, LEVELS_BELOW_PACKAGE_PATH)) return found;
  for (const std::string& prefix : split(environment("CMAKE_PREFIX_PATH"), ':'))
    if (auto found = searchPrefix(prefix, name)) return found;

  std::error_code error;
  const fs::path program = fs::read_symlink("/proc/self/exe", error);
  for (fs::path folder = program.parent_path(); !folder.empty(); folder = folder.parent_path())
  {
    if (packageName(folder) == name) return folder;
    if (auto found = searchPrefix(folder, name)) return found;
    if (folder == folder.root_path()) break;
  }
  return {};
}

}  // namespace

std::optional<std::string> findPackage(const std::string& name)
{
  if (name.empty()) return {};
  const std::optional<fs::path> found = search(name);
  if (!found) return {};
  return fs::absolute(*found).lexically_normal().string();
}

}  // namespace bezier_fem
