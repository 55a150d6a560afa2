#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

namespace bezier_fem
{
/** How large the elements of a meshed surface shall be at a point; in between make_model grades the size. */
struct SizePoint
{
  Eigen::Vector3d position;  // m
  double size;               // m, above 0: what make_model's --cell-size is for the whole body
};

/**
 * Reads x,y,z,size with that header, at least one row.
 * @throws InputError with file, line and value
 */
std::vector<SizePoint> readSizing(const std::string& path);

/** Writes what readSizing() reads, to the last bit. @throws InputError where the file cannot be written */
void writeSizing(const std::string& path, const std::vector<SizePoint>& points);

}  // namespace bezier_fem
