#include "bezier_fem/assembled_matrix.h"

#include <algorithm>
#include <array>
#include <numeric>

#include "element_loop.h"
#include "kernels.h"
#include "parallel.h"

namespace bezier_fem
{
namespace
{
kernels::Elements elementsOf(const Model& model)
{
  return bezier_fem::elementsOf(model, 1);
}

int pairsOf(const Model& model)
{
  return model.nodes_per_tet * (model.nodes_per_tet + 1) / 2;
}

/** Calls loop(begin, end) of every thread's share of [0, count). */
template <class Loop>
void share(const Partition& partition, std::size_t count, const Loop& loop)
{
  const std::size_t pieces = partition.pieces();
  forEachPiece(partition,
               [&](int t) { loop(static_cast<int>(count * t / pieces), static_cast<int>(count * (t + 1) / pieces)); });
}

std::size_t blocksOf(const AssembledMatrix& matrix)
{
  return matrix.column().size();
}

kernels::BlockRows rowsOf(const AssembledMatrix& matrix)
{
  return {matrix.rowBegin().data(), matrix.column().data()};
}
}  // namespace

ElementMatrices::ElementMatrices(const Model& model)
    : nodes(model.nodes_per_tet),
      stride((9 * pairsOf(model) + LANES - 1) / LANES * LANES),
      blocks(static_cast<std::size_t>(model.num_blocks) * LANES * stride)
{
}

void rotatedGradientMatrices(const Model& model, const Partition& partition, const Rotations& rotations, double alpha,
                             double beta, ElementMatrices& out)
{
  forEachPiece(partition, [&](int t) {
    kernels::table().element_matrices(elementsOf(model), partition.blockBegin(t), partition.blockEnd(t),
                                      rotations.gradients.data(), alpha, beta, out.blocks.data());
  });
}

RestStiffness restStiffness(const Model& model)
{
  ElementMatrices matrices(model);
  rotatedGradientMatrices(model, Partition(model, 1), restRotations(model), 0, 1, matrices);
  const std::size_t numbers = 9 * static_cast<std::size_t>(pairsOf(model));
  RestStiffness stiffness(numbers * LANES * model.num_blocks);
  for (std::size_t element = 0; element < static_cast<std::size_t>(model.num_blocks) * LANES; ++element)
  {
    for (std::size_t k = 0; k < numbers; ++k)
    {
      stiffness[(element / LANES * numbers + k) * LANES + element % LANES] =
          matrices.blocks[element * matrices.stride + k];
    }
  }
  return stiffness;
}

void warpedMatrices(const Model& model, const Partition& partition, const RestStiffness& stiffness,
                    const Rotations& rotations, double alpha, double beta, ElementMatrices& out)
{
  forEachPiece(partition, [&](int t) {
    kernels::table().warped_matrices(elementsOf(model), partition.blockBegin(t), partition.blockEnd(t),
                                     stiffness.data(), rotations.matrices.data(), alpha, beta, out.blocks.data());
  });
}

AssembledMatrix::AssembledMatrix(const Model& model)
{
  const int n = model.nodes_per_tet;
  std::vector<int> tets_begin(model.num_nodes + 1, 0), tets_of_node(model.tets.size());
  for (const int node : model.tets) ++tets_begin[node + 1];
  std::partial_sum(tets_begin.begin(), tets_begin.end(), tets_begin.begin());
  std::vector<int> next(tets_begin.begin(), tets_begin.end() - 1);
  for (std::size_t k = 0; k < model.tets.size(); ++k) tets_of_node[next[model.tets[k]]++] = static_cast<int>(k) / n;

  row_begin_.push_back(0);
  std::vector<int> row;
  for (int i = 0; i < model.num_nodes; ++i)
  {
    row.clear();
    for (int k = tets_begin[i]; k < tets_begin[i + 1]; ++k)
    {
      const int* nodes = model.nodesOf(tets_of_node[k]);
      row.insert(row.end(), nodes, nodes + n);
    }
    std::sort(row.begin(), row.end());
    row.erase(std::unique(row.begin(), row.end()), row.end());
    column_.insert(column_.end(), row.begin(), row.end());
    row_begin_.push_back(static_cast<int>(column_.size()));
  }
  for (int i = 0; i < model.num_nodes; ++i) diagonal_.push_back(slot(i, i));
  blocks_.assign(9 * column_.size() + 1, 0.0);
}

AssembledMatrix::AssembledMatrix(std::vector<int> row_begin, std::vector<int> column)
    : row_begin_(std::move(row_begin)), column_(std::move(column)), blocks_(9 * column_.size() + 1, 0.0)
{
  for (int i = 0; i < rows(); ++i) diagonal_.push_back(slot(i, i));
}

int AssembledMatrix::slot(int i, int j) const
{
  const auto begin = column_.begin() + row_begin_[i], end = column_.begin() + row_begin_[i + 1];
  const auto found = std::lower_bound(begin, end, j);
  return found == end || *found != j ? -1 : static_cast<int>(found - column_.begin());
}

void AssembledMatrix::product(const Partition& partition, const NodalField& u, NodalField& out) const
{
  forEachPiece(partition, [&](int t) {
    kernels::table().block_product(rowsOf(*this), partition.nodeBegin(t), partition.nodeEnd(t), blocks_.data(),
                                   u.data(), out.data());
  });
}

void AssembledMatrix::diagonal(AlignedVector<double>& blocks) const
{
  for (int i = 0; i < rows(); ++i)
  {
    const double* from = blocks_.data() + 9 * static_cast<std::ptrdiff_t>(diagonal_[i]);
    double* to = blocks.data() + static_cast<std::ptrdiff_t>(kernels::DIAGONAL_STRIDE) * i;
    const std::array<int, 7> place{0, 4, 8, 0, 3, 6, 7};  // of a block by columns
    for (int k = 0; k < 7; ++k) to[k] = from[place[k]];
    to[3] = to[7] = 0;
  }
}

struct Assembler::Lists
{
  std::vector<int> slots;  // STORED_SLOTS: [element][pair][2], then marks

  // MESH_ORIENTED
  std::size_t num_targets = 0;
  std::vector<kernels::Contributions::Target> targets;
  std::vector<long> from;
};

Assembler::Assembler(const Model& model, const AssembledMatrix& pattern, Traversal traversal)
    : traversal_(traversal), lists_(std::make_unique<Lists>())
{
  if (traversal == Traversal::CONVENTIONAL) return;
  const int n = model.nodes_per_tet;
  std::vector<int>& slots = lists_->slots;
  slots.reserve(2 * static_cast<std::size_t>(pairsOf(model)) * model.num_tets);
  for (int t = 0; t < model.num_tets; ++t)
  {
    const int* nodes = model.nodesOf(t);
    for (int I = 0; I < n; ++I)
    {
      for (int J = I; J < n; ++J)
      {
        slots.push_back(pattern.slot(nodes[I], nodes[J]));
        slots.push_back(pattern.slot(nodes[J], nodes[I]));
      }
    }
  }
  if (traversal == Traversal::STORED_SLOTS)
  {
    slots.resize(slots.size() + 2 * kernels::READ_AHEAD);
    return;
  }

  // Contributions to the blocks of the upper triangle, those that lie the same way round first.
  struct Contribution
  {
    int slot, mirror;
    bool turned;
    long from;
  };
  const ElementMatrices layout(model);
  std::vector<Contribution> contributions;
  contributions.reserve(slots.size() / 2);
  std::size_t k = 0;
  for (int t = 0; t < model.num_tets; ++t)
  {
    for (int I = 0; I < n; ++I)
    {
      for (int J = I; J < n; ++J, k += 2)
      {
        const auto [slot, mirror] = std::minmax(slots[k], slots[k + 1]);
        contributions.push_back({slot, mirror, slots[k] > slots[k + 1], layout.at(t, I, J)});
      }
    }
  }
  std::stable_sort(contributions.begin(), contributions.end(), [](const Contribution& a, const Contribution& b) {
    return a.slot != b.slot ? a.slot < b.slot : a.turned < b.turned;
  });
  slots.clear();
  slots.shrink_to_fit();

  auto& targets = lists_->targets;
  auto& from = lists_->from;
  from.reserve(contributions.size());
  for (const Contribution& c : contributions)
  {
    const long here = static_cast<long>(from.size());
    if (targets.empty() || targets.back().slot != c.slot) targets.push_back({c.slot, c.mirror, here, here});
    from.push_back(c.from);
    if (!c.turned) targets.back().turned = here + 1;
  }
  const long end = static_cast<long>(from.size());
  lists_->num_targets = targets.size();
  targets.resize(targets.size() + 1 + kernels::READ_AHEAD, {0, 0, end, end});
  from.resize(from.size() + kernels::READ_AHEAD);
}

Assembler::~Assembler() = default;

void Assembler::assemble(const Model& model, const Partition& partition, const ElementMatrices& elements,
                         AssembledMatrix& out) const
{
  const double* matrices = elements.blocks.data();
  const kernels::Table& table = kernels::table();
  if (traversal_ == Traversal::MESH_ORIENTED)
  {
    const kernels::Contributions list{lists_->targets.data(), lists_->from.data()};
    share(partition, lists_->num_targets,
          [&](int begin, int end) { table.gather_blocks(list, begin, end, matrices, out.blocks().data()); });
    return;
  }
  std::fill(out.blocks().begin(), out.blocks().end(), 0.0);
  if (traversal_ == Traversal::CONVENTIONAL)
  {
    table.add_by_search(rowsOf(out), model.nodes_per_tet, model.num_tets, model.tets.data(), matrices,
                        out.blocks().data());
  }
  else
  {
    table.add_by_slots(model.nodes_per_tet, model.num_tets, lists_->slots.data(), matrices, out.blocks().data());
  }
}

struct FusedAssembler::Lists
{
  std::vector<kernels::MeshEntities::Vertex> vertices;
  std::vector<kernels::MeshEntities::Edge> edges;
  std::vector<kernels::MeshEntities::Face> faces;
  std::vector<kernels::MeshEntities::Tet> tets;
  std::vector<kernels::MeshEntities::Chunk> chunks;
  std::vector<int> uses;
  AlignedVector<double> corner_order;  // [block][4][LANES]
  AlignedVector<double> products;      // [element][PRODUCTS_STRIDE], and an element of zeros
};

FusedAssembler::FusedAssembler(const Model& model, const AssembledMatrix& pattern) : lists_(std::make_unique<Lists>())
{
  // Chunks whose blocks stay in the second-level cache while their vertices, edges, faces and tets are gone through.
  constexpr int CHUNK = 128;
  Lists& l = *lists_;
  const std::size_t elements = static_cast<std::size_t>(model.num_blocks) * LANES;
  l.corner_order.assign(elements * CORNERS, 0.0);

  std::vector<int> entity(blocksOf(pattern), -1);  // at the place of a block that only this entity has
  std::vector<std::vector<int>> vertex_uses, edge_uses;
  const auto endOfChunk = [&] {
    l.chunks.push_back({static_cast<int>(l.vertices.size()), static_cast<int>(l.edges.size()),
                        static_cast<int>(l.faces.size()), static_cast<int>(l.tets.size())});
  };
  const auto set = [&](int* pair, int i, int j) {
    pair[0] = pattern.slot(i, j);
    pair[1] = pattern.slot(j, i);
  };
  for (int t = 0; t < model.num_tets; ++t)
  {
    if (t % CHUNK == 0) endOfChunk();
    const int* nodes = model.nodesOf(t);
    std::array<int, CORNERS> corner{0, 1, 2, 3};
    std::sort(corner.begin(), corner.end(), [&](int a, int b) { return nodes[a] < nodes[b]; });
    for (int s = 0; s < CORNERS; ++s)
    {
      l.corner_order[(static_cast<std::size_t>(t) / LANES * CORNERS + s) * LANES + t % LANES] = corner[s];
    }
    const auto node = [&](int a, int b) { return nodes[CONTROL_POINT[corner[a]][corner[b]]]; };
    const auto use = [&](int local) { return 8 * t + local; };

    for (int a = 0; a < CORNERS; ++a)
    {
      const int slot = pattern.slot(node(a, a), node(a, a));
      if (entity[slot] < 0)
      {
        entity[slot] = static_cast<int>(l.vertices.size());
        l.vertices.push_back({slot, 0});
        vertex_uses.emplace_back();
      }
      vertex_uses[entity[slot]].push_back(use(a));
    }
    for (int e = 0; e < EDGES; ++e)
    {
      const auto [a, b] = EDGE_CORNERS[e];
      const int slot = pattern.slot(node(a, a), node(b, b));
      if (entity[slot] < 0)
      {
        entity[slot] = static_cast<int>(l.edges.size());
        kernels::MeshEntities::Edge edge{};
        set(edge.slots, node(a, a), node(b, b));
        if (model.quadratic())
        {
          set(edge.slots + 2, node(a, a), node(a, b));
          set(edge.slots + 4, node(a, b), node(b, b));
          edge.slots[6] = pattern.slot(node(a, b), node(a, b));
        }
        l.edges.push_back(edge);
        edge_uses.emplace_back();
      }
      edge_uses[entity[slot]].push_back(use(e));
    }
    if (!model.quadratic()) continue;
    for (int missing = 0; missing < CORNERS; ++missing)
    {
      const int a = missing == 0 ? 1 : 0, b = missing <= 1 ? 2 : 1, c = missing == 3 ? 2 : 3;
      const int slot = pattern.slot(node(a, a), node(b, c));
      if (entity[slot] < 0)
      {
        entity[slot] = static_cast<int>(l.faces.size());
        kernels::MeshEntities::Face face{};
        set(face.slots, node(a, a), node(b, c));
        set(face.slots + 2, node(b, b), node(a, c));
        set(face.slots + 4, node(a, b), node(c, c));
        set(face.slots + 6, node(a, b), node(a, c));
        set(face.slots + 8, node(a, b), node(b, c));
        set(face.slots + 10, node(a, c), node(b, c));
        face.uses[0] = use(missing);
        face.uses[1] = 8 * static_cast<int>(elements);
        l.faces.push_back(face);
      }
      else
      {
        l.faces[entity[slot]].uses[1] = use(missing);
      }
    }
    kernels::MeshEntities::Tet tet{};
    set(tet.slots, node(0, 1), node(2, 3));
    set(tet.slots + 2, node(0, 2), node(1, 3));
    set(tet.slots + 4, node(0, 3), node(1, 2));
    tet.element = t;
    l.tets.push_back(tet);
  }
  endOfChunk();

  const auto listUses = [&](auto& entities, const std::vector<std::vector<int>>& uses) {
    for (std::size_t k = 0; k < entities.size(); ++k)
    {
      entities[k].begin = static_cast<int>(l.uses.size());
      l.uses.insert(l.uses.end(), uses[k].begin(), uses[k].end());
    }
    entities.resize(entities.size() + kernels::READ_AHEAD);
    entities[uses.size()].begin = static_cast<int>(l.uses.size());
  };
  listUses(l.vertices, vertex_uses);
  listUses(l.edges, edge_uses);
  l.faces.resize(l.faces.size() + kernels::READ_AHEAD);
  l.tets.resize(l.tets.size() + kernels::READ_AHEAD);
}

FusedAssembler::~FusedAssembler() = default;

void FusedAssembler::assemble(const Model& model, const Partition& partition, const Rotations& rotations, double alpha,
                              double beta, AssembledMatrix& out)
{
  const Lists& l = *lists_;
  const bool mean = model.quadratic() && meanOf(model);
  const std::size_t elements = static_cast<std::size_t>(model.num_blocks) * LANES;
  lists_->products.resize((elements + 1) * kernels::PRODUCTS_STRIDE * (mean ? 2 : 1));
  std::fill(lists_->products.end() - kernels::PRODUCTS_STRIDE * (mean ? 2 : 1), lists_->products.end(), 0.0);
  double* products = lists_->products.data();
  forEachPiece(partition, [&](int t) {
    kernels::table().gradient_products(elementsOf(model), partition.blockBegin(t), partition.blockEnd(t),
                                       l.corner_order.data(), rotations.gradients.data(), alpha, beta, products);
  });
  const kernels::MeshEntities mesh{l.vertices.data(), l.edges.data(), l.faces.data(),
                                   l.tets.data(),     l.uses.data(),  l.chunks.data()};
  share(partition, l.chunks.size() - 1, [&](int begin, int end) {
    kernels::table().fuse_blocks(mesh, model.nodes_per_tet, mean, begin, end, products, out.blocks().data());
  });
}

}  // namespace bezier_fem
