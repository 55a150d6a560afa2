#include "bezier_fem/refine.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <map>
#include <set>

#include "bezier_fem/mesh_io.h"
#include "bezier_fem/simulation.h"
#include "core/bar.h"

namespace bezier_fem
{
namespace
{
const std::string DATA = TEST_DATA_DIR;

double volume(const TetMesh& mesh, Eigen::Index t)
{
  const Eigen::Vector3d a = mesh.corners.col(mesh.tets(0, t));
  const Eigen::Vector3d b = mesh.corners.col(mesh.tets(1, t)) - a, c = mesh.corners.col(mesh.tets(2, t)) - a;
  return b.cross(c).dot(mesh.corners.col(mesh.tets(3, t)) - a) / 6;
}

double volume(const TetMesh& mesh)
{
  double sum = 0;
  for (Eigen::Index t = 0; t < mesh.tets.cols(); ++t) sum += volume(mesh, t);
  return sum;
}

/** How many elements each face belongs to. */
std::map<std::array<int, 3>, int> faces(const TetMesh& mesh)
{
  std::map<std::array<int, 3>, int> count;
  for (Eigen::Index t = 0; t < mesh.tets.cols(); ++t)
  {
    for (const auto& face : FACE_CORNERS)
    {
      std::array<int, 3> corners{mesh.tets(face[0], t), mesh.tets(face[1], t), mesh.tets(face[2], t)};
      std::sort(corners.begin(), corners.end());
      ++count[corners];
    }
  }
  return count;
}

double area(const TetMesh& mesh, const std::array<int, 3>& face)
{
  const Eigen::Vector3d a = mesh.corners.col(face[0]);
  return (mesh.corners.col(face[1]) - a).cross(mesh.corners.col(face[2]) - a).norm() / 2;
}

const MeshGroup& group(const TetMesh& mesh, const std::string& name)
{
  return *std::find_if(mesh.groups.begin(), mesh.groups.end(), [&](const MeshGroup& g) { return g.name == name; });
}

/** Area of the boundary faces whose three corners are in the group, as a load takes them. */
double areaOfGroup(const TetMesh& mesh, const std::string& name)
{
  const std::vector<int>& corners = group(mesh, name).corners;
  double sum = 0;
  for (const auto& [face, count] : faces(mesh))
  {
    if (count > 1) continue;
    const auto inside = [&](int c) { return std::binary_search(corners.begin(), corners.end(), c); };
    if (std::all_of(face.begin(), face.end(), inside)) sum += area(mesh, face);
  }
  return sum;
}

TEST(Refine, FillsTheSameBodyWithConformingTetrahedra)
{
  const TetMesh coarse = test::irregularBox({2, 1, 3}, {0.5, 0.3, 1});
  const TetMesh fine = refined(coarse, 2);
  ASSERT_EQ(fine.tets.cols(), 64 * coarse.tets.cols());
  EXPECT_NEAR(volume(fine), volume(coarse), 1e-14);
  for (Eigen::Index t = 0; t < fine.tets.cols(); ++t)
  {
    ASSERT_NEAR(volume(fine, t), volume(coarse, t / 64) / 64, 1e-15) << "positive, and all descendants alike";
  }
  double boundary = 0;
  for (const auto& [face, count] : faces(fine))
  {
    ASSERT_LE(count, 2);
    if (count == 1) boundary += area(fine, face);
  }
  EXPECT_NEAR(boundary, 2 * (0.5 * 0.3 + 0.5 + 0.3), 1e-13) << "no face inside belongs to one element only";
}

TEST(Refine, AtMostThreeShapesHoweverOften)
{
  const TetMesh coarse = test::irregularBox({2, 2, 2}, {1, 0.4, 0.7}, 0.3);
  for (int levels = 1; levels <= 3; ++levels)
  {
    const TetMesh fine = refined(coarse, levels);
    const Eigen::Index children = fine.tets.cols() / coarse.tets.cols();
    for (Eigen::Index t = 0; t < coarse.tets.cols(); ++t)
    {
      // Edge lengths, sorted: what a shape has in common wherever it lies and however its corners are named
      std::vector<std::array<double, EDGES>> shapes;
      for (Eigen::Index k = children * t; k < children * (t + 1); ++k)
      {
        std::array<double, EDGES> lengths{};
        for (int e = 0; e < EDGES; ++e)
        {
          lengths[e] =
              (fine.corners.col(fine.tets(EDGE_CORNERS[e][0], k)) - fine.corners.col(fine.tets(EDGE_CORNERS[e][1], k)))
                  .norm();
        }
        std::sort(lengths.begin(), lengths.end());
        const auto same = [&](const std::array<double, EDGES>& other) {
          return std::equal(lengths.begin(), lengths.end(), other.begin(),
                            [](double a, double b) { return std::abs(a - b) < 1e-12; });
        };
        if (std::none_of(shapes.begin(), shapes.end(), same)) shapes.push_back(lengths);
      }
      ASSERT_LE(shapes.size(), 3u);
    }
  }
}

// A corner made of an edge's middle is what a quadratic element of the coarse mesh has there: its id, its place.
TEST(Refine, MiddlesOfEdgesKeepTheirIds)
{
  for (const char* file : {"two_boxes_22.msh", "two_boxes_o2_22.msh", "two_regions_o2.ele"})
  {
    SCOPED_TRACE(file);
    const TetMesh coarse = readTetMesh(DATA + "/" + file);
    const TetMesh fine = refined(coarse, 1);
    const Model quadratic = test::boxModel(coarse, Element::QUADRATIC);
    std::map<std::int64_t, Eigen::Vector3d> expected;
    for (int i = 0; i < quadratic.num_nodes; ++i) expected[quadratic.ids[i]] = quadratic.rest[i];
    ASSERT_EQ(fine.corner_ids.size(), expected.size());
    EXPECT_TRUE(std::is_sorted(fine.corner_ids.begin(), fine.corner_ids.end()));
    for (std::size_t c = 0; c < fine.corner_ids.size(); ++c)
    {
      ASSERT_EQ(expected.count(fine.corner_ids[c]), 1u);
      EXPECT_LT((expected[fine.corner_ids[c]] - fine.corners.col(static_cast<Eigen::Index>(c))).norm(), 1e-14);
    }
    EXPECT_GE(fine.largest_id, fine.corner_ids.back());
    EXPECT_GE(fine.largest_id, coarse.largest_id);
    const TetMesh finer = refined(coarse, 2);
    EXPECT_EQ(std::set<std::int64_t>(finer.corner_ids.begin(), finer.corner_ids.end()).size(), finer.corner_ids.size());
  }
}

TEST(Refine, GroupsStayTheSamePartOfTheBody)
{
  const TetMesh coarse = readTetMesh(DATA + "/two_boxes_22.msh");
  const TetMesh fine = refined(coarse, 2);
  ASSERT_EQ(fine.groups.size(), coarse.groups.size());
  int solid = 0, flat = 0;
  for (const MeshGroup& before : coarse.groups)
  {
    SCOPED_TRACE(before.name);
    const MeshGroup& after = group(fine, before.name);
    double volume_before = 0, volume_after = 0;
    for (const int t : before.tets) volume_before += volume(coarse, t);
    for (const int t : after.tets) volume_after += volume(fine, t);
    EXPECT_NEAR(volume_after, volume_before, 1e-12);
    EXPECT_NEAR(areaOfGroup(fine, before.name), areaOfGroup(coarse, before.name), 1e-12);
    EXPECT_TRUE(std::is_sorted(after.corners.begin(), after.corners.end()));
    ++(before.tets.empty() ? flat : solid);
  }
  EXPECT_GT(solid, 0);
  EXPECT_GT(flat, 0);
}

Scene bar(int refine, std::vector<std::string> overrides)
{
  overrides.push_back("model.refine=" + std::to_string(refine));
  return loadScene(DATA + "/../../config/bar.yaml", overrides);
}

/** Work of the weight in the static equilibrium, J. */
double compliance(Scene scene)
{
  scene.solver.tolerance = 1e-8;
  Simulation simulation(std::move(scene), 1, [](const std::string&) {});
  const double before = simulation.energies().gravity;
  EXPECT_TRUE(simulation.solveStatic().converged);
  return before - simulation.energies().gravity;
}

// Each space of shapes holds the coarser one, and of all shapes the equilibrium has the least energy.
TEST(RefinedScene, AFinerMeshIsSofter)
{
  for (const char* element : {"element=linear", "element=quadratic"})
  {
    const std::vector<std::string> law{element, "elasticity=linear"};
    const double coarse = compliance(bar(0, law)), fine = compliance(bar(1, law)), finer = compliance(bar(2, law));
    EXPECT_GT(fine, coarse);
    EXPECT_GT(finer, fine);
    EXPECT_LT(finer - fine, fine - coarse) << "and they approach each other";
  }
}

TEST(RefinedScene, UnlistedCornersStartHalfway)
{
  const std::string positions = DATA + "/../../config/recovery.csv";  // the bar mirrored at z = 0
  Simulation simulation(bar(2, {"initial.positions=" + positions}), 1, [](const std::string&) {});
  const Model& model = simulation.model();
  ASSERT_EQ(model.num_tets, 64 * 120);
  for (int i = 0; i < model.num_nodes; ++i)
  {
    const Eigen::Vector3d mirrored = model.rest[i].cwiseProduct(Eigen::Vector3d(1, 1, -1));
    ASSERT_LT((simulation.state().x[i] - mirrored).norm(), 1e-14);
  }
}

}  // namespace
}  // namespace bezier_fem
