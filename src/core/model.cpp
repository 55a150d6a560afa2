#include "bezier_fem/model.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cassert>
#include <map>
#include <numeric>
#include <unordered_map>

#include "element_order.h"
#include "kernels.h"

namespace bezier_fem
{
namespace
{
std::uint64_t pairKey(int a, int b)
{
  return static_cast<std::uint64_t>(std::min(a, b)) << 32 | static_cast<std::uint32_t>(std::max(a, b));
}

/** Whether what an element adds to its node k is stored by the one across its face (kernels::Pairing). */
bool storedAcross(const Model& model, int t, int k)
{
  return model.block_pairing[t / LANES] == kernels::SECOND && kernels::ACROSS[k] >= 0;
}

/** Numbers corners and edges. */
void numberNodes(const TetMesh& mesh, const std::vector<ElementOrder::Tet>& order, Model& model)
{
  std::unordered_map<std::uint64_t, int> node_of_edge;
  model.node_of_corner.assign(mesh.corners.cols(), -1);
  model.tets.reserve(order.size() * model.nodes_per_tet);
  for (const ElementOrder::Tet& tet : order)
  {
    for (const int corner : tet.corners)
    {
      if (model.node_of_corner[corner] < 0)
      {
        model.node_of_corner[corner] = static_cast<int>(model.ends.size());
        model.ends.push_back({corner, corner});
      }
      model.tets.push_back(model.node_of_corner[corner]);
    }
    if (!model.quadratic()) continue;
    for (const auto& edge : EDGE_CORNERS)
    {
      const int a = tet.corners[edge[0]], b = tet.corners[edge[1]];
      const auto [entry, is_new] = node_of_edge.try_emplace(pairKey(a, b), static_cast<int>(model.ends.size()));
      if (is_new) model.ends.push_back({std::min(a, b), std::max(a, b)});
      model.tets.push_back(entry->second);
    }
  }
  model.num_nodes = static_cast<int>(model.ends.size());

  // Near their elements in the order of those, so that whoever works on a part of the elements finds much of what their
  // nodes need in his core's cache; and of neighbours those with many shares first: what is done for several nodes at
  // a time takes as long as for the one with the most.
  constexpr int NEIGHBOURS = 64;
  std::vector<int> elements(model.num_nodes, 0), shares(elements), old(model.num_nodes), place(model.num_nodes);
  std::vector<double> middle(model.num_nodes, 0);
  for (std::size_t k = 0; k < model.tets.size(); ++k)
  {
    ++elements[model.tets[k]];
    middle[model.tets[k]] += static_cast<double>(k);
    const int t = static_cast<int>(k) / model.nodes_per_tet, own = static_cast<int>(k) % model.nodes_per_tet;
    if (!storedAcross(model, t, own)) ++shares[model.tets[k]];
  }
  for (int i = 0; i < model.num_nodes; ++i) middle[i] /= elements[i];
  std::iota(old.begin(), old.end(), 0);
  std::stable_sort(old.begin(), old.end(), [&](int a, int b) { return middle[a] < middle[b]; });
  for (auto begin = old.begin(); begin != old.end();)
  {
    const auto end = begin + std::min<std::ptrdiff_t>(NEIGHBOURS, old.end() - begin);
    std::stable_sort(begin, end, [&](int a, int b) { return shares[a] > shares[b]; });
    begin = end;
  }
  std::vector<std::array<int, 2>> ends;
  for (const int i : old)
  {
    place[i] = static_cast<int>(ends.size());
    ends.push_back(model.ends[i]);
  }
  model.ends = std::move(ends);
  for (int& node : model.tets) node = place[node];
  for (int& node : model.node_of_corner) node = node < 0 ? node : place[node];
}

/** Ids of the mesh's corners and of midEdges(). */
void assignIds(const TetMesh& mesh, Model& model)
{
  std::unordered_map<std::uint64_t, std::int64_t> id_of_edge;
  if (model.quadratic())
  {
    for (const MidEdgeNode& mid : midEdges(mesh)) id_of_edge[pairKey(mid.corner_a, mid.corner_b)] = mid.id;
  }
  for (const auto& [a, b] : model.ends)
  {
    model.ids.push_back(a == b ? mesh.corner_ids[a] : id_of_edge.at(pairKey(a, b)));
  }
}

void findBoundary(Model& model)
{
  struct Entry
  {
    std::array<int, 3> key;
    Model::Face face;
  };
  std::vector<Entry> faces;
  faces.reserve(static_cast<std::size_t>(model.num_tets) * CORNERS);
  for (int t = 0; t < model.num_tets; ++t)
  {
    for (int a = 0; a < CORNERS; ++a)
    {
      std::array<int, 3> key{};
      for (int k = 0; k < 3; ++k) key[k] = model.nodesOf(t)[FACE_CORNERS[a][k]];
      std::sort(key.begin(), key.end());
      faces.push_back({key, {t, a}});
    }
  }
  std::stable_sort(faces.begin(), faces.end(), [](const Entry& a, const Entry& b) { return a.key < b.key; });
  for (std::size_t i = 0; i < faces.size();)
  {
    std::size_t end = i + 1;
    while (end < faces.size() && faces[end].key == faces[i].key) ++end;
    if (end == i + 1) model.boundary.push_back(faces[i].face);
    i = end;
  }
  std::sort(model.boundary.begin(), model.boundary.end(), [](const Model::Face& a, const Model::Face& b) {
    return std::make_pair(a.tet, a.opposite) < std::make_pair(b.tet, b.opposite);
  });
}

/** Volumes and gradients of the barycentric coordinates: the rows of inv([v1-v0, v2-v0, v3-v0]). */
void computeGeometry(Model& model)
{
  model.volumes.resize(model.num_tets);
  model.gradients.resize(3, 3 * static_cast<Eigen::Index>(model.num_tets));
  for (int t = 0; t < model.num_tets; ++t)
  {
    const int* nodes = model.nodesOf(t);
    Eigen::Matrix3d edges;
    for (int k = 0; k < 3; ++k) edges.col(k) = model.rest[nodes[k + 1]] - model.rest[nodes[0]];
    model.volumes[t] = edges.determinant() / 6;
    assert(model.volumes[t] > 0);
    model.gradients.middleCols<3>(3 * static_cast<Eigen::Index>(t)) = edges.inverse().transpose();
  }
}

void fillBlocks(Model& model)
{
  const int n = model.nodes_per_tet;
  model.num_blocks = (model.num_tets + LANES - 1) / LANES;
  model.block_offsets.resize(static_cast<std::size_t>(model.num_blocks) * n * LANES);
  model.block_gradients.resize(static_cast<std::size_t>(model.num_blocks) * 9 * LANES);
  for (int slot = 0; slot < model.num_blocks * LANES; ++slot)
  {
    const int t = std::min(slot, model.num_tets - 1);
    const std::size_t block = slot / LANES, lane = slot % LANES;
    for (int k = 0; k < n; ++k) model.block_offsets[(block * n + k) * LANES + lane] = 4 * model.nodesOf(t)[k];
    for (int k = 0; k < 9; ++k)
    {
      model.block_gradients[(block * 9 + k) * LANES + lane] =
          model.gradients(k % 3, 3 * static_cast<Eigen::Index>(t) + k / 3);
    }
  }
}

void listShares(Model& model)
{
  constexpr int GROUP = kernels::NODE_GROUP;
  std::vector<std::vector<int>> of_node((static_cast<std::size_t>(model.num_nodes) + GROUP - 1) / GROUP * GROUP);
  for (int t = 0; t < model.num_tets; ++t)
  {
    for (int k = 0; k < model.nodes_per_tet; ++k)
    {
      if (storedAcross(model, t, k)) continue;
      const int row = kernels::ZERO_ROWS + t / LANES * model.nodes_per_tet + k;
      of_node[model.nodesOf(t)[k]].push_back(4 * (LANES * row + kernels::slotOf(t % LANES)));
    }
  }
  model.share_begin.push_back(0);
  for (std::size_t i = 0; i < of_node.size(); i += GROUP)
  {
    std::size_t most = 0;
    for (int k = 0; k < GROUP; ++k) most = std::max(most, of_node[i + k].size());
    for (std::size_t step = 0; step < most; ++step)
    {
      for (int k = 0; k < GROUP; ++k)
      {
        const std::vector<int>& slots = of_node[i + k];
        model.share_slots.push_back(step < slots.size() ? slots[step] : 0);
      }
    }
    model.share_begin.push_back(static_cast<int>(model.share_slots.size()) / GROUP);
  }
}
}  // namespace

std::vector<MidEdgeNode> midEdges(const TetMesh& mesh)
{
  if (!mesh.mid_edges.empty()) return mesh.mid_edges;
  // By the ids of their corners, the smaller one first.
  std::map<std::pair<std::int64_t, std::int64_t>, MidEdgeNode> edges;
  for (Eigen::Index t = 0; t < mesh.tets.cols(); ++t)
  {
    for (const auto& edge : EDGE_CORNERS)
    {
      const int a = mesh.tets(edge[0], t), b = mesh.tets(edge[1], t);
      edges[std::minmax(mesh.corner_ids[a], mesh.corner_ids[b])] = {std::min(a, b), std::max(a, b), 0};
    }
  }
  std::vector<MidEdgeNode> result;
  for (const auto& entry : edges)
  {
    result.push_back(entry.second);
    result.back().id = mesh.largest_id + static_cast<std::int64_t>(result.size());
  }
  return result;
}

double Model::mass() const
{
  return std::accumulate(node_mass.begin(), node_mass.end(), 0.0);
}

double Model::volume() const
{
  return std::accumulate(volumes.begin(), volumes.end(), 0.0);
}

std::array<int, 6> Model::nodesOf(const Face& face) const
{
  const int* nodes = nodesOf(face.tet);
  const auto& corners = FACE_CORNERS[face.opposite];
  std::array<int, 6> result{nodes[corners[0]], nodes[corners[1]], nodes[corners[2]], -1, -1, -1};
  if (quadratic())
  {
    result[3] = nodes[CONTROL_POINT[corners[0]][corners[1]]];
    result[4] = nodes[CONTROL_POINT[corners[0]][corners[2]]];
    result[5] = nodes[CONTROL_POINT[corners[1]][corners[2]]];
  }
  return result;
}

double Model::area(const Face& face) const
{
  const auto nodes = nodesOf(face);
  const Eigen::Vector3d a = rest[nodes[1]] - rest[nodes[0]], b = rest[nodes[2]] - rest[nodes[0]];
  return a.cross(b).norm() / 2;
}

void setMaterials(Model& model, const std::vector<Material>& materials)
{
  model.materials.resize(model.num_tets);
  for (std::size_t t = 0; t < materials.size(); ++t) model.materials[model.tet_of_mesh_tet[t]] = materials[t];

  model.block_coefficients.assign(static_cast<std::size_t>(model.num_blocks) * 3 * LANES, 0.0);
  model.block_mean.clear();
  model.node_mass.assign(model.num_nodes, 0.0);
  model.largest_mass = model.largest_stiffness = model.largest_condition = 0;
  for (int t = 0; t < model.num_tets; ++t)
  {
    const Material& m = model.materials[t];
    const double modulus = lameLambda(m) + 2 * lameMu(m), volume = model.volumes[t];
    const double slope2 =
        model.gradients.middleCols<3>(3 * static_cast<Eigen::Index>(t)).colwise().squaredNorm().maxCoeff();
    model.largest_mass = std::max(model.largest_mass, volume * m.density);
    model.largest_stiffness = std::max(model.largest_stiffness, volume * modulus * slope2);
    model.largest_condition = std::max(model.largest_condition, modulus / lameMu(m));
    double* c = model.block_coefficients.data() + static_cast<std::size_t>(t / LANES) * 3 * LANES + t % LANES;
    c[0] = model.volumes[t] * lameLambda(m);
    c[LANES] = model.volumes[t] * lameMu(m);
    c[2 * LANES] = model.volumes[t] * m.density;
    if (const double mean = meanLambda(model, t); mean > 0)
    {
      model.block_mean.resize(static_cast<std::size_t>(model.num_blocks) * LANES);
      model.block_mean[t] = model.volumes[t] * mean;
    }
    // Every basis function has the same integral: V/10, or V/4 for linear elements.
    for (int k = 0; k < model.nodes_per_tet; ++k)
    {
      model.node_mass[model.nodesOf(t)[k]] += model.volumes[t] * m.density / model.nodes_per_tet;
    }
  }
}

double meanLambda(const Model& model, int tet)
{
  const Material& m = model.materials[tet];
  if (!model.quadratic() || model.dilatation == Dilatation::FULL) return 0;
  if (model.dilatation == Dilatation::AUTO && m.poisson <= LOCKING_POISSON) return 0;
  constexpr double POISSON = 0.3;
  return m.poisson > POISSON ? lameLambda(m) - 2 * lameMu(m) * POISSON / (1 - 2 * POISSON) : 0;
}

Model buildModel(const TetMesh& mesh, Element element, const std::vector<Material>& materials, Dilatation dilatation)
{
  assert(static_cast<Eigen::Index>(materials.size()) == mesh.tets.cols());
  Model model;
  model.num_tets = static_cast<int>(mesh.tets.cols());
  model.num_corners = static_cast<int>(mesh.corners.cols());
  model.dilatation = dilatation;
  model.nodes_per_tet = element == Element::QUADRATIC ? QUADRATIC_NODES : CORNERS;

  ElementOrder order = orderElements(mesh);
  model.tet_of_mesh_tet.resize(order.tets.size());
  for (std::size_t k = 0; k < order.tets.size(); ++k) model.tet_of_mesh_tet[order.tets[k].tet] = static_cast<int>(k);

  model.block_pairing = std::move(order.pairing);

  numberNodes(mesh, order.tets, model);
  assignIds(mesh, model);
  model.rest = NodalField(model.num_nodes);
  for (int i = 0; i < model.num_nodes; ++i)
  {
    model.rest[i] = (mesh.corners.col(model.ends[i][0]) + mesh.corners.col(model.ends[i][1])) / 2;
  }
  findBoundary(model);
  computeGeometry(model);
  fillBlocks(model);
  listShares(model);
  setMaterials(model, materials);
  return model;
}

}  // namespace bezier_fem
