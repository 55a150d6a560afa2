#include "sparse_cholesky.h"

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>

#include "kernels.h"
#include "parallel.h"

namespace bezier_fem
{
namespace
{
using Panel = Eigen::Map<Eigen::MatrixXf, Eigen::Aligned64, Eigen::OuterStride<>>;

/** Four numbers of which the last is not looked at. */
using Node = float __attribute__((vector_size(16)));
using PackedNode = float __attribute__((vector_size(16), aligned(4)));

Node& nodeAt(float* nodes, std::ptrdiff_t i)
{
  return *reinterpret_cast<Node*>(nodes + 4 * i);
}
/** Among nodes of three numbers: its fourth is the next one's first. */
PackedNode& packedAt(float* nodes, std::ptrdiff_t i)
{
  return *reinterpret_cast<PackedNode*>(nodes + 3 * i);
}

/** Rows of a panel in memory: whole registers of any width. */
int stride(int rows)
{
  return (3 * rows + LANES - 1) / LANES * LANES;
}

/**
 * Nested dissection by planes (George 1973): two parts of a set of nodes first, then the nodes that part them. These
 * are as few as there can be for a plane: a least cover of the edges across it, from a largest matching (Koenig's
 * theorem).
 */
class Dissection
{
public:
  Dissection(const AssembledMatrix& pattern, const NodalField& positions)
      : pattern_(pattern),
        positions_(positions),
        side_(pattern.rows(), NONE),
        match_(pattern.rows()),
        seen_(pattern.rows())
  {
    std::vector<int> all(pattern.rows());
    std::iota(all.begin(), all.end(), 0);
    order_.reserve(all.size());
    dissect(std::move(all));
  }
  const std::vector<int>& order() const { return order_; }

private:
  static constexpr int NONE = -1;

  void dissect(std::vector<int> nodes)
  {
    constexpr std::size_t LEAF = 12;
    if (nodes.size() <= LEAF)
    {
      order_.insert(order_.end(), nodes.begin(), nodes.end());
      return;
    }
    std::array<std::vector<int>, 3> best;  // two parts and what parts them
    double least = std::numeric_limits<double>::infinity();
    for (int axis = 0; axis < 3; ++axis)
    {
      std::sort(nodes.begin(), nodes.end(),
                [&](int a, int b) { return std::pair(positions_[a][axis], a) < std::pair(positions_[b][axis], b); });
      for (const double share : {0.4, 0.45, 0.5, 0.55, 0.6})
      {
        std::array<std::vector<int>, 3> parts =
            part(nodes, static_cast<std::size_t>(share * static_cast<double>(nodes.size())));
        // Few nodes part well, and even parts do.
        const auto a = static_cast<double>(parts[0].size()), b = static_cast<double>(parts[1].size());
        const double uneven = (a - b) / (a + b),
                     cost = static_cast<double>(parts[2].size()) * (1 + 2 * uneven * uneven);
        if (a == 0 || b == 0 || cost >= least) continue;
        least = cost;
        best = std::move(parts);
      }
    }
    if (best[0].empty())
    {
      order_.insert(order_.end(), nodes.begin(), nodes.end());
      return;
    }
    dissect(std::move(best[0]));
    dissect(std::move(best[1]));
    order_.insert(order_.end(), best[2].begin(), best[2].end());
  }

  /** Of the first so many nodes and of the others what is left, and as few as can be that part the two. */
  std::array<std::vector<int>, 3> part(const std::vector<int>& nodes, std::size_t first)
  {
    for (std::size_t k = 0; k < nodes.size(); ++k)
    {
      side_[nodes[k]] = k < first ? 0 : 1;
      match_[nodes[k]] = NONE;
    }
    // A largest matching across the plane; then all that alternating paths reach from the first side's free nodes.
    for (bool more = true; more;)
    {
      ++walk_;
      more = false;
      for (std::size_t k = 0; k < first; ++k) more = (match_[nodes[k]] == NONE && augment(nodes[k])) || more;
    }
    ++walk_;
    for (std::size_t k = 0; k < first; ++k)
    {
      if (match_[nodes[k]] == NONE) reach(nodes[k]);
    }
    std::array<std::vector<int>, 3> parts;
    for (const int i : nodes)
    {
      const bool reached = seen_[i] == walk_;
      const bool parting = side_[i] == 0 ? match_[i] != NONE && !reached : reached;
      parts[parting ? 2 : side_[i]].push_back(i);
    }
    for (const int i : nodes) side_[i] = NONE;
    return parts;
  }

  /** Whether f is true of one of the other side's nodes that a node touches and that this walk has not come by. */
  template <class F>
  bool anyAcross(int node, const F& f)
  {
    for (int k = pattern_.rowBegin()[node]; k < pattern_.rowBegin()[node + 1]; ++k)
    {
      const int other = pattern_.column()[k];
      if (side_[other] != 1 || seen_[other] == walk_) continue;
      seen_[other] = walk_;
      if (f(other)) return true;
    }
    return false;
  }

  /** Matches a node of the first side, and others anew where they are in its way. */
  bool augment(int node)
  {
    return anyAcross(node, [&](int other) {
      if (match_[other] != NONE && !augment(match_[other])) return false;
      match_[other] = node;
      match_[node] = other;
      return true;
    });
  }

  void reach(int node)
  {
    seen_[node] = walk_;
    anyAcross(node, [&](int other) {
      if (seen_[match_[other]] != walk_) reach(match_[other]);
      return false;
    });
  }

  const AssembledMatrix& pattern_;
  const NodalField& positions_;
  std::vector<int> side_, match_, seen_;
  int walk_ = 0;
  std::vector<int> order_;
};

/** Columns of like structure, and the rows below them. */
struct Columns
{
  int begin, end;
  std::vector<int> rows;
  double zeros;
  double size() const
  {
    const double w = end - begin;
    return w * (w + 1) / 2 + w * static_cast<double>(rows.size());
  }
};

/** How long the parts of some work take so many threads, each taking the longest that is left. */
double longest(std::vector<double> works, int threads)
{
  std::sort(works.rbegin(), works.rend());
  std::vector<double> sums(threads);
  for (const double work : works) *std::min_element(sums.begin(), sums.end()) += work;
  return *std::max_element(sums.begin(), sums.end());
}

/**
 * The roots of the subtrees to be solved at the same time, so that two threads and four take little time in all; the
 * heaviest first, none where it is not worth it.
 * @param panels  in postorder, so that a subtree is so many up to its root
 * @param counts  set to how many
 */
std::vector<int> partingRoots(const std::vector<Columns>& panels, std::vector<int>& counts)
{
  constexpr double WAKE = 3000;  // blocks that a thread multiplies by while it waits for others to begin and to end
  constexpr int MOST_SPLITS = 24;
  const int n = static_cast<int>(panels.size());
  std::vector<int> panel_of;
  for (int p = 0; p < n; ++p) panel_of.insert(panel_of.end(), panels[p].end - panels[p].begin, p);
  std::vector<std::vector<int>> children(n);
  std::vector<double> works(n);
  std::vector<int> roots, best;
  counts.assign(n, 1);
  double parting = 0, all = 0;
  for (int p = 0; p < n; ++p)
  {
    works[p] += panels[p].size();
    all += panels[p].size();
    if (panels[p].rows.empty())
    {
      roots.push_back(p);
      continue;
    }
    const int parent = panel_of[panels[p].rows.front()];
    works[parent] += works[p];
    counts[parent] += counts[p];
    children[parent].push_back(p);
  }
  double least = 2 * all;
  for (int split = 0; split < MOST_SPLITS && !roots.empty(); ++split)
  {
    std::sort(roots.begin(), roots.end(),
              [&](int a, int b) { return std::pair(works[b], a) < std::pair(works[a], b); });
    std::vector<double> parts;
    parts.reserve(roots.size());
    for (const int root : roots) parts.push_back(works[root]);
    const double time = 2 * (parting + WAKE) + longest(parts, 2) + longest(parts, 4);
    if (time < least)
    {
      least = time;
      best = roots;
    }
    const int heaviest = roots.front();
    parting += panels[heaviest].size();
    roots.erase(roots.begin());
    roots.insert(roots.end(), children[heaviest].begin(), children[heaviest].end());
  }
  return best;
}
}  // namespace

SparseCholesky::SparseCholesky(const AssembledMatrix& pattern, const NodalField& positions)
    : order_(Dissection(pattern, positions).order()), position_(pattern.rows())
{
  const int n = pattern.rows();
  const auto place = [&] {
    for (int k = 0; k < n; ++k) position_[order_[k]] = k;
  };
  place();

  // Elimination tree (Liu 1990), then its postorder, which keeps supernodes together.
  std::vector<int> parent(n, -1), ancestor(n, -1);
  for (int i = 0; i < n; ++i)
  {
    for (int k = pattern.rowBegin()[order_[i]]; k < pattern.rowBegin()[order_[i] + 1]; ++k)
    {
      int j = position_[pattern.column()[k]];
      while (j != -1 && j < i)
      {
        const int next = ancestor[j];
        ancestor[j] = i;
        if (next == -1) parent[j] = i;
        j = next;
      }
    }
  }
  std::vector<std::vector<int>> children(n + 1);
  for (int j = 0; j < n; ++j) children[parent[j] < 0 ? n : parent[j]].push_back(j);
  std::vector<int> postorder;
  std::vector<std::pair<int, std::size_t>> stack{{n, 0}};
  while (!stack.empty())
  {
    auto& [node, child] = stack.back();
    if (child < children[node].size())
    {
      stack.emplace_back(children[node][child++], 0);
      continue;
    }
    if (node < n) postorder.push_back(node);
    stack.pop_back();
  }
  std::vector<int> renumber(n), moved(n), moved_parent(n);
  for (int k = 0; k < n; ++k)
  {
    renumber[postorder[k]] = k;
    moved[k] = order_[postorder[k]];
  }
  for (int j = 0; j < n; ++j) moved_parent[renumber[j]] = parent[j] < 0 ? -1 : renumber[parent[j]];
  order_ = std::move(moved);
  parent = std::move(moved_parent);
  place();

  // Rows of every column of L below its diagonal.
  std::vector<std::vector<int>> below(n);
  std::vector<std::vector<int>> kids(n);
  std::vector<int> mark(n, -1);
  for (int j = 0; j < n; ++j)
  {
    mark[j] = j;
    const auto add = [&](int i) {
      if (i <= j || mark[i] == j) return;
      mark[i] = j;
      below[j].push_back(i);
    };
    for (int k = pattern.rowBegin()[order_[j]]; k < pattern.rowBegin()[order_[j] + 1]; ++k)
      add(position_[pattern.column()[k]]);
    for (const int child : kids[j])
      for (const int i : below[child]) add(i);
    std::sort(below[j].begin(), below[j].end());
    if (parent[j] >= 0) kids[parent[j]].push_back(j);
  }

  // Supernodes: columns join the next where that adds few zeros.
  constexpr int MOST_COLUMNS = 32;
  std::vector<Columns> panels;
  for (int j = 0; j < n; ++j)
  {
    panels.push_back({j, j + 1, below[j], 0});
    while (panels.size() > 1)
    {
      Columns& last = panels.back();
      Columns& before = panels[panels.size() - 2];
      if (parent[before.end - 1] != last.begin || last.end - before.begin > MOST_COLUMNS) break;
      Columns merged{before.begin, last.end, last.rows, 0};
      merged.zeros = merged.size() - (before.size() - before.zeros) - (last.size() - last.zeros);
      const int width = merged.end - merged.begin;
      const double allowed = width <= 4 ? 0.7 : width <= 16 ? 0.3 : 0.1;
      if (merged.zeros > allowed * merged.size()) break;
      panels.pop_back();
      panels.back() = std::move(merged);
    }
  }

  // Subtrees first, then the supernodes that part them.
  std::vector<int> counts;
  std::vector<Columns> sequence;
  moved.clear();
  const auto put = [&](Columns& panel) {
    const int begin = static_cast<int>(moved.size());
    for (int j = panel.begin; j < panel.end; ++j)
    {
      renumber[j] = static_cast<int>(moved.size());
      moved.push_back(order_[j]);
    }
    sequence.push_back({begin, static_cast<int>(moved.size()), std::move(panel.rows), 0});
    panel.begin = panel.end;
  };
  for (const int root : partingRoots(panels, counts))
  {
    Piece piece{static_cast<int>(moved.size()), 0, static_cast<int>(sequence.size()), 0};
    for (int p = root + 1 - counts[root]; p <= root; ++p) put(panels[p]);
    piece.columns_end = static_cast<int>(moved.size());
    piece.supernodes_end = static_cast<int>(sequence.size());
    pieces_.push_back(piece);
  }
  parting_column_ = static_cast<int>(moved.size());
  parting_supernode_ = static_cast<int>(sequence.size());
  for (Columns& panel : panels)
  {
    if (panel.begin < panel.end) put(panel);
  }
  panels = std::move(sequence);
  // Ancestors stay in their order, so that rows do.
  for (Columns& panel : panels)
  {
    for (int& row : panel.rows) row = renumber[row];
  }
  order_ = std::move(moved);
  place();
  // Threads take pieces from either end: the heaviest first, the light one in the middle.
  const int subtrees = static_cast<int>(pieces_.size());
  const std::vector<Piece> by_weight = std::move(pieces_);
  pieces_.assign(subtrees + 1, {parting_column_, n, parting_supernode_, parting_supernode_});
  for (int k = 0; k < subtrees; ++k) pieces_[k % 2 == 0 ? k / 2 : subtrees - k / 2] = by_weight[k];

  std::size_t values = 0, most_update = 0;
  int most_rows = 0, widest = 0;
  for (const Columns& p : panels) widest = std::max(widest, p.end - p.begin);
  for (const Columns& p : panels)
  {
    const int count = static_cast<int>(p.rows.size());
    supernodes_.push_back({p.begin, p.end, static_cast<int>(rows_.size()), count, values});
    rows_.insert(rows_.end(), p.rows.begin(), p.rows.end());
    values += 3 * static_cast<std::size_t>(stride(p.end - p.begin + count)) * (p.end - p.begin);
    for (int j = 0; j < 3 * (p.end - p.begin); ++j) size_ += stride(p.end - p.begin + count) - j / LANES * LANES;
    most_rows = std::max(most_rows, p.end - p.begin + count);
    // An update of another supernode, or the panel itself with its diagonal block inverted.
    const std::size_t size = 9 * static_cast<std::size_t>(p.end - p.begin) * (p.end - p.begin + count);
    most_update = std::max({most_update, 9 * static_cast<std::size_t>(count) * std::min(count, widest), size});
    supernode_of_.insert(supernode_of_.end(), p.end - p.begin, static_cast<int>(supernodes_.size()) - 1);
  }
  update_.resize(most_update);
  local_.resize(n);
  for (std::vector<int>* list : {&head_, &next_, &done_}) list->resize(supernodes_.size());
  values_.resize(values);
  // Of the tallest panel, then of its columns; whole nodes are read and written, that is a number more.
  packed_begin_ = stride(most_rows) + LANES;
  packed_size_ = packed_begin_ + stride(widest) + LANES;
  packed_.resize(packed_size_ * pieces_.size());
  work_.resize(4 * (static_cast<std::size_t>(n) + (n - parting_column_) * pieces_.size()));
  sums_ = rows_;
  for (std::size_t k = 0; k < pieces_.size(); ++k)
  {
    const int sums = n + (n - parting_column_) * static_cast<int>(k);
    for (int s = pieces_[k].supernodes_begin; s < pieces_[k].supernodes_end; ++s)
    {
      for (int r = supernodes_[s].rows_begin; r < supernodes_[s].rows_begin + supernodes_[s].rows_count; ++r)
      {
        if (rows_[r] >= parting_column_) sums_[r] = sums + rows_[r] - parting_column_;
      }
    }
  }
}

double SparseCholesky::makingTime() const
{
  double sum = 0;  // multiplications
  for (const Supernode& node : supernodes_)
  {
    const double w = 3.0 * (node.end - node.begin), below = 3.0 * node.rows_count;
    sum += w * w * w / 6 + below * w * w / 2 + below * below * w / 2;
  }
  return 1e-10 * sum;
}

double SparseCholesky::solvingTime() const
{
  return 8e-10 * static_cast<double>(size_);  // from memory; from cache a seventh
}

bool SparseCholesky::factor(const AssembledMatrix& matrix)
{
  std::fill(values_.begin(), values_.end(), 0.0f);
  std::fill(head_.begin(), head_.end(), -1);
  std::fill(done_.begin(), done_.end(), 0);
  for (std::size_t s = 0; s < supernodes_.size(); ++s)
  {
    const Supernode& node = supernodes_[s];
    const int width = node.end - node.begin, height = width + node.rows_count;
    Panel panel(values_.data() + node.values, 3L * height, 3L * width, Eigen::OuterStride<>(stride(height)));
    for (int j = 0; j < width; ++j) local_[node.begin + j] = j;
    for (int k = 0; k < node.rows_count; ++k) local_[rows_[node.rows_begin + k]] = width + k;
    for (int j = 0; j < width; ++j)
    {
      const int old = order_[node.begin + j];
      for (int k = matrix.rowBegin()[old]; k < matrix.rowBegin()[old + 1]; ++k)
      {
        const int i = position_[matrix.column()[k]];
        if (i < node.begin + j) continue;
        // Stored by columns as (old, column[k]): its transpose is (i, j).
        const Eigen::Map<const Eigen::Matrix3d> block(matrix.blocks().data() + 9L * k);
        panel.block<3, 3>(3L * local_[i], 3L * j) = block.transpose().cast<float>();
      }
    }
    // Updates by all supernodes that have rows among these columns.
    for (int k = head_[s]; k >= 0;)
    {
      const Supernode& from = supernodes_[k];
      const int following = next_[k], w = from.end - from.begin, first = done_[k];
      int last = first;
      while (last < from.rows_count && rows_[from.rows_begin + last] < node.end) ++last;
      const Panel source(values_.data() + from.values, 3L * (w + from.rows_count), 3L * w,
                         Eigen::OuterStride<>(stride(w + from.rows_count)));
      const Eigen::Index rows = 3L * (from.rows_count - first), columns = 3L * (last - first);
      Eigen::Map<Eigen::MatrixXf, Eigen::Aligned64> update(update_.data(), rows, columns);
      update.noalias() = source.bottomRows(rows) * source.middleRows(3L * (w + first), columns).transpose();
      for (int c = first; c < last; ++c)
      {
        const int column = local_[rows_[from.rows_begin + c]];
        for (int r = c; r < from.rows_count; ++r)
        {
          panel.block<3, 3>(3L * local_[rows_[from.rows_begin + r]], 3L * column) -=
              update.block<3, 3>(3L * (r - first), 3L * (c - first));
        }
      }
      done_[k] = last;
      if (last < from.rows_count)
      {
        const int target = supernode_of_[rows_[from.rows_begin + last]];
        next_[k] = head_[target];
        head_[target] = k;
      }
      k = following;
    }
    auto diagonal = panel.topRows(3L * width);
    const Eigen::LLT<Eigen::Ref<Eigen::MatrixXf>> llt(diagonal);
    if (llt.info() != Eigen::Success) return false;
    auto lower = panel.bottomRows(3L * node.rows_count);
    llt.matrixL().transpose().solveInPlace<Eigen::OnTheRight>(lower);
    if (node.rows_count > 0)
    {
      const int target = supernode_of_[rows_[node.rows_begin]];
      next_[s] = head_[target];
      head_[target] = static_cast<int>(s);
    }
  }
  invertDiagonal();
  return true;
}

void SparseCholesky::invertDiagonal()
{
  for (const Supernode& node : supernodes_)
  {
    const int width = node.end - node.begin, height = width + node.rows_count;
    Panel panel(values_.data() + node.values, 3L * height, 3L * width, Eigen::OuterStride<>(stride(height)));
    auto diagonal = panel.topRows(3L * width);
    auto below = panel.bottomRows(3L * node.rows_count);
    Eigen::Map<Eigen::MatrixXf> inverse(update_.data(), 3L * width, 3L * width);
    Eigen::Map<Eigen::MatrixXf> product(update_.data() + inverse.size(), below.rows(), below.cols());
    inverse.setIdentity();
    diagonal.triangularView<Eigen::Lower>().solveInPlace(inverse);
    product.noalias() = below * inverse;
    diagonal = inverse;
    below = product;
  }
}

void SparseCholesky::solve(const float* b, float* x)
{
  solve(
      1,
      [&](int begin, int end, float* to) {
        for (int k = begin; k < end; ++k)
        {
          for (int axis = 0; axis < 4; ++axis) *to++ = b[4L * order_[k] + axis];
        }
      },
      [&](int begin, int end, const float* from) {
        for (int k = begin; k < end; ++k, from += 4)
        {
          for (int axis = 0; axis < 3; ++axis) x[4L * order_[k] + axis] = from[axis];
          x[4L * order_[k] + 3] = 0;
        }
      });
}

void SparseCholesky::solve(int threads, const Read& read, const Write& write)
{
  const int pieces = static_cast<int>(pieces_.size()), supernodes = static_cast<int>(supernodes_.size());
  const std::ptrdiff_t columns = static_cast<std::ptrdiff_t>(order_.size()), parted = columns - parting_column_;
  const auto sumsOf = [&](int piece) { return work_.data() + 4 * (columns + parted * piece); };
  forEachPiece(threads, pieces, [&](int k) {
    const Piece& piece = pieces_[k];
    std::fill_n(sumsOf(k), 4 * parted, 0.0f);
    read(piece.columns_begin, piece.columns_end, work_.data() + 4L * piece.columns_begin);
    forward(piece.supernodes_begin, piece.supernodes_end, packed_.data() + packed_size_ * k);
  });
  float* parting = work_.data() + 4L * parting_column_;
  for (int k = 0; k < pieces; ++k)
  {
    const float* sums = sumsOf(k);
    for (std::ptrdiff_t i = 0; i < 4 * parted; ++i) parting[i] += sums[i];
  }
  forward(parting_supernode_, supernodes, packed_.data());
  backward(parting_supernode_, supernodes, packed_.data());
  forEachPiece(threads, pieces, [&](int claimed) {
    // One thread goes back the way it came, as the caches have what it had last.
    const int k = threads == 1 ? pieces - 1 - claimed : claimed;
    const Piece& piece = pieces_[k];
    backward(piece.supernodes_begin, piece.supernodes_end, packed_.data() + packed_size_ * k);
    write(piece.columns_begin, piece.columns_end, work_.data() + 4L * piece.columns_begin);
  });
}

/** @param packed  scratch of a piece: 3 numbers a node, each node's written before the next one's */
void SparseCholesky::forward(int begin, int end, float* packed)
{
  const kernels::Table& kernel = kernels::table();
  float *product = packed, *columns = packed + packed_begin_;
  for (int s = begin; s < end; ++s)
  {
    const Supernode& node = supernodes_[s];
    const int width = node.end - node.begin;
    float* own = work_.data() + 4L * node.begin;
    for (int j = 0; j < width; ++j) packedAt(columns, j) = nodeAt(own, j);
    kernel.panel_product(stride(width + node.rows_count), 3 * width, values_.data() + node.values, columns, product);
    for (int j = 0; j < width; ++j) nodeAt(own, j) = packedAt(product, j);
    const int* sums = sums_.data() + node.rows_begin;
    for (int k = 0; k < node.rows_count; ++k) nodeAt(work_.data(), sums[k]) -= packedAt(product, width + k);
  }
}

void SparseCholesky::backward(int begin, int end, float* packed)
{
  const kernels::Table& kernel = kernels::table();
  float *gathered = packed, *columns = packed + packed_begin_;
  for (int s = end - 1; s >= begin; --s)
  {
    const Supernode& node = supernodes_[s];
    const int width = node.end - node.begin, height = width + node.rows_count;
    float* own = work_.data() + 4L * node.begin;
    const int* rows = rows_.data() + node.rows_begin;
    for (int j = 0; j < width; ++j) packedAt(gathered, j) = nodeAt(own, j);
    for (int k = 0; k < node.rows_count; ++k) packedAt(gathered, width + k) = -nodeAt(work_.data(), rows[k]);
    std::fill(gathered + 3L * height, gathered + stride(height), 0.0f);
    kernel.panel_transpose_product(stride(height), 3 * width, values_.data() + node.values, gathered, columns);
    for (int j = 0; j < width; ++j) nodeAt(own, j) = packedAt(columns, j);
  }
}

}  // namespace bezier_fem
