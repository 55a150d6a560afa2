// The CSV files that a scene names.
#include <charconv>
#include <cmath>
#include <fstream>
#include <limits>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "bezier_fem/error.h"
#include "bezier_fem/scene.h"
#include "bezier_fem/sizing.h"
#include "yaml_tree.h"

namespace bezier_fem
{
namespace
{
/** One line of a CSV file, cut at its commas. */
struct Row
{
  std::string place;  // "hand.csv:12", for messages
  std::vector<std::string_view> fields;
};

std::string_view trimmed(std::string_view text)
{
  const std::size_t first = text.find_first_not_of(" \t\r");
  if (first == std::string_view::npos) return {};
  return text.substr(first, text.find_last_not_of(" \t\r") - first + 1);
}

std::vector<std::string_view> split(std::string_view line)
{
  std::vector<std::string_view> fields;
  for (;;)
  {
    const std::size_t comma = line.find(',');
    fields.push_back(trimmed(line.substr(0, comma)));
    if (comma == std::string_view::npos) return fields;
    line.remove_prefix(comma + 1);
  }
}

template <typename T>
T parse(const Row& row, std::size_t column, std::string_view name, const char* allowed)
{
  const std::string_view text = row.fields[column];
  const std::string_view digits = text.substr(text.size() > 1 && text[0] == '+' && text[1] != '-' ? 1 : 0);
  T value;
  const auto [end, error] = std::from_chars(digits.data(), digits.data() + digits.size(), value);
  if (error != std::errc() || end != digits.data() + digits.size() || !std::isfinite(static_cast<double>(value)))
    throw InputError(row.place + ": " + std::string(name) + " is '" + excerpt(std::string(text)) + "', must be " +
                     allowed);
  return value;
}

/** Calls readRow(Row) for each line below the header, which must be `header`. Empty lines may stand at the end only. */
template <typename ReadRow>
void readTable(const std::string& path, std::string_view header, ReadRow readRow)
{
  const std::string name = excerpt(path, std::string::npos);
  std::ifstream file(path, std::ios::binary);
  std::string line;
  if (!file || !std::getline(file, line)) throw InputError(name + ": cannot be read, or is empty");
  constexpr std::string_view BYTE_ORDER_MARK = "\xEF\xBB\xBF";  // spreadsheets write it
  const bool marked = line.compare(0, BYTE_ORDER_MARK.size(), BYTE_ORDER_MARK) == 0;
  const auto columns = split(header);
  if (split(std::string_view(line).substr(marked ? BYTE_ORDER_MARK.size() : 0)) != columns)
    throw InputError(name + ":1: the header is '" + excerpt(line) + "', must be " + std::string(header));

  std::size_t number = 1;
  std::size_t rows = 0;
  std::optional<std::size_t> empty_line;
  while (std::getline(file, line))
  {
    ++number;
    if (trimmed(line).empty())
    {
      if (!empty_line) empty_line = number;
      continue;
    }
    if (empty_line)
      throw InputError(name + ":" + std::to_string(*empty_line) + ": an empty line, must be " + std::string(header));
    const Row row{name + ":" + std::to_string(number), split(line)};
    if (row.fields.size() != columns.size())
      throw InputError(row.place + ": '" + excerpt(line) + "' has " + std::to_string(row.fields.size()) +
                       " fields, must be " + std::string(header));
    readRow(row);
    ++rows;
  }
  if (rows == 0) throw InputError(name + ": has no row below the header " + std::string(header));
}

constexpr const char* NUMBER = "a finite number";
constexpr const char* SIZING_HEADER = "x,y,z,size";

}  // namespace

std::vector<MotionSample> readMotion(const std::string& path)
{
  constexpr double SHORTEST_QUATERNION = 1e-9;
  std::vector<MotionSample> samples;
  readTable(path, "time,x,y,z,qx,qy,qz,qw", [&](const Row& row) {
    MotionSample sample;
    sample.time = parse<double>(row, 0, "time", NUMBER);
    if (!samples.empty() && sample.time <= samples.back().time)
      throw InputError(row.place + ": time is " + std::string(row.fields[0]) + ", must be later than the row before");
    for (int i = 0; i < 3; ++i)
      sample.translation[i] = parse<double>(row, 1 + i, std::string_view("xyz").substr(i, 1), NUMBER);
    for (int i = 0; i < 4; ++i)
      sample.quaternion[i] = parse<double>(row, 4 + i, std::string_view("qxqyqzqw").substr(2 * i, 2), NUMBER);
    const double length = sample.quaternion.stableNorm();
    if (!(length > SHORTEST_QUATERNION && std::isfinite(length)))
      throw InputError(row.place + ": qx,qy,qz,qw is a quaternion of length " + std::to_string(length) + ", must be 1");
    sample.quaternion /= length;
    samples.push_back(sample);
  });
  return samples;
}

std::map<std::int64_t, Eigen::Vector3d> readPositions(const std::string& path)
{
  std::map<std::int64_t, Eigen::Vector3d> positions;
  readTable(path, "node,x,y,z", [&](const Row& row) {
    const auto id = parse<std::int64_t>(row, 0, "node", "a node id, an integer");
    Eigen::Vector3d position;
    for (int i = 0; i < 3; ++i) position[i] = parse<double>(row, 1 + i, std::string_view("xyz").substr(i, 1), NUMBER);
    if (!positions.emplace(id, position).second)
      throw InputError(row.place + ": node " + std::to_string(id) + " is given twice, must be given once");
  });
  return positions;
}

std::vector<SizePoint> readSizing(const std::string& path)
{
  constexpr const char* SIZE = "a finite number above 0";
  std::vector<SizePoint> points;
  readTable(path, SIZING_HEADER, [&](const Row& row) {
    SizePoint& point = points.emplace_back();
    for (int i = 0; i < 3; ++i) point.position[i] = parse<double>(row, i, std::string_view("xyz").substr(i, 1), NUMBER);
    point.size = parse<double>(row, 3, "size", SIZE);
    if (!(point.size > 0))
      throw InputError(row.place + ": size is '" + excerpt(std::string(row.fields[3])) + "', must be " + SIZE);
  });
  return points;
}

void writeSizing(const std::string& path, const std::vector<SizePoint>& points)
{
  std::ofstream file(path);
  file.precision(std::numeric_limits<double>::max_digits10);
  file << SIZING_HEADER << '\n';
  for (const auto& [p, size] : points) file << p.x() << ',' << p.y() << ',' << p.z() << ',' << size << '\n';
  file.close();
  if (!file) throw InputError(excerpt(path, std::string::npos) + ": cannot be written");
}

}  // namespace bezier_fem
