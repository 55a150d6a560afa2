#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

namespace bezier_fem
{
/** A triangle mesh, as a file gives it or as the boundary of a tetrahedral mesh. */
struct SurfaceMesh
{
  Eigen::Matrix3Xd points;     // 3 x points, m (file units when read)
  Eigen::Matrix3Xi triangles;  // 3 x triangles, columns of point indices, counter-clockwise seen from outside
};

/**
 * Reads .off, .obj, .stl or .ply, text or binary (.off: text). Points at identical positions are merged, so that an
 * .stl is connected too; polygons are cut into triangles; what is in no triangle, and triangles with two corners at the
 * same position, are left out.
 * @throws InputError, naming the file and what is wrong with it.
 */
SurfaceMesh readSurfaceMesh(const std::string& path);

/**
 * Writes a binary .ply: points (as floats), their normals, triangles.
 * @param points, normals  3 x points; m, and unit vectors
 * @param triangles        3 x triangles, columns of point indices
 * @throws InputError if it can't be written whole
 */
void writePly(const std::string& path, const Eigen::Matrix3Xd& points, const Eigen::Matrix3Xd& normals,
              const Eigen::Matrix3Xi& triangles);

/** True if the file name's extension is one that readSurfaceMesh() reads. */
bool isSurfaceFile(const std::string& path);

}  // namespace bezier_fem
