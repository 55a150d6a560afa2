#include "bezier_fem/local_sizes.h"

#include <gtest/gtest.h>

#include "bezier_fem/error.h"

namespace bezier_fem
{
namespace
{
Scene bar(const std::vector<std::string>& overrides)
{
  Scene scene = loadScene(TEST_DATA_DIR "/../../config/bar.yaml", overrides);
  scene.model.cell_size = 0.2;  // not used by a file of tetrahedra; the measure of what comes out
  return scene;
}

/** Mean size of the elements at one end of the bar, which lies along z from 0 to 1, over that at the other. */
double ratioOfEnds(const std::vector<SizePoint>& sizes)
{
  double low = 0, high = 0;
  for (const SizePoint& s : sizes) (s.position.z() < 0.5 ? low : high) += s.size;
  return low / high;
}

TEST(BalancedSizes, SmallWhereTheStressIsUneven)
{
  RunPlan plan;
  plan.statics = true;
  for (const char* element : {"element=linear", "element=quadratic"})
  {
    // Held at z = 0, where a bar that hangs down bends most
    const auto held = balancedSizes(bar({"model.refine=1", element}), plan);
    ASSERT_EQ(held.size(), 960u);
    EXPECT_LT(ratioOfEnds(held), 0.75);
    // Pressed at the other end, without weight
    const auto pressed =
        balancedSizes(bar({"model.refine=1", element, "gravity=[0,0,0]",
                           "loads=[{box: {min: [-0.01,-0.01,0.99], max: [0.21,0.21,1.01]}, force: [0, 0, -100]}]"}),
                      plan);
    EXPECT_GT(ratioOfEnds(pressed), 1.2 * ratioOfEnds(held));
    // As many elements as there are: the volume over size^3, in the measure of the cell size
    double elements = 0;
    for (const SizePoint& s : held) elements += 0.16 / 960 / std::pow(s.size, 3);
    EXPECT_NEAR(elements, 0.16 / std::pow(0.2, 3), 1e-9);
  }
}

TEST(BalancedSizes, OfAMotionToo)
{
  RunPlan plan;
  plan.duration = 0.2;
  EXPECT_LT(ratioOfEnds(balancedSizes(bar({}), plan)), 0.9);
}

TEST(BalancedSizes, NothingToRefineForWithoutStress)
{
  RunPlan plan;
  plan.statics = true;
  EXPECT_THROW(balancedSizes(bar({"gravity=[0,0,0]"}), plan), InputError);
}

}  // namespace
}  // namespace bezier_fem
