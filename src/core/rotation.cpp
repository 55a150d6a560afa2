#include "bezier_fem/rotation.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>

#include "kernels.h"
#include "parallel.h"

namespace bezier_fem
{
namespace
{
/**
 * s2 + s3 below which it counts as zero, relative to s1 + s2 or, for an element smaller than at rest, to the rest
 * shape's 1: the gradient of a body collapsed to a point is rounding noise.
 */
constexpr double SAME = 1e-6;
/** Below this margin an element's rotation may jump, so that its change says nothing about the length of the step. */
constexpr double UNIQUE_MARGIN = 0.1;

/** A slot is a lane of a row of LANES: element `slot` of one point each, or [block][point][lane] of several. */
std::size_t offset(int slot)
{
  return static_cast<std::size_t>(slot / LANES) * 9 * LANES + slot % LANES;
}

int slotOf(int tet, int points, int point)
{
  return (tet / LANES * points + point) * LANES + tet % LANES;
}

Eigen::Matrix3d loadMatrix(const AlignedVector<double>& blocks, int slot)
{
  Eigen::Matrix3d m;
  const double* p = blocks.data() + offset(slot);
  for (int k = 0; k < 9; ++k) m(k / 3, k % 3) = p[k * LANES];
  return m;
}

/** Columns g_1, g_2, g_3 of a slot. */
Eigen::Matrix3d loadGradients(const AlignedVector<double>& blocks, int slot)
{
  return loadMatrix(blocks, slot).transpose();
}

void storeMatrix(AlignedVector<double>& blocks, int slot, const Eigen::Matrix3d& m)
{
  double* p = blocks.data() + offset(slot);
  for (int k = 0; k < 9; ++k) p[k * LANES] = m(k / 3, k % 3);
}

/** Horn 1987: q^T N q = tr(R(q)^T F) for a unit quaternion q = (w, x, y, z). */
Eigen::Matrix4d quaternionForm(const Eigen::Matrix3d& F)
{
  Eigen::Matrix4d n;
  n << F.trace(), F(2, 1) - F(1, 2), F(0, 2) - F(2, 0), F(1, 0) - F(0, 1),   //
      0, F(0, 0) - F(1, 1) - F(2, 2), F(0, 1) + F(1, 0), F(0, 2) + F(2, 0),  //
      0, 0, F(1, 1) - F(0, 0) - F(2, 2), F(1, 2) + F(2, 1),                  //
      0, 0, 0, F(2, 2) - F(0, 0) - F(1, 1);
  return n.selfadjointView<Eigen::Upper>();
}

/** The gradient that a rotation is taken of. */
Eigen::Matrix3d gradientOf(const Model& model, const NodalField& x, const Eigen::Matrix3d& gradients, int tet,
                           RotationRule rule, int point)
{
  const int* nodes = model.nodesOf(tet);
  std::array<Eigen::Vector3d, CORNERS> y;  // F = sum_d y_d g_d^T
  for (int d = 0; d < CORNERS; ++d)
  {
    if (rule == RotationRule::FROM_CORNERS)
    {
      y[d] = x[nodes[d]];
      continue;
    }
    y[d].setZero();
    for (int c = 0; c < CORNERS; ++c)
    {
      const double lambda = rule == RotationRule::FROM_CENTROID ? 0.25 : c == point ? kernels::NEAR : kernels::FAR;
      y[d] += 2 * lambda * x[nodes[CONTROL_POINT[c][d]]];
    }
  }
  Eigen::Matrix3d edges;
  for (int k = 0; k < 3; ++k) edges.col(k) = y[k + 1] - y[0];
  return edges * gradients.transpose();
}

/** Makes the rotation of a slot anew, unless the kernel was certain of it. */
void settle(const Model& model, const NodalField& x, const Rotations& before, int slot, Rotations& after,
            AlignedVector<double>& turned)
{
  if (after.flags[slot] & kernels::UNIQUE) return;
  const int points = before.points;
  const int element = slot / LANES / points * LANES + slot % LANES, point = slot / LANES % points;
  const Eigen::Matrix3d gradients = loadGradients(model.block_gradients, element);
  const Eigen::Matrix3d last = loadMatrix(before.matrices, slot);
  double margin;
  const Eigen::Matrix3d R = polarRotation(
      gradientOf(model, x, gradients, std::min(element, model.num_tets - 1), before.rule, point), last, &margin);
  storeMatrix(after.matrices, slot, R);
  storeMatrix(after.gradients, slot, (R * gradients).transpose());
  turned[slot] = (R - last).squaredNorm();
  if (margin > UNIQUE_MARGIN) after.flags[slot] |= kernels::UNIQUE;
}
}  // namespace

Eigen::Matrix3d polarRotation(const Eigen::Matrix3d& F, const Eigen::Matrix3d& before, double* margin)
{
  const double size = F.cwiseAbs().maxCoeff();
  if (margin) *margin = 0;
  if (!(size > 1e-200) || !std::isfinite(size)) return before;
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix4d> eigen(quaternionForm(F / size));
  const Eigen::Vector4d& values = eigen.eigenvalues();                      // ascending: s1+s2+s3 last, then s1-s2-s3
  if (margin) *margin = (values[3] - values[2]) / (values[3] - values[0]);  // 2 (s2 + s3) over 2 (s1 + s2)

  Eigen::Vector4d q = eigen.eigenvectors().col(3);
  const double same = SAME * std::max(values[3] - values[0], 1 / size);
  if (values[3] - values[2] < same)
  {
    const Eigen::Quaterniond previous(before);
    const Eigen::Vector4d p(previous.w(), previous.x(), previous.y(), previous.z());
    Eigen::Vector4d projected = Eigen::Vector4d::Zero();
    for (int k = 0; k < 4; ++k)
    {
      if (values[3] - values[k] < same)
      {
        projected += eigen.eigenvectors().col(k) * eigen.eigenvectors().col(k).dot(p);
      }
    }
    // Orthogonal to all maxima: none is nearer than another.
    if (projected.norm() > 1e-3) q = projected;
  }
  return Eigen::Quaterniond(q[0], q[1], q[2], q[3]).normalized().toRotationMatrix();
}

Eigen::Matrix3d Rotations::matrix(int tet, int point) const
{
  return loadMatrix(matrices, slotOf(tet, points, point));
}

Eigen::Matrix<double, 3, 4> Rotations::gradient(int tet, int point) const
{
  Eigen::Matrix<double, 3, 4> r;
  r.rightCols<3>() = loadGradients(gradients, slotOf(tet, points, point));
  r.col(0) = -(r.col(1) + r.col(2) + r.col(3));
  return r;
}

int Rotations::inverted(int num_tets) const
{
  int count = 0;
  for (int first = 0; first < num_tets; first += LANES)
  {
    std::array<unsigned char, LANES> any{};
    for (int q = 0; q < points; ++q)
    {
      const unsigned char* own = flags.data() + slotOf(first, points, q);
      for (int lane = 0; lane < LANES; ++lane) any[lane] |= own[lane];
    }
    const int lanes = std::min(LANES, num_tets - first);
    for (int lane = 0; lane < lanes; ++lane) count += (any[lane] & kernels::INVERTED) / kernels::INVERTED;
  }
  return count;
}

Rotations restRotations(const Model& model, RotationRule rule)
{
  Rotations rotations;
  rotations.rule = model.quadratic() ? rule : RotationRule::FROM_CORNERS;
  rotations.points = rotations.rule == RotationRule::FOUR_POINTS ? 4 : 1;
  const int slots = model.num_blocks * rotations.points * LANES;
  rotations.matrices.assign(static_cast<std::size_t>(slots) * 9, 0.0);
  rotations.gradients.resize(rotations.matrices.size());
  rotations.flags.assign(slots, kernels::UNIQUE);
  for (int block_point = 0; block_point < model.num_blocks * rotations.points; ++block_point)
  {
    std::copy_n(model.block_gradients.data() + 9L * LANES * (block_point / rotations.points), 9 * LANES,
                rotations.gradients.data() + 9L * LANES * block_point);
  }
  for (int slot = 0; slot < slots; ++slot) storeMatrix(rotations.matrices, slot, Eigen::Matrix3d::Identity());
  return rotations;
}

Turn updateRotations(const Model& model, const Partition& partition, const NodalField& x, const Rotations& before,
                     Rotations& after, AlignedVector<double>& turned)
{
  after.rule = before.rule;
  after.points = before.points;
  const int points = before.points;
  const kernels::Elements elements{model.nodes_per_tet, points, model.block_offsets.data(), nullptr, nullptr, nullptr};
  const kernels::Gradient gradient = before.rule == RotationRule::FROM_CORNERS    ? kernels::Gradient::OF_CORNERS
                                     : before.rule == RotationRule::FROM_CENTROID ? kernels::Gradient::AT_CENTROID
                                                                                  : kernels::Gradient::AT_FOUR_POINTS;
  std::atomic<double> largest{0};
  forEachPiece(partition, [&](int thread) {
    const int begin = partition.blockBegin(thread), end = partition.blockEnd(thread);
    kernels::table().update_rotations(elements, gradient, begin, end, model.block_gradients.data(), x.data(),
                                      before.matrices.data(), after.matrices.data(), after.gradients.data(),
                                      turned.data(), after.flags.data());
    std::array<double, LANES> lanes{};
    for (int row = begin * points * LANES; row < end * points * LANES; row += LANES)
    {
      const unsigned char* now = after.flags.data() + row;
      if (std::any_of(now, now + LANES, [](unsigned char flags) { return !(flags & kernels::UNIQUE); }))
      {
        for (int lane = 0; lane < LANES; ++lane) settle(model, x, before, row + lane, after, turned);
      }
      const unsigned char* last = before.flags.data() + row;
      const double* angles = turned.data() + row;
      for (int lane = 0; lane < LANES; ++lane)  // the copies that fill the last block do no harm
      {
        const double angle = last[lane] & now[lane] & kernels::UNIQUE ? angles[lane] : 0.0;
        lanes[lane] = std::max(lanes[lane], angle);
      }
    }
    const double own = *std::max_element(lanes.begin(), lanes.end());
    double others = largest;
    while (own > others && !largest.compare_exchange_weak(others, own)) continue;
  });
  Turn turn;
  turn.inverted = after.inverted(model.num_tets);
  turn.angle = 2 * std::asin(std::min(1.0, std::sqrt(largest / 8)));
  return turn;
}

}  // namespace bezier_fem
