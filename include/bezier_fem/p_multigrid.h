#pragma once

#include <array>
#include <limits>
#include <memory>
#include <vector>

#include "bezier_fem/preconditioner.h"

namespace bezier_fem
{
class TurnedInverse;

/**
 * Preconditions alpha M + beta K' by the linear elements below the quadratic ones (Weber et al. 2015, "Deformation
 * simulation using cubic finite elements and efficient p-multigrid methods"): a symmetric V-cycle of Chebyshev
 * smoothing with the 3x3 diagonal blocks and a correction from the linear elements on the same tetrahedra. These are a
 * subspace, by degree elevation: b_aa = v_a, b_ab = (v_a + v_b)/2. Where the mass is small beside the stiffness, the
 * smoothing has it lumped at the nodes. Of linear elements only the correction is left.
 *
 * The linear elements' system is factored now and then, and applied in frames that turn with the mean rotation of each
 * vertex's elements since. What the body has deformed since makes the iteration longer, and never the result wrong. A
 * large one's is not factored: a cycle over aggregates of vertices, made and turned like the factor, stands for it.
 */
class PMultigrid final : public Preconditioner
{
public:
  /** The linear elements' system is factored up to some thousands of vertices. */
  PMultigrid(const Model& model, const Partition& partition);
  PMultigrid(const Model& model, const Partition& partition, bool factored);
  ~PMultigrid() override;

  bool prepare(const Model& model, const Rotations& rotations, const HeldAxes& held, double alpha, double beta,
               const AlignedVector<double>& inverse) override;
  void forget() override;
  void took(int iterations) override;
  int patience() const override { return std::numeric_limits<int>::max(); }  // an old factor costs few iterations
  void apply(const NodalField& r, NodalField& z) override;
  bool hasProduct(double tolerance) const override;
  void product(const NodalField& u, NodalField& rounded, NodalField& out) override;
  bool improves() const override { return quadratic_ != nullptr; }
  int improve(const NodalField& r, double target, int max_iterations, NodalField& u) override;

private:
  class QuadraticLevel;

  void cycle();

  double cost_;                                  // of making the linear elements' inverse, in iterations
  std::vector<int> node_of_vertex_;              // of the linear elements, to the model's nodes
  std::vector<std::array<int, 2>> vertices_of_;  // the two vertices of each node; up to a whole group of nodes
  std::vector<int> edges_begin_, edges_;         // of each vertex: the nodes of its edges
  std::unique_ptr<Model> linear_;
  Rotations linear_rotations_;  // only their gradients are looked at
  std::unique_ptr<TurnedInverse> inverse_;
  HeldAxes held_vertices_;
  std::unique_ptr<QuadraticLevel> quadratic_;  // null for linear elements
  bool one_rotation_ = true;                   // an element; of several, there is only the mean in single precision
};

}  // namespace bezier_fem
