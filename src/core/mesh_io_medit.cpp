// Medit's .mesh, ASCII (P. Frey, "MEDIT: an interactive mesh visualization software", INRIA RT-0253, 2001; the
// second-order keywords are libMeshb's).

#include <algorithm>
#include <array>

#include "mesh_io_detail.h"

namespace bezier_fem
{
namespace mesh_io
{
namespace
{
struct Keyword
{
  const char* name;
  int nodes, dimension;
};

// A row of each has the nodes and a reference.
constexpr Keyword KEYWORDS[] = {{"Edges", 2, 1},        {"EdgesP2", 3, 1},        {"Triangles", 3, 2},
                                {"TrianglesP2", 6, 2},  {"Quadrilaterals", 4, 2}, {"QuadrilateralsQ2", 9, 2},
                                {"Tetrahedra", 4, 3},   {"TetrahedraP2", 10, 3},  {"Hexahedra", 8, 3},
                                {"HexahedraQ2", 27, 3}, {"Prisms", 6, 3},         {"PrismsP2", 18, 3},
                                {"Pyramids", 5, 3},     {"PyramidsP2", 14, 3}};
constexpr int MOST_NODES = 27;

bool isLetter(char c)
{
  return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z');
}

void readVertices(Cursor& in, RawMesh* raw)
{
  const std::size_t count = in.count("the number of vertices", 8);
  for (std::size_t i = 0; i < count; ++i)
  {
    in.atEnd();
    const std::size_t at = in.offset();
    Eigen::Vector3d position;
    for (double& x : position) x = in.number<double>("a coordinate");
    raw->addNode(static_cast<std::int64_t>(i) + 1, position, at);
    // Not a group: mesh generators write which geometric entity a vertex is on, numbered apart from the references of
    // elements.
    in.number<std::int64_t>("a vertex's reference");
  }
}

void readElements(Cursor& in, const Keyword& keyword, RawMesh* raw)
{
  const std::size_t count = in.count("the number of elements", 2 * static_cast<std::size_t>(keyword.nodes + 1));
  const std::string kind = keyword.name;
  const bool tetrahedra = kind == "Tetrahedra" || kind == "TetrahedraP2";
  if (keyword.dimension == 3 && !tetrahedra && count > 0) raw->ignored[kind] += count;

  std::array<std::int64_t, MOST_NODES> nodes;
  for (std::size_t i = 0; i < count; ++i)
  {
    in.atEnd();
    const std::size_t at = in.offset();
    for (int k = 0; k < keyword.nodes; ++k) nodes[k] = in.number<std::int64_t>("a vertex of an element");
    const auto reference = in.number<std::int64_t>("an element's reference");
    // The ten nodes have our order already.
    if (tetrahedra) raw->addElement(static_cast<std::int64_t>(i) + 1, nodes.data(), keyword.nodes, at);
    if (reference == 0 || (keyword.dimension == 3 && !tetrahedra)) continue;
    RawGroup& group = raw->groups[{std::to_string(reference), keyword.dimension}];
    if (tetrahedra)
      group.elements.push_back(raw->elementCount() - 1);
    else
      group.nodes.insert(group.nodes.end(), nodes.begin(), nodes.begin() + keyword.nodes);
  }
}

}  // namespace

TetMesh readMedit(const std::string& path)
{
  const Source source(path);
  Cursor in(source, Cursor::Layout::FREE, '#');
  RawMesh raw(source, source);

  const std::string_view first = in.word("'MeshVersionFormatted'");
  if (first != "MeshVersionFormatted") in.fail(quoted(first) + " where 'MeshVersionFormatted' is expected");
  const auto version = in.number<std::int64_t>("the version");
  if (version < 1 || version > 4) in.fail("version " + std::to_string(version) + "; 1 to 4 are read");

  while (!in.atEnd())
  {
    const std::string_view name = in.word("a keyword");
    if (!isLetter(name[0])) in.fail(quoted(name) + " where a keyword such as 'Vertices' is expected");
    if (name == "End") break;
    const auto keyword =
        std::find_if(std::begin(KEYWORDS), std::end(KEYWORDS), [&](const Keyword& k) { return name == k.name; });
    if (name == "Dimension")
    {
      const auto dimension = in.number<std::int64_t>("the dimension");
      if (dimension != 3) in.fail("dimension " + std::to_string(dimension) + "; 3 is allowed");
    }
    else if (name == "Vertices")
    {
      if (!raw.node_ids.empty()) in.fail("'Vertices' a second time");
      readVertices(in, &raw);
    }
    else if (name == "TetrahedraP2Ordering")
    {
      in.fail("'TetrahedraP2Ordering' is not supported; the ten vertices are read in libMeshb's default order");
    }
    else if (keyword != std::end(KEYWORDS))
    {
      readElements(in, *keyword, &raw);
    }
    else
    {
      while (!in.atEnd() && !isLetter(source.bytes()[in.offset()])) in.word("");
    }
  }
  return buildTetMesh(raw);
}

}  // namespace mesh_io
}  // namespace bezier_fem
