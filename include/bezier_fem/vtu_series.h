#pragma once

#include <string>
#include <vector>

#include "bezier_fem/model.h"
#include "bezier_fem/nodal_field.h"
#include "bezier_fem/rotation.h"

namespace bezier_fem
{
/**
 * A series of .vtu files and the .pvd that lists them with their times, for ParaView. Points are material points at
 * rest, elements are quadratic (VTK type 24) or linear (10) tetrahedra; point data: `node` (the file's id),
 * `displacement` (m), `velocity` (m/s), `von_mises` (Pa), `stress` (Pa; xx, yy, zz, xy, yz, xz).
 */
class VtuSeries
{
public:
  /**
   * Makes the folder where it is missing.
   * @throws InputError if the folder can't be written to
   */
  VtuSeries(const std::string& folder, const std::string& name);

  /**
   * Adds a file for one time, s.
   * @param nodal_stress  6 x nodes, Pa (measures.h)
   * @throws InputError if it can't be written whole
   */
  void write(const Model& model, const NodalField& x, const NodalField& v,
             const Eigen::Matrix<double, 6, Eigen::Dynamic>& nodal_stress, double time);

private:
  std::string folder_, name_;
  std::vector<std::pair<double, std::string>> files_;  // time, file name

  void writeIndex() const;
};

}  // namespace bezier_fem
