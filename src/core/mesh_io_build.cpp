#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>
#include <set>
#include <tuple>
#include <unordered_map>

#include "bezier_fem/error.h"
#include "mesh_io_detail.h"

namespace bezier_fem
{
namespace mesh_io
{
namespace
{
// A tetrahedron is taken as flat if 6 V <= this * (longest edge)^3. Far above the round-off of coordinates in double
// precision (1e-16), far below the worst slivers of mesh generators (1e-5) and anything that a stiffness matrix bears.
constexpr double FLAT = 1e-10;
// Nodes this close, relative to the diagonal of the bounding box, are at the same place: CAD kernels and mesh
// generators reproduce a point to about 1e-12.
constexpr double SAME_PLACE = 1e-9;
// A mid-edge node is off its place if it is by this part of its edge's length, and by more than the round-off of
// coordinates in single precision.
constexpr double CURVED = 1e-4;
constexpr double SINGLE_PRECISION = 1e-6;

/** The disjoint sets of 0 .. n - 1. */
class DisjointSets
{
public:
  explicit DisjointSets(int size) : parents_(static_cast<std::size_t>(size))
  {
    std::iota(parents_.begin(), parents_.end(), 0);
  }
  int find(int i)
  {
    while (parents_[i] != i)
    {
      parents_[i] = parents_[parents_[i]];
      i = parents_[i];
    }
    return i;
  }
  void unite(int a, int b)
  {
    a = find(a);
    b = find(b);
    parents_[std::max(a, b)] = std::min(a, b);  // the smallest member stands for the set
  }

private:
  std::vector<int> parents_;
};

struct Edge
{
  std::array<int, 2> corners;  // increasing
  int node;                    // index into RawMesh's nodes
  int tet;
};

struct Face
{
  std::array<int, 3> corners;  // increasing
  int opposite;                // the tetrahedron's fourth corner
  int tet;
  bool even;  // whether the increasing order is an even permutation of the one seen counter-clockwise from outside
};

/** Sorts edges or faces by their corners; by buckets of the first corner, for speed with millions of them. */
template <class T>
std::vector<T> sortedByCorners(const std::vector<T>& items, Eigen::Index corner_count)
{
  std::vector<std::size_t> starts(static_cast<std::size_t>(corner_count) + 1, 0);
  for (const T& item : items) ++starts[item.corners[0] + 1];
  std::partial_sum(starts.begin(), starts.end(), starts.begin());
  std::vector<T> result(items.size());
  std::vector<std::size_t> next(starts.begin(), starts.end() - 1);
  for (const T& item : items) result[next[item.corners[0]]++] = item;
  for (std::size_t i = 0; i + 1 < starts.size(); ++i)
  {
    std::sort(result.begin() + static_cast<std::ptrdiff_t>(starts[i]),
              result.begin() + static_cast<std::ptrdiff_t>(starts[i + 1]),
              [](const T& a, const T& b) { return std::tie(a.corners, a.tet) < std::tie(b.corners, b.tet); });
  }
  return result;
}

/** Calls f(begin, end) for every run of items with the same corners. */
template <class T, class F>
void forEachRun(const std::vector<T>& items, F f)
{
  for (std::size_t begin = 0; begin < items.size();)
  {
    std::size_t end = begin + 1;
    while (end < items.size() && items[end].corners == items[begin].corners) ++end;
    f(begin, end);
    begin = end;
  }
}

/** Gathers what a warning is about: names the first few, counts all. */
class List
{
public:
  template <class F>
  void add(F name)
  {
    if (++total_ <= LISTED) names_.push_back(name());
  }
  std::size_t total() const { return total_; }
  std::string str() const { return listed(names_, total_); }

private:
  std::vector<std::string> names_;
  std::size_t total_ = 0;
};

/** "1 edge", "2 edges" */
std::string counted(std::size_t count, const std::string& noun)
{
  return std::to_string(count) + " " + noun + (count == 1 ? "" : "s");
}

class Builder
{
public:
  explicit Builder(RawMesh& raw) : raw_(raw) {}

  TetMesh build()
  {
    warnOfIgnored();
    sortNodes();
    resolveNodes();
    makeCorners();
    makeTets();
    makeMidEdges();
    checkFaces();
    checkPieces();
    checkPlaces();
    makeGroups();
    return std::move(mesh_);
  }

private:
  int tetCount() const { return raw_.elementCount(); }
  int& elementNode(int tet, int i)
  {
    return element_nodes_[static_cast<std::size_t>(tet) * raw_.nodes_per_element + i];
  }

  std::string element(int tet) const { return raw_.element_noun + " " + std::to_string(raw_.element_ids[tet]); }
  std::string nodeId(int node) const { return std::to_string(raw_.node_ids[order_[node]]); }
  std::string cornerId(int corner) const { return std::to_string(mesh_.corner_ids[corner]); }
  [[noreturn]] void failAtElement(int tet, const std::string& message) const
  {
    raw_.element_source->fail(raw_.element_places[tet], message);
  }
  void warn(const std::string& message) { mesh_.warnings.push_back(raw_.element_source->path() + ": " + message); }

  void warnOfIgnored();
  void sortNodes();
  int findNode(std::int64_t id) const;
  void resolveNodes();
  void makeCorners();
  void makeTets();
  void makeMidEdges();
  void checkFaces();
  void checkPieces();
  void warnOfLooseJoints();
  void checkPlaces();
  void makeGroups();

  RawMesh& raw_;
  TetMesh mesh_;

  // "Node" below is a position in the order of increasing id.
  std::vector<int> order_;          // of a node: index into raw_
  std::vector<std::int64_t> ids_;   // of a node
  std::vector<int> nodes_by_id_;    // of an id less the smallest: node or -1; empty where the ids are too sparse
  std::vector<int> element_nodes_;  // raw_.elements as nodes
  std::vector<int> corners_;        // of a node: index into mesh_.corners or -1
  std::vector<int> pieces_;         // of a tetrahedron: the first one that hangs together with it by faces
};

void Builder::warnOfIgnored()
{
  List kinds;
  for (const auto& [kind, count] : raw_.ignored)
  {
    kinds.add([&, &k = kind, &n = count] { return std::to_string(n) + " of " + k; });
  }
  if (tetCount() == 0)
  {
    throw InputError(raw_.element_source->path() + ": there are no tetrahedra of 4 or 10 nodes" +
                     (kinds.total() > 0 ? ", only volume elements of other kinds: " + kinds.str() : ""));
  }
  if (kinds.total() > 0) warn("volume elements that are not tetrahedra of 4 or 10 nodes are left out: " + kinds.str());
}

void Builder::sortNodes()
{
  const std::vector<std::int64_t>& ids = raw_.node_ids;
  if (ids.size() >= std::numeric_limits<int>::max()) throw InputError(raw_.node_source->path() + ": too many nodes");
  order_.resize(ids.size());
  std::iota(order_.begin(), order_.end(), 0);
  const auto before = [&](int a, int b) { return std::tie(ids[a], a) < std::tie(ids[b], b); };
  if (!std::is_sorted(order_.begin(), order_.end(), before)) std::sort(order_.begin(), order_.end(), before);
  ids_.resize(ids.size());
  for (std::size_t i = 0; i < ids.size(); ++i) ids_[i] = ids[order_[i]];

  const auto twice = std::adjacent_find(ids_.begin(), ids_.end());
  if (twice != ids_.end())
  {
    const std::size_t second = order_[twice - ids_.begin() + 1];
    raw_.node_source->fail(raw_.node_places[second],
                           raw_.node_noun + " " + std::to_string(*twice) + " is given twice, first at " +
                               raw_.node_source->place(raw_.node_places[order_[twice - ids_.begin()]]));
  }
  if (ids_.empty()) return;
  mesh_.largest_id = ids_.back();
  const auto span = static_cast<std::uint64_t>(ids_.back() - ids_.front());
  if (span < 8 * ids_.size())
  {
    nodes_by_id_.assign(span + 1, -1);
    for (std::size_t i = 0; i < ids_.size(); ++i) nodes_by_id_[ids_[i] - ids_.front()] = static_cast<int>(i);
  }
}

int Builder::findNode(std::int64_t id) const
{
  if (ids_.empty() || id < ids_.front() || id > ids_.back()) return -1;
  if (!nodes_by_id_.empty()) return nodes_by_id_[id - ids_.front()];
  const auto found = std::lower_bound(ids_.begin(), ids_.end(), id);
  return found != ids_.end() && *found == id ? static_cast<int>(found - ids_.begin()) : -1;
}

void Builder::resolveNodes()
{
  const int width = raw_.nodes_per_element;
  element_nodes_.resize(raw_.elements.size());
  for (int t = 0; t < tetCount(); ++t)
  {
    for (int i = 0; i < width; ++i)
    {
      const std::int64_t id = raw_.elements[static_cast<std::size_t>(t) * width + i];
      const int node = findNode(id);
      if (node < 0)
      {
        failAtElement(t, element(t) + " names " + raw_.node_noun + " " + std::to_string(id) + ", which the file lacks" +
                             (ids_.empty() ? ""
                                           : "; its ids are from " + std::to_string(ids_.front()) + " to " +
                                                 std::to_string(ids_.back())));
      }
      for (int j = 0; j < i; ++j)
      {
        if (elementNode(t, j) == node)
        {
          failAtElement(t, element(t) + " names " + raw_.node_noun + " " + std::to_string(id) + " twice");
        }
      }
      elementNode(t, i) = node;
    }
  }
  raw_.elements = {};
}

void Builder::makeCorners()
{
  const std::size_t node_count = ids_.size();
  std::vector<int> corner_of(node_count, -1), middle_of(node_count, -1);  // an element, for the message
  for (int t = 0; t < tetCount(); ++t)
  {
    for (int i = 0; i < raw_.nodes_per_element; ++i) (i < 4 ? corner_of : middle_of)[elementNode(t, i)] = t;
  }
  corners_.assign(node_count, -1);
  int corner_count = 0;
  for (std::size_t n = 0; n < node_count; ++n)
  {
    if (corner_of[n] < 0) continue;
    if (middle_of[n] >= 0)
    {
      failAtElement(middle_of[n], raw_.node_noun + " " + nodeId(static_cast<int>(n)) + " is a corner of " +
                                      element(corner_of[n]) + " and in the middle of an edge of " +
                                      element(middle_of[n]));
    }
    corners_[n] = corner_count++;
  }
  mesh_.corners.resize(3, corner_count);
  mesh_.corner_ids.resize(static_cast<std::size_t>(corner_count));
  for (std::size_t n = 0; n < node_count; ++n)
  {
    if (corners_[n] < 0) continue;
    mesh_.corners.col(corners_[n]) = raw_.node_positions[order_[n]];
    mesh_.corner_ids[corners_[n]] = ids_[n];
  }
}

void Builder::makeTets()
{
  mesh_.tets.resize(4, tetCount());
  List flipped;
  for (int t = 0; t < tetCount(); ++t)
  {
    auto tet = mesh_.tets.col(t);
    Eigen::Matrix<double, 3, 4> x;
    for (int i = 0; i < 4; ++i)
    {
      tet[i] = corners_[elementNode(t, i)];
      x.col(i) = mesh_.corners.col(tet[i]);
    }
    double longest = 0;
    for (const auto& [a, b] : EDGE_CORNERS) longest = std::max(longest, (x.col(a) - x.col(b)).norm());
    const double volume_6 = (x.col(1) - x.col(0)).cross(x.col(2) - x.col(0)).dot(x.col(3) - x.col(0));
    if (!(std::abs(volume_6) > FLAT * longest * longest * longest))
    {
      failAtElement(t, element(t) + " has no volume: " + text(volume_6 / 6) + " with a longest edge of " +
                           text(longest) + ", at " + raw_.node_noun + "s " + cornerId(tet[0]) + ", " +
                           cornerId(tet[1]) + ", " + cornerId(tet[2]) + " and " + cornerId(tet[3]));
    }
    if (volume_6 < 0)
    {
      // element_nodes_ stays in the file's order, in which makeMidEdges() pairs the middles with their corners.
      std::swap(tet[2], tet[3]);
      ++mesh_.flipped;
      flipped.add([&] { return std::to_string(raw_.element_ids[t]); });
    }
  }
  if (mesh_.flipped > 0)
  {
    warn(std::to_string(mesh_.flipped) + " of " + std::to_string(tetCount()) +
         " elements were inverted and have been turned round: " + raw_.element_noun + " " + flipped.str());
  }
}

void Builder::makeMidEdges()
{
  if (raw_.nodes_per_element != 10) return;
  std::vector<Edge> edges;
  edges.reserve(static_cast<std::size_t>(tetCount()) * 6);
  for (int t = 0; t < tetCount(); ++t)
  {
    for (int e = 0; e < 6; ++e)
    {
      const int a = corners_[elementNode(t, EDGE_CORNERS[e][0])];
      const int b = corners_[elementNode(t, EDGE_CORNERS[e][1])];
      edges.push_back({{std::min(a, b), std::max(a, b)}, elementNode(t, 4 + e), t});
    }
  }
  edges = sortedByCorners(edges, mesh_.corners.cols());

  std::vector<int> edge_of(ids_.size(), -1);  // of a node: index into edges
  List curved;
  const auto endNames = [&](const Edge& edge) {
    return raw_.node_noun + "s " + cornerId(edge.corners[0]) + " and " + cornerId(edge.corners[1]);
  };
  forEachRun(edges, [&](std::size_t begin, std::size_t end) {
    const Edge& edge = edges[begin];
    for (std::size_t i = begin + 1; i < end; ++i)
    {
      if (edges[i].node == edge.node) continue;
      failAtElement(edges[i].tet, "the edge between " + endNames(edge) + " has " + raw_.node_noun + " " +
                                      nodeId(edge.node) + " in its middle in " + element(edge.tet) + " and " +
                                      nodeId(edges[i].node) + " in " + element(edges[i].tet));
    }
    if (edge_of[edge.node] >= 0)
    {
      failAtElement(edge.tet, raw_.node_noun + " " + nodeId(edge.node) + " is in the middle of two edges, between " +
                                  endNames(edges[edge_of[edge.node]]) + " and between " + endNames(edge));
    }
    edge_of[edge.node] = static_cast<int>(begin);
    mesh_.mid_edges.push_back({edge.corners[0], edge.corners[1], ids_[edge.node]});

    const Eigen::Vector3d a = mesh_.corners.col(edge.corners[0]), b = mesh_.corners.col(edge.corners[1]);
    const double distance = (raw_.node_positions[order_[edge.node]] - (a + b) / 2).norm();
    mesh_.largest_curvature = std::max(mesh_.largest_curvature, distance);
    const double largest_coordinate = std::max(a.cwiseAbs().maxCoeff(), b.cwiseAbs().maxCoeff());
    if (distance > CURVED * (b - a).norm() && distance > SINGLE_PRECISION * largest_coordinate)
    {
      curved.add([&] { return nodeId(edge.node); });
    }
  });
  if (curved.total() > 0)
  {
    warn(std::to_string(curved.total()) + " of " + std::to_string(mesh_.mid_edges.size()) +
         " edges are curved and have been taken as straight; their " + raw_.node_noun +
         "s are off the middle by up to " + text(mesh_.largest_curvature) + ": " + curved.str());
  }
}

void Builder::checkFaces()
{
  // The face opposite each corner, seen counter-clockwise from outside.
  constexpr int FACE_CORNERS[4][3] = {{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}};
  std::vector<Face> faces;
  faces.reserve(static_cast<std::size_t>(tetCount()) * 4);
  for (int t = 0; t < tetCount(); ++t)
  {
    for (int i = 0; i < 4; ++i)
    {
      std::array<int, 3> c;
      for (int k = 0; k < 3; ++k) c[k] = mesh_.tets(FACE_CORNERS[i][k], t);
      const bool even = ((c[0] < c[1]) + (c[1] < c[2]) + (c[0] < c[2])) % 2 == 1;
      std::sort(c.begin(), c.end());
      faces.push_back({c, mesh_.tets(i, t), t, even});
    }
  }
  faces = sortedByCorners(faces, mesh_.corners.cols());

  DisjointSets pieces(tetCount());
  List folded;
  forEachRun(faces, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin + 1; i < end; ++i)
    {
      pieces.unite(faces[begin].tet, faces[i].tet);
      for (std::size_t j = begin; j < i; ++j)
      {
        if (faces[j].opposite == faces[i].opposite)
        {
          failAtElement(faces[i].tet, element(faces[i].tet) + " has the same four corners as " + element(faces[j].tet));
        }
      }
    }
    if (end - begin > 2)
    {
      List tets;
      for (std::size_t i = begin; i < end; ++i)
      {
        tets.add([&] { return std::to_string(raw_.element_ids[faces[i].tet]); });
      }
      const std::array<int, 3>& c = faces[begin].corners;
      failAtElement(faces[begin + 2].tet, "the face with " + raw_.node_noun + "s " + cornerId(c[0]) + ", " +
                                              cornerId(c[1]) + " and " + cornerId(c[2]) + " belongs to " +
                                              std::to_string(end - begin) + " elements, " + raw_.element_noun + " " +
                                              tets.str() + "; at most two can share a face");
    }
    if (end - begin == 2 && faces[begin].even == faces[begin + 1].even)
    {
      folded.add([&] {
        return std::to_string(raw_.element_ids[faces[begin].tet]) + " with " +
               std::to_string(raw_.element_ids[faces[begin + 1].tet]);
      });
    }
  });
  if (folded.total() > 0)
  {
    warn(counted(folded.total(), "pair") +
         " of elements overlap, on the same side of the face they share: " + raw_.element_noun + " " + folded.str());
  }
  pieces_.resize(static_cast<std::size_t>(tetCount()));
  for (int t = 0; t < tetCount(); ++t) pieces_[t] = pieces.find(t);
}

void Builder::checkPieces()
{
  if (std::all_of(pieces_.begin(), pieces_.end(), [](int piece) { return piece == 0; })) return;

  DisjointSets touching(tetCount());  // of the pieces
  std::vector<int> piece_at(static_cast<std::size_t>(mesh_.corners.cols()), -1);
  for (int t = 0; t < tetCount(); ++t)
  {
    for (const int c : mesh_.tets.col(t))
    {
      if (piece_at[c] < 0) piece_at[c] = pieces_[t];
      touching.unite(piece_at[c], pieces_[t]);
    }
  }
  std::map<int, int> sizes;
  for (int t = 0; t < tetCount(); ++t) ++sizes[touching.find(pieces_[t])];
  if (sizes.size() > 1)
  {
    List list;
    for (const auto& piece : sizes)
    {
      list.add(
          [&] { return counted(static_cast<std::size_t>(piece.second), "element") + " with " + element(piece.first); });
    }
    warn("the mesh is in " + std::to_string(sizes.size()) + " pieces that do not touch: " + list.str());
  }
  warnOfLooseJoints();
}

void Builder::warnOfLooseJoints()
{
  constexpr int SEVERAL = -2;
  const auto add = [](int piece, int& at) {
    if (at < 0 && at != SEVERAL) at = piece;
    if (at != piece) at = SEVERAL;
  };
  std::vector<int> corner_pieces(static_cast<std::size_t>(mesh_.corners.cols()), -1);
  for (int t = 0; t < tetCount(); ++t)
  {
    for (const int c : mesh_.tets.col(t)) add(pieces_[t], corner_pieces[c]);
  }
  std::map<std::pair<int, int>, int> edge_pieces;  // only of the few edges between corners of several pieces
  for (int t = 0; t < tetCount(); ++t)
  {
    for (const auto& [i, j] : EDGE_CORNERS)
    {
      const std::pair<int, int> edge = std::minmax({mesh_.tets(i, t), mesh_.tets(j, t)});
      if (corner_pieces[edge.first] != SEVERAL || corner_pieces[edge.second] != SEVERAL) continue;
      add(pieces_[t], edge_pieces.try_emplace(edge, -1).first->second);
    }
  }
  List edges, vertices;
  for (const auto& [edge, piece] : edge_pieces)
  {
    if (piece != SEVERAL) continue;
    edges.add([&, &e = edge] { return cornerId(e.first) + " to " + cornerId(e.second); });
    corner_pieces[edge.first] = corner_pieces[edge.second] = -1;  // told
  }
  for (std::size_t c = 0; c < corner_pieces.size(); ++c)
  {
    if (corner_pieces[c] == SEVERAL) vertices.add([&] { return cornerId(static_cast<int>(c)); });
  }
  if (edges.total() > 0)
  {
    warn("pieces hang together only by " + counted(edges.total(), "edge") +
         ", about which they turn freely: " + raw_.node_noun + " " + edges.str());
  }
  if (vertices.total() > 0)
  {
    warn("pieces hang together only by " + counted(vertices.total(), "corner") +
         ", about which they turn freely: " + raw_.node_noun + " " + vertices.str());
  }
}

void Builder::checkPlaces()
{
  const Eigen::Matrix3Xd& x = mesh_.corners;
  const Eigen::Vector3d low = x.rowwise().minCoeff();
  const double tolerance = SAME_PLACE * (x.rowwise().maxCoeff() - low).norm();
  // A few tolerances: wide enough that most points are looked for in one or two cells, narrow enough that a cell has no
  // room for many points that are not at the same place.
  const double cell_size = 4 * tolerance;
  const auto cell = [&](double distance) { return static_cast<std::int64_t>(std::floor(distance / cell_size)); };
  const auto key = [](std::int64_t i, std::int64_t j, std::int64_t k) {  // cells that share a key do no harm
    return (static_cast<std::uint64_t>(i) * 0x9E3779B97F4A7C15u + static_cast<std::uint64_t>(j)) * 0xC2B2AE3D27D4EB4Fu +
           static_cast<std::uint64_t>(k);
  };

  std::unordered_multimap<std::uint64_t, int> seen;
  seen.reserve(static_cast<std::size_t>(x.cols()));
  List pairs;
  for (int c = 0; c < x.cols(); ++c)
  {
    const Eigen::Vector3d p = x.col(c) - low;
    int twin = -1;
    std::array<std::array<std::int64_t, 2>, 3> range;
    for (int axis = 0; axis < 3; ++axis) range[axis] = {cell(p[axis] - tolerance), cell(p[axis] + tolerance)};
    for (std::int64_t i = range[0][0]; i <= range[0][1]; ++i)
    {
      for (std::int64_t j = range[1][0]; j <= range[1][1]; ++j)
      {
        for (std::int64_t k = range[2][0]; k <= range[2][1]; ++k)
        {
          const auto [begin, end] = seen.equal_range(key(i, j, k));
          for (auto other = begin; other != end; ++other)
          {
            if ((x.col(other->second) - x.col(c)).norm() <= tolerance) twin = other->second;
          }
        }
      }
    }
    // Only the first node of a place is kept: a thousand nodes at one place are a thousand pairs, not a million.
    if (twin < 0)
    {
      seen.emplace(key(cell(p[0]), cell(p[1]), cell(p[2])), c);
    }
    else
    {
      pairs.add([&] { return cornerId(twin) + " and " + cornerId(c); });
    }
  }
  if (pairs.total() > 0)
  {
    warn(counted(pairs.total(), "duplicate " + raw_.node_noun) +
         ", at the same place as another but not connected to it: " + pairs.str());
  }
}

void Builder::makeGroups()
{
  std::set<std::string> numbers, names;  // that are not one group's alone
  for (auto& [key, raw_group] : raw_.groups)
  {
    const auto& [name, dimension] = key;
    MeshGroup group;
    group.name = name;
    for (const std::int64_t id : raw_group.nodes)
    {
      const int node = findNode(id);
      if (node < 0)
      {
        throw InputError(raw_.element_source->path() + ": an element of group " + quoted(name) + " names " +
                         raw_.node_noun + " " + std::to_string(id) + ", which the file lacks");
      }
      if (corners_[node] >= 0) group.corners.push_back(corners_[node]);
    }
    group.tets = std::move(raw_group.elements);
    for (const int t : group.tets)
    {
      for (const int c : mesh_.tets.col(t)) group.corners.push_back(c);
    }
    if (!mesh_.groups.empty() && mesh_.groups.back().name == name)  // of a lower dimension
    {
      // Who gives two things one name wants both. But surfaces, curves and so on are numbered apart.
      const bool number = name.find_first_not_of("-0123456789") == name.npos;
      (number ? numbers : names).insert(quoted(name));
      const std::vector<int>& lower = mesh_.groups.back().corners;
      if (!number) group.corners.insert(group.corners.end(), lower.begin(), lower.end());
      mesh_.groups.pop_back();
    }
    for (std::vector<int>* indices : {&group.corners, &group.tets})
    {
      std::sort(indices->begin(), indices->end());
      indices->erase(std::unique(indices->begin(), indices->end()), indices->end());
    }
    mesh_.groups.push_back(std::move(group));
  }
  const auto str = [](const std::set<std::string>& shared) {
    List list;
    for (const std::string& name : shared) list.add([&] { return name; });
    return list.str();
  };
  if (!numbers.empty())
  {
    warn("a number that groups of several dimensions have stands for the one of the highest dimension: " +
         str(numbers));
  }
  if (!names.empty()) warn("a name that groups of several dimensions have stands for all of them: " + str(names));
}

}  // namespace

TetMesh buildTetMesh(RawMesh& raw)
{
  return Builder(raw).build();
}

}  // namespace mesh_io
}  // namespace bezier_fem
