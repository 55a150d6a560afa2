#include "bezier_fem/vtu_series.h"

#include <array>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <sstream>

#include "bezier_fem/error.h"
#include "bezier_fem/measures.h"

namespace bezier_fem
{
namespace
{
/** VTK's edges of a quadratic tetrahedron, 01 12 20 03 13 23, in ours. */
constexpr std::array<int, QUADRATIC_NODES> VTK_ORDER{0, 1, 2, 3, 4, 7, 5, 6, 8, 9};

std::string base64(const std::string& bytes)
{
  static const char* digits = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string text;
  text.reserve((bytes.size() + 2) / 3 * 4);
  for (std::size_t i = 0; i < bytes.size(); i += 3)
  {
    std::uint32_t group = 0;
    for (std::size_t k = 0; k < 3; ++k)
    {
      group = group << 8 | (i + k < bytes.size() ? static_cast<unsigned char>(bytes[i + k]) : 0U);
    }
    for (std::size_t k = 0; k < 4; ++k) text += i + k <= bytes.size() ? digits[group >> (18 - 6 * k) & 63] : '=';
  }
  return text;
}

template <class T>
void dataArray(std::ostream& out, const char* type, const char* name, int components, const std::vector<T>& values)
{
  const std::uint64_t size = values.size() * sizeof(T);
  std::string bytes(sizeof(size) + size, '\0');
  std::memcpy(bytes.data(), &size, sizeof(size));
  std::memcpy(bytes.data() + sizeof(size), values.data(), size);
  out << "<DataArray type=\"" << type << "\" Name=\"" << name << "\" NumberOfComponents=\"" << components
      << "\" format=\"binary\">" << base64(bytes) << "</DataArray>\n";
}

void writeWhole(const std::string& path, const std::string& content)
{
  std::ofstream file(path, std::ios::binary);
  file << content;
  file.close();
  if (!file) throw InputError(path + ": cannot be written");
}
}  // namespace

VtuSeries::VtuSeries(const std::string& folder, const std::string& name) : folder_(folder), name_(name)
{
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error) throw InputError(folder + ": cannot make this folder: " + error.message());
  writeIndex();
}

void VtuSeries::writeIndex() const
{
  std::ostringstream out;
  out.precision(17);
  out << "<?xml version=\"1.0\"?>\n<VTKFile type=\"Collection\" version=\"1.0\" "
         "byte_order=\"LittleEndian\">\n<Collection>\n";
  for (const auto& [time, file] : files_)
  {
    out << "<DataSet timestep=\"" << time << "\" part=\"0\" file=\"" << file << "\"/>\n";
  }
  out << "</Collection>\n</VTKFile>\n";
  writeWhole(folder_ + "/" + name_ + ".pvd", out.str());
}

void VtuSeries::write(const Model& model, const NodalField& x, const NodalField& v,
                      const Eigen::Matrix<double, 6, Eigen::Dynamic>& nodal_stress, double time)
{
  std::vector<double> points, displacement, velocity, von_mises, stress;
  for (int i = 0; i < model.num_nodes; ++i)
  {
    const Eigen::Vector3d rest = nodePosition(model, model.rest, i), now = nodePosition(model, x, i);
    const Eigen::Vector3d speed = nodePosition(model, v, i);
    points.insert(points.end(), rest.begin(), rest.end());
    for (int axis = 0; axis < 3; ++axis) displacement.push_back(now[axis] - rest[axis]);
    velocity.insert(velocity.end(), speed.begin(), speed.end());
    von_mises.push_back(vonMises(nodal_stress.col(i)));
    stress.insert(stress.end(), nodal_stress.col(i).begin(), nodal_stress.col(i).end());
  }
  std::vector<std::int64_t> connectivity, offsets;
  for (int t = 0; t < model.num_tets; ++t)
  {
    for (int k = 0; k < model.nodes_per_tet; ++k) connectivity.push_back(model.nodesOf(t)[VTK_ORDER[k]]);
    offsets.push_back(static_cast<std::int64_t>(connectivity.size()));
  }
  const std::vector<std::uint8_t> types(model.num_tets, model.quadratic() ? 24 : 10);

  std::ostringstream out;
  out << "<?xml version=\"1.0\"?>\n<VTKFile type=\"UnstructuredGrid\" version=\"1.0\" byte_order=\"LittleEndian\" "
         "header_type=\"UInt64\">\n<UnstructuredGrid>\n<Piece NumberOfPoints=\""
      << model.num_nodes << "\" NumberOfCells=\"" << model.num_tets << "\">\n<Points>\n";
  dataArray(out, "Float64", "Points", 3, points);
  out << "</Points>\n<Cells>\n";
  dataArray(out, "Int64", "connectivity", 1, connectivity);
  dataArray(out, "Int64", "offsets", 1, offsets);
  dataArray(out, "UInt8", "types", 1, types);
  out << "</Cells>\n<PointData Scalars=\"von_mises\" Vectors=\"displacement\">\n";
  dataArray(out, "Int64", "node", 1, model.ids);
  dataArray(out, "Float64", "displacement", 3, displacement);
  dataArray(out, "Float64", "velocity", 3, velocity);
  dataArray(out, "Float64", "von_mises", 1, von_mises);
  dataArray(out, "Float64", "stress", 6, stress);
  out << "</PointData>\n</Piece>\n</UnstructuredGrid>\n</VTKFile>\n";

  std::array<char, 32> number{};
  std::snprintf(number.data(), number.size(), "_%06zu.vtu", files_.size());
  files_.emplace_back(time, name_ + number.data());
  writeWhole(folder_ + "/" + files_.back().second, out.str());
  writeIndex();
}

}  // namespace bezier_fem
