// VTK's XML format for unstructured grids ("VTK XML formats", VTK documentation).

#include <tinyxml2.h>
#include <zlib.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <optional>

#include "mesh_io_detail.h"

namespace bezier_fem
{
namespace mesh_io
{
namespace
{
using tinyxml2::XMLElement;

/** The value of a base64 digit, or -1. */
int digitValue(char c)
{
  if (c >= 'A' && c <= 'Z') return c - 'A';
  if (c >= 'a' && c <= 'z') return c - 'a' + 26;
  if (c >= '0' && c <= '9') return c - '0' + 52;
  if (c == '+') return 62;
  return c == '/' ? 63 : -1;
}

/** Bytes written as they are or in base64, to be read front to back. */
class ByteStream
{
public:
  ByteStream(std::string_view text, bool base64) : text_(text), base64_(base64) {}

  /** No more bytes than these can follow. */
  std::size_t bound() const
  {
    return (base64_ ? (text_.size() - next_) / 4 * 3 : text_.size() - next_) + pending_size_;
  }

  /** Empty if there are not as many. */
  std::optional<std::string> read(std::size_t size)
  {
    if (size > bound()) return {};
    if (!base64_)
    {
      next_ += size;
      return std::string(text_.substr(next_ - size, size));
    }
    std::string bytes;
    bytes.reserve(size);
    while (bytes.size() < size)
    {
      if (pending_size_ == 0 && !decodeFour()) return {};
      bytes += pending_[pending_begin_++];
      --pending_size_;
    }
    return bytes;
  }

private:
  /** Padding ends a run of base64, not the stream: headers and data are encoded one after the other. */
  bool decodeFour()
  {
    unsigned bits = 0;
    int digits = 0, padding = 0;
    for (; digits + padding < 4 && next_ < text_.size(); ++next_)
    {
      const char c = text_[next_];
      if (c == ' ' || c == '\n' || c == '\r' || c == '\t') continue;
      const int value = digitValue(c);
      if (c == '=')
        ++padding;
      else if (value < 0 || padding > 0)
        return false;
      else
        ++digits;
      bits = bits << 6 | static_cast<unsigned>(std::max(value, 0));
    }
    if (digits < 2 || digits + padding < 4) return false;
    for (int i = 0; i < 3; ++i) pending_[i] = static_cast<char>(bits >> (16 - 8 * i) & 0xff);
    pending_begin_ = 0;
    pending_size_ = static_cast<std::size_t>(digits - 1);
    return true;
  }

  std::string_view text_;
  bool base64_;
  std::size_t next_ = 0;
  std::array<char, 3> pending_{};
  std::size_t pending_begin_ = 0, pending_size_ = 0;
};

class VtuReader
{
public:
  explicit VtuReader(const std::string& path) : source_(path), raw_(source_, source_)
  {
    raw_.node_noun = "point";
    raw_.element_noun = "cell";
    source_.setPlaces(Source::Places::LINES);
  }

  TetMesh read();

private:
  [[noreturn]] void fail(const XMLElement& at, const std::string& message) const
  {
    source_.fail(static_cast<std::size_t>(at.GetLineNum()), message);
  }
  std::string attribute(const XMLElement& element, const char* name, const char* otherwise) const;
  std::size_t sizeAttribute(const XMLElement& element, const char* name) const;
  const XMLElement& child(const XMLElement& parent, const char* name) const;
  const XMLElement& array(const XMLElement& parent, const char* name) const;

  void parse();
  void readHeader(const XMLElement& root);
  void readPiece(const XMLElement& piece);

  ScalarType scalarType(const XMLElement& array) const;
  template <class T>
  std::vector<T> values(const XMLElement& array, std::optional<std::size_t> expected_count) const;
  template <class T>
  std::vector<T> asciiValues(const XMLElement& array) const;
  ByteStream bytesOf(const XMLElement& array, const std::string& format) const;
  std::string readBytes(const XMLElement& array, ByteStream stream) const;
  std::uint64_t readSize(const XMLElement& array, ByteStream& stream) const;

  Source source_;
  RawMesh raw_;
  std::size_t cell_total_ = 0;
  tinyxml2::XMLDocument document_;
  std::string_view appended_;
  bool appended_base64_ = false;
  bool swap_ = false;
  std::size_t size_bytes_ = 4;  // of the sizes before binary data
  bool compressed_ = false;
};

TetMesh VtuReader::read()
{
  parse();
  const XMLElement* root = document_.RootElement();
  if (root == nullptr || std::string_view(root->Name()) != "VTKFile") source_.fail(1, "there is no VTKFile element");
  readHeader(*root);
  const XMLElement& grid = child(*root, "UnstructuredGrid");
  for (const XMLElement* piece = &child(grid, "Piece"); piece != nullptr; piece = piece->NextSiblingElement("Piece"))
  {
    readPiece(*piece);
  }
  return buildTetMesh(raw_);
}

void VtuReader::parse()
{
  // Appended data may be raw, which no XML parser takes: it gets the file without them.
  const std::string_view bytes = source_.bytes();
  std::string xml;
  const std::size_t tag = bytes.find("<AppendedData");
  const std::size_t tag_end = tag == bytes.npos ? tag : bytes.find('>', tag);
  if (tag_end != bytes.npos)
  {
    const std::size_t start = bytes.find('_', tag_end);
    if (start != bytes.npos) appended_ = bytes.substr(start + 1);
    xml = std::string(bytes.substr(0, tag_end + 1)) + "</AppendedData></VTKFile>";
  }
  else
  {
    xml = bytes;
  }
  if (document_.Parse(xml.data(), xml.size()) != tinyxml2::XML_SUCCESS)
  {
    source_.fail(static_cast<std::size_t>(std::max(1, document_.ErrorLineNum())),
                 std::string("not well-formed XML, or cut short (") + document_.ErrorName() + ")");
  }
}

void VtuReader::readHeader(const XMLElement& root)
{
  const std::string type = attribute(root, "type", "");
  if (type != "UnstructuredGrid") fail(root, "VTKFile of type " + quoted(type) + "; UnstructuredGrid is read");
  const std::string version = attribute(root, "version", "0.1");
  if (version.size() < 2 || version[0] < '0' || version[0] > '2' || version[1] != '.')
  {
    fail(root, "version " + quoted(version) + "; 0.1 to 2.x are read");
  }
  const std::string order = attribute(root, "byte_order", "LittleEndian");
  if (order != "LittleEndian" && order != "BigEndian")
  {
    fail(root, "byte_order " + quoted(order) + "; LittleEndian and BigEndian are allowed");
  }
  const std::uint16_t probe = 1;
  const bool machine_is_little = fromBytes<char>(reinterpret_cast<const char*>(&probe), false) == 1;
  swap_ = (order == "LittleEndian") != machine_is_little;
  const std::string header_type = attribute(root, "header_type", "UInt32");
  if (header_type != "UInt32" && header_type != "UInt64")
  {
    fail(root, "header_type " + quoted(header_type) + "; UInt32 and UInt64 are allowed");
  }
  size_bytes_ = header_type == "UInt32" ? 4 : 8;
  const std::string compressor = attribute(root, "compressor", "");
  if (!compressor.empty() && compressor != "vtkZLibDataCompressor")
  {
    fail(root, "compressor " + quoted(compressor) + "; vtkZLibDataCompressor or none is allowed");
  }
  compressed_ = !compressor.empty();
  if (const XMLElement* appended = root.FirstChildElement("AppendedData"))
  {
    const std::string encoding = attribute(*appended, "encoding", "");
    if (encoding != "raw" && encoding != "base64")
    {
      fail(*appended, "encoding " + quoted(encoding) + "; raw and base64 are allowed");
    }
    appended_base64_ = encoding == "base64";
  }
}

void VtuReader::readPiece(const XMLElement& piece)
{
  const std::size_t point_count = sizeAttribute(piece, "NumberOfPoints");
  const std::size_t cell_count = sizeAttribute(piece, "NumberOfCells");
  // Many pieces are one mesh: ids go on.
  const auto first_point = static_cast<std::int64_t>(raw_.node_ids.size());
  const auto first_cell = static_cast<std::int64_t>(cell_total_);

  const XMLElement& points = child(child(piece, "Points"), "DataArray");
  if (attribute(points, "NumberOfComponents", "3") != "3")
  {
    fail(points, quoted(attribute(points, "NumberOfComponents", "")) + " components of a point; 3 are allowed");
  }
  const std::vector<double> coordinates = values<double>(points, 3 * point_count);
  for (std::size_t i = 0; i < point_count; ++i)
  {
    raw_.addNode(first_point + static_cast<std::int64_t>(i), Eigen::Vector3d(coordinates.data() + 3 * i),
                 static_cast<std::size_t>(points.GetLineNum()));
  }

  const XMLElement& cells_element = child(piece, "Cells");
  const XMLElement& connectivity = array(cells_element, "connectivity");
  const XMLElement& offsets = array(cells_element, "offsets");
  VtkCells cells;
  cells.connectivity = values<std::int64_t>(connectivity, {});
  cells.types = values<std::int64_t>(array(cells_element, "types"), cell_count);
  cells.places.assign(cell_count, static_cast<std::size_t>(connectivity.GetLineNum()));
  cells.offsets = values<std::int64_t>(offsets, cell_count);
  cells.offsets.insert(cells.offsets.begin(), 0);
  for (std::size_t i = 1; i <= cell_count; ++i)
  {
    if (cells.offsets[i] < cells.offsets[i - 1] ||
        cells.offsets[i] > static_cast<std::int64_t>(cells.connectivity.size()))
    {
      fail(offsets, "offset " + std::to_string(cells.offsets[i]) + " of cell " + std::to_string(i - 1) + "; " +
                        std::to_string(cells.offsets[i - 1]) + " to " + std::to_string(cells.connectivity.size()) +
                        " is allowed");
    }
  }
  addVtkCells(cells, first_point, static_cast<std::int64_t>(point_count), first_cell, &raw_);
  cell_total_ += cell_count;
}

std::string VtuReader::attribute(const XMLElement& element, const char* name, const char* otherwise) const
{
  const char* value = element.Attribute(name);
  return value == nullptr ? otherwise : value;
}

std::size_t VtuReader::sizeAttribute(const XMLElement& element, const char* name) const
{
  const std::string value = attribute(element, name, "");
  std::uint32_t size = 0;
  const std::from_chars_result result = std::from_chars(value.data(), value.data() + value.size(), size);
  if (result.ec != std::errc() || result.ptr != value.data() + value.size())
  {
    fail(element, std::string(name) + " is " + quoted(value) + "; 0 to 4294967295 is allowed");
  }
  return size;
}

const XMLElement& VtuReader::child(const XMLElement& parent, const char* name) const
{
  const XMLElement* found = parent.FirstChildElement(name);
  if (found == nullptr) fail(parent, std::string("there is no ") + name + " in " + parent.Name());
  return *found;
}

const XMLElement& VtuReader::array(const XMLElement& parent, const char* name) const
{
  const XMLElement* found = &child(parent, "DataArray");
  while (found != nullptr && attribute(*found, "Name", "") != name) found = found->NextSiblingElement("DataArray");
  if (found == nullptr) fail(parent, std::string("there is no DataArray ") + name + " in " + parent.Name());
  return *found;
}

ScalarType VtuReader::scalarType(const XMLElement& array) const
{
  using Kind = ScalarType::Kind;
  static const std::map<std::string, ScalarType> TYPES{{"Int8", {Kind::SIGNED, 1}},   {"UInt8", {Kind::UNSIGNED, 1}},
                                                       {"Int16", {Kind::SIGNED, 2}},  {"UInt16", {Kind::UNSIGNED, 2}},
                                                       {"Int32", {Kind::SIGNED, 4}},  {"UInt32", {Kind::UNSIGNED, 4}},
                                                       {"Int64", {Kind::SIGNED, 8}},  {"UInt64", {Kind::UNSIGNED, 8}},
                                                       {"Float32", {Kind::FLOAT, 4}}, {"Float64", {Kind::FLOAT, 8}}};
  const std::string name = attribute(array, "type", "");
  const auto type = TYPES.find(name);
  if (type == TYPES.end()) fail(array, "type " + quoted(name) + "; Int8 to UInt64, Float32 and Float64 are allowed");
  return type->second;
}

template <class T>
std::vector<T> VtuReader::values(const XMLElement& array, std::optional<std::size_t> expected_count) const
{
  const ScalarType type = scalarType(array);
  if (type.kind == ScalarType::Kind::FLOAT && !std::is_same_v<T, double>)
  {
    fail(array, "type " + attribute(array, "type", "") + "; a type of whole numbers is allowed");
  }
  std::vector<T> result;
  const std::string format = attribute(array, "format", "ascii");
  if (format == "ascii")
  {
    result = asciiValues<T>(array);
  }
  else
  {
    const std::string bytes = readBytes(array, bytesOf(array, format));
    if (bytes.size() % type.size != 0)
    {
      fail(array,
           std::to_string(bytes.size()) + " bytes of data; a multiple of " + std::to_string(type.size) + " is allowed");
    }
    result.resize(bytes.size() / type.size);
    for (std::size_t i = 0; i < result.size(); ++i) result[i] = decode<T>(bytes.data() + i * type.size, type, swap_);
  }
  if (expected_count && result.size() != *expected_count)
  {
    fail(array, "the DataArray " + quoted(attribute(array, "Name", "")) + " holds " + std::to_string(result.size()) +
                    " values, but " + std::to_string(*expected_count) + " are expected");
  }
  return result;
}

template <class T>
std::vector<T> VtuReader::asciiValues(const XMLElement& array) const
{
  const char* begin = array.GetText();
  std::vector<T> result;
  if (begin == nullptr) return result;
  const std::string_view text(begin);
  constexpr const char* BLANKS = " \t\r\n";
  const std::size_t first = text.find_first_not_of(BLANKS);
  for (std::size_t next = first; next != text.npos;)
  {
    const std::size_t end = std::min(text.find_first_of(BLANKS, next), text.size());
    T value{};
    const std::from_chars_result parsed = std::from_chars(begin + next + (text[next] == '+'), begin + end, value);
    if (parsed.ec != std::errc() || parsed.ptr != begin + end)
    {
      // The parser counts from the first character that is not blank.
      const auto line = std::count(begin + first, begin + next, '\n');
      source_.fail(static_cast<std::size_t>(array.FirstChild()->GetLineNum() + line),
                   quoted(text.substr(next, end - next)) + " in the DataArray " + quoted(attribute(array, "Name", "")) +
                       " where a number of type " + attribute(array, "type", "") + " is expected");
    }
    result.push_back(value);
    next = text.find_first_not_of(BLANKS, end);
  }
  return result;
}

ByteStream VtuReader::bytesOf(const XMLElement& array, const std::string& format) const
{
  if (format == "binary")
  {
    const char* text = array.GetText();
    return ByteStream(text == nullptr ? "" : text, true);
  }
  if (format != "appended") fail(array, "format " + quoted(format) + "; ascii, binary and appended are allowed");
  const std::string value = attribute(array, "offset", "");
  std::size_t offset = 0;
  const std::from_chars_result result = std::from_chars(value.data(), value.data() + value.size(), offset);
  if (result.ec != std::errc() || result.ptr != value.data() + value.size() || offset > appended_.size())
  {
    fail(array, "offset " + quoted(value) + "; 0 to " + std::to_string(appended_.size()) + " is allowed");
  }
  return ByteStream(appended_.substr(offset), appended_base64_);
}

std::uint64_t VtuReader::readSize(const XMLElement& array, ByteStream& stream) const
{
  const std::optional<std::string> bytes = stream.read(size_bytes_);
  if (!bytes) fail(array, "the data of this DataArray are cut short or not base64");
  return size_bytes_ == 4 ? fromBytes<std::uint32_t>(bytes->data(), swap_)
                          : fromBytes<std::uint64_t>(bytes->data(), swap_);
}

std::string VtuReader::readBytes(const XMLElement& array, ByteStream stream) const
{
  const auto readBlock = [&](std::uint64_t size) {
    std::optional<std::string> bytes = stream.read(size);
    if (!bytes)
    {
      fail(array, "the data of this DataArray are cut short or not base64: " + std::to_string(size) +
                      " bytes are announced, no more than " + std::to_string(stream.bound()) + " follow");
    }
    return *std::move(bytes);
  };
  if (!compressed_) return readBlock(readSize(array, stream));

  const std::uint64_t block_count = readSize(array, stream);
  if (block_count == 0) return {};
  const std::uint64_t block_size = readSize(array, stream);
  const std::uint64_t last_size = readSize(array, stream);  // 0 if it is full too
  if (block_count > stream.bound() / size_bytes_)
  {
    fail(array, std::to_string(block_count) + " compressed blocks are announced, more than the file can hold");
  }
  std::vector<std::uint64_t> packed_sizes(block_count);
  for (std::uint64_t& size : packed_sizes) size = readSize(array, stream);

  std::string result;
  for (std::size_t i = 0; i < block_count; ++i)
  {
    const std::string packed = readBlock(packed_sizes[i]);
    const std::uint64_t size = i + 1 == block_count && last_size != 0 ? last_size : block_size;
    constexpr std::uint64_t MOST_PER_BYTE = 1040;  // more than deflate can reach
    uLongf unpacked = static_cast<uLongf>(size);
    const bool possible = size / MOST_PER_BYTE <= packed.size();
    const std::size_t before = result.size();
    if (possible) result.resize(before + size);
    if (!possible ||
        uncompress(reinterpret_cast<Bytef*>(result.data() + before), &unpacked,
                   reinterpret_cast<const Bytef*>(packed.data()), static_cast<uLong>(packed.size())) != Z_OK ||
        unpacked != size)
    {
      fail(array, "block " + std::to_string(i) + " of the compressed data is damaged");
    }
  }
  return result;
}

}  // namespace

TetMesh readVtu(const std::string& path)
{
  return VtuReader(path).read();
}

}  // namespace mesh_io
}  // namespace bezier_fem
