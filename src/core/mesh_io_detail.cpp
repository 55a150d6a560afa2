#include "mesh_io_detail.h"

#include <algorithm>
#include <charconv>
#include <filesystem>
#include <fstream>
#include <limits>

#include "bezier_fem/error.h"

namespace bezier_fem
{
namespace mesh_io
{
namespace
{
bool isBlank(char c)
{
  return c == ' ' || c == '\t' || c == '\r' || c == '\v' || c == '\f';
}

// Ids are continued past the largest one for the points that a first-order file has no nodes for.
constexpr std::int64_t MAX_ID = std::numeric_limits<std::int64_t>::max() / 2;
// Their edges can be counted by an int.
constexpr std::size_t MAX_ELEMENTS = std::numeric_limits<int>::max() / 6;
// The cube of a length still fits into a double.
constexpr double MAX_COORDINATE = 1e100;

}  // namespace

Source::Source(const std::string& path) : path_(path)
{
  std::error_code error;
  const std::filesystem::file_status status = std::filesystem::status(path, error);
  if (!std::filesystem::exists(status)) throw InputError(path + ": there is no such file");
  if (std::filesystem::is_directory(status)) throw InputError(path + ": is a directory, not a mesh file");
  // A pipe or a device may never end.
  if (!std::filesystem::is_regular_file(status)) throw InputError(path + ": is not a regular file");

  const std::uintmax_t size = std::filesystem::file_size(path, error);
  std::ifstream stream(path, std::ios::binary);
  if (error || !stream) throw InputError(path + ": cannot be opened for reading");
  if (size == 0) throw InputError(path + ": the file is empty");
  bytes_.resize(size);
  if (!stream.read(bytes_.data(), static_cast<std::streamsize>(size))) throw InputError(path + ": cannot be read");
}

std::string Source::place(std::size_t at) const
{
  if (places_ == Places::BYTES) return path_ + ", byte " + std::to_string(at);
  const std::size_t line =
      places_ == Places::LINES
          ? at
          : static_cast<std::size_t>(std::count(
                bytes_.begin(), bytes_.begin() + static_cast<std::ptrdiff_t>(std::min(at, bytes_.size())), '\n')) +
                1;
  return path_ + ", line " + std::to_string(line);
}

void Source::fail(std::size_t at, const std::string& message) const
{
  throw InputError(place(at) + ": " + message);
}

std::string quoted(std::string_view bytes)
{
  constexpr std::size_t LONGEST = 40;
  std::string result = "'";
  for (const char c : bytes.substr(0, LONGEST)) result += c >= ' ' && c <= '~' ? c : '?';
  return result + (bytes.size() > LONGEST ? "...'" : "'");
}

std::string text(double value)
{
  char buffer[32];
  const std::to_chars_result result = std::to_chars(buffer, buffer + sizeof(buffer), value);
  return std::string(buffer, result.ptr);
}

std::string listed(const std::vector<std::string>& first_ones, std::size_t total)
{
  std::string result;
  for (std::size_t i = 0; i < first_ones.size(); ++i)
  {
    if (i > 0) result += i + 1 == total ? " and " : ", ";
    result += first_ones[i];
  }
  if (total > first_ones.size()) result += " and " + std::to_string(total - first_ones.size()) + " more";
  return result;
}

Cursor::Cursor(const Source& source, Layout layout, char comment)
    : source_(&source), bytes_(source.bytes()), layout_(layout), comment_(comment)
{
}

void Cursor::skipBlanks(bool across_lines)
{
  while (next_ < bytes_.size())
  {
    const char c = bytes_[next_];
    if (comment_ != '\0' && c == comment_)
    {
      while (next_ < bytes_.size() && bytes_[next_] != '\n') ++next_;
    }
    else if (isBlank(c) || (across_lines && c == '\n'))
    {
      ++next_;
    }
    else
    {
      break;
    }
  }
}

bool Cursor::atEnd()
{
  skipBlanks(true);
  return next_ == bytes_.size();
}

bool Cursor::atRowEnd()
{
  skipBlanks(false);
  return next_ == bytes_.size() || bytes_[next_] == '\n';
}

void Cursor::endRow()
{
  if (!atRowEnd())
  {
    const std::string_view surplus = word("");
    fail(quoted(surplus) + " where the line should end");
  }
  skipBlanks(true);
}

std::string_view Cursor::restOfLine()
{
  last_ = next_;
  const std::size_t end = std::min(bytes_.find('\n', next_), bytes_.size());
  std::string_view line = bytes_.substr(next_, end - next_);
  next_ = std::min(end + 1, bytes_.size());
  if (!line.empty() && line.back() == '\r') line.remove_suffix(1);
  return line;
}

std::string_view Cursor::word(const char* expected)
{
  skipBlanks(layout_ == Layout::FREE);
  last_ = next_;
  while (next_ < bytes_.size() && !isBlank(bytes_[next_]) && bytes_[next_] != '\n' &&
         (comment_ == '\0' || bytes_[next_] != comment_))
  {
    ++next_;
  }
  if (next_ == last_) failExpected(expected);
  return bytes_.substr(last_, next_ - last_);
}

void Cursor::failExpected(const char* expected) const
{
  const bool at_end = bytes_.find_first_not_of(" \t\r\v\f\n", next_) == std::string_view::npos;
  fail(std::string("the ") + (at_end ? "file" : "line") + " ends where " + expected + " is expected");
}

template <class T>
T Cursor::number(const char* expected)
{
  std::string_view digits = word(expected);
  if (digits.size() > 1 && digits[0] == '+' && digits[1] != '-') digits.remove_prefix(1);
  T value{};
  const std::from_chars_result result = std::from_chars(digits.data(), digits.data() + digits.size(), value);
  if (result.ec != std::errc() || result.ptr != digits.data() + digits.size())
  {
    fail(quoted(digits) + " where " + expected + " is expected");
  }
  return value;
}

template double Cursor::number<double>(const char*);
template std::int64_t Cursor::number<std::int64_t>(const char*);

std::size_t Cursor::count(const char* expected, std::size_t bytes_each)
{
  const std::int64_t count = number<std::int64_t>(expected);
  if (count < 0) fail(std::to_string(count) + " where " + expected + " is expected; 0 or more is allowed");
  checkRoom(static_cast<std::size_t>(count), bytes_each, expected);
  return static_cast<std::size_t>(count);
}

void Cursor::checkRoom(std::size_t count, std::size_t bytes_each, const char* what)
{
  // The last line may lack its end, hence the 1.
  if (bytes_each > 0 && count > (remaining() + 1) / bytes_each)
  {
    fail("the file is cut short or announces too much: " + std::to_string(count) + " as " + what + ", but only " +
         std::to_string(remaining()) + " bytes follow");
  }
}

std::string_view Cursor::take(std::size_t size, const char* expected)
{
  last_ = next_;
  if (size > remaining())
  {
    fail(std::string("the file is cut short: it ends within ") + expected + ", of which " + std::to_string(size) +
         " bytes are expected and " + std::to_string(remaining()) + " follow");
  }
  next_ += size;
  return bytes_.substr(last_, size);
}

RawMesh::RawMesh(const Source& nodes_in, const Source& elements_in)
    : node_source(&nodes_in), element_source(&elements_in)
{
}

void RawMesh::addNode(std::int64_t id, const Eigen::Vector3d& position, std::size_t at)
{
  if (id < 0 || id > MAX_ID)
  {
    node_source->fail(at, node_noun + " id " + std::to_string(id) + " is out of range; 0 to " + std::to_string(MAX_ID) +
                              " is allowed");
  }
  if (!(position.array().abs() <= MAX_COORDINATE).all())
  {
    node_source->fail(at, "the coordinates (" + text(position.x()) + ", " + text(position.y()) + ", " +
                              text(position.z()) + ") of " + node_noun + " " + std::to_string(id) +
                              " are not finite numbers up to 1e100");
  }
  node_ids.push_back(id);
  node_positions.push_back(position);
  node_places.push_back(at);
}

void RawMesh::addElement(std::int64_t id, const std::int64_t* nodes, int node_count, std::size_t at)
{
  if (nodes_per_element == 0) nodes_per_element = node_count;
  if (node_count != nodes_per_element)
  {
    element_source->fail(at, element_noun + " " + std::to_string(id) + " has " + std::to_string(node_count) +
                                 " nodes and those before it have " + std::to_string(nodes_per_element) +
                                 "; all must be of one order");
  }
  if (element_ids.size() == MAX_ELEMENTS)
  {
    element_source->fail(at, "more than " + std::to_string(MAX_ELEMENTS) + " tetrahedra");
  }
  elements.insert(elements.end(), nodes, nodes + node_count);
  element_ids.push_back(id);
  element_places.push_back(at);
}

}  // namespace mesh_io
}  // namespace bezier_fem
