// Gmsh's MSH formats 2.2 and 4.1 (Gmsh reference manual, "MSH file format"), ASCII and binary.

#include <algorithm>
#include <array>
#include <utility>

#include "mesh_io_detail.h"

namespace bezier_fem
{
namespace mesh_io
{
namespace
{
struct ElementType
{
  int number, nodes, dimension;
};

// The manual's table; types that are not in it occur in no mesh of second or lower order.
constexpr ElementType ELEMENT_TYPES[] = {
    {1, 2, 1},   {2, 3, 2},   {3, 4, 2},   {4, 4, 3},   {5, 8, 3},   {6, 6, 3},   {7, 5, 3},   {8, 3, 1},   {9, 6, 2},
    {10, 9, 2},  {11, 10, 3}, {12, 27, 3}, {13, 18, 3}, {14, 14, 3}, {15, 1, 0},  {16, 8, 2},  {17, 20, 3}, {18, 15, 3},
    {19, 13, 3}, {20, 9, 2},  {21, 10, 2}, {22, 12, 2}, {23, 15, 2}, {24, 15, 2}, {25, 21, 2}, {26, 4, 1},  {27, 5, 1},
    {28, 6, 1},  {29, 20, 3}, {30, 35, 3}, {31, 56, 3}, {92, 64, 3}, {93, 125, 3}};
constexpr int TET_4 = 4;
constexpr int TET_10 = 11;
constexpr int MOST_NODES = 125;

/** Dimension and tag, of a geometric entity or of a physical group. */
using Tag = std::pair<int, std::int64_t>;

class GmshReader
{
public:
  explicit GmshReader(const std::string& path)
      : source_(path), in_(source_, Cursor::Layout::ROWS), raw_(source_, source_)
  {
  }

  TetMesh read();

private:
  // Numbers that are text in an ASCII file; the size is that of the binary ones.
  std::int64_t int32(const char* expected);
  std::int64_t int64(const char* expected);
  double real(const char* expected);
  std::size_t count64(const char* expected, std::size_t ascii_bytes_each, std::size_t binary_bytes_each);
  void endAsciiRow();

  void readFormat();
  void readPhysicalNames();
  void readNodes2(bool parametric);
  void readElements2();
  void readEntities(bool partitioned);
  void readNodes4();
  void readElements4();
  void skipSection(const std::string& name);

  Eigen::Vector3d readPosition();
  const ElementType& findType(std::int64_t number) const;
  void addElement(const ElementType& type, std::int64_t id, const std::int64_t* nodes, std::size_t at, RawGroup* group);
  std::string groupName(const Tag& physical) const;
  void nameGroups();

  Source source_;
  Cursor in_;
  RawMesh raw_;

  int version_ = 0;  // 2 or 4; 0 before $MeshFormat
  bool binary_ = false;
  bool swap_ = false;
  bool has_nodes_ = false, has_elements_ = false;
  std::map<Tag, std::string> names_;
  std::map<Tag, std::vector<std::int64_t>> physicals_of_entities_;  // 4.1
  std::map<Tag, RawGroup> parts_;                                   // 2.2: by physical group; 4.1: by entity
};

std::int64_t GmshReader::int32(const char* expected)
{
  if (binary_) return in_.binary<std::int32_t>(swap_, expected);
  const auto value = in_.number<std::int64_t>(expected);
  if (value != static_cast<std::int32_t>(value))
  {
    in_.fail(std::to_string(value) + " where " + expected + " is expected, which has 32 bits");
  }
  return value;
}

std::int64_t GmshReader::int64(const char* expected)
{
  return binary_ ? in_.binary<std::int64_t>(swap_, expected) : in_.number<std::int64_t>(expected);
}

double GmshReader::real(const char* expected)
{
  return binary_ ? in_.binary<double>(swap_, expected) : in_.number<double>(expected);
}

std::size_t GmshReader::count64(const char* expected, std::size_t ascii_bytes_each, std::size_t binary_bytes_each)
{
  if (!binary_) return in_.count(expected, ascii_bytes_each);
  const auto count = in_.binary<std::uint64_t>(swap_, expected);
  in_.checkRoom(count, binary_bytes_each, expected);
  return count;
}

void GmshReader::endAsciiRow()
{
  if (!binary_) in_.endRow();
}

TetMesh GmshReader::read()
{
  while (!in_.atEnd())
  {
    const std::string section(in_.word("a section"));
    if (section[0] != '$') in_.fail(quoted(section) + " where a section such as '$Nodes' is expected");
    if (version_ == 0 && section != "$MeshFormat" && section != "$Comments")
    {
      in_.fail(quoted(section) + " comes before '$MeshFormat'; Gmsh's formats 2.2 and 4.1 are read");
    }
    in_.restOfLine();
    if (!binary_) in_.atEnd();
    if (section == "$MeshFormat")
      readFormat();
    else if (section == "$PhysicalNames")
      readPhysicalNames();
    else if (section == "$Entities" && version_ == 4)
      readEntities(false);
    else if (section == "$PartitionedEntities" && version_ == 4)
      readEntities(true);
    else if (section == "$Nodes" && version_ == 4)
      readNodes4();
    else if (section == "$Nodes")
      readNodes2(false);
    else if (section == "$ParametricNodes" && version_ == 2)
      readNodes2(true);
    else if (section == "$Elements" && version_ == 4)
      readElements4();
    else if (section == "$Elements")
      readElements2();
    else
    {
      skipSection(section.substr(1));
      continue;
    }

    in_.atEnd();
    const std::string end = "$End" + section.substr(1);
    const std::string_view found = in_.word(quoted(end).c_str());
    if (found != end) in_.fail(quoted(found) + " where " + quoted(end) + " is expected");
  }
  if (!has_nodes_ || !has_elements_)
  {
    source_.fail(source_.bytes().size(),
                 std::string("the file ends without ") + (has_nodes_ ? "'$Elements'" : "'$Nodes'"));
  }
  nameGroups();
  return buildTetMesh(raw_);
}

void GmshReader::readFormat()
{
  const std::string version(in_.word("the version"));
  if (version == "2.2")
    version_ = 2;
  else if (version == "4.1")
    version_ = 4;
  else
    in_.fail("version " + quoted(version) + " of the format; 2.2 and 4.1 are read (gmsh -save -format msh41)");

  const auto type = in_.number<std::int64_t>("the file type");
  if (type != 0 && type != 1) in_.fail("file type " + std::to_string(type) + "; 0 (ASCII) and 1 (binary) are allowed");
  binary_ = type == 1;
  const auto size = in_.number<std::int64_t>("the data size");
  if (binary_ && size != 8) in_.fail("data size " + std::to_string(size) + "; 8 is allowed");
  in_.restOfLine();
  if (!binary_) return;

  source_.setPlaces(Source::Places::BYTES);
  const auto one = in_.binary<std::int32_t>(false, "the number 1 that tells the byte order");
  swap_ = one == 0x01000000;
  if (one != 1 && !swap_) in_.fail("the number that tells the byte order is " + std::to_string(one) + "; 1 is allowed");
}

void GmshReader::readPhysicalNames()
{
  const std::size_t count = in_.count("the number of physical names", 7);
  in_.endRow();
  for (std::size_t i = 0; i < count; ++i)
  {
    const auto dimension = in_.number<std::int64_t>("the dimension of a physical name");
    if (dimension < 0 || dimension > 3) in_.fail("dimension " + std::to_string(dimension) + "; 0 to 3 is allowed");
    const auto tag = in_.number<std::int64_t>("the number of a physical name");
    const std::string_view rest = in_.restOfLine();
    const std::size_t first = rest.find('"'), last = rest.rfind('"');
    if (first == last) in_.fail(quoted(rest) + " where a physical name in double quotes is expected");
    names_[{static_cast<int>(dimension), tag}] = rest.substr(first + 1, last - first - 1);
    in_.atEnd();
  }
}

Eigen::Vector3d GmshReader::readPosition()
{
  Eigen::Vector3d position;
  for (double& x : position) x = real("a coordinate");
  return position;
}

void GmshReader::readNodes2(bool parametric)
{
  has_nodes_ = true;
  const std::size_t count = in_.count("the number of nodes", binary_ ? 28 : 8);
  in_.restOfLine();
  if (!binary_) in_.atEnd();
  for (std::size_t i = 0; i < count; ++i)
  {
    const std::size_t at = in_.offset();
    const std::int64_t id = int32("a node id");
    raw_.addNode(id, readPosition(), at);
    if (parametric)
    {
      const std::int64_t dimension = int32("the dimension of a node's entity");
      int32("a node's entity");
      if (dimension == 1 || dimension == 2)
      {
        for (int k = 0; k < dimension; ++k) real("a parameter");
      }
    }
    endAsciiRow();
  }
}

const ElementType& GmshReader::findType(std::int64_t number) const
{
  for (const ElementType& type : ELEMENT_TYPES)
  {
    if (type.number == number) return type;
  }
  in_.fail("element type " + std::to_string(number) + "; 1 to 31, 92 and 93 are known");
}

void GmshReader::addElement(const ElementType& type, std::int64_t id, const std::int64_t* nodes, std::size_t at,
                            RawGroup* group)
{
  if (type.number == TET_4 || type.number == TET_10)
  {
    std::array<std::int64_t, 10> ours;
    std::copy(nodes, nodes + type.nodes, ours.begin());
    if (type.number == TET_10) std::swap(ours[8], ours[9]);  // Gmsh has edge 2-3 before 1-3
    raw_.addElement(id, ours.data(), type.nodes, at);
    if (group != nullptr) group->elements.push_back(raw_.elementCount() - 1);
  }
  else if (type.dimension == 3)
  {
    ++raw_.ignored["Gmsh element type " + std::to_string(type.number)];
  }
  else if (group != nullptr)
  {
    group->nodes.insert(group->nodes.end(), nodes, nodes + type.nodes);
  }
}

void GmshReader::readElements2()
{
  has_elements_ = true;
  const std::size_t count = in_.count("the number of elements", binary_ ? 12 : 8);
  in_.restOfLine();
  if (!binary_) in_.atEnd();

  std::array<std::int64_t, MOST_NODES> nodes, last_tet;
  std::int64_t last_physical = 0;
  last_tet.fill(-1);
  for (std::size_t done = 0; done < count;)
  {
    // A binary file has blocks of elements of one type; a row of an ASCII file is much like a block of one.
    const std::size_t block_at = in_.offset();
    std::size_t block = 1;
    std::int64_t id = 0;
    if (!binary_) id = int32("an element id");
    const ElementType& type = findType(int32("an element type"));
    if (binary_)
    {
      const std::int64_t announced = int32("the number of elements in a block");
      if (announced < 1 || static_cast<std::size_t>(announced) > count - done)
      {
        in_.fail(std::to_string(announced) + " elements in a block; 1 to " + std::to_string(count - done) +
                 " are allowed, which are still missing");
      }
      block = static_cast<std::size_t>(announced);
    }
    const std::int64_t tags = int32("the number of tags");
    if (tags < 0) in_.fail(std::to_string(tags) + " tags; 0 or more are allowed");
    in_.checkRoom(static_cast<std::size_t>(tags), binary_ ? 4 : 2, "the number of tags");
    if (binary_) in_.checkRoom(block, 4 * static_cast<std::size_t>(1 + tags + type.nodes), "the size of a block");

    for (std::size_t i = 0; i < block; ++i, ++done)
    {
      const std::size_t at = binary_ ? in_.offset() : block_at;
      if (binary_) id = int32("an element id");
      std::int64_t physical = 0;  // the first tag; 0 is none, a negative one is for elements turned round
      for (std::int64_t k = 0; k < tags; ++k)
      {
        const std::int64_t tag = int32("a tag");
        if (k == 0) physical = tag < 0 ? -tag : tag;
      }
      for (int k = 0; k < type.nodes; ++k) nodes[k] = int32("a node of an element");
      endAsciiRow();

      RawGroup* group = nullptr;
      if (physical != 0) group = &parts_[{type.dimension, physical}];
      if (type.number == TET_4 || type.number == TET_10)
      {
        // Gmsh writes an element once for each physical group that it belongs to, one after the other.
        if (physical != last_physical &&
            std::is_permutation(nodes.begin(), nodes.begin() + type.nodes, last_tet.begin()))
        {
          if (group != nullptr) group->elements.push_back(raw_.elementCount() - 1);
          last_physical = physical;
          continue;
        }
        std::copy(nodes.begin(), nodes.begin() + type.nodes, last_tet.begin());
        last_physical = physical;
      }
      addElement(type, id, nodes.data(), at, group);
    }
  }
}

void GmshReader::readEntities(bool partitioned)
{
  if (partitioned)
  {
    int64("the number of partitions");
    endAsciiRow();
    const std::size_t ghosts = count64("the number of ghost entities", 4, 8);
    endAsciiRow();
    for (std::size_t i = 0; i < ghosts; ++i)
    {
      int32("a ghost entity");
      int32("a partition");
      endAsciiRow();
    }
  }
  std::array<std::size_t, 4> counts;
  for (std::size_t& count : counts) count = count64("the number of entities", 8, 36);
  endAsciiRow();

  for (int dimension = 0; dimension < 4; ++dimension)
  {
    for (std::size_t i = 0; i < counts[dimension]; ++i)
    {
      const std::int64_t entity = int32("an entity");
      if (partitioned)
      {
        int32("the dimension of a parent entity");
        int32("a parent entity");
        const std::size_t partitions = count64("the number of partitions", 2, 4);
        for (std::size_t k = 0; k < partitions; ++k) int32("a partition");
      }
      for (int k = 0; k < (dimension == 0 ? 3 : 6); ++k) real("a corner of a bounding box");
      const std::size_t physicals = count64("the number of physical groups", 2, 4);
      for (std::size_t k = 0; k < physicals; ++k)
      {
        const std::int64_t physical = int32("a physical group");
        physicals_of_entities_[{dimension, entity}].push_back(physical < 0 ? -physical : physical);
      }
      if (!binary_)
      {
        in_.restOfLine();
        in_.atEnd();
      }
      else if (dimension > 0)
      {
        const std::size_t bounding = count64("the number of bounding entities", 2, 4);
        in_.take(4 * bounding, "bounding entities");
      }
    }
  }
}

void GmshReader::readNodes4()
{
  has_nodes_ = true;
  const std::size_t blocks = count64("the number of node blocks", 8, 20);
  const std::size_t total = count64("the number of nodes", 8, 32);
  int64("the smallest node id");
  int64("the largest node id");
  endAsciiRow();
  std::size_t found = 0;
  for (std::size_t b = 0; b < blocks; ++b)
  {
    const std::int64_t dimension = int32("the dimension of a block");
    if (dimension < 0 || dimension > 3) in_.fail("dimension " + std::to_string(dimension) + "; 0 to 3 is allowed");
    int32("the entity of a block");
    const std::int64_t parametric = int32("whether nodes are parametric");
    if (parametric != 0 && parametric != 1)
    {
      in_.fail(std::to_string(parametric) + " where 0 or 1 is expected: whether nodes are parametric");
    }
    const std::int64_t parameters = parametric * dimension;
    const std::size_t count = count64("the number of nodes in a block", 8, 32);
    endAsciiRow();
    std::vector<std::pair<std::int64_t, std::size_t>> ids(count);
    for (auto& [id, at] : ids)
    {
      at = in_.offset();
      id = int64("a node id");
      endAsciiRow();
    }
    for (const auto& node : ids)
    {
      const std::size_t at = in_.offset();
      raw_.addNode(node.first, readPosition(), at);
      for (std::int64_t k = 0; k < parameters; ++k) real("a parameter");
      endAsciiRow();
    }
    found += count;
  }
  if (found != total)
  {
    in_.fail("the blocks hold " + std::to_string(found) + " nodes, but " + std::to_string(total) + " are announced");
  }
}

void GmshReader::readElements4()
{
  has_elements_ = true;
  const std::size_t blocks = count64("the number of element blocks", 8, 20);
  const std::size_t total = count64("the number of elements", 4, 16);
  int64("the smallest element id");
  int64("the largest element id");
  endAsciiRow();
  std::size_t found = 0;
  std::array<std::int64_t, MOST_NODES> nodes;
  for (std::size_t b = 0; b < blocks; ++b)
  {
    int32("the dimension of a block");
    const std::int64_t entity = int32("the entity of a block");
    const ElementType& type = findType(int32("an element type"));
    const std::size_t width = 1 + static_cast<std::size_t>(type.nodes);
    const std::size_t count = count64("the number of elements in a block", 2 * width, 8 * width);
    endAsciiRow();
    RawGroup* part = &parts_[{type.dimension, entity}];
    for (std::size_t i = 0; i < count; ++i)
    {
      const std::size_t at = in_.offset();
      const std::int64_t id = int64("an element id");
      for (int k = 0; k < type.nodes; ++k) nodes[k] = int64("a node of an element");
      endAsciiRow();
      addElement(type, id, nodes.data(), at, part);
    }
    found += count;
  }
  if (found != total)
  {
    in_.fail("the blocks hold " + std::to_string(found) + " elements, but " + std::to_string(total) + " are announced");
  }
}

void GmshReader::skipSection(const std::string& name)
{
  const std::string end = "$End" + name;
  const std::size_t found = source_.bytes().find(end, in_.offset());
  if (found == std::string_view::npos) in_.fail("the file ends without " + quoted(end));
  in_.take(found + end.size() - in_.offset(), "a section");
}

std::string GmshReader::groupName(const Tag& physical) const
{
  const auto name = names_.find(physical);
  return name == names_.end() ? std::to_string(physical.second) : name->second;
}

void GmshReader::nameGroups()
{
  for (auto& [tag, part] : parts_)
  {
    std::vector<std::int64_t> physicals{tag.second};
    if (version_ == 4) physicals = physicals_of_entities_[tag];
    for (const std::int64_t physical : physicals)
    {
      RawGroup& group = raw_.groups[{groupName({tag.first, physical}), tag.first}];
      group.nodes.insert(group.nodes.end(), part.nodes.begin(), part.nodes.end());
      group.elements.insert(group.elements.end(), part.elements.begin(), part.elements.end());
    }
  }
}

}  // namespace

TetMesh readGmsh(const std::string& path)
{
  return GmshReader(path).read();
}

}  // namespace mesh_io
}  // namespace bezier_fem
