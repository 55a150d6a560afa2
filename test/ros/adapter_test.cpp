// The parts of the node that need no master.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <limits>

#include "bezier_fem/simulation.h"
#include "color_map.h"
#include "markers.h"
#include "pacer.h"
#include "scene_from_parameters.h"

namespace bezier_fem
{
namespace
{
using XmlRpc::XmlRpcValue;

TEST(ToYaml, KeepsTypes)
{
  EXPECT_EQ(toYaml(XmlRpcValue(true)), "true");
  EXPECT_EQ(toYaml(XmlRpcValue(-7)), "-7");
  EXPECT_EQ(toYaml(XmlRpcValue(3.0)), "3.0");
  EXPECT_EQ(toYaml(XmlRpcValue("3.0")), "\"3.0\"");
  EXPECT_EQ(toYaml(XmlRpcValue("true")), "\"true\"");
  EXPECT_EQ(toYaml(XmlRpcValue("")), "\"\"");
  EXPECT_EQ(toYaml(XmlRpcValue("a \"b\"\\c\n: #\t")), "\"a \\\"b\\\"\\\\c\\x0a: #\\x09\"");
  EXPECT_EQ(toYaml(XmlRpcValue("Bär")), "\"Bär\"");
  EXPECT_EQ(toYaml(XmlRpcValue()), "null");
}

TEST(ToYaml, LosesNoDigit)
{
  for (const double value : {0.1, 1.0 / 3, 2e5, 1e300, 5e-324, -1e-7, 123456789012345678.0, -0.0})
  {
    const std::string text = toYaml(XmlRpcValue(value));
    EXPECT_EQ(std::strtod(text.c_str(), nullptr), value) << text;
    EXPECT_NE(text.find_first_of(".e"), std::string::npos) << text;
  }
  EXPECT_EQ(toYaml(XmlRpcValue(std::numeric_limits<double>::infinity())), ".inf");
  EXPECT_EQ(toYaml(XmlRpcValue(-std::numeric_limits<double>::infinity())), "-.inf");
  EXPECT_EQ(toYaml(XmlRpcValue(std::nan(""))), ".nan");
}

TEST(ToYaml, Nests)
{
  XmlRpcValue value;
  value["box"]["min"][0] = -1;
  value["box"]["min"][1] = 0.5;
  value["on"] = true;
  value["text"].setSize(0);
  EXPECT_EQ(toYaml(value), R"({"box": {"min": [-1, 0.5]}, "on": true, "text": []})");
}

TEST(Pacer, OwesAStepForEveryTimeStepThatPasses)
{
  Pacer pacer(0.02);
  ros::Time now(1000, 0);
  pacer.advance(now);
  int steps = 0;
  for (int i = 0; i < 1000; ++i)
  {
    now += ros::Duration(0.007);
    EXPECT_FALSE(pacer.advance(now));
    while (pacer.stepDue())
    {
      pacer.stepped();
      ++steps;
    }
    EXPECT_NEAR(pacer.stateTime(now).toSec(), 1000 + steps * 0.02, 1e-6);
    EXPECT_LE((now - pacer.stateTime(now)).toSec(), 0.02);
  }
  EXPECT_NEAR(steps, 350, 1);
  EXPECT_EQ(pacer.dropped(), 0);
}

TEST(Pacer, StepsOnEveryTickOfAClockOfTheSamePeriod)
{
  Pacer pacer(0.02);
  for (int i = 0; i < 1000; ++i)
  {
    pacer.advance(ros::Time(100 + 0.02 * i));
    EXPECT_EQ(pacer.stepDue(), i > 0) << i;
    if (i > 0) pacer.stepped();
  }
}

TEST(Pacer, BoundsItsBacklogAndTellsWhatItDropped)
{
  Pacer pacer(0.02);
  pacer.advance(ros::Time(1000, 0));
  pacer.advance(ros::Time(1010, 0));
  int steps = 0;
  for (; pacer.stepDue(); ++steps) pacer.stepped();
  EXPECT_LE(steps, 5);
  EXPECT_NEAR(pacer.dropped() + steps * 0.02, 10, 1e-9);
}

TEST(Pacer, KeepsALongStepInHand)
{
  Pacer pacer(0.5);
  pacer.advance(ros::Time(1000, 0));
  for (int i = 1; i <= 4; ++i)
  {
    EXPECT_FALSE(pacer.stepDue());
    pacer.advance(ros::Time(1000 + 0.125 * i));
  }
  EXPECT_TRUE(pacer.stepDue());
  EXPECT_EQ(pacer.dropped(), 0);
}

TEST(Pacer, OwesNothingForAClockThatStandsOrJumpsBack)
{
  Pacer pacer(0.02);
  EXPECT_FALSE(pacer.advance(ros::Time()));
  EXPECT_FALSE(pacer.advance(ros::Time(50, 0)));
  EXPECT_FALSE(pacer.stepDue());
  EXPECT_FALSE(pacer.advance(ros::Time(50, 0)));
  EXPECT_TRUE(pacer.advance(ros::Time(20, 0)));
  EXPECT_FALSE(pacer.stepDue());
  EXPECT_FALSE(pacer.advance(ros::Time(20.05)));
  EXPECT_TRUE(pacer.stepDue());
  pacer.restart();
  EXPECT_FALSE(pacer.stepDue());
}

TEST(RealTimeFactor, IsTheSlopeOfTheLastSecond)
{
  RealTimeFactor factor;
  EXPECT_EQ(factor.value(), 0);
  double simulated = 0, clock = 7;
  for (int i = 0; i < 1000; ++i) factor.add(simulated += 0.001, clock += 0.01);
  EXPECT_NEAR(factor.value(), 0.1, 1e-3);
  for (int i = 0; i < 1000; ++i) factor.add(simulated += 0.001, clock += 0.002);
  EXPECT_NEAR(factor.value(), 0.5, 1e-3);
  factor.add(0, clock += 0.01);  // after a reset
  EXPECT_EQ(factor.value(), 0);
}

TEST(SmoothedScale, FollowsWithoutJumpsAndNeverVanishes)
{
  SmoothedScale scale(1e-3);
  EXPECT_EQ(scale.value(), 1e-3);
  scale.update(10, 0.03);
  EXPECT_EQ(scale.value(), 10);
  double last = scale.value();
  for (int i = 0; i < 100; ++i)  // 3 s
  {
    scale.update(2, 0.03);
    EXPECT_LT(scale.value(), last);
    EXPECT_GT(scale.value(), 0.95 * last);
    last = scale.value();
  }
  EXPECT_LT(last, 5);
  scale.update(std::numeric_limits<double>::infinity(), 0.03);
  scale.update(std::nan(""), 0.03);
  EXPECT_EQ(scale.value(), last);
  scale.update(1e200, 0.03);
  scale.update(1, 0.03);
  EXPECT_LT(scale.value(), 2);
}

/** Relative luminance of sRGB. */
double luminance(const Eigen::Vector3f& rgb)
{
  const auto linear = [](float c) { return c <= 0.04045F ? c / 12.92 : std::pow((c + 0.055) / 1.055, 2.4); };
  return 0.2126 * linear(rgb[0]) + 0.7152 * linear(rgb[1]) + 0.0722 * linear(rgb[2]);
}

TEST(ColorMap, GrowsLighterAllTheWay)
{
  for (int i = 1; i <= 64; ++i)
  {
    EXPECT_GT(luminance(colorOf(i / 64.0)), luminance(colorOf((i - 1) / 64.0)) + 1e-3) << i;
    EXPECT_GE(colorOf(i / 64.0).minCoeff(), 0);
    EXPECT_LE(colorOf(i / 64.0).maxCoeff(), 1);
  }
  EXPECT_EQ(colorOf(-3), colorOf(0));
  EXPECT_EQ(colorOf(1e9), colorOf(1));
}

TEST(Legend, HasAFewRoundValues)
{
  const Eigen::AlignedBox3d body(Eigen::Vector3d::Zero(), Eigen::Vector3d::Ones());
  for (double largest = 1.1e-4; largest < 1e12; largest *= 1.7)
  {
    visualization_msgs::MarkerArray markers;
    addLegend(std_msgs::Header(), body, largest, markers);
    int ticks = 0;
    for (const auto& marker : markers.markers)
    {
      if (marker.type != visualization_msgs::Marker::TEXT_VIEW_FACING) continue;
      if (marker.action == visualization_msgs::Marker::ADD && marker.id > 1) ++ticks;
    }
    EXPECT_GE(ticks, 4) << largest;
    EXPECT_LE(ticks, 8) << largest;
    EXPECT_NE(markers.markers[1].text.find("Pa"), std::string::npos);
  }
}

}  // namespace
}  // namespace bezier_fem
