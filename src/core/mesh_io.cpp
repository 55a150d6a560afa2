#include "bezier_fem/mesh_io.h"

#include <algorithm>
#include <array>
#include <filesystem>
#include <utility>

#include "bezier_fem/error.h"
#include "mesh_io_detail.h"

namespace bezier_fem
{
namespace
{
using Reader = TetMesh (*)(const std::string&);

constexpr std::array<std::pair<const char*, Reader>, 6> READERS{{{".msh", mesh_io::readGmsh},
                                                                 {".node", mesh_io::readTetgen},
                                                                 {".ele", mesh_io::readTetgen},
                                                                 {".vtk", mesh_io::readVtk},
                                                                 {".vtu", mesh_io::readVtu},
                                                                 {".mesh", mesh_io::readMedit}}};

Reader findReader(const std::string& path)
{
  std::string extension = std::filesystem::path(path).extension().string();
  // Not std::tolower: it depends on the locale.
  for (char& c : extension)
  {
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
  }
  const auto found =
      std::find_if(READERS.begin(), READERS.end(), [&](const auto& reader) { return extension == reader.first; });
  return found == READERS.end() ? nullptr : found->second;
}

}  // namespace

TetMesh readTetMesh(const std::string& path)
{
  const Reader reader = findReader(path);
  if (reader == nullptr)
  {
    throw InputError(path + ": not a tetrahedral mesh format; .msh, .node, .ele, .vtk, .vtu and .mesh are read");
  }
  return reader(path);
}

bool isTetMeshFile(const std::string& path)
{
  return findReader(path) != nullptr;
}

}  // namespace bezier_fem
