// VTK's legacy format up to version 5.1 ("VTK File Formats", The VTK User's Guide), ASCII and binary (big endian).

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
std::string upperCase(std::string_view word)
{
  std::string result(word);
  for (char& c : result)
  {
    if (c >= 'a' && c <= 'z') c = static_cast<char>(c - 'a' + 'A');
  }
  return result;
}

class VtkReader
{
public:
  explicit VtkReader(const std::string& path)
      : source_(path), in_(source_, Cursor::Layout::FREE), raw_(source_, source_)
  {
    raw_.node_noun = "point";
    raw_.element_noun = "cell";
  }

  TetMesh read();

private:
  void readHeader();
  ScalarType readType(bool whole_numbers);
  std::size_t readCount(const char* expected);
  /** Numbers follow from the next line on; whether there can be that many. */
  void beginValues(std::size_t count, ScalarType type, const char* expected);
  template <class T>
  T value(ScalarType type, const char* expected);
  bool nextIs(const char* keyword);

  std::array<std::pair<bool, const char*>, 3> sections() const
  {
    return {{{has_points_, "POINTS"}, {has_cells_, "CELLS"}, {has_types_, "CELL_TYPES"}}};
  }
  void readPoints();
  void readCells();
  void readOffsetsAndConnectivity(std::size_t offset_count, std::size_t connectivity_size);
  void readRows(std::size_t cell_count, std::size_t size);
  void readCellTypes();
  void skipField();
  void skipMetadata();

  Source source_;
  Cursor in_;
  RawMesh raw_;
  bool binary_ = false;
  bool has_points_ = false, has_cells_ = false, has_types_ = false;
  VtkCells cells_;
};

TetMesh VtkReader::read()
{
  readHeader();
  while (!in_.atEnd())
  {
    const std::string keyword = upperCase(in_.word("a keyword"));
    if (keyword == "POINTS")
      readPoints();
    else if (keyword == "CELLS")
      readCells();
    else if (keyword == "CELL_TYPES")
      readCellTypes();
    else if (keyword == "FIELD")
      skipField();
    else if (keyword == "METADATA")
      skipMetadata();
    else if (keyword == "CELL_DATA" || keyword == "POINT_DATA")
      break;
    else
      in_.fail(quoted(keyword) + " where POINTS, CELLS or CELL_TYPES is expected");
  }
  for (const auto& [found, keyword] : sections())
  {
    if (!found) in_.fail(std::string("the mesh ends without ") + keyword);
  }
  if (cells_.types.size() + 1 != cells_.offsets.size())
  {
    in_.fail(std::to_string(cells_.types.size()) + " CELL_TYPES for " + std::to_string(cells_.offsets.size() - 1) +
             " CELLS");
  }
  addVtkCells(cells_, 0, static_cast<std::int64_t>(raw_.node_ids.size()), 0, &raw_);
  return buildTetMesh(raw_);
}

void VtkReader::readHeader()
{
  constexpr std::string_view MAGIC = "# vtk DataFile Version ";
  const std::string_view first = in_.restOfLine();
  if (first.substr(0, MAGIC.size()) != MAGIC) in_.fail(quoted(first) + " where '# vtk DataFile Version' is expected");
  const std::string_view version = first.substr(MAGIC.size());
  const bool known = version.size() >= 3 && version[0] >= '1' && version[0] <= '5' && version[1] == '.' &&
                     version[2] >= '0' && version[2] <= '9' && version.find_first_not_of(' ', 3) == version.npos &&
                     version.substr(0, 3) <= "5.1";
  if (!known) in_.fail("version " + quoted(version) + "; 1.0 to 5.1 are read");
  in_.restOfLine();  // the title

  const std::string format = upperCase(in_.word("'ASCII' or 'BINARY'"));
  if (format != "ASCII" && format != "BINARY") in_.fail(quoted(format) + " where 'ASCII' or 'BINARY' is expected");
  binary_ = format == "BINARY";
  if (binary_) source_.setPlaces(Source::Places::BYTES);

  const std::string dataset = upperCase(in_.word("'DATASET'"));
  if (dataset != "DATASET") in_.fail(quoted(dataset) + " where 'DATASET' is expected");
  const std::string type = upperCase(in_.word("the kind of data set"));
  if (type != "UNSTRUCTURED_GRID") in_.fail("data set " + quoted(type) + "; UNSTRUCTURED_GRID is read");
}

ScalarType VtkReader::readType(bool whole_numbers)
{
  using Kind = ScalarType::Kind;
  static const std::map<std::string, ScalarType> TYPES{
      {"CHAR", {Kind::SIGNED, 1}},         {"UNSIGNED_CHAR", {Kind::UNSIGNED, 1}},
      {"SHORT", {Kind::SIGNED, 2}},        {"UNSIGNED_SHORT", {Kind::UNSIGNED, 2}},
      {"INT", {Kind::SIGNED, 4}},          {"UNSIGNED_INT", {Kind::UNSIGNED, 4}},
      {"LONG", {Kind::SIGNED, 8}},         {"UNSIGNED_LONG", {Kind::UNSIGNED, 8}},
      {"VTKIDTYPE", {Kind::SIGNED, 4}},  // VTK writes its ids as int
      {"VTKTYPEINT32", {Kind::SIGNED, 4}}, {"VTKTYPEUINT32", {Kind::UNSIGNED, 4}},
      {"VTKTYPEINT64", {Kind::SIGNED, 8}}, {"VTKTYPEUINT64", {Kind::UNSIGNED, 8}},
      {"FLOAT", {Kind::FLOAT, 4}},         {"DOUBLE", {Kind::FLOAT, 8}}};
  const std::string_view name = in_.word("a data type");
  const auto type = TYPES.find(upperCase(name));
  if (type == TYPES.end() || (whole_numbers && type->second.kind == Kind::FLOAT))
  {
    in_.fail("data type " + quoted(name) + "; " + (whole_numbers ? "a" : "float, double or a") +
             " type of whole numbers is allowed");
  }
  return type->second;
}

std::size_t VtkReader::readCount(const char* expected)
{
  return in_.count(expected, binary_ ? 1 : 2);
}

void VtkReader::beginValues(std::size_t count, ScalarType type, const char* expected)
{
  if (binary_) in_.restOfLine();
  in_.checkRoom(count, binary_ ? type.size : 2, expected);
}

template <class T>
T VtkReader::value(ScalarType type, const char* expected)
{
  return binary_ ? decode<T>(in_.take(type.size, expected).data(), type, true) : in_.number<T>(expected);
}

bool VtkReader::nextIs(const char* keyword)
{
  Cursor ahead = in_;
  return !ahead.atEnd() && upperCase(ahead.word("")) == keyword;
}

void VtkReader::readPoints()
{
  if (std::exchange(has_points_, true)) in_.fail("POINTS a second time");
  const std::size_t count = readCount("the number of points");
  const ScalarType type = readType(false);
  beginValues(3 * count, type, "the number of coordinates");
  for (std::size_t i = 0; i < count; ++i)
  {
    if (!binary_) in_.atEnd();
    const std::size_t at = in_.offset();
    Eigen::Vector3d position;
    for (double& x : position) x = value<double>(type, "a coordinate");
    raw_.addNode(static_cast<std::int64_t>(i), position, at);
  }
}

void VtkReader::readCells()
{
  if (std::exchange(has_cells_, true)) in_.fail("CELLS a second time");
  const std::size_t first = readCount("the number of cells");
  const std::size_t second = readCount("the size of the list of cells");
  // Not asked of the version: some writers number the newer form 4.x or 5.0.
  if (nextIs("OFFSETS"))
    readOffsetsAndConnectivity(first, second);
  else
    readRows(first, second);
}

void VtkReader::readOffsetsAndConnectivity(std::size_t offset_count, std::size_t connectivity_size)
{
  in_.word("'OFFSETS'");
  const ScalarType offset_type = readType(true);
  beginValues(offset_count, offset_type, "the number of offsets");
  cells_.offsets.resize(offset_count);
  for (std::size_t i = 0; i < offset_count; ++i)
  {
    const auto offset = value<std::int64_t>(offset_type, "an offset");
    const std::int64_t least = i == 0 ? 0 : cells_.offsets[i - 1];
    const std::int64_t most = i == 0 ? 0 : static_cast<std::int64_t>(connectivity_size);
    if (offset < least || offset > most)
    {
      in_.fail("offset " + std::to_string(offset) + "; " + std::to_string(least) + " to " + std::to_string(most) +
               " is allowed");
    }
    cells_.offsets[i] = offset;
  }
  if (offset_count == 0) cells_.offsets = {0};

  const std::string keyword = upperCase(in_.word("'CONNECTIVITY'"));
  if (keyword != "CONNECTIVITY") in_.fail(quoted(keyword) + " where 'CONNECTIVITY' is expected");
  const ScalarType type = readType(true);
  beginValues(connectivity_size, type, "the size of the connectivity");
  cells_.connectivity.reserve(connectivity_size);
  cells_.places.reserve(cells_.offsets.size());
  for (std::size_t cell = 0; cell + 1 < cells_.offsets.size(); ++cell)
  {
    if (!binary_) in_.atEnd();
    cells_.places.push_back(in_.offset());
    for (std::int64_t k = cells_.offsets[cell]; k < cells_.offsets[cell + 1]; ++k)
    {
      cells_.connectivity.push_back(value<std::int64_t>(type, "a point of a cell"));
    }
  }
  if (cells_.connectivity.size() != connectivity_size)
  {
    in_.fail("the offsets end at " + std::to_string(cells_.connectivity.size()) + ", but the connectivity has " +
             std::to_string(connectivity_size) + " entries");
  }
}

void VtkReader::readRows(std::size_t cell_count, std::size_t size)
{
  constexpr ScalarType INT{ScalarType::Kind::SIGNED, 4};
  beginValues(size, INT, "the size of the list of cells");
  in_.checkRoom(cell_count, binary_ ? 4 : 2, "the number of cells");
  cells_.offsets.reserve(cell_count + 1);
  cells_.places.reserve(cell_count);
  cells_.connectivity.reserve(size);
  cells_.offsets.push_back(0);
  for (std::size_t cell = 0; cell < cell_count; ++cell)
  {
    if (!binary_) in_.atEnd();
    cells_.places.push_back(in_.offset());
    const auto count = value<std::int64_t>(INT, "the number of points of a cell");
    const std::size_t used = cells_.connectivity.size() + cell + 1;
    if (count < 0 || used > size || static_cast<std::size_t>(count) > size - used)
    {
      in_.fail("cell " + std::to_string(cell) + " of " + std::to_string(count) +
               " points does not fit into the list of cells, whose size is " + std::to_string(size));
    }
    for (std::int64_t k = 0; k < count; ++k)
    {
      cells_.connectivity.push_back(value<std::int64_t>(INT, "a point of a cell"));
    }
    cells_.offsets.push_back(static_cast<std::int64_t>(cells_.connectivity.size()));
  }
  if (cells_.connectivity.size() + cell_count != size)
  {
    in_.fail("the list of cells has " + std::to_string(cells_.connectivity.size() + cell_count) +
             " entries, but its size is said to be " + std::to_string(size));
  }
}

void VtkReader::readCellTypes()
{
  if (std::exchange(has_types_, true)) in_.fail("CELL_TYPES a second time");
  constexpr ScalarType INT{ScalarType::Kind::SIGNED, 4};
  const std::size_t count = readCount("the number of cell types");
  beginValues(count, INT, "the number of cell types");
  cells_.types.resize(count);
  for (std::int64_t& type : cells_.types) type = value<std::int64_t>(INT, "a cell type");
}

void VtkReader::skipField()
{
  // Its arrays may be of strings, whose binary form is another format of its own.
  std::size_t next = source_.bytes().size();
  for (const auto& [found, keyword] : sections())
  {
    if (!found) next = std::min(next, source_.bytes().find(std::string("\n") + keyword + ' ', in_.offset()));
  }
  in_.take(next - in_.offset(), "a field");
}

void VtkReader::skipMetadata()
{
  in_.restOfLine();
  while (in_.remaining() > 0 && !in_.restOfLine().empty())
  {
  }
}

}  // namespace

TetMesh readVtk(const std::string& path)
{
  return VtkReader(path).read();
}

}  // namespace mesh_io
}  // namespace bezier_fem
