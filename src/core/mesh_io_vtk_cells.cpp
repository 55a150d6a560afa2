#include "mesh_io_detail.h"

namespace bezier_fem
{
namespace mesh_io
{
namespace
{
constexpr std::int64_t VTK_TETRA = 10;
constexpr std::int64_t VTK_QUADRATIC_TETRA = 24;

/** Voxels, hexahedra, prisms, pyramids, their relatives of higher order and polyhedra. */
bool isOtherVolume(std::int64_t type)
{
  return (type >= 11 && type <= 16) || (type >= 25 && type <= 27) || type == 29 || (type >= 31 && type <= 33) ||
         type == 37 || type == 42 || (type >= 71 && type <= 74) || (type >= 78 && type <= 81);
}

template <class From, class To>
To decodeAs(const char* bytes, bool swap)
{
  return static_cast<To>(fromBytes<From>(bytes, swap));
}

}  // namespace

template <class T>
T decode(const char* bytes, ScalarType type, bool swap)
{
  const bool is_signed = type.kind == ScalarType::Kind::SIGNED;
  if (type.kind == ScalarType::Kind::FLOAT)
  {
    return type.size == 4 ? decodeAs<float, T>(bytes, swap) : decodeAs<double, T>(bytes, swap);
  }
  switch (type.size)
  {
    case 1:
      return is_signed ? decodeAs<std::int8_t, T>(bytes, swap) : decodeAs<std::uint8_t, T>(bytes, swap);
    case 2:
      return is_signed ? decodeAs<std::int16_t, T>(bytes, swap) : decodeAs<std::uint16_t, T>(bytes, swap);
    case 4:
      return is_signed ? decodeAs<std::int32_t, T>(bytes, swap) : decodeAs<std::uint32_t, T>(bytes, swap);
    default:
      return is_signed ? decodeAs<std::int64_t, T>(bytes, swap) : decodeAs<std::uint64_t, T>(bytes, swap);
  }
}

template double decode<double>(const char*, ScalarType, bool);
template std::int64_t decode<std::int64_t>(const char*, ScalarType, bool);

void addVtkCells(const VtkCells& cells, std::int64_t first_point, std::int64_t point_count, std::int64_t first_cell,
                 RawMesh* raw)
{
  for (std::size_t i = 0; i < cells.types.size(); ++i)
  {
    const std::int64_t type = cells.types[i];
    if (isOtherVolume(type)) ++raw->ignored["VTK cell type " + std::to_string(type)];
    if (type != VTK_TETRA && type != VTK_QUADRATIC_TETRA) continue;

    const std::int64_t id = first_cell + static_cast<std::int64_t>(i);
    const std::int64_t expected = type == VTK_TETRA ? 4 : 10;
    const std::int64_t begin = cells.offsets[i], count = cells.offsets[i + 1] - begin;
    const auto fail = [&](const std::string& message) {
      raw->element_source->fail(cells.places[i], "cell " + std::to_string(id) + message);
    };
    if (count != expected)
    {
      fail(" of type " + std::to_string(type) + " has " + std::to_string(count) + " points; " +
           std::to_string(expected) + " are allowed");
    }
    std::int64_t nodes[10];  // VTK's order is ours
    for (std::int64_t k = 0; k < count; ++k)
    {
      const std::int64_t point = cells.connectivity[static_cast<std::size_t>(begin + k)];
      if (point < 0 || point >= point_count)
      {
        fail(" names point " + std::to_string(point) + "; 0 to " + std::to_string(point_count - 1) + " is allowed");
      }
      nodes[k] = first_point + point;
    }
    raw->addElement(id, nodes, static_cast<int>(count), cells.places[i]);
  }
}

}  // namespace mesh_io
}  // namespace bezier_fem
