// TetGen's .node and .ele (TetGen 1.5 user's manual, "File formats").

#include <array>
#include <cmath>
#include <filesystem>

#include "bezier_fem/error.h"
#include "mesh_io_detail.h"

namespace bezier_fem
{
namespace mesh_io
{
namespace
{
// TetGen's numbering of the second-order nodes, as -o2 writes them: the middles of the edges 2-3, 0-3, 0-1, 1-2, 1-3
// and 0-2. Of each of our ten nodes, its place in a row of the .ele file.
constexpr int FILE_ORDER[10] = {0, 1, 2, 3, 6, 7, 9, 5, 8, 4};

/** "1" for 1 and 1.0 alike; not "1e+06" for a million. */
std::string regionName(double attribute)
{
  const bool whole = std::abs(attribute) < 1e15 && attribute == std::floor(attribute);
  return whole ? std::to_string(static_cast<std::int64_t>(attribute)) : text(attribute);
}

void readNodes(Cursor& in, RawMesh* raw)
{
  in.atEnd();
  const std::size_t count = in.count("the number of points", 8);
  const auto dimension = in.number<std::int64_t>("the dimension");
  if (dimension != 3) in.fail("dimension " + std::to_string(dimension) + "; 3 is allowed");
  in.restOfLine();  // attributes and boundary markers, which nothing here uses
  for (std::size_t i = 0; i < count; ++i)
  {
    in.atEnd();
    const std::size_t at = in.offset();
    const auto id = in.number<std::int64_t>("a point's number");
    Eigen::Vector3d position;
    for (double& x : position) x = in.number<double>("a coordinate");
    raw->addNode(id, position, at);
    in.restOfLine();
  }
}

void readElements(Cursor& in, RawMesh* raw)
{
  in.atEnd();
  const std::size_t count = in.count("the number of tetrahedra", 10);
  const auto width = in.number<std::int64_t>("the number of nodes of a tetrahedron");
  if (width != 4 && width != 10) in.fail(std::to_string(width) + " nodes in a tetrahedron; 4 or 10 are allowed");
  const auto attributes = in.atRowEnd() ? 0 : in.number<std::int64_t>("the number of attributes");
  if (attributes < 0) in.fail(std::to_string(attributes) + " attributes; 0 or more are allowed");
  in.endRow();
  for (std::size_t i = 0; i < count; ++i)
  {
    in.atEnd();
    const std::size_t at = in.offset();
    const auto id = in.number<std::int64_t>("a tetrahedron's number");
    std::array<std::int64_t, 10> row, nodes;
    for (int k = 0; k < width; ++k) row[k] = in.number<std::int64_t>("a node of a tetrahedron");
    for (int k = 0; k < width; ++k) nodes[k] = row[FILE_ORDER[k]];
    raw->addElement(id, nodes.data(), static_cast<int>(width), at);
    if (attributes > 0)
    {
      RawGroup& region = raw->groups[{regionName(in.number<double>("a region attribute")), 3}];
      region.elements.push_back(raw->elementCount() - 1);
    }
    for (std::int64_t k = 1; k < attributes; ++k) in.number<double>("an attribute");
    in.endRow();
  }
}

}  // namespace

TetMesh readTetgen(const std::string& path)
{
  std::filesystem::path node_path(path), ele_path(path);
  const std::string extension = node_path.extension().string();
  const bool upper = extension[1] < 'a';
  (extension.size() == 5 ? ele_path : node_path)
      .replace_extension(extension.size() == 5 ? (upper ? ".ELE" : ".ele") : (upper ? ".NODE" : ".node"));

  const Source node_source(node_path.string()), ele_source(ele_path.string());
  Cursor nodes(node_source, Cursor::Layout::ROWS, '#'), elements(ele_source, Cursor::Layout::ROWS, '#');
  RawMesh raw(node_source, ele_source);
  readNodes(nodes, &raw);
  readElements(elements, &raw);
  return buildTetMesh(raw);
}

}  // namespace mesh_io
}  // namespace bezier_fem
