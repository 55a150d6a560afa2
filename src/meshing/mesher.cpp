// SPDX-License-Identifier: GPL-3.0-or-later
#include "mesher.h"

#include <CGAL/Mesh_complex_3_in_triangulation_3.h>
#include <CGAL/Mesh_criteria_3.h>
#include <CGAL/Mesh_triangulation_3.h>
#include <CGAL/Polygon_mesh_processing/detect_features.h>
#include <CGAL/Polyhedral_mesh_domain_with_features_3.h>
#include <CGAL/Random.h>
#include <CGAL/make_mesh_3.h>

#include <algorithm>
#include <climits>
#include <cmath>
#include <cstdint>
#include <limits>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "element_count.h"

namespace make_model
{
namespace
{
namespace PMP = CGAL::Polygon_mesh_processing;
using Domain = CGAL::Polyhedral_mesh_domain_with_features_3<Kernel, Surface>;
using Triangulation = CGAL::Mesh_triangulation_3<Domain>::type;
using Complex = CGAL::Mesh_complex_3_in_triangulation_3<Triangulation, Domain::Corner_index, Domain::Curve_index>;
using Criteria = CGAL::Mesh_criteria_3<Triangulation>;

// The surface is sampled finer than the volume: a coarse mesh of some thousand tetrahedra keeps limbs and curvature.
// Measured on the bear, bunny, armadillo and elephant of CGAL's examples at 1000 to 10000 tetrahedra.
constexpr double FACET_SIZE = 0.7;       // times the cell size: the largest circumradius of a boundary triangle
constexpr double FACET_ANGLE = 25;       // degrees, the smallest in a boundary triangle
constexpr double RADIUS_EDGE_RATIO = 2;  // circumradius / shortest edge of a tetrahedron
constexpr double GOOD_DIHEDRAL = 10;     // degrees: with that, no other mesh is looked for
constexpr double SHARP_EDGE = 60;        // degrees between the normals of the two triangles
constexpr int SHARP_WORTH = 2;           // sharp edges are kept if that at most doubles the number of elements ...
constexpr double SHARP_DIHEDRAL = 8;     // ... and leaves no smaller angle [degrees]
constexpr int SHARP_ALONE = 1000000;     // elements, where there is no mesh without them to compare with
constexpr double MOST_NODES = 10;        // times those expected (thin, curved solids took 3) ...
constexpr double FREE_NODES = 5000;      // ... and these, whatever is expected
constexpr double SPECK = 1e-4;           // times the cell size: refinement that comes to such edges has run away

/** Points of each shell, as far from one another as they go: every piece and limb gets some, however small. */
std::vector<Point> seeds(const Solid& solid, double spacing)
{
  constexpr std::size_t FEWEST = 8, MOST = 64;
  std::vector<Point> chosen;
  for (const auto& shell : solid.shells)
  {
    std::vector<double> distance(shell.size(), std::numeric_limits<double>::infinity());
    std::size_t next = 0;
    for (std::size_t count = 0; count < MOST; ++count)
    {
      if (count >= FEWEST && distance[next] < spacing * spacing) break;
      if (distance[next] == 0) break;
      const Point& p = solid.surface.point(shell[next]);
      chosen.push_back(p);
      for (std::size_t i = 0; i < shell.size(); ++i)
        distance[i] = std::min(distance[i], CGAL::squared_distance(p, solid.surface.point(shell[i])));
      next = static_cast<std::size_t>(std::max_element(distance.begin(), distance.end()) - distance.begin());
    }
  }
  return chosen;
}

Tets extract(const Complex& complex)
{
  Tets mesh;
  mesh.points.resize(3, static_cast<Eigen::Index>(complex.triangulation().number_of_vertices()));
  mesh.tets.resize(4, static_cast<Eigen::Index>(complex.number_of_cells_in_complex()));
  std::map<Triangulation::Vertex_handle, int> index;
  Eigen::Index t = 0;
  for (auto cell = complex.cells_in_complex_begin(); cell != complex.cells_in_complex_end(); ++cell, ++t)
    for (int i = 0; i < 4; ++i)
    {
      const auto vertex = cell->vertex(i);
      const auto [entry, is_new] = index.emplace(vertex, static_cast<int>(index.size()));
      mesh.tets(i, t) = entry->second;
      if (!is_new) continue;
      const auto& p = vertex->point();
      mesh.points.col(entry->second) << p.x(), p.y(), p.z();
      mesh.on_sharp.push_back(vertex->in_dimension() < 2);
    }
  mesh.points.conservativeResize(3, static_cast<Eigen::Index>(index.size()));
  return mesh;
}

struct Style
{
  bool keep_sharp;          // edges; else they are rounded off
  bool insist_on_manifold;  // boundary; else it is only checked. At sharp edges and corners insisting need not end
};
constexpr Style SHARP{true, false}, ROUNDED{false, true}, SHARP_AND_MANIFOLD{true, true};

/** A share of the cell size, as CGAL asks for it. */
struct SizeCriterion
{
  double share;
  ScaledField sizes;
  double operator()(const Point& p, int /*dimension*/, const Triangulation::Vertex::Index& /*index*/) const
  {
    return share * sizes(toEigen(p));
  }
};

/** No criterion to be met: notes whether refinement has come to edges of triangles shorter than `length`. */
class SpeckDetector : public Criteria::Facet_criteria::Abstract_criterion
{
public:
  SpeckDetector(double length, bool& found) : squared_length_(length * length), found_(&found) {}

protected:
  void do_accept(Criteria::Facet_criteria::Visitor& visitor) const override { visitor.visit(*this); }
  SpeckDetector* do_clone() const override { return new SpeckDetector(*this); }
  Is_bad do_is_bad(const Triangulation& /*triangulation*/, const Triangulation::Facet& facet) const override
  {
    for (int i = 1; i <= 3; ++i)
    {
      const auto a = facet.first->vertex((facet.second + i) % 4),
                 b = facet.first->vertex((facet.second + i % 3 + 1) % 4);
      const bool given = a->in_dimension() < 2 && b->in_dimension() < 2;  // on sharp edges
      if (!given && CGAL::squared_distance(a->point().point(), b->point().point()) < squared_length_) *found_ = true;
    }
    return {};
  }

private:
  double squared_length_;
  bool* found_;
};

/** Delaunay refinement of a solid and the removal of slivers. */
class Mesher
{
public:
  Mesher(const Solid& solid, const ScaledField& sizes, Style style, const Progress& progress)
      : solid_(solid),
        sizes_(sizes),
        cell_size_(sizes.factor * sizes.field.largest()),
        style_(style),
        progress_(progress),
        random_(0),
        domain_(solid.surface, &random_)
  {
    if (style.keep_sharp) domain_.detect_features(SHARP_EDGE);
  }

  struct Refined
  {
    Complex complex;
    Topology topology;
  };

  /**
   * Null where the boundary does not become that of a solid, or not with fewer than `most_nodes` or any sensible number
   * of them. Where pieces get lost or stick together, it is tried again from more points.
   */
  std::unique_ptr<Refined> refined(std::size_t most_nodes = SIZE_MAX)
  {
    most_nodes_ = std::min(most_nodes, sensibleNodes());
    std::unique_ptr<Refined> first;
    for (const double spacing : {2., 1., 0.5})
    {
      seed_spacing_ = spacing * cell_size_;
      auto result = refine();
      if (gave_up_) return nullptr;
      if (result && keepsPieces(result->topology)) return result;
      if (!first) first = std::move(result);
    }
    return first;
  }

  /** Whether refined() would have needed more nodes than it may have, or would never have ended. */
  bool gaveUp() const { return gave_up_; }

  bool keepsPieces(const Topology& topology) const
  {
    return topology.bodies == solid_.bodies && topology.shells == static_cast<int>(solid_.shells.size());
  }

  /** Takes what refined() gave. */
  std::optional<Model> withoutSlivers(std::unique_ptr<Refined> start)
  {
    namespace P = CGAL::parameters;
    // Perturbing moves boundary points too, and can tear a coarse boundary; then a milder or no treatment has to do.
    for (const double sliver : {SLIVER, SLIVER / 2, 0.})
    {
      if (!start) start = refine();
      progress_.show("removing slivers ...");
      if (sliver > 0) CGAL::perturb_mesh_3(start->complex, domain_, P::sliver_bound = sliver);
      CGAL::exude_mesh_3(start->complex, P::sliver_bound = SLIVER);
      Model model{extract(start->complex), {}, {}};
      model.topology = findTopology(model.mesh);
      model.quality = measureQuality(model.mesh);
      if (model.topology.non_manifold == 0 && model.topology.euler == start->topology.euler &&
          model.topology.bodies == start->topology.bodies)
        return model;
      start.reset();
    }
    return std::nullopt;
  }

private:
  std::unique_ptr<Refined> refine()
  {
    namespace P = CGAL::parameters;
    CGAL::get_default_random() = CGAL::Random(0);
    const auto size = [&](double share) { return SizeCriterion{share, sizes_}; };
    Criteria criteria(P::edge_size = size(1), P::facet_angle = FACET_ANGLE, P::facet_size = size(FACET_SIZE),
                      P::facet_distance = size(FACET_DISTANCE), P::cell_radius_edge_ratio = RADIUS_EDGE_RATIO,
                      P::cell_size = size(1));
    auto result = std::make_unique<Refined>();
    Complex& complex = result->complex;
    if (style_.keep_sharp)
      CGAL::Mesh_3::internal::init_c3t3_with_features(complex, domain_, criteria, false, most_nodes_);
    insertSeeds(complex);
    bool has_speck = false;
    criteria.add_facet_criterion(new SpeckDetector(SPECK * sizes_.factor * sizes_.field.smallest(), has_speck));
    gave_up_ = !finishes(complex, criteria, has_speck);
    if (gave_up_ || complex.number_of_cells_in_complex() == 0) return nullptr;
    result->topology = findTopology(extract(complex));
    return result->topology.non_manifold == 0 ? std::move(result) : nullptr;
  }

  /**
   * What CGAL::refine_mesh_3 does, but step by step: that one has no end at a corner where it makes ever smaller
   * triangles, until the point that should split one is rounded to a place where it does not. False where not finished.
   */
  bool finishes(Complex& complex, const Criteria& criteria, const bool& has_speck) const
  {
    using Boundary = CGAL::parameters::internal::Manifold_options;
    const Triangulation& triangulation = complex.triangulation();
    complex.clear_cells_and_facets_from_c3t3();
    CGAL::Mesh_3::Mesher_3<Complex, Criteria, Domain> mesher(
        complex, domain_, criteria, style_.insist_on_manifold ? Boundary::MANIFOLD : Boundary::NON_MANIFOLD,
        most_nodes_);
    mesher.initialize();
    std::size_t nodes = triangulation.number_of_vertices(), idle_steps = 0;
    for (std::size_t step = 0; step == 0 || !mesher.is_algorithm_done(); ++step)
    {
      if (step % 1000 == 0)
        progress_.show((style_.keep_sharp ? "meshing with sharp edges" : "meshing") + text(": %zu nodes", nodes));
      mesher.one_step();
      const std::size_t nodes_before = std::exchange(nodes, triangulation.number_of_vertices());
      idle_steps = nodes > nodes_before ? 0 : idle_steps + 1;
      if (has_speck || idle_steps > 1000 + nodes) return false;  // two idle steps in a row are rare
    }
    complex.clear_manifold_info();
    return nodes < most_nodes_;
  }

  /** A limit for refinement that runs away. */
  std::size_t sensibleNodes() const
  {
    // Thin solids are meshed as fine as they are thin.
    const double thickness = 2 * solid_.volume / solid_.area;
    const Amount expected = amountOf(solid_, {sizes_.field, sizes_.factor, thickness});
    return static_cast<std::size_t>(
        std::min(MOST_NODES * (expected.solid + expected.surface) + FREE_NODES, MOST_ELEMENTS));
  }

  void insertSeeds(Complex& complex) const
  {
    std::vector<Point> protected_points;
    for (const auto v : complex.triangulation().finite_vertex_handles()) protected_points.push_back(v->point().point());
    for (const Point& p : seeds(solid_, seed_spacing_))
    {
      const bool near_sharp = std::any_of(protected_points.begin(), protected_points.end(), [&](const Point& q) {
        return CGAL::squared_distance(p, q) < cell_size_ * cell_size_;
      });
      if (near_sharp) continue;
      const auto v = complex.triangulation().insert(Triangulation::Weighted_point(p));
      if (v == Triangulation::Vertex_handle()) continue;
      complex.set_dimension(v, 2);
      complex.set_index(v, domain_.index_from_surface_patch_index(1));
    }
  }

  const Solid& solid_;
  const ScaledField sizes_;
  const double cell_size_;  // the largest
  const Style style_;
  const Progress& progress_;
  std::size_t most_nodes_ = 0;
  double seed_spacing_ = 0;  // m
  bool gave_up_ = false;
  CGAL::Random random_;
  Domain domain_;
};

bool hasSharpEdges(Surface surface)
{
  auto sharp = get(CGAL::edge_is_feature, surface);
  PMP::detect_sharp_edges(surface, SHARP_EDGE, sharp);
  return std::any_of(surface.edges_begin(), surface.edges_end(), [&](Surface::Edge_index e) { return get(sharp, e); });
}

/** What a mesh with sharp edges must be better than: one without. */
struct Yardstick
{
  std::size_t most_elements = SIZE_MAX;
  int most_euler_off = INT_MAX;  // from the surface's, see Topology
};

int eulerOff(const Solid& solid, const Topology& topology)
{
  return std::abs(topology.euler - solid.euler);
}

/** Where an element stays flat, a slightly smaller cell size leads to another mesh; the best of three is taken. */
std::optional<Model> bestMesh(const Solid& solid, const SizingField& sizes, Style style, const Yardstick& limit,
                              const Progress& progress)
{
  std::optional<Model> best;
  std::pair<bool, double> best_score(false, -1);
  for (const double factor : {1., 0.97, 0.94})
  {
    Mesher mesher(solid, {sizes, factor}, style, progress);
    auto refined = mesher.refined(limit.most_elements / 2);  // with more nodes it has more elements
    if (mesher.gaveUp()) break;
    if (!refined || eulerOff(solid, refined->topology) > limit.most_euler_off) continue;
    if (refined->complex.number_of_cells_in_complex() > limit.most_elements) break;
    std::optional<Model> model = mesher.withoutSlivers(std::move(refined));
    if (!model) continue;
    const std::pair<bool, double> score(mesher.keepsPieces(model->topology), model->quality.smallest_dihedral);
    if (score > best_score) best = std::move(model);
    best_score = std::max(best_score, score);
    if (best_score.first && best_score.second >= GOOD_DIHEDRAL) break;
  }
  return best;
}
}  // namespace

std::optional<Model> bestMesh(const Solid& solid, const SizingField& sizes, const Progress& progress)
{
  std::optional<Model> model;
  if (hasSharpEdges(solid.surface))
  {
    Yardstick limit{SHARP_ALONE, INT_MAX};
    if (const auto rounded = Mesher(solid, {sizes}, ROUNDED, progress).refined())
      limit = {SHARP_WORTH * rounded->complex.number_of_cells_in_complex(), eulerOff(solid, rounded->topology)};
    model = bestMesh(solid, sizes, SHARP, limit, progress);
    if (model && (model->topology.bodies != solid.bodies || model->quality.smallest_dihedral < SHARP_DIHEDRAL))
      model.reset();
  }
  if (!model) model = bestMesh(solid, sizes, ROUNDED, {}, progress);
  if (!model)
    model = bestMesh(solid, sizes, SHARP_AND_MANIFOLD, {}, progress);  // thin wedges, however flat the elements
  return model;
}

}  // namespace make_model
