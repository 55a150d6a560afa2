#pragma once

#include <Eigen/Dense>
#include <cmath>
#include <stdexcept>

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

struct FieldErrors  // in the L2 norm, relative to that of the exact field
{
  double displacement, stress;
};

/** Solves the problem with u given on the whole boundary, and measures how far off the solution is. */
inline FieldErrors solveWaves(const Model& model, const Waves& waves = {})
{
  // Control points that interpolate the field at corners and middles of edges: the middle is (x_aa + 2 x_ab + x_bb)/4.
  Supports supports;
  supports.start = model.rest;
  for (int i = 0; i < model.num_nodes; ++i)
  {
    const auto [a, b] = model.ends[i];
    supports.start[i] += waves.displacement(model.rest[i]);
    if (a == b) continue;
    const Eigen::Vector3d ends = waves.displacement(model.rest[model.node_of_corner[a]]) +
                                 waves.displacement(model.rest[model.node_of_corner[b]]);
    supports.start[i] += waves.displacement(model.rest[i]) - ends / 2;
  }
  supports.held.assign(model.num_nodes, 0);
  supports.region.assign(model.num_nodes, {-1, -1, -1});
  supports.regions.resize(1);
  for (const Model::Face& face : model.boundary)
  {
    for (const int i : model.nodesOf(face))
    {
      if (i < 0 || supports.held[i]) continue;
      supports.held[i] = 7;
      supports.region[i] = {0, 0, 0};
      supports.regions[0].nodes.push_back(i);
    }
  }

  const std::vector<QuadraturePoint> rule = tetRule(5);
  NodalField force(model.num_nodes);
  for (int t = 0; t < model.num_tets; ++t)
  {
    for (const auto& [lambda, weight] : rule)
    {
      const MaterialPoint point{t, lambda};
      const Eigen::Vector3d X = position(model, model.rest, point);
      addForce(model, point, weight * model.volumes[t] * waves.bodyForce(X, model.materials[t]), force);
    }
  }

  StepSettings settings{};
  settings.time_step = 1;
  settings.elasticity = Elasticity::LINEAR;
  settings.gravity.setZero();
  settings.solver.tolerance = 1e-8;
  settings.solver.max_iterations = 1000;
  Workspace workspace(model, settings, 1);
  State state = startState(model, settings, supports, model.rest, Eigen::Vector3d::Zero(), workspace);
  if (!solveStatic(model, settings, supports, {}, force, state, workspace, {}).converged)
  {
    throw std::runtime_error("the made-up problem was not solved");
  }

  double error = 0, size = 0, stress_error = 0, stress_size = 0;
  for (int t = 0; t < model.num_tets; ++t)
  {
    for (const auto& [lambda, weight] : rule)
    {
      const MaterialPoint point{t, lambda};
      const Eigen::Vector3d X = position(model, model.rest, point);
      const Eigen::Vector3d u = waves.displacement(X), u_h = position(model, state.x, point) - X;
      const Eigen::Matrix3d s = waves.stress(X, model.materials[t]);
      const Stress v = stressAt(model, state.rotations, state.x, point);
      const Eigen::Matrix3d s_h =
          (Eigen::Matrix3d() << v[0], v[3], v[5], v[3], v[1], v[4], v[5], v[4], v[2]).finished();
      const double part = weight * model.volumes[t];
      error += part * (u_h - u).squaredNorm();
      size += part * u.squaredNorm();
      stress_error += part * (s_h - s).squaredNorm();
      stress_size += part * s.squaredNorm();
    }
  }
  return {std::sqrt(error / size), std::sqrt(stress_error / stress_size)};
}

}  // namespace bezier_fem::test
