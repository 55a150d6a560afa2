#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <cstring>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "bezier_fem/mesh.h"

namespace bezier_fem
{
namespace mesh_io
{
/** A file in memory, and the names of places in it. */
class Source
{
public:
  /** What the places are that go into place() and fail(). */
  enum class Places
  {
    LINES_OF_BYTES,  // byte offsets, told as line numbers
    BYTES,           // byte offsets, told as such: binary files have no lines
    LINES            // line numbers
  };

  /** @throws InputError if `path` is not a readable, regular file with something in it */
  explicit Source(const std::string& path);

  const std::string& path() const { return path_; }
  std::string_view bytes() const { return bytes_; }
  void setPlaces(Places places) { places_ = places; }

  std::string place(std::size_t at) const;
  [[noreturn]] void fail(std::size_t at, const std::string& message) const;

private:
  std::string path_;
  std::string bytes_;
  Places places_ = Places::LINES_OF_BYTES;
};

/** A piece of a file as it may stand in a message: short, on one line, in quotes. */
std::string quoted(std::string_view bytes);

/** The shortest decimal that reads back as the same number, whatever the locale. */
std::string text(double value);

/** "a, b, c and 4 more" */
std::string listed(const std::vector<std::string>& first_ones, std::size_t total);
constexpr std::size_t LISTED = 5;  // how many are named before "and 4 more"

/** Reads a Source from front to back. Every read is checked; what is wrong is told with its place. */
class Cursor
{
public:
  enum class Layout
  {
    FREE,  // line ends are white space
    ROWS   // a row is a line: word() and number() stay on it, endRow() goes to the next that is not blank
  };

  /** @param comment  a character that makes the rest of its line white space */
  Cursor(const Source& source, Layout layout, char comment = '\0');

  std::size_t offset() const { return next_; }
  std::size_t remaining() const { return bytes_.size() - next_; }

  /** True if only white space is left, on any line. */
  bool atEnd();
  /** True if the row has nothing more. */
  bool atRowEnd();
  void endRow();
  /** The rest of the line without its end, and past it. */
  std::string_view restOfLine();

  std::string_view word(const char* expected);
  /** T is double or std::int64_t. */
  template <class T>
  T number(const char* expected);
  /** How many things follow; refused if the rest of the file cannot hold that many of `bytes_each` or more. */
  std::size_t count(const char* expected, std::size_t bytes_each);
  void checkRoom(std::size_t count, std::size_t bytes_each, const char* what);

  /** Raw bytes. */
  std::string_view take(std::size_t size, const char* expected);
  template <class T>
  T binary(bool swap, const char* expected);

  /** Complains about what was read last. */
  [[noreturn]] void fail(const std::string& message) const { source_->fail(last_, message); }

private:
  void skipBlanks(bool across_lines);
  [[noreturn]] void failExpected(const char* expected) const;

  const Source* source_;
  std::string_view bytes_;
  Layout layout_;
  char comment_;
  std::size_t next_ = 0;
  std::size_t last_ = 0;  // where the last thing began
};

template <class T>
T fromBytes(const char* bytes, bool swap)
{
  char buffer[sizeof(T)];
  std::memcpy(buffer, bytes, sizeof(T));
  if (swap)
  {
    for (std::size_t i = 0; i < sizeof(T) / 2; ++i) std::swap(buffer[i], buffer[sizeof(T) - 1 - i]);
  }
  T value;
  std::memcpy(&value, buffer, sizeof(T));
  return value;
}

template <class T>
T Cursor::binary(bool swap, const char* expected)
{
  return fromBytes<T>(take(sizeof(T), expected).data(), swap);
}

/** Edges of a tetrahedron in the order of the nodes 4 to 9 in RawMesh (which is VTK's). */
constexpr int EDGE_CORNERS[6][2] = {{0, 1}, {1, 2}, {0, 2}, {0, 3}, {1, 3}, {2, 3}};

struct RawGroup
{
  std::vector<std::int64_t> nodes;  // ids of all nodes of the entities of dimension 0 to 2
  std::vector<int> elements;        // indices into RawMesh's elements
};

/** What a file says, before it is checked. */
struct RawMesh
{
  RawMesh(const Source& nodes_in, const Source& elements_in);

  /** @param at  the place in its Source */
  void addNode(std::int64_t id, const Eigen::Vector3d& position, std::size_t at);
  /** @param node_ids  4 or 10, corners first, then the middles of EDGE_CORNERS */
  void addElement(std::int64_t id, const std::int64_t* node_ids, int node_count, std::size_t at);
  int elementCount() const { return static_cast<int>(element_ids.size()); }

  const Source* node_source;
  const Source* element_source;
  std::string node_noun = "node";
  std::string element_noun = "tetrahedron";

  std::vector<std::int64_t> node_ids;
  std::vector<Eigen::Vector3d> node_positions;
  std::vector<std::size_t> node_places;

  int nodes_per_element = 0;           // 4 or 10, 0 while there is none
  std::vector<std::int64_t> elements;  // node ids, nodes_per_element for each
  std::vector<std::int64_t> element_ids;
  std::vector<std::size_t> element_places;

  std::map<std::pair<std::string, int>, RawGroup> groups;  // by name and dimension
  std::map<std::string, std::size_t> ignored;              // how many volume elements of other kinds, by kind
};

/** Checks `raw` and makes it compact. Uses `raw` up. */
TetMesh buildTetMesh(RawMesh& raw);

/** A number type of the VTK formats. */
struct ScalarType
{
  enum class Kind
  {
    SIGNED,
    UNSIGNED,
    FLOAT
  } kind;
  std::size_t size;  // bytes
};

/** T is double or std::int64_t; an unsigned number too large for the latter comes out negative. */
template <class T>
T decode(const char* bytes, ScalarType type, bool swap);

/** Cells of a VTK file: cell i has the points connectivity[offsets[i]] up to but without [offsets[i + 1]]. */
struct VtkCells
{
  std::vector<std::int64_t> types;
  std::vector<std::int64_t> offsets;
  std::vector<std::int64_t> connectivity;
  std::vector<std::size_t> places;
};

/** Adds the tetrahedra; the points 0 .. point_count - 1 of `cells` have the ids first_point + 0, 1, ... */
void addVtkCells(const VtkCells& cells, std::int64_t first_point, std::int64_t point_count, std::int64_t first_cell,
                 RawMesh* raw);

TetMesh readGmsh(const std::string& path);
TetMesh readTetgen(const std::string& path);
TetMesh readVtk(const std::string& path);
TetMesh readVtu(const std::string& path);
TetMesh readMedit(const std::string& path);

}  // namespace mesh_io
}  // namespace bezier_fem
