#include "bezier_fem/surface_mesh.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <limits>
#include <optional>
#include <string_view>
#include <unordered_map>

#include "bezier_fem/error.h"

namespace bezier_fem
{
namespace
{
using Polygon = std::vector<int>;

struct PolygonSoup
{
  std::vector<Eigen::Vector3d> points;
  std::vector<Polygon> polygons;  // three or more corners each, every index checked
};

std::string lowerCase(std::string_view text)
{
  std::string lower(text);
  std::transform(lower.begin(), lower.end(), lower.begin(), [](unsigned char c) { return std::tolower(c); });
  return lower;
}

std::string extension(const std::string& path)
{
  return lowerCase(std::filesystem::path(path).extension().string());
}

/** Text of unknown origin, fit for a message: short and printable. */
std::string excerpt(std::string_view text)
{
  std::string shown = "'";
  for (const char c : text.substr(0, 20)) shown += std::isprint(static_cast<unsigned char>(c)) ? c : '?';
  return shown + (text.size() > 20 ? "...'" : "'");
}

/** Walks over a text file line by line and word by word, and knows where it is. */
class TextReader
{
public:
  TextReader(const std::string& path, std::string_view text) : path_(path), rest_(text) {}

  [[noreturn]] void fail(const std::string& what) const
  {
    throw InputError(path_ + ":" + std::to_string(line_number_) + ": " + what);
  }

  /** Goes to the next line that holds more than blanks and a comment; false at the end of the file. */
  bool nextLine(bool backslash_continues = false)
  {
    do
    {
      if (rest_.empty()) return false;
      line_ = takeRawLine();
      if (backslash_continues)
      {
        joined_.clear();
        while (!line_.empty() && line_.back() == '\\')
        {
          joined_ += line_.substr(0, line_.size() - 1);
          joined_ += ' ';
          line_ = takeRawLine();
        }
        if (!joined_.empty()) line_ = joined_ += line_;
      }
      line_ = line_.substr(0, line_.find('#'));
      skipBlanks();
    } while (line_.empty());
    return true;
  }

  /** The next word of this line, empty at its end. */
  std::string_view word()
  {
    skipBlanks();
    const std::string_view found = line_.substr(0, line_.find_first_of(BLANKS));
    line_.remove_prefix(found.size());
    return found;
  }

  /** The next word of the file, whatever the line; empty at the end of the file. */
  std::string_view wordAnywhere()
  {
    std::string_view found = word();
    while (found.empty() && nextLine()) found = word();
    return found;
  }

  template <class Number>
  Number number(std::string_view text, const char* meaning) const
  {
    const std::string_view all = text;
    if (!text.empty() && text.front() == '+') text.remove_prefix(1);
    Number value{};
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (text.empty()) fail(std::string("ends where ") + meaning + " should be");
    if (error != std::errc() || end != text.data() + text.size()) fail(excerpt(all) + " is not " + meaning);
    return value;
  }

  Eigen::Vector3d point()
  {
    Eigen::Vector3d p;
    for (double& coordinate : p)
    {
      coordinate = number<double>(word(), "a coordinate");
      if (!std::isfinite(coordinate)) fail("the coordinate " + std::to_string(coordinate) + " is not finite");
    }
    return p;
  }

  /** What follows the current line, for formats whose header is text. */
  std::string_view rest() const { return rest_; }
  std::string_view restOfLine() const { return line_; }

private:
  static constexpr const char* BLANKS = " \t\r\f\v";

  std::string_view takeRawLine()
  {
    const std::size_t end = std::min(rest_.find('\n'), rest_.size());
    std::string_view line = rest_.substr(0, end);
    rest_.remove_prefix(std::min(end + 1, rest_.size()));
    ++line_number_;
    if (!line.empty() && line.back() == '\r') line.remove_suffix(1);
    return line;
  }

  void skipBlanks() { line_.remove_prefix(std::min(line_.find_first_not_of(BLANKS), line_.size())); }

  const std::string& path_;
  std::string_view rest_, line_;
  std::string joined_;
  std::int64_t line_number_ = 0;
};

/** OFF's and PLY's indices begin at 0. */
int checkedIndex(std::int64_t index, std::size_t points, const TextReader& where)
{
  if (index < 0 || index >= static_cast<std::int64_t>(points))
    where.fail("the point index " + std::to_string(index) + " is not in 0.." +
               std::to_string(static_cast<std::int64_t>(points) - 1));
  return static_cast<int>(index);
}

/** A count that a file announces; `bytes_left` bounds it, so that a bad one cannot ask for all memory. */
std::size_t checkedCount(std::int64_t count, std::size_t bytes_left, const char* of_what, const TextReader& where)
{
  if (count < 0 || static_cast<std::uint64_t>(count) > bytes_left)
    where.fail("announces " + std::to_string(count) + " " + of_what + ", more than the file can hold");
  return static_cast<std::size_t>(count);
}

// Object File Format: OFF, with or without normals, colours and texture coordinates ------------------------------

PolygonSoup readOff(const std::string& path, std::string_view text)
{
  TextReader in(path, text);
  if (!in.nextLine()) in.fail("is empty");
  const std::string_view header = in.word();
  if (header.size() < 3 || header.substr(header.size() - 3) != "OFF") in.fail("does not begin with OFF");
  if (header.find('4') != header.npos || header.find('n') != header.npos)
    in.fail(excerpt(header) + ": only points in three dimensions are read");
  std::string_view first = in.wordAnywhere();
  if (first == "BINARY") in.fail("binary OFF is not read; only text is");
  const auto announced_points = in.number<std::int64_t>(first, "the number of points");
  const auto announced_faces = in.number<std::int64_t>(in.wordAnywhere(), "the number of faces");
  const std::size_t points = checkedCount(announced_points, in.rest().size(), "points", in);
  const std::size_t faces = checkedCount(announced_faces, in.rest().size(), "faces", in);

  PolygonSoup soup;
  soup.points.reserve(points);
  for (std::size_t i = 0; i < points; ++i)
  {
    if (!in.nextLine()) in.fail("ends after " + std::to_string(i) + " of " + std::to_string(points) + " points");
    soup.points.push_back(in.point());
  }
  soup.polygons.reserve(faces);
  for (std::size_t i = 0; i < faces; ++i)
  {
    if (!in.nextLine()) in.fail("ends after " + std::to_string(i) + " of " + std::to_string(faces) + " faces");
    const auto corners = in.number<std::int64_t>(in.word(), "a number of corners");
    Polygon polygon(checkedCount(corners, in.restOfLine().size(), "corners", in));
    for (int& corner : polygon)
      corner = checkedIndex(in.number<std::int64_t>(in.word(), "a point index"), soup.points.size(), in);
    if (polygon.size() >= 3) soup.polygons.push_back(std::move(polygon));
  }
  return soup;
}

// Wavefront: points and faces only; everything else in an .obj file is of no concern here ------------------------

PolygonSoup readObj(const std::string& path, std::string_view text)
{
  TextReader in(path, text);
  PolygonSoup soup;
  while (in.nextLine(true))
  {
    const std::string_view keyword = in.word();
    if (keyword == "v") soup.points.push_back(in.point());
    if (keyword != "f") continue;
    Polygon polygon;
    const auto points = static_cast<std::int64_t>(soup.points.size());
    for (std::string_view corner = in.word(); !corner.empty(); corner = in.word())
    {
      // point/texture/normal, counted from 1, or from the latest backwards if negative
      const auto given = in.number<std::int64_t>(corner.substr(0, corner.find('/')), "a point index");
      const std::int64_t index = given < 0 ? points + given : given - 1;
      if (given == 0 || index < 0 || index >= points)
        in.fail("the point index " + std::to_string(given) + " is not one of the " + std::to_string(points) +
                " points above");
      polygon.push_back(static_cast<int>(index));
    }
    if (polygon.size() < 3) in.fail("a face needs three corners");
    soup.polygons.push_back(std::move(polygon));
  }
  return soup;
}

// Stereolithography, text and binary -----------------------------------------------------------------------------

// Bytes of the binary variant; the count of triangles ends the header, a normal begins each facet.
constexpr std::size_t STL_HEADER = 84, STL_FACET = 50, STL_NORMAL = 12;

void addTriangle(PolygonSoup& soup, const std::array<Eigen::Vector3d, 3>& corners)
{
  const int first = static_cast<int>(soup.points.size());
  soup.points.insert(soup.points.end(), corners.begin(), corners.end());
  soup.polygons.push_back({first, first + 1, first + 2});
}

PolygonSoup readStlText(const std::string& path, std::string_view text)
{
  TextReader in(path, text);
  PolygonSoup soup;
  std::array<Eigen::Vector3d, 3> corners;
  std::size_t known = 0;
  bool inside_solid = false;
  while (in.nextLine())
  {
    const std::string keyword = lowerCase(in.word());
    if (keyword == "solid") inside_solid = true;
    if (keyword == "endsolid") inside_solid = false;
    if (keyword == "vertex")
    {
      if (known == 3) in.fail("a fourth vertex in a facet; only triangles are allowed");
      corners[known++] = in.point();
    }
    if (keyword == "endfacet")
    {
      if (known != 3) in.fail("a facet has " + std::to_string(known) + " vertices, not 3");
      addTriangle(soup, corners);
      known = 0;
    }
  }
  if (inside_solid) in.fail("is cut short: no endsolid");
  return soup;
}

PolygonSoup readStlBinary(const std::string& path, std::string_view bytes)
{
  std::uint32_t triangles;
  std::memcpy(&triangles, bytes.data() + STL_HEADER - sizeof(triangles), sizeof(triangles));
  if (bytes.size() < STL_HEADER + STL_FACET * std::size_t{triangles})
    throw InputError(path + ": is cut short: " + std::to_string(triangles) + " triangles need " +
                     std::to_string(STL_HEADER + STL_FACET * std::size_t{triangles}) + " bytes, the file has " +
                     std::to_string(bytes.size()));
  PolygonSoup soup;
  soup.points.reserve(3 * std::size_t{triangles});
  soup.polygons.reserve(triangles);
  for (std::size_t t = 0; t < triangles; ++t)
  {
    std::array<float, 9> coordinates;
    std::memcpy(coordinates.data(), bytes.data() + STL_HEADER + STL_FACET * t + STL_NORMAL, sizeof(coordinates));
    const Eigen::Matrix3d corners = Eigen::Map<Eigen::Matrix3f>(coordinates.data()).cast<double>();
    if (!corners.allFinite())
      throw InputError(path + ": triangle " + std::to_string(t) + " has a coordinate that is not finite");
    addTriangle(soup, {corners.col(0), corners.col(1), corners.col(2)});
  }
  return soup;
}

PolygonSoup readStl(const std::string& path, std::string_view bytes)
{
  // Binary files may begin with "solid" too; their size gives them away.
  std::uint32_t triangles = 0;
  if (bytes.size() >= STL_HEADER) std::memcpy(&triangles, bytes.data() + 80, sizeof(triangles));
  const bool size_fits = bytes.size() >= STL_HEADER && bytes.size() == STL_HEADER + STL_FACET * std::size_t{triangles};
  const std::size_t start = std::min(bytes.find_first_not_of(" \t\r\n"), bytes.size());
  const bool text = lowerCase(bytes.substr(start, 5)) == "solid" &&
                    std::memchr(bytes.data(), 0, std::min<std::size_t>(bytes.size(), 512)) == nullptr;
  if (text && !size_fits) return readStlText(path, bytes);
  if (bytes.size() < STL_HEADER) throw InputError(path + ": is neither a text nor a binary STL file");
  return readStlBinary(path, bytes);
}

// Polygon files, text and binary ---------------------------------------------------------------------------------

class PlyReader
{
public:
  PlyReader(const std::string& path, std::string_view text) : in_(path, text) {}

  PolygonSoup read()
  {
    readHeader();
    body_ = in_.rest();
    PolygonSoup soup;
    for (const Element& element : elements_)
    {
      if (element.name == "vertex") soup.points.reserve(element.count);
      for (std::size_t i = 0; i < element.count; ++i) readItem(element, i, soup);
    }
    // Faces may come before points, so their indices are checked last.
    for (const Polygon& polygon : soup.polygons)
      for (const int corner : polygon)
        if (corner < 0 || static_cast<std::size_t>(corner) >= soup.points.size())
          in_.fail("the point index " + std::to_string(corner) + " is not in 0.." +
                   std::to_string(static_cast<std::int64_t>(soup.points.size()) - 1));
    return soup;
  }

private:
  enum class Format
  {
    TEXT,
    LITTLE,
    BIG
  };
  enum class Type
  {
    INT8,
    UINT8,
    INT16,
    UINT16,
    INT32,
    UINT32,
    FLOAT32,
    FLOAT64
  };
  struct Property
  {
    std::string name;
    Type type;
    std::optional<Type> list_count;  // the type of a list's length
  };
  struct Element
  {
    std::string name;
    std::size_t count;
    std::vector<Property> properties;
  };

  void readHeader()
  {
    if (!in_.nextLine() || in_.word() != "ply") in_.fail("does not begin with ply");
    bool format_known = false;
    while (true)
    {
      if (!in_.nextLine()) in_.fail("ends within the header");
      const std::string_view keyword = in_.word();
      if (keyword == "end_header") break;
      if (keyword == "format")
      {
        const std::string_view format = in_.word();
        if (format == "ascii")
          format_ = Format::TEXT;
        else if (format == "binary_little_endian")
          format_ = Format::LITTLE;
        else if (format == "binary_big_endian")
          format_ = Format::BIG;
        else
          in_.fail(excerpt(format) + " is not ascii, binary_little_endian or binary_big_endian");
        format_known = true;
      }
      else if (keyword == "element")
      {
        Element element{std::string(in_.word()), 0, {}};
        const auto count = in_.number<std::int64_t>(in_.word(), "a number of elements");
        element.count = checkedCount(count, in_.rest().size(), element.name.c_str(), in_);
        elements_.push_back(std::move(element));
      }
      else if (keyword == "property")
      {
        if (elements_.empty()) in_.fail("a property before the first element");
        Property property;
        std::string_view type_name = in_.word();
        if (type_name == "list")
        {
          property.list_count = type(in_.word());
          type_name = in_.word();
        }
        property.type = type(type_name);
        property.name = in_.word();
        elements_.back().properties.push_back(std::move(property));
      }
      else if (keyword != "comment" && keyword != "obj_info")
        in_.fail(excerpt(keyword) + " does not belong in a header");
    }
    if (!format_known) in_.fail("has no format line");
    for (const Element& element : elements_)
      if (element.properties.empty() && element.count > 0) in_.fail("the element " + element.name + " has no property");
  }

  Type type(std::string_view name) const
  {
    static const std::unordered_map<std::string_view, Type> TYPES = {
        {"char", Type::INT8},     {"int8", Type::INT8},       {"uchar", Type::UINT8},    {"uint8", Type::UINT8},
        {"short", Type::INT16},   {"int16", Type::INT16},     {"ushort", Type::UINT16},  {"uint16", Type::UINT16},
        {"int", Type::INT32},     {"int32", Type::INT32},     {"uint", Type::UINT32},    {"uint32", Type::UINT32},
        {"float", Type::FLOAT32}, {"float32", Type::FLOAT32}, {"double", Type::FLOAT64}, {"float64", Type::FLOAT64}};
    const auto found = TYPES.find(name);
    if (found == TYPES.end()) in_.fail(excerpt(name) + " is not a property type");
    return found->second;
  }

  void readItem(const Element& element, std::size_t item, PolygonSoup& soup)
  {
    item_ = item;
    element_ = &element;
    Eigen::Vector3d point = Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN());
    for (const Property& property : element.properties)
    {
      if (!property.list_count)
      {
        const double number = value(property.type);
        if (property.name.size() == 1 && property.name[0] >= 'x' && property.name[0] <= 'z')
          point[property.name[0] - 'x'] = number;
        continue;
      }
      const double length = value(*property.list_count);
      const std::size_t bytes_left = format_ == Format::TEXT ? in_.restOfLine().size() : body_.size();
      if (!(length >= 0 && length <= static_cast<double>(bytes_left))) failHere("a list is longer than the file");
      Polygon list(static_cast<std::size_t>(length));
      for (int& index : list)
      {
        const double number = value(property.type);
        index = number >= 0 && number < INDEX_LIMIT ? static_cast<int>(number) : -1;
      }
      if (element.name == "face" && (property.name == "vertex_indices" || property.name == "vertex_index") &&
          list.size() >= 3)
        soup.polygons.push_back(std::move(list));
    }
    if (element.name != "vertex") return;
    if (!point.allFinite()) failHere("x, y and z are not all there and finite");
    soup.points.push_back(point);
  }

  double value(Type type)
  {
    if (format_ == Format::TEXT)
    {
      const std::string_view word = in_.wordAnywhere();
      if (word.empty()) failHere("is missing: the file is cut short");
      return in_.number<double>(word, "a number");
    }
    switch (type)
    {
      case Type::INT8:
        return binary<std::int8_t>();
      case Type::UINT8:
        return binary<std::uint8_t>();
      case Type::INT16:
        return binary<std::int16_t>();
      case Type::UINT16:
        return binary<std::uint16_t>();
      case Type::INT32:
        return binary<std::int32_t>();
      case Type::UINT32:
        return binary<std::uint32_t>();
      case Type::FLOAT32:
        return binary<float>();
      case Type::FLOAT64:
        return binary<double>();
    }
    return 0;
  }

  template <class Number>
  Number binary()
  {
    std::array<char, sizeof(Number)> bytes;
    if (body_.size() < bytes.size()) failHere("is missing: the file is cut short");
    std::copy_n(body_.begin(), bytes.size(), bytes.begin());
    body_.remove_prefix(bytes.size());
    if (format_ == Format::BIG) std::reverse(bytes.begin(), bytes.end());
    Number number;
    std::memcpy(&number, bytes.data(), sizeof(number));
    return number;
  }

  [[noreturn]] void failHere(const std::string& what) const
  {
    in_.fail(element_->name + " " + std::to_string(item_) + " of " + std::to_string(element_->count) + ": " + what);
  }

  static constexpr double INDEX_LIMIT = std::numeric_limits<int>::max();

  TextReader in_;
  Format format_ = Format::TEXT;
  std::vector<Element> elements_;
  std::string_view body_;
  const Element* element_ = nullptr;  // being read, for messages
  std::size_t item_ = 0;
};

// What all formats share -----------------------------------------------------------------------------------------

/** Cuts the ears off a polygon, in the plane that fits it best, convex or not. */
void triangulate(const std::vector<Eigen::Vector3d>& points, Polygon polygon, std::vector<Eigen::Vector3i>& triangles)
{
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();  // Newell's: twice the area, whatever the shape
  for (std::size_t i = 0; i < polygon.size(); ++i)
    normal +=
        (points[polygon[i]] - points[polygon[0]]).cross(points[polygon[(i + 1) % polygon.size()]] - points[polygon[0]]);
  const auto area = [&](int a, int b, int c) {
    return normal.dot((points[b] - points[a]).cross(points[c] - points[a]));
  };
  const auto isEar = [&](std::size_t i) {
    const std::size_t n = polygon.size();
    const int a = polygon[(i + n - 1) % n], b = polygon[i], c = polygon[(i + 1) % n];
    if (area(a, b, c) <= 0) return false;
    return std::none_of(polygon.begin(), polygon.end(), [&](int p) {
      return p != a && p != b && p != c && area(a, b, p) >= 0 && area(b, c, p) >= 0 && area(c, a, p) >= 0;
    });
  };
  while (polygon.size() > 3)
  {
    const std::size_t n = polygon.size();
    std::size_t ear = 0;
    while (ear < n && !isEar(ear)) ++ear;
    if (ear == n) ear = 0;  // degenerate or crossing itself: keep the topology, whoever uses it checks the geometry
    triangles.emplace_back(polygon[(ear + n - 1) % n], polygon[ear], polygon[(ear + 1) % n]);
    polygon.erase(polygon.begin() + static_cast<std::ptrdiff_t>(ear));
  }
  triangles.emplace_back(polygon[0], polygon[1], polygon[2]);
}

struct PointHash
{
  std::size_t operator()(const Eigen::Vector3d& p) const
  {
    std::size_t hash = 0;
    for (const double x : p) hash = hash * 0x9E3779B97F4A7C15u + std::hash<double>()(x);
    return hash;
  }
};

std::string readBytes(const std::string& path)
{
  std::error_code error;
  const std::filesystem::file_status status = std::filesystem::status(path, error);
  if (!std::filesystem::exists(status)) throw InputError(path + ": there is no such file");
  if (!std::filesystem::is_regular_file(status)) throw InputError(path + ": is not a file");
  std::ifstream file(path, std::ios::binary);
  std::string bytes(std::filesystem::file_size(path), '\0');
  if (!file.read(bytes.data(), static_cast<std::streamsize>(bytes.size()))) throw InputError(path + ": cannot be read");
  if (bytes.empty()) throw InputError(path + ": is empty");
  return bytes;
}

PolygonSoup readSoup(const std::string& path)
{
  if (!isSurfaceFile(path))
    throw InputError(path + ": the extension " + excerpt(extension(path)) + " is not one of .off, .obj, .stl, .ply");
  const std::string bytes = readBytes(path);
  const std::string format = extension(path);
  if (format == ".off") return readOff(path, bytes);
  if (format == ".obj") return readObj(path, bytes);
  if (format == ".stl") return readStl(path, bytes);
  return PlyReader(path, bytes).read();
}

}  // namespace

bool isSurfaceFile(const std::string& path)
{
  const std::string format = extension(path);
  return format == ".off" || format == ".obj" || format == ".stl" || format == ".ply";
}

SurfaceMesh readSurfaceMesh(const std::string& path)
{
  const PolygonSoup soup = readSoup(path);

  std::unordered_map<Eigen::Vector3d, int, PointHash> known;
  std::vector<int> same_as(soup.points.size());  // the first point at the same position
  for (std::size_t i = 0; i < soup.points.size(); ++i)
    same_as[i] = known.emplace(soup.points[i].array() + 0., static_cast<int>(i)).first->second;  // -0 becomes 0

  std::vector<Eigen::Vector3i> triangles;
  for (const Polygon& polygon : soup.polygons)
  {
    Polygon merged;
    for (const int corner : polygon)
      if (merged.empty() || merged.back() != same_as[corner]) merged.push_back(same_as[corner]);
    while (merged.size() > 1 && merged.front() == merged.back()) merged.pop_back();
    if (merged.size() >= 3) triangulate(soup.points, std::move(merged), triangles);
  }
  triangles.erase(std::remove_if(triangles.begin(), triangles.end(),
                                 [](const Eigen::Vector3i& t) { return t[0] == t[1] || t[1] == t[2] || t[2] == t[0]; }),
                  triangles.end());
  if (triangles.empty()) throw InputError(path + ": holds no triangles");

  std::vector<int> index(soup.points.size(), -1);  // by first use; points in no triangle are left out
  std::vector<int> used;
  for (Eigen::Vector3i& triangle : triangles)
    for (int& corner : triangle)
    {
      if (index[corner] < 0)
      {
        index[corner] = static_cast<int>(used.size());
        used.push_back(corner);
      }
      corner = index[corner];
    }

  SurfaceMesh mesh;
  mesh.points.resize(3, static_cast<Eigen::Index>(used.size()));
  for (std::size_t i = 0; i < used.size(); ++i) mesh.points.col(static_cast<Eigen::Index>(i)) = soup.points[used[i]];
  mesh.triangles.resize(3, static_cast<Eigen::Index>(triangles.size()));
  for (std::size_t i = 0; i < triangles.size(); ++i) mesh.triangles.col(static_cast<Eigen::Index>(i)) = triangles[i];
  return mesh;
}

void writePly(const std::string& path, const Eigen::Matrix3Xd& points, const Eigen::Matrix3Xd& normals,
              const Eigen::Matrix3Xi& triangles)
{
  std::ofstream file(path, std::ios::binary);
  file << "ply\nformat binary_little_endian 1.0\nelement vertex " << points.cols();
  for (const char* name : {"x", "y", "z", "nx", "ny", "nz"}) file << "\nproperty float " << name;
  file << "\nelement face " << triangles.cols() << "\nproperty list uchar int vertex_indices\nend_header\n";
  for (Eigen::Index i = 0; i < points.cols(); ++i)
  {
    Eigen::Matrix<float, 6, 1> row;
    row << points.col(i).cast<float>(), normals.col(i).cast<float>();
    file.write(reinterpret_cast<const char*>(row.data()), sizeof(row));
  }
  for (Eigen::Index k = 0; k < triangles.cols(); ++k)
  {
    file.put(3).write(reinterpret_cast<const char*>(triangles.col(k).data()), 3 * sizeof(int));
  }
  file.close();
  if (!file) throw InputError(path + ": cannot be written");
}

}  // namespace bezier_fem
