#include "element_order.h"

#include <Eigen/Dense>
#include <algorithm>
#include <numeric>

#include "bezier_fem/bernstein.h"
#include "bezier_fem/model.h"
#include "kernels.h"

namespace bezier_fem
{
namespace
{
using Corners = std::array<int, CORNERS>;

/** The tetrahedron on the other side of each face, or -1; faces by the corner that they do not have. */
std::vector<Corners> neighbours(const TetMesh& mesh)
{
  struct Side
  {
    std::array<int, 3> key;
    int tet, opposite;
  };
  std::vector<Side> sides;
  sides.reserve(static_cast<std::size_t>(mesh.tets.cols()) * CORNERS);
  for (int t = 0; t < mesh.tets.cols(); ++t)
  {
    for (int a = 0; a < CORNERS; ++a)
    {
      std::array<int, 3> key{};
      for (int k = 0; k < 3; ++k) key[k] = mesh.tets(FACE_CORNERS[a][k], t);
      std::sort(key.begin(), key.end());
      sides.push_back({key, t, a});
    }
  }
  std::stable_sort(sides.begin(), sides.end(), [](const Side& a, const Side& b) { return a.key < b.key; });
  std::vector<Corners> result(mesh.tets.cols(), Corners{-1, -1, -1, -1});
  for (std::size_t i = 0; i + 1 < sides.size(); ++i)
  {
    if (sides[i].key != sides[i + 1].key) continue;
    result[sides[i].tet][sides[i].opposite] = sides[i + 1].tet;
    result[sides[i + 1].tet][sides[i + 1].opposite] = sides[i].tet;
    ++i;
  }
  return result;
}

/**
 * Sorts [begin, end) of the order so that each half, of whole blocks, lies on one side of a plane across the longest
 * extent of its points, and so on in the halves (recursive coordinate bisection): whoever works on a half shares few
 * nodes with others. Calls leaf(begin, end) for what has no more than `largest`.
 */
template <class Leaf>
void bisect(const Eigen::Matrix3Xd& points, std::vector<int>& order, std::ptrdiff_t begin, std::ptrdiff_t end,
            std::ptrdiff_t largest, const Leaf& leaf)
{
  if (end - begin <= largest)
  {
    // What follows leaves the order within open.
    std::sort(order.begin() + begin, order.begin() + end);
    leaf(begin, end);
    return;
  }
  Eigen::Vector3d low = points.col(order[begin]), high = low;
  for (std::ptrdiff_t k = begin; k < end; ++k)
  {
    low = low.cwiseMin(points.col(order[k]));
    high = high.cwiseMax(points.col(order[k]));
  }
  Eigen::Index axis = 0;
  (high - low).maxCoeff(&axis);
  const std::ptrdiff_t blocks = (end - begin + LANES - 1) / LANES, middle = begin + blocks / 2 * LANES;
  std::nth_element(order.begin() + begin, order.begin() + middle, order.begin() + end,
                   [&](int s, int t) { return std::pair(points(axis, s), s) < std::pair(points(axis, t), t); });
  bisect(points, order, begin, middle, largest, leaf);
  bisect(points, order, middle, end, largest, leaf);
}

/** Makes pairs of neighbours, each with one at most. */
class Matching
{
public:
  explicit Matching(const TetMesh& mesh)
      : neighbours_(neighbours(mesh)), partner_(mesh.tets.cols(), -1), free_(mesh.tets.cols(), 0), part_(free_)
  {
  }

  /** Among some of the tetrahedra, which have not been matched yet. */
  void match(const std::vector<int>& tets)
  {
    ++parts_;
    for (const int t : tets) part_[t] = parts_;
    // Those with the fewest free neighbours first, with the one of those that has the fewest.
    std::array<std::vector<int>, CORNERS + 1> with;
    for (const int t : tets)
    {
      forEachFree(t, [&](int) { ++free_[t]; });
      with[free_[t]].push_back(t);
    }
    while (true)
    {
      int fewest = 1;
      while (fewest <= CORNERS && with[fewest].empty()) ++fewest;
      if (fewest > CORNERS) break;
      const int t = with[fewest].back();
      with[fewest].pop_back();
      if (partner_[t] >= 0 || free_[t] != fewest) continue;  // no longer
      int best = -1;
      forEachFree(t, [&](int n) {
        if (best < 0 || free_[n] < free_[best]) best = n;
      });
      pair(t, best);
      for (const int gone : {t, best})
      {
        forEachFree(gone, [&](int n) {
          --free_[n];
          with[free_[n]].push_back(n);
        });
      }
    }
  }

  /** -1 if there is none */
  int partner(int t) const { return partner_[t]; }
  /** The corner that t does not share with its partner. */
  int opposite(int t) const
  {
    const Corners& of = neighbours_[t];
    return static_cast<int>(std::find(of.begin(), of.end(), partner_[t]) - of.begin());
  }

private:
  template <class F>
  void forEachFree(int t, const F& f) const
  {
    for (const int n : neighbours_[t])
    {
      if (n >= 0 && part_[n] == parts_ && partner_[n] < 0) f(n);
    }
  }
  void pair(int s, int t)
  {
    partner_[s] = t;
    partner_[t] = s;
  }

  std::vector<Corners> neighbours_;
  std::vector<int> partner_, free_, part_;
  int parts_ = 0;
};

/** The mesh's corners of a tetrahedron, evenly permuted so that corner `first` comes first. */
Corners startingWith(const TetMesh& mesh, int t, int first)
{
  constexpr std::array<Corners, CORNERS> EVEN{{{0, 1, 2, 3}, {1, 0, 3, 2}, {2, 3, 0, 1}, {3, 2, 1, 0}}};
  Corners corners{};
  for (int a = 0; a < CORNERS; ++a) corners[a] = mesh.tets(EVEN[first][a], t);
  return corners;
}

class Ordering
{
public:
  explicit Ordering(const TetMesh& mesh) : mesh_(mesh), matching_(mesh), centroids_(3, mesh.tets.cols())
  {
    centroids_.setZero();
    for (Eigen::Index t = 0; t < mesh.tets.cols(); ++t)
    {
      for (int a = 0; a < CORNERS; ++a) centroids_.col(t) += mesh.corners.col(mesh.tets(a, t)) / CORNERS;
    }
    std::vector<int> tets(mesh.tets.cols());
    std::iota(tets.begin(), tets.end(), 0);
    bisect(centroids_, tets, 0, mesh.tets.cols(), PART, [&](std::ptrdiff_t begin, std::ptrdiff_t end) {
      add({tets.begin() + begin, tets.begin() + end});
    });
  }

  ElementOrder order;

private:
  /**
   * No pair is of two parts, so that what lies between two parts is flat. A part's last pairs, fewer than LANES, are
   * left alone: a few per cent of so large a part.
   */
  static constexpr int PART = 1024;

  struct Pair
  {
    ElementOrder::Tet first, second;
  };

  void add(const std::vector<int>& part)
  {
    matching_.match(part);
    std::vector<Pair> pairs;
    std::vector<ElementOrder::Tet> alone;
    const auto leaveAlone = [&](int t) { alone.push_back({t, startingWith(mesh_, t, 0)}); };
    for (const int t : part)
    {
      const int other = matching_.partner(t);
      if (other < 0) leaveAlone(t);
      if (other < t) continue;
      const Corners a = startingWith(mesh_, t, matching_.opposite(t));
      Corners b = startingWith(mesh_, other, matching_.opposite(other));
      for (int k = 0; k < 2 && b[1] != a[1]; ++k) std::rotate(b.begin() + 1, b.begin() + 2, b.end());
      if (b[1] == a[1] && b[2] == a[3] && b[3] == a[2])
      {
        pairs.push_back({{t, a}, {other, b}});
      }
      else
      {
        // On the same side of their face, or the same tetrahedron twice: the mesh overlaps itself.
        leaveAlone(t);
        leaveAlone(other);
      }
    }
    Eigen::Matrix3Xd centres(3, static_cast<Eigen::Index>(pairs.size()));
    std::vector<int> order_of_pairs(pairs.size());
    for (std::size_t k = 0; k < pairs.size(); ++k)
    {
      centres.col(static_cast<Eigen::Index>(k)) =
          (centroids_.col(pairs[k].first.tet) + centroids_.col(pairs[k].second.tet)) / 2;
      order_of_pairs[k] = static_cast<int>(k);
    }
    bisect(centres, order_of_pairs, 0, static_cast<std::ptrdiff_t>(pairs.size()), LANES,
           [&](std::ptrdiff_t begin, std::ptrdiff_t end) {
             if (end - begin == LANES) order.pairing.insert(order.pairing.end(), {kernels::FIRST, kernels::SECOND});
             std::vector<ElementOrder::Tet>& to = end - begin == LANES ? order.tets : alone;
             for (std::ptrdiff_t k = begin; k < end; ++k) to.push_back(pairs[order_of_pairs[k]].first);
             for (std::ptrdiff_t k = begin; k < end; ++k) to.push_back(pairs[order_of_pairs[k]].second);
           });
    order.tets.insert(order.tets.end(), alone.begin(), alone.end());
    order.pairing.resize((order.tets.size() + LANES - 1) / LANES, kernels::ALONE);
  }

  const TetMesh& mesh_;
  Matching matching_;
  Eigen::Matrix3Xd centroids_;
};
}  // namespace

ElementOrder orderElements(const TetMesh& mesh)
{
  return Ordering(mesh).order;
}

}  // namespace bezier_fem
