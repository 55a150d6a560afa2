#include "bezier_fem/simulation.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <numeric>
#include <set>
#include <sstream>
#include <unordered_map>

#include "bezier_fem/error.h"
#include "bezier_fem/green_strain.h"
#include "bezier_fem/mesh_io.h"
#include "bezier_fem/meshed_surface.h"
#include "bezier_fem/refine.h"
#include "bezier_fem/sizing.h"
#include "bezier_fem/surface_mesh.h"
#include "forces.h"
#include "region.h"

namespace bezier_fem
{
namespace
{
/** From the model file's coordinates to the world's: world = R (scale file) + t. */
struct Placement
{
  double scale;
  Eigen::Isometry3d T_world_model;

  void apply(Eigen::Matrix3Xd& points) const
  {
    points = (T_world_model.linear() * (scale * points)).colwise() + T_world_model.translation();
  }
};

/** Of a refined mesh, far more than memory has room for: numbers of nodes and elements stay integers. */
constexpr double MOST_TETS = 2e7;

double longestSide(const Eigen::Matrix3Xd& points)
{
  return (points.rowwise().maxCoeff() - points.rowwise().minCoeff()).maxCoeff();
}

Eigen::Isometry3d poseOf(const Scene::Model& model)
{
  using Eigen::AngleAxisd;
  using Eigen::Vector3d;
  return Eigen::Translation3d(model.xyz) * AngleAxisd(model.rpy.z(), Vector3d::UnitZ()) *
         AngleAxisd(model.rpy.y(), Vector3d::UnitY()) * AngleAxisd(model.rpy.x(), Vector3d::UnitX());
}

/** Reads the tetrahedral mesh, or has the surface meshed, and puts it into the world frame. */
TetMesh loadMesh(const Scene::Model& model, const Simulation::Log& log, Placement& placement)
{
  placement.T_world_model = poseOf(model);
  TetMesh mesh;
  double scale_left = 1;
  if (isTetMeshFile(model.file))
  {
    mesh = readTetMesh(model.file);
    placement.scale = model.longest_side ? *model.longest_side / longestSide(mesh.corners) : model.scale;
    scale_left = placement.scale;
  }
  else
  {
    placement.scale = model.scale;
    if (model.longest_side) placement.scale = *model.longest_side / longestSide(readSurfaceMesh(model.file).points);
    std::vector<SizePoint> sizing;
    if (model.sizing) sizing = readSizing(*model.sizing);
    for (SizePoint& point : sizing) point.position = placement.T_world_model.inverse() * point.position;
    mesh = readTetMesh(meshedSurface(model.file, *model.cell_size, placement.scale, sizing, log));
  }
  for (const std::string& warning : mesh.warnings) log(warning);
  Placement{scale_left, placement.T_world_model}.apply(mesh.corners);
  const double tets = static_cast<double>(mesh.tets.cols()) * std::pow(8, model.refine);
  if (tets > MOST_TETS)
  {
    throw InputError("model.refine: is " + std::to_string(model.refine) + ", which makes " +
                     std::to_string(std::llround(tets)) + " tetrahedra of " + std::to_string(mesh.tets.cols()) +
                     ", must leave at most " + std::to_string(std::llround(MOST_TETS)));
  }
  return refined(std::move(mesh), model.refine);
}

/** The boundary of the mesh; each face of a quadratic element as four triangles over its corners and mid-edges. */
Surface boundarySurface(const Model& model)
{
  Surface surface;
  std::unordered_map<int, int> point_of_node;
  std::vector<Eigen::Vector3i> triangles;
  for (const Model::Face& face : model.boundary)
  {
    const auto nodes = model.nodesOf(face);
    const auto& c = FACE_CORNERS[face.opposite];
    const std::array<std::array<int, 2>, 6> ends{
        {{c[0], c[0]}, {c[1], c[1]}, {c[2], c[2]}, {c[0], c[1]}, {c[0], c[2]}, {c[1], c[2]}}};
    std::array<int, 6> points{};
    for (int k = 0; k < (model.quadratic() ? 6 : 3); ++k)
    {
      const auto [entry, is_new] = point_of_node.try_emplace(nodes[k], static_cast<int>(surface.points.size()));
      points[k] = entry->second;
      if (!is_new) continue;
      const Eigen::Vector4d lambda = (Eigen::Vector4d::Unit(ends[k][0]) + Eigen::Vector4d::Unit(ends[k][1])) / 2;
      surface.points.push_back({face.tet, lambda});
    }
    if (!model.quadratic())
    {
      triangles.emplace_back(points[0], points[1], points[2]);
      continue;
    }
    triangles.emplace_back(points[0], points[3], points[4]);
    triangles.emplace_back(points[3], points[1], points[5]);
    triangles.emplace_back(points[4], points[5], points[2]);
    triangles.emplace_back(points[3], points[5], points[4]);
  }
  surface.triangles.resize(3, static_cast<Eigen::Index>(triangles.size()));
  for (std::size_t k = 0; k < triangles.size(); ++k) surface.triangles.col(static_cast<Eigen::Index>(k)) = triangles[k];
  return surface;
}

Surface fineSurface(const std::string& file, const Placement& placement, const Model& model,
                    const PointLocator& locator, const Simulation::Log& log)
{
  SurfaceMesh mesh = readSurfaceMesh(file);
  placement.apply(mesh.points);
  Surface surface;
  surface.triangles = mesh.triangles;
  surface.points.reserve(mesh.points.cols());
  double farthest = 0;
  for (Eigen::Index i = 0; i < mesh.points.cols(); ++i)
  {
    double distance;
    surface.points.push_back(locator.locate(mesh.points.col(i), &distance));
    farthest = std::max(farthest, distance);
  }
  const double size = longestSide(model.rest.matrix().topRows<3>());
  if (farthest > 0.1 * size)
  {
    log(file + ": a point of the surface lies " + std::to_string(farthest) + " m outside the body, which is " +
        std::to_string(size) + " m long; is it the same shape, scale and pose?");
  }
  return surface;
}

Eigen::Matrix3Xd restNormals(const Model& model, const Surface& surface)
{
  const auto count = static_cast<Eigen::Index>(surface.points.size());
  Eigen::Matrix3Xd points(3, count), normals = Eigen::Matrix3Xd::Zero(3, count);
  for (Eigen::Index i = 0; i < count; ++i) points.col(i) = position(model, model.rest, surface.points[i]);
  for (Eigen::Index k = 0; k < surface.triangles.cols(); ++k)
  {
    const Eigen::Vector3i t = surface.triangles.col(k);
    const Eigen::Vector3d a = points.col(t[1]) - points.col(t[0]), b = points.col(t[2]) - points.col(t[0]);
    for (const int i : t) normals.col(i) += a.cross(b);
  }
  for (Eigen::Index i = 0; i < count; ++i)
  {
    const double length = normals.col(i).norm();
    normals.col(i) = length > 0 ? Eigen::Vector3d(normals.col(i) / length) : Eigen::Vector3d::UnitZ();
  }
  return normals;
}

Supports buildSupports(const Scene& scene, const Model& model, const RegionSelector& selector)
{
  Supports supports;
  supports.held.assign(model.num_nodes, 0);
  supports.region.assign(model.num_nodes, {-1, -1, -1});
  for (const Scene::Fixed& fixed : scene.fixed)
  {
    HeldRegion region;
    region.name = fixed.name;
    region.axes = fixed.axes;
    if (fixed.motion) region.motion = readMotion(*fixed.motion);
    region.frame = fixed.frame.value_or("");
    const std::vector<bool> inside = selector.corners(fixed.region, fixed.key);
    const int index = static_cast<int>(supports.regions.size());
    for (int i = 0; i < model.num_nodes; ++i)
    {
      const auto [a, b] = model.ends[i];
      if (!inside[a] || !inside[b]) continue;
      region.nodes.push_back(i);
      for (int axis = 0; axis < 3; ++axis)
      {
        if (!fixed.axes[axis]) continue;
        supports.region[i][axis] = index;
        supports.held[i] |= static_cast<std::uint8_t>(1 << axis);
      }
    }
    supports.regions.push_back(std::move(region));
  }
  return supports;
}

/** Control points of the initial state: rest, or the positions of a file, mid-edge points halfway if not listed. */
NodalField initialPositions(const Scene& scene, const Model& model, const TetMesh& mesh)
{
  if (!scene.initial.positions) return model.rest;
  const std::string& file = *scene.initial.positions;
  const std::map<std::int64_t, Eigen::Vector3d> listed = readPositions(file);
  std::set<std::int64_t> known(model.ids.begin(), model.ids.end());
  for (const MidEdgeNode& mid : midEdges(mesh)) known.insert(mid.id);
  for (const auto& [id, p] : listed)
  {
    if (!known.count(id)) throw InputError(file + ": no tetrahedron of the mesh has a node " + std::to_string(id));
  }
  NodalField x = model.rest;
  // Of the corners of a refined mesh those first that others sit halfway between. A chain is as long as the levels.
  const std::function<Eigen::Vector3d(int)> cornerAt = [&](int c) -> Eigen::Vector3d {
    const auto found = listed.find(mesh.corner_ids[c]);
    if (found != listed.end()) return found->second;
    if (mesh.parents.empty() || mesh.parents[c][0] == mesh.parents[c][1]) return mesh.corners.col(c);
    return (cornerAt(mesh.parents[c][0]) + cornerAt(mesh.parents[c][1])) / 2;
  };
  for (std::size_t c = 0; c < mesh.corner_ids.size(); ++c) x[model.node_of_corner[c]] = cornerAt(static_cast<int>(c));
  for (int i = 0; i < model.num_nodes; ++i)
  {
    if (model.ends[i][0] == model.ends[i][1]) continue;
    const Eigen::Vector3d middle =
        (x[model.node_of_corner[model.ends[i][0]]] + x[model.node_of_corner[model.ends[i][1]]]) / 2;
    const auto found = listed.find(model.ids[i]);
    // m = (a + 2 x + b)/4
    x[i] = found == listed.end() ? middle : Eigen::Vector3d(2 * found->second - middle);
  }
  return x;
}

AppliedLoad buildLoad(const Scene::Load& load, const Model& model, const RegionSelector& selector)
{
  AppliedLoad result;
  result.from = load.from;
  result.until = load.until;
  if (load.force && load.region.nodes)
  {
    // On material points: weights 1 at a corner; 1/4, 1/2, 1/4 (linear elements 1/2, 1/2) at the middle of an edge.
    std::map<std::pair<int, int>, int> node_of_edge;
    for (int i = 0; i < model.num_nodes; ++i) node_of_edge[{model.ends[i][0], model.ends[i][1]}] = i;
    const Eigen::Vector3d share = *load.force / static_cast<double>(load.region.nodes->size());
    for (const std::int64_t id : *load.region.nodes)
    {
      const auto [a, b] =
          std::minmax(selector.ends(id, load.key + ".nodes").first, selector.ends(id, load.key + ".nodes").second);
      if (a == b)
      {
        result.nodal.emplace_back(model.node_of_corner[a], share);
        continue;
      }
      const double end_weight = model.quadratic() ? 0.25 : 0.5;
      result.nodal.emplace_back(model.node_of_corner[a], end_weight * share);
      result.nodal.emplace_back(model.node_of_corner[b], end_weight * share);
      if (model.quadratic()) result.nodal.emplace_back(node_of_edge.at({a, b}), 0.5 * share);
    }
    return result;
  }

  const std::vector<bool> inside = selector.corners(load.region, load.key);
  double area = 0;
  for (const Model::Face& face : model.boundary)
  {
    bool all = true;
    for (int k = 0; k < 3; ++k) all = all && inside[model.ends[model.nodesOf(face)[k]][0]];
    if (!all) continue;
    result.faces.push_back(face);
    area += model.area(face);
  }
  if (result.faces.empty()) throw InputError(load.key + ": no boundary face has its three corners in this region");
  if (load.pressure)
  {
    result.pressure = *load.pressure;
    return result;
  }
  const Eigen::Vector3d traction = load.force ? Eigen::Vector3d(*load.force / area) : *load.traction;
  std::map<int, Eigen::Vector3d> nodal;
  const int count = model.quadratic() ? 6 : 3;
  for (const Model::Face& face : result.faces)
  {
    // Every basis function has the same integral over a face: A/6, or A/3 for linear elements.
    for (int k = 0; k < count; ++k)
    {
      nodal.try_emplace(model.nodesOf(face)[k], Eigen::Vector3d::Zero()).first->second +=
          traction * model.area(face) / count;
    }
  }
  result.nodal.assign(nodal.begin(), nodal.end());
  result.faces.clear();
  return result;
}

/** Throws for a piece of the body that its supports let move without deforming. */
void checkHeld(const Model& model, const Supports& supports)
{
  std::vector<int> piece(model.num_nodes);
  std::iota(piece.begin(), piece.end(), 0);
  const auto root = [&](int i) {
    while (piece[i] != i) i = piece[i] = piece[piece[i]];
    return i;
  };
  for (int t = 0; t < model.num_tets; ++t)
  {
    for (int k = 1; k < model.nodes_per_tet; ++k) piece[root(model.nodesOf(t)[k])] = root(model.nodesOf(t)[0]);
  }
  const double size = longestSide(model.rest.matrix().topRows<3>());
  std::map<int, Eigen::Matrix<double, 6, 6>> normal;  // sum of the squares of what held components do to rigid motions
  std::map<int, Eigen::Vector3d> somewhere;
  for (int i = 0; i < model.num_nodes; ++i)
  {
    auto& sum = normal.try_emplace(root(i), Eigen::Matrix<double, 6, 6>::Zero()).first->second;
    const Eigen::Vector3d p = model.rest[i];
    const Eigen::Vector3d origin = somewhere.try_emplace(root(i), p).first->second;
    for (int axis = 0; axis < 3; ++axis)
    {
      if (!(supports.held[i] >> axis & 1)) continue;
      Eigen::Matrix<double, 6, 1> row;
      row << Eigen::Vector3d::Unit(axis), ((p - origin) / size).cross(Eigen::Vector3d::Unit(axis));
      sum += row * row.transpose();
    }
  }
  int loose = 0;
  std::string first;
  for (const auto& [r, sum] : normal)
  {
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, 6, 6>> eigen(sum);
    const int free =
        static_cast<int>((eigen.eigenvalues().array() <= 1e-9 * std::max(1.0, eigen.eigenvalues()[5])).count());
    if (free == 0) continue;
    ++loose;
    if (!first.empty()) continue;
    const Eigen::Vector3d p = model.rest[r];
    first = "the piece with node " + std::to_string(model.ids[r]) + " at (" + std::to_string(p.x()) + ", " +
            std::to_string(p.y()) + ", " + std::to_string(p.z()) + ") can move in " + std::to_string(free) +
            " of 6 rigid ways";
  }
  if (loose == 0) return;
  throw InputError("fixed: a static run needs every piece of the body held: " + first +
                   (loose > 1 ? ", and so can " + std::to_string(loose - 1) + " more" : ""));
}

StepSettings settingsOf(const Scene& scene)
{
  return {scene.time_step, scene.elasticity, scene.rotation, scene.damping, scene.gravity, scene.solver};
}
}  // namespace

Simulation::Simulation(Scene scene, int threads, const Log& log)
    : scene_(std::move(scene)), settings_(settingsOf(scene_))
{
  Placement placement{};
  const TetMesh mesh = loadMesh(scene_.model, log, placement);
  const RegionSelector selector(mesh);
  for (const Scene::MaterialOverride& region : scene_.material_regions)
  {
    override_tets_.push_back(selector.tets(region.region, region.key));
  }
  model_.num_tets = static_cast<int>(mesh.tets.cols());
  // Green's strain has one volumetric term only.
  const Dilatation dilatation = scene_.elasticity == Elasticity::GREEN ? Dilatation::FULL : scene_.dilatation;
  model_ = buildModel(mesh, scene_.element, materials(scene_.material), dilatation);
  supports_ = buildSupports(scene_, model_, selector);
  initial_ = initialPositions(scene_, model_, mesh);
  supports_.start = initial_;
  for (const Scene::Load& load : scene_.loads) loads_.push_back(buildLoad(load, model_, selector));
  external_forces_ = NodalField(model_.num_nodes);

  const PointLocator locator(model_);
  surface_ = scene_.surface_file ? fineSurface(*scene_.surface_file, placement, model_, locator, log)
                                 : boundarySurface(model_);
  surface_.rest_normals = restNormals(model_, surface_);
  for (const auto& [name, rest] : scene_.probes)
  {
    double distance;
    probes_.push_back(locator.locate(rest, &distance));
    const double size = std::cbrt(model_.volumes[probes_.back().tet]);
    if (distance > 2 * size)
    {
      throw InputError("probes." + name + ": the point lies " + std::to_string(distance) + " m outside the body");
    }
  }
  workspace_ = std::make_unique<Workspace>(model_, settings_, threads);
  rest_ = std::make_unique<RestWatch>(model_, settings_.solver.tolerance);
  reset();
  if (scene_.integrator == Integrator::EXPLICIT) checkExplicit();
}

void Simulation::checkExplicit() const
{
  const double longest = MAX_EXPLICIT_SUBSTEPS * stableStep(model_, settings_, state_, *workspace_);
  if (scene_.time_step <= longest) return;
  std::ostringstream message;
  message << "time_step: is " << scene_.time_step << " s, must be at most " << longest
          << " s for integrator: explicit, which takes up to " << MAX_EXPLICIT_SUBSTEPS << " stable sub-steps a step";
  throw InputError(message.str());
}

std::vector<Material> Simulation::materials(const Material& base) const
{
  std::vector<Material> result(model_.num_tets, base);
  for (std::size_t k = 0; k < override_tets_.size(); ++k)
  {
    const Scene::MaterialOverride& region = scene_.material_regions[k];
    for (const int t : override_tets_[k])
    {
      result[t].young = region.young.value_or(result[t].young);
      result[t].poisson = region.poisson.value_or(result[t].poisson);
      result[t].density = region.density.value_or(result[t].density);
    }
  }
  return result;
}

StepReport Simulation::step()
{
  StepReport report;
  if (rest_->asleep() && staysAsleep())
  {
    report.substeps = 0;
    report.asleep = true;
    report.inverted = inverted_;
    ++state_.steps;
    state_.time = settings_.time_step * static_cast<double>(state_.steps);
  }
  else
  {
    const auto integrate = scene_.integrator == Integrator::EXPLICIT ? explicitStep
                           : scene_.integrator == Integrator::SDIRK2 ? sdirk2Step
                           : scene_.integrator == Integrator::AUTO   ? automaticStep
                                                                     : implicitEulerStep;
    report = integrate(model_, settings_, supports_, loads_, external_forces_, state_, *workspace_);
    inverted_ = report.inverted;
    rest_->stepped(state_.v, workspace_->load, settings_.time_step, report.converged && report.finite);
    if (rest_->asleep()) state_.v.setZero();
  }
  for (HeldRegion& region : supports_.regions) region.begin = region.end;
  return report;
}

/** Whether nothing changes in the coming step that a sleeping body would answer to; wakes it otherwise. */
bool Simulation::staysAsleep()
{
  NodalField &load = workspace_->load, &place = workspace_->led;
  const double middle = state_.time + settings_.time_step / 2;  // loads that come and go do so between steps
  externalForce(model_, workspace_->partition, settings_, loads_, external_forces_, middle, state_.x, load);
  place.matrix() = state_.x.matrix();
  applySupports(supports_, state_.time + settings_.time_step, 1, place);
  if (!rest_->isOtherLoad(load) && !rest_->isOtherPlace(place, state_.x)) return true;
  rest_->wake();
  workspace_->history = 0;  // what the changes of speed were long ago is no start for the next one
  return false;
}

StepReport Simulation::solveStatic(const std::function<void(int, double)>& progress)
{
  checkHeld(model_, supports_);
  rest_->wake();
  return bezier_fem::solveStatic(model_, settings_, supports_, loads_, external_forces_, state_, *workspace_, progress);
}

void Simulation::reset()
{
  for (HeldRegion& region : supports_.regions) region.begin = region.end = Eigen::Isometry3d::Identity();
  state_ = startState(model_, settings_, supports_, initial_, scene_.initial.velocity, *workspace_);
  addSpin();
  rest_->wake();
  workspace_->balance.setZero();
}

void Simulation::addSpin()
{
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  for (int i = 0; i < model_.num_nodes; ++i) centre += model_.node_mass[i] * state_.x[i];
  centre /= model_.mass();
  for (int i = 0; i < model_.num_nodes; ++i)
  {
    const Eigen::Vector3d spin = scene_.initial.spin.cross(Eigen::Vector3d(state_.x[i] - centre));
    for (int axis = 0; axis < 3; ++axis)
    {
      if (!(supports_.held[i] >> axis & 1)) state_.v[i][axis] += spin[axis];
    }
  }
}

void Simulation::setMaterial(const Material& material)
{
  scene_.material = material;
  setMaterials(model_, materials(material));
  workspace_->forgetMaterials();
  rest_->wake();
}

void Simulation::evaluateSurface(Eigen::Matrix3Xd& positions, Eigen::Matrix3Xd* normals) const
{
  evaluate(model_, workspace_->partition, state_.x, surface_.points, surface_.rest_normals, positions, normals);
}

Eigen::Matrix<double, 6, Eigen::Dynamic> Simulation::nodalStress() const
{
  return scene_.elasticity == Elasticity::GREEN ? greenNodalStress(model_, state_.x)
                                                : bezier_fem::nodalStress(model_, state_.rotations, state_.x);
}

void Simulation::evaluateSurfaceStress(Eigen::VectorXd& von_mises) const
{
  evaluateStress(surface_.points, von_mises);
}

void Simulation::evaluateStress(const std::vector<MaterialPoint>& points, Eigen::VectorXd& von_mises) const
{
  const auto nodal = nodalStress();
  von_mises.resize(static_cast<Eigen::Index>(points.size()));
  for (std::size_t i = 0; i < points.size(); ++i)
  {
    // Averaged at the corners, then linear: smooth over the surface, where stressAt() jumps between elements.
    const MaterialPoint& point = points[i];
    Eigen::Vector4d lambda = point.lambda.cwiseMax(0.0);
    lambda /= lambda.sum();
    Stress stress = Stress::Zero();
    for (int c = 0; c < CORNERS; ++c) stress += lambda[c] * nodal.col(model_.nodesOf(point.tet)[c]);
    von_mises[static_cast<Eigen::Index>(i)] = vonMises(stress);
  }
}

std::vector<Eigen::Vector3d> Simulation::probes() const
{
  std::vector<Eigen::Vector3d> result;
  for (const MaterialPoint& point : probes_) result.push_back(position(model_, state_.x, point));
  return result;
}

Energies Simulation::energies() const
{
  const double elastic = scene_.elasticity == Elasticity::GREEN ? greenEnergy(model_, state_.x)
                                                                : elasticEnergy(model_, state_.rotations, state_.x);
  return {kineticEnergy(model_, state_.v), elastic, gravityEnergy(model_, settings_.gravity, state_.x)};
}

std::vector<Reaction> Simulation::reactions() const
{
  return bezier_fem::reactions(supports_, state_.x, workspace_->balance);
}

}  // namespace bezier_fem
