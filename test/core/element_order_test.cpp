#include "element_order.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <set>

#include "bezier_fem/partition.h"
#include "core/bar.h"
#include "kernels.h"

namespace bezier_fem
{
namespace
{
using Eigen::Vector3d;
using Corners = std::array<int, CORNERS>;

double volume(const TetMesh& mesh, const Corners& corners)
{
  const auto at = [&](int a) -> Vector3d { return mesh.corners.col(corners[a]); };
  return (at(1) - at(0)).cross(at(2) - at(0)).dot(at(3) - at(0)) / 6;
}

/** What holds of any mesh. Returns how many elements are in pairs. */
int check(const TetMesh& mesh)
{
  const ElementOrder order = orderElements(mesh);
  const auto tets = static_cast<std::size_t>(mesh.tets.cols());
  EXPECT_EQ(order.tets.size(), tets);
  EXPECT_EQ(order.pairing.size(), (tets + LANES - 1) / LANES);
  std::vector<int> seen(tets, 0);
  for (const auto& [t, corners] : order.tets)
  {
    ++seen[t];
    Corners of_mesh{};
    for (int a = 0; a < CORNERS; ++a) of_mesh[a] = mesh.tets(a, t);
    EXPECT_TRUE(std::is_permutation(corners.begin(), corners.end(), of_mesh.begin()));
    EXPECT_NEAR(volume(mesh, corners), volume(mesh, of_mesh), 1e-12 * std::abs(volume(mesh, of_mesh)));
  }
  EXPECT_EQ(std::count(seen.begin(), seen.end(), 1), tets);

  int paired = 0;
  for (std::size_t block = 0; block < order.pairing.size(); ++block)
  {
    if (order.pairing[block] == kernels::ALONE) continue;
    EXPECT_EQ(order.pairing[block], kernels::FIRST);
    if (++block == order.pairing.size() || tets < (block + 1) * LANES)
    {
      ADD_FAILURE() << "a pair that is not whole";
      break;
    }
    EXPECT_EQ(order.pairing[block], kernels::SECOND);
    for (int lane = 0; lane < LANES; ++lane)
    {
      const Corners &a = order.tets[(block - 1) * LANES + lane].corners, &b = order.tets[block * LANES + lane].corners;
      EXPECT_EQ(a[1], b[1]);
      EXPECT_EQ(a[2], b[3]);
      EXPECT_EQ(a[3], b[2]);
      EXPECT_NE(a[0], b[0]);
    }
    paired += 2 * LANES;
  }
  return paired;
}

/** Several copies of a mesh, side by side. */
TetMesh copies(const TetMesh& mesh, int count)
{
  TetMesh all;
  const Eigen::Index corners = mesh.corners.cols(), tets = mesh.tets.cols();
  all.corners.resize(3, count * corners);
  all.tets.resize(4, count * tets);
  for (int k = 0; k < count; ++k)
  {
    all.corners.middleCols(k * corners, corners) = mesh.corners.colwise() + Vector3d(10.0 * k, 0, 0);
    all.tets.middleCols(k * tets, tets) = mesh.tets.array() + static_cast<int>(k * corners);
  }
  for (Eigen::Index i = 0; i < all.corners.cols(); ++i) all.corner_ids.push_back(i);
  return all;
}

TetMesh meshOf(const std::vector<Vector3d>& corners, const std::vector<Corners>& tets)
{
  TetMesh mesh;
  mesh.corners.resize(3, static_cast<Eigen::Index>(corners.size()));
  for (std::size_t i = 0; i < corners.size(); ++i) mesh.corners.col(static_cast<Eigen::Index>(i)) = corners[i];
  mesh.tets.resize(4, static_cast<Eigen::Index>(tets.size()));
  for (std::size_t t = 0; t < tets.size(); ++t)
  {
    for (int a = 0; a < CORNERS; ++a) mesh.tets(a, static_cast<Eigen::Index>(t)) = tets[t][a];
  }
  return mesh;
}

const Vector3d O = Vector3d::Zero(), X = Vector3d::UnitX(), Y = Vector3d::UnitY(), Z = Vector3d::UnitZ();

TEST(ElementOrder, MostElementsAreInPairs)
{
  for (const Eigen::Vector3i& cells :
       {Eigen::Vector3i(5, 4, 6), Eigen::Vector3i(3, 3, 30), Eigen::Vector3i(9, 7, 8), Eigen::Vector3i(1, 1, 40)})
  {
    SCOPED_TRACE(cells.transpose());
    const TetMesh mesh = test::irregularBox(cells, cells.cast<double>());
    // Fewer than LANES pairs, and a block of those that are left, can be lost to whole blocks.
    EXPECT_GT(check(mesh), 0.97 * static_cast<double>(mesh.tets.cols()) - 3 * LANES);
  }
}

TEST(ElementOrder, SmallMeshesAreInOrderToo)
{
  for (int cells = 1; cells <= 6; ++cells)
  {
    SCOPED_TRACE(cells);
    EXPECT_EQ(check(test::kuhnBox({1, 1, cells}, {1, 1, 1.0 * cells})), cells < 6 ? 0 : 2 * LANES);
  }
  check(meshOf({O, X, Y, Z}, {{0, 1, 2, 3}}));
}

TEST(ElementOrder, WhoHasNoNeighbourIsAlone)
{
  EXPECT_EQ(check(copies(meshOf({O, X, Y, Z}, {{0, 1, 2, 3}}), 70)), 0);
  // Edges and corners do not make neighbours.
  EXPECT_EQ(check(copies(meshOf({O, X, Y, Z, -Y, -Z}, {{0, 1, 2, 3}, {0, 1, 4, 5}}), 40)), 0);
  // A middle with four neighbours has one of them.
  const TetMesh star = meshOf({O, X, Y, Z, -X, -Y, -Z, X + Y + Z},
                              {{0, 1, 2, 3}, {4, 0, 2, 3}, {1, 0, 5, 3}, {1, 2, 0, 6}, {1, 2, 3, 7}});
  EXPECT_EQ(check(copies(star, 2 * LANES)), 4 * LANES);
}

TEST(ElementOrder, MeshesThatOverlapThemselvesHaveNoPairsThere)
{
  EXPECT_EQ(check(copies(meshOf({O, X, Y, Z, 0.5 * Z}, {{0, 1, 2, 3}, {0, 1, 2, 4}}), 40)), 0);
  EXPECT_EQ(check(copies(meshOf({O, X, Y, Z}, {{0, 1, 2, 3}, {1, 2, 0, 3}}), 40)), 0);
  // Three at one face: two of them, on both sides of it or not.
  const TetMesh three = meshOf({O, X, Y, Z, 0.5 * Z, -Z}, {{0, 1, 2, 3}, {0, 1, 2, 4}, {0, 2, 1, 5}});
  EXPECT_LE(check(copies(three, 2 * LANES)), 4 * LANES);
}

TEST(ElementOrder, TheModelKnowsWhichElementIsWhichTetrahedron)
{
  const TetMesh mesh = test::irregularBox({3, 4, 5}, {1, 1, 1});
  std::vector<Material> materials(mesh.tets.cols(), test::RUBBER);
  for (std::size_t t = 0; t < materials.size(); ++t) materials[t].density = 1.0 + static_cast<double>(t);
  const Model model = buildModel(mesh, Element::QUADRATIC, materials);
  for (int t = 0; t < model.num_tets; ++t)
  {
    const int element = model.tet_of_mesh_tet[t];
    EXPECT_EQ(model.materials[element].density, materials[t].density);
    Corners corners{}, of_mesh{};
    for (int a = 0; a < CORNERS; ++a)
    {
      corners[a] = model.ends[model.nodesOf(element)[a]][0];
      of_mesh[a] = mesh.tets(a, t);
    }
    EXPECT_TRUE(std::is_permutation(corners.begin(), corners.end(), of_mesh.begin())) << t;
  }
}

TEST(ElementOrder, HalvesShareFewNodes)
{
  const TetMesh mesh = test::irregularBox({6, 6, 60}, {1, 1, 10});
  const Model model = test::boxModel(mesh, Element::QUADRATIC);
  const Partition partition(model, 2);
  ASSERT_EQ(partition.pieces() % 2, 0);
  const int middle = partition.blockBegin(partition.pieces() / 2) * LANES;
  std::set<int> before, common;
  for (int t = 0; t < model.num_tets; ++t)
  {
    for (int k = 0; k < model.nodes_per_tet; ++k)
    {
      const int node = model.nodesOf(t)[k];
      if (t < middle) before.insert(node);
      if (t >= middle && before.count(node) != 0) common.insert(node);
    }
  }
  // A plane of corners and edges has 13 x 13 nodes. Pairs across it would make it ragged.
  EXPECT_LT(common.size(), 1.5 * 13 * 13);
}

TEST(ElementOrder, NobodyGetsHalfAPair)
{
  const Model model = test::boxModel(test::irregularBox({9, 8, 12}, {1, 1, 1}), Element::QUADRATIC);
  for (int threads = 1; threads <= 11; ++threads)
  {
    const Partition partition(model, threads);
    EXPECT_EQ(partition.blockBegin(0), 0);
    EXPECT_EQ(partition.blockEnd(partition.pieces() - 1), model.num_blocks);
    for (int piece = 1; piece < partition.pieces(); ++piece)
    {
      EXPECT_LE(partition.blockBegin(piece - 1), partition.blockBegin(piece));
      EXPECT_NE(model.block_pairing[partition.blockBegin(piece)], kernels::SECOND);
    }
  }
}

}  // namespace
}  // namespace bezier_fem
