#include "bezier_fem/measures.h"

#include <Eigen/Dense>
#include <array>
#include <cmath>

#include "kernels.h"

namespace bezier_fem
{
namespace
{
using Strain = Eigen::Matrix3d;

/** Co-rotated strain of the gradient at corner c of an element, turned by its rotation `point`, world axes. */
Strain cornerStrain(const Model& model, const Rotations& rotations, const NodalField& x, int tet, int c, int point)
{
  const int* nodes = model.nodesOf(tet);
  const auto r = rotations.gradient(tet, point);
  const int origin = model.quadratic() ? CONTROL_POINT[c][0] : 0;
  const double factor = model.quadratic() ? 2 : 1;
  Eigen::Matrix3d gradient = Eigen::Matrix3d::Zero();
  for (int d = 1; d < CORNERS; ++d)
  {
    const int node = model.quadratic() ? CONTROL_POINT[c][d] : d;
    gradient += factor * (x[nodes[node]] - x[nodes[origin]]) * r.col(d).transpose();
  }
  return (gradient + gradient.transpose()) / 2 - Eigen::Matrix3d::Identity();
}

/**
 * Co-rotated strain at the four corners of an element, world axes; linear in between. Four rotations give it at their
 * points: it is the linear function through those.
 */
std::array<Strain, CORNERS> cornerStrains(const Model& model, const Rotations& rotations, const NodalField& x, int tet)
{
  std::array<Strain, CORNERS> strains;
  if (rotations.points == 1)
  {
    for (int c = 0; c < CORNERS; ++c) strains[c] = cornerStrain(model, rotations, x, tet, c, 0);
    return strains;
  }
  Strain sum = Strain::Zero();
  for (int q = 0; q < CORNERS; ++q)
  {
    strains[q].setZero();
    for (int c = 0; c < CORNERS; ++c)
    {
      strains[q] += (c == q ? kernels::NEAR : kernels::FAR) * cornerStrain(model, rotations, x, tet, c, q);
    }
    sum += strains[q];
  }
  for (Strain& strain : strains) strain = (strain - kernels::FAR * sum) / (kernels::NEAR - kernels::FAR);
  return strains;
}

/** The law of an element: part of lambda acts on the mean dilatation, which is that of the corners' mean strain. */
struct StressLaw
{
  StressLaw(const Model& model, int tet, const std::array<Strain, CORNERS>& corners)
      : mu(lameMu(model.materials[tet])),
        mean_lambda(meanLambda(model, tet)),
        lambda(lameLambda(model.materials[tet]) - mean_lambda)
  {
    for (const Strain& strain : corners) mean_dilatation += strain.trace() / CORNERS;
  }
  Eigen::Matrix3d operator()(const Strain& strain) const
  {
    return (lambda * strain.trace() + mean_lambda * mean_dilatation) * Eigen::Matrix3d::Identity() + 2 * mu * strain;
  }
  double mu, mean_lambda, lambda, mean_dilatation = 0;
};

Stress toVector(const Eigen::Matrix3d& s)
{
  return (Stress() << s(0, 0), s(1, 1), s(2, 2), s(0, 1), s(1, 2), s(0, 2)).finished();
}

MaterialPoint cornerOf(int tet, int c)
{
  return {tet, Eigen::Vector4d::Unit(c)};
}
}  // namespace

double vonMises(const Stress& s)
{
  const double a = s[0] - s[1], b = s[1] - s[2], c = s[2] - s[0];
  return std::sqrt((a * a + b * b + c * c) / 2 + 3 * s.tail<3>().squaredNorm());
}

Stress stressAt(const Model& model, const Rotations& rotations, const NodalField& x, const MaterialPoint& point)
{
  const std::array<Strain, CORNERS> corners = cornerStrains(model, rotations, x, point.tet);
  Strain strain = Strain::Zero();
  for (int c = 0; c < CORNERS; ++c) strain += point.lambda[c] * corners[c];
  return toVector(StressLaw(model, point.tet, corners)(strain));
}

Eigen::Matrix<double, 6, Eigen::Dynamic> nodalStress(const Model& model, const Rotations& rotations,
                                                     const NodalField& x)
{
  Eigen::Matrix<double, 6, Eigen::Dynamic> sum = Eigen::Matrix<double, 6, Eigen::Dynamic>::Zero(6, model.num_nodes);
  Eigen::VectorXd count = Eigen::VectorXd::Zero(model.num_nodes);
  for (int t = 0; t < model.num_tets; ++t)
  {
    const int* nodes = model.nodesOf(t);
    const std::array<Strain, CORNERS> strains = cornerStrains(model, rotations, x, t);
    const StressLaw stressOf(model, t, strains);
    std::array<Stress, CORNERS> corner;
    for (int c = 0; c < CORNERS; ++c)
    {
      corner[c] = toVector(stressOf(strains[c]));
      sum.col(nodes[c]) += corner[c];
    }
    for (int e = 0; model.quadratic() && e < EDGES; ++e)
    {
      sum.col(nodes[CORNERS + e]) += (corner[EDGE_CORNERS[e][0]] + corner[EDGE_CORNERS[e][1]]) / 2;
    }
    for (int k = 0; k < model.nodes_per_tet; ++k) count[nodes[k]] += 1;
  }
  return sum * count.cwiseInverse().asDiagonal();
}

Eigen::Vector3d nodePosition(const Model& model, const NodalField& x, int node)
{
  const auto [a, b] = model.ends[node];
  if (a == b) return x[node];
  return (x[model.node_of_corner[a]] + 2 * x[node] + x[model.node_of_corner[b]]) / 4;
}

double kineticEnergy(const Model& model, const NodalField& v)
{
  double energy = 0;
  for (int t = 0; t < model.num_tets; ++t)
  {
    const int* nodes = model.nodesOf(t);
    const double mass = model.volumes[t] * model.materials[t].density;
    if (!model.quadratic())
    {
      // integral of lambda_a lambda_b = V (1 + delta_ab)/20
      Eigen::Vector3d sum = Eigen::Vector3d::Zero();
      double squares = 0;
      for (int a = 0; a < CORNERS; ++a)
      {
        sum += v[nodes[a]];
        squares += v[nodes[a]].squaredNorm();
      }
      energy += mass / 40 * (sum.squaredNorm() + squares);
      continue;
    }
    // (M u)_ab = rho V/210 (S + t_a + t_b + u_ab), t_a = 2 u_aa + sum_{b != a} u_ab, S = sum_a t_a / 2
    std::array<Eigen::Vector3d, CORNERS> sums;
    Eigen::Vector3d half = Eigen::Vector3d::Zero();
    for (int a = 0; a < CORNERS; ++a)
    {
      sums[a] = v[nodes[a]];
      for (int b = 0; b < CORNERS; ++b) sums[a] += v[nodes[CONTROL_POINT[a][b]]];
      half += sums[a] / 2;
    }
    for (int a = 0; a < CORNERS; ++a)
    {
      for (int b = a; b < CORNERS; ++b)
      {
        const auto u = v[nodes[CONTROL_POINT[a][b]]];
        energy += mass / 420 * u.dot(half + sums[a] + sums[b] + u);
      }
    }
  }
  return energy;
}

double elasticEnergy(const Model& model, const Rotations& rotations, const NodalField& x)
{
  double energy = 0;
  for (int t = 0; t < model.num_tets; ++t)
  {
    // Strain and stress are linear in between the corners: integral of lambda_a lambda_b = V (1 + delta_ab)/20.
    const std::array<Strain, CORNERS> strains = cornerStrains(model, rotations, x, t);
    const StressLaw stressOf(model, t, strains);
    Strain strain_sum = Strain::Zero();
    Eigen::Matrix3d stress_sum = Eigen::Matrix3d::Zero();
    double squares = 0;
    for (const Strain& strain : strains)
    {
      const Eigen::Matrix3d stress = stressOf(strain);
      strain_sum += strain;
      stress_sum += stress;
      squares += strain.cwiseProduct(stress).sum();
    }
    energy += model.volumes[t] / 40 * (strain_sum.cwiseProduct(stress_sum).sum() + squares);
  }
  return energy;
}

double gravityEnergy(const Model& model, const Eigen::Vector3d& gravity, const NodalField& x)
{
  double energy = 0;
  for (int i = 0; i < model.num_nodes; ++i) energy -= model.node_mass[i] * gravity.dot(x[i]);
  return energy;
}

int invertedElements(const Model& model, const NodalField& x)
{
  int count = 0;
  for (int t = 0; t < model.num_tets; ++t)
  {
    for (int c = 0; c < CORNERS; ++c)
    {
      if (deformationGradient(model, x, cornerOf(t, c)).determinant() > 0) continue;
      ++count;
      break;
    }
  }
  return count;
}

double currentVolume(const Model& model, const NodalField& x)
{
  // F is linear in lambda, det F cubic. With det(sum_c lambda_c F_c) in Bernstein form, the integral is V/20 times the
  // sum of the twenty coefficients; the mixed ones are polarised determinants. Equal and shorter: the rule of degree 3
  // with five points (Keast 1986), weights -4/5 at the centroid and 9/20 at the points (1/2, 1/6, 1/6, 1/6).
  double volume = 0;
  for (int t = 0; t < model.num_tets; ++t)
  {
    const auto det = [&](const Eigen::Vector4d& lambda) {
      return deformationGradient(model, x, {t, lambda}).determinant();
    };
    double mean = -0.8 * det(Eigen::Vector4d::Constant(0.25));
    for (int c = 0; c < CORNERS; ++c)
    {
      mean += 0.45 * det(Eigen::Vector4d::Constant(1.0 / 6) + Eigen::Vector4d::Unit(c) / 3);
    }
    volume += model.volumes[t] * mean;
  }
  return volume;
}

}  // namespace bezier_fem
