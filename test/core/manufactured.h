#pragma once

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>
#include <vector>

#include "bezier_fem/embedding.h"
#include "bezier_fem/measures.h"
#include "bezier_fem/step.h"
#include "core/quadrature.h"

namespace bezier_fem::test
{
/**
 * A made-up displacement u_i = a_i sin(k_i . X + phi_i), its small-strain stress, and the body force that holds it in
 * equilibrium: a problem with a known smooth solution (the method of manufactured solutions, Roache 2002).
 */
struct Waves
{
  Eigen::Matrix3d k = (Eigen::Matrix3d() << 3.1, 1.2, -2.0, -1.7, 2.6, 1.5, 2.2, -1.1, 2.9).finished();  // rows, 1/m
  Eigen::Vector3d amplitude{1e-3, -0.8e-3, 1.2e-3};                                                      // m
  Eigen::Vector3d phase{0.3, 1.1, -0.6};

  Eigen::Vector3d displacement(const Eigen::Vector3d& X) const
  {
    return amplitude.array() * (k * X + phase).array().sin();
  }

  Eigen::Matrix3d stress(const Eigen::Vector3d& X, const Material& m) const
  {
    const Eigen::Vector3d slope = amplitude.array() * (k * X + phase).array().cos();
    const Eigen::Matrix3d gradient = slope.asDiagonal() * k;
    return lameLambda(m) * gradient.trace() * Eigen::Matrix3d::Identity() +
           lameMu(m) * (gradient + gradient.transpose());
  }

  /** -div stress = -(mu laplace u + (lambda + mu) grad div u), N/m^3; the second derivatives are -u_i k_ij k_il. */
  Eigen::Vector3d bodyForce(const Eigen::Vector3d& X, const Material& m) const
  {
    const Eigen::Vector3d u = displacement(X);
    const Eigen::Vector3d laplace = -u.cwiseProduct(k.rowwise().squaredNorm());
    const Eigen::Vector3d gradient_of_divergence = -k.transpose() * u.cwiseProduct(k.diagonal());
    return -(lameMu(m) * laplace + (lameLambda(m) + lameMu(m)) * gradient_of_divergence);
  }
};

/** Holds nodes where the field puts them: control points that interpolate it at corners and middles of edges. */
template <class Displacement>
Supports holdAt(const Model& model, const std::vector<int>& nodes, const Displacement& u)
{
  Supports supports;
  supports.start = model.rest;
  supports.held.assign(model.num_nodes, 0);
  supports.region.assign(model.num_nodes, {-1, -1, -1});
  supports.regions.resize(1);
  for (const int i : nodes)
  {
    if (supports.held[i]) continue;
    supports.held[i] = 7;
    supports.region[i] = {0, 0, 0};
    supports.regions[0].nodes.push_back(i);
    supports.start[i] += u(model.rest[i]);
    const auto [a, b] = model.ends[i];
    if (a == b) continue;
    // The middle is (x_aa + 2 x_ab + x_bb)/4.
    const Eigen::Vector3d ends = u(model.rest[model.node_of_corner[a]]) + u(model.rest[model.node_of_corner[b]]);
    supports.start[i] += u(model.rest[i]) - ends / 2;
  }
  return supports;
}

/** The static equilibrium at small strain. */
inline State solveSmallStrain(const Model& model, const Supports& supports, const NodalField& force)
{
  StepSettings settings{};
  settings.time_step = 1;
  settings.elasticity = Elasticity::LINEAR;
  settings.gravity.setZero();
  settings.solver.tolerance = 1e-8;
  settings.solver.max_iterations = 10000;
  Workspace workspace(model, settings, 1);
  State state = startState(model, settings, supports, model.rest, Eigen::Vector3d::Zero(), workspace);
  if (!solveStatic(model, settings, supports, {}, force, state, workspace, {}).converged)
  {
    throw std::runtime_error("the problem with a known solution was not solved");
  }
  return state;
}

struct FieldErrors  // in the L2 norm, relative to that of the exact field
{
  double displacement, stress;
  double shown_stress;  // of the nodes' mean stresses, linear in between: what a user sees
};

/** @param u, s  the exact displacement and stress, functions of the rest position */
template <class Displacement, class ExactStress>
FieldErrors fieldErrors(const Model& model, const State& state, const Displacement& u, const ExactStress& s)
{
  const auto toMatrix = [](const Stress& v) {
    return (Eigen::Matrix3d() << v[0], v[3], v[5], v[3], v[1], v[4], v[5], v[4], v[2]).finished();
  };
  const auto nodal = nodalStress(model, state.rotations, state.x);
  double error = 0, size = 0, stress_error = 0, shown_error = 0, stress_size = 0;
  const std::vector<QuadraturePoint> rule = tetRule(5);
  for (int t = 0; t < model.num_tets; ++t)
  {
    for (const auto& [lambda, weight] : rule)
    {
      const MaterialPoint point{t, lambda};
      const Eigen::Vector3d X = position(model, model.rest, point);
      const Eigen::Vector3d exact = u(X);
      const Eigen::Matrix3d stress = s(X);
      Stress shown = Stress::Zero();
      for (int c = 0; c < CORNERS; ++c) shown += lambda[c] * nodal.col(model.nodesOf(t)[c]);
      const double part = weight * model.volumes[t];
      error += part * (position(model, state.x, point) - X - exact).squaredNorm();
      size += part * exact.squaredNorm();
      stress_error += part * (toMatrix(stressAt(model, state.rotations, state.x, point)) - stress).squaredNorm();
      shown_error += part * (toMatrix(shown) - stress).squaredNorm();
      stress_size += part * stress.squaredNorm();
    }
  }
  return {std::sqrt(error / size), std::sqrt(stress_error / stress_size), std::sqrt(shown_error / stress_size)};
}

/** Solves the problem with u given on the whole boundary, and measures how far off the solution is. */
inline FieldErrors solveWaves(const Model& model, const Waves& waves = {})
{
  const auto u = [&](const Eigen::Vector3d& X) { return waves.displacement(X); };
  std::vector<int> boundary;
  for (const Model::Face& face : model.boundary)
  {
    for (const int i : model.nodesOf(face))
    {
      if (i >= 0) boundary.push_back(i);
    }
  }
  NodalField force(model.num_nodes);
  for (int t = 0; t < model.num_tets; ++t)
  {
    for (const auto& [lambda, weight] : tetRule(5))
    {
      const MaterialPoint point{t, lambda};
      const Eigen::Vector3d X = position(model, model.rest, point);
      addForce(model, point, weight * model.volumes[t] * waves.bodyForce(X, model.materials[t]), force);
    }
  }
  const State state = solveSmallStrain(model, holdAt(model, boundary, u), force);
  return fieldErrors(model, state, u, [&](const Eigen::Vector3d& X) { return waves.stress(X, model.materials[0]); });
}

/**
 * Displacement and stress about a point force in an infinite body (Kelvin 1848; Love 1927, article 130): no body force
 * elsewhere, for any Poisson's ratio up to one half.
 */
struct Kelvin
{
  Material material;
  Eigen::Vector3d at{0.4, 0.6, -0.35};   // m
  Eigen::Vector3d force{3e3, 2e3, 5e3};  // N

  Eigen::Vector3d displacement(const Eigen::Vector3d& X) const
  {
    const Eigen::Vector3d d = X - at;
    const double r = d.norm(), nu = material.poisson;
    return ((3 - 4 * nu) * force + d * d.dot(force) / (r * r)) / (16 * M_PI * lameMu(material) * (1 - nu) * r);
  }

  Eigen::Matrix3d stress(const Eigen::Vector3d& X) const
  {
    const Eigen::Vector3d d = X - at;
    const double r = d.norm(), along = d.dot(force), nu = material.poisson;
    const Eigen::Matrix3d mixed = force * d.transpose() + d * force.transpose() - along * Eigen::Matrix3d::Identity();
    return -(3 * along / (r * r) * d * d.transpose() + (1 - 2 * nu) * mixed) / (8 * M_PI * (1 - nu) * r * r * r);
  }
};

/** The part of that body in a box on the plane z = 0, its lower face led and tractions on the others. */
inline FieldErrors solveKelvin(const Model& model)
{
  const Kelvin kelvin{model.materials[0]};
  const auto u = [&](const Eigen::Vector3d& X) { return kelvin.displacement(X); };
  std::vector<int> lower;
  for (int i = 0; i < model.num_nodes; ++i)
  {
    if (model.rest[i].z() < 1e-9) lower.push_back(i);
  }
  // Seven points of a triangle, degree five (Radon 1948): its two orbits beside the centroid.
  const double root = std::sqrt(15.0);
  NodalField force(model.num_nodes);
  for (const Model::Face& face : model.boundary)
  {
    const auto& corners = FACE_CORNERS[face.opposite];
    std::array<Eigen::Vector3d, 3> v;
    for (int k = 0; k < 3; ++k) v[k] = model.rest[model.nodesOf(face.tet)[corners[k]]];
    if (std::max({v[0].z(), v[1].z(), v[2].z()}) < 1e-9) continue;
    const Eigen::Vector3d normal = (v[1] - v[0]).cross(v[2] - v[0]).normalized();
    const auto add = [&](const Eigen::Vector3d& lambda, double weight) {
      MaterialPoint point{face.tet, Eigen::Vector4d::Zero()};
      for (int k = 0; k < 3; ++k) point.lambda[corners[k]] = lambda[k];
      const Eigen::Vector3d X = position(model, model.rest, point);
      addForce(model, point, weight * model.area(face) * kelvin.stress(X) * normal, force);
    };
    add(Eigen::Vector3d::Constant(1.0 / 3), 9.0 / 40);
    for (const double sign : {-1.0, 1.0})
    {
      const double p = (6 + sign * root) / 21;
      for (int k = 0; k < 3; ++k)
      {
        Eigen::Vector3d lambda = Eigen::Vector3d::Constant(p);
        lambda[k] = 1 - 2 * p;
        add(lambda, (155 + sign * root) / 1200);
      }
    }
  }
  const State state = solveSmallStrain(model, holdAt(model, lower, u), force);
  return fieldErrors(model, state, u, [&](const Eigen::Vector3d& X) { return kelvin.stress(X); });
}

}  // namespace bezier_fem::test
