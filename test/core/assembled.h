#pragma once

#include <Eigen/Core>
#include <Eigen/SparseCore>
#include <algorithm>
#include <vector>

#include "bezier_fem/element_operator.h"

namespace bezier_fem::test
{
/**
 * alpha M + beta K' of a model as a matrix of 3 num_nodes rows, read off from the package's products and nothing else.
 * Nodes without a common neighbour share a product, because no row then sees more than one of them (Curtis, Powell,
 * Reid 1974).
 */
inline Eigen::SparseMatrix<double> assembled(const Model& model, const Rotations& rotations, double alpha, double beta)
{
  const int n = model.num_nodes;
  std::vector<std::vector<int>> neighbours(n);
  for (int t = 0; t < model.num_tets; ++t)
  {
    const int* nodes = model.nodesOf(t);
    for (int i = 0; i < model.nodes_per_tet; ++i)
    {
      neighbours[nodes[i]].insert(neighbours[nodes[i]].end(), nodes, nodes + model.nodes_per_tet);
    }
  }
  for (auto& list : neighbours)
  {
    std::sort(list.begin(), list.end());
    list.erase(std::unique(list.begin(), list.end()), list.end());
  }

  std::vector<std::vector<int>> groups;
  std::vector<int> group_of(n, -1), taken_by;  // taken_by[group]: the last node that may not join it
  for (int j = 0; j < n; ++j)
  {
    for (const int i : neighbours[j])
    {
      for (const int k : neighbours[i])
      {
        if (group_of[k] >= 0) taken_by[group_of[k]] = j;
      }
    }
    const auto open = std::find_if(taken_by.begin(), taken_by.end(), [&](int node) { return node != j; });
    group_of[j] = static_cast<int>(open - taken_by.begin());
    if (open == taken_by.end())
    {
      taken_by.push_back(-1);
      groups.emplace_back();
    }
    groups[group_of[j]].push_back(j);
  }

  const Partition partition(model, 1);
  NodalField unit(n), product(model.num_nodes);
  std::vector<Eigen::Triplet<double>> entries;
  for (const std::vector<int>& group : groups)
  {
    for (int axis = 0; axis < 3; ++axis)
    {
      unit.setZero();
      for (const int j : group) unit[j][axis] = 1;
      systemProduct(model, partition, rotations, alpha, beta, unit, product);
      for (const int j : group)
      {
        for (const int i : neighbours[j])
        {
          for (int row = 0; row < 3; ++row) entries.emplace_back(3 * i + row, 3 * j + axis, product[i][row]);
        }
      }
    }
  }
  Eigen::SparseMatrix<double> matrix(3L * n, 3L * n);
  matrix.setFromTriplets(entries.begin(), entries.end());
  return matrix;
}

/** Rows and columns `keep` of a symmetric matrix, in that order. */
inline Eigen::SparseMatrix<double> part(const Eigen::SparseMatrix<double>& matrix, const std::vector<int>& keep)
{
  Eigen::SparseMatrix<double> select(matrix.rows(), static_cast<Eigen::Index>(keep.size()));
  for (std::size_t k = 0; k < keep.size(); ++k) select.insert(keep[k], static_cast<Eigen::Index>(k)) = 1;
  return select.transpose() * matrix * select;
}

}  // namespace bezier_fem::test
