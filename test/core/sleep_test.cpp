// A body at rest sleeps, a body that only looks as if does not, and whatever acts on it wakes it.

#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <functional>

#include "bezier_fem/rest_watch.h"
#include "bezier_fem/simulation.h"
#include "core/bar.h"

namespace bezier_fem
{
namespace
{
using Eigen::Vector3d;

constexpr double SIZE = 1, MAY_REMAIN = 1e-5 * SIZE;  // m

/** A watch over a body that moves as it is told. */
class RestWatchTest : public testing::Test
{
protected:
  Model model = test::boxModel(test::kuhnBox({1, 1, 2}, {0.4, 0.4, SIZE}), Element::LINEAR, test::RUBBER);
  RestWatch watch{model, 1e-4};
  NodalField v{model.num_nodes}, load{model.num_nodes};

  /** Steps until it sleeps; returns when, s, or infinity. */
  double sleepsAt(const std::function<double(double)>& speed, double time_step, double duration, bool solved = true)
  {
    watch.wake();
    const long steps = std::lround(duration / time_step);
    for (long k = 1; k <= steps; ++k)
    {
      v[3] = Vector3d(0, speed(static_cast<double>(k) * time_step), 0);
      watch.stepped(v, load, time_step, solved);
      if (watch.asleep()) return static_cast<double>(k) * time_step;
    }
    return std::numeric_limits<double>::infinity();
  }
};

TEST_F(RestWatchTest, ASwingIsNotAtRestWhereItTurns)
{
  for (const double period : {0.1, 1.0, 7.3, 100.0})
  {
    for (const double time_step : {period / 1000, period / 37.3, period / 4, 2.77 * period})
    {
      for (const double decay : {0.0, 0.03, 0.5})  // of the logarithm, a radian
      {
        for (const double phase : {0.0, 0.4, 1.2, M_PI / 2})
        {
          const double rate = 2 * M_PI / period, amplitude = 0.1;
          const auto envelope = [&](double t) { return amplitude * std::exp(-decay * rate * t); };
          const auto speed = [&](double t) { return envelope(t) * rate * std::cos(rate * t + phase); };
          const double duration = std::min(60 * period, 20000 * time_step);
          const double end = sleepsAt(speed, time_step, duration);
          // A step as long as the period shows what it shows: an envelope.
          if (std::isfinite(end))
          {
            EXPECT_LT(envelope(end), MAY_REMAIN) << period << ' ' << time_step << ' ' << phase;
          }
          else
          {
            EXPECT_GT(envelope(duration), 1e-3 * MAY_REMAIN) << period << ' ' << time_step << ' ' << phase;
          }
        }
      }
    }
  }
}

TEST_F(RestWatchTest, ACreepingBodyIsNotFrozen)
{
  for (const double time : {0.01, 1.0, 30.0, 1000.0})
  {
    for (const double time_step : {0.001, 0.02, 1.0})
    {
      const auto left = [&](double t) { return 0.1 * std::exp(-t / time); };
      const double end = sleepsAt([&](double t) { return left(t) / time; }, time_step, 50 * time + 100 * time_step);
      ASSERT_TRUE(std::isfinite(end)) << time << ' ' << time_step;
      EXPECT_LT(left(end), MAY_REMAIN) << time << ' ' << time_step;
    }
  }
  EXPECT_EQ(sleepsAt([](double) { return 1e-9; }, 0.02, 1e3), std::numeric_limits<double>::infinity());
  EXPECT_LT(sleepsAt([](double t) { return 1e-13 * (1 + std::sin(1e3 * t)); }, 0.02, 1e3), 10);  // trembling
  // Falling over: from nothing, but faster and faster.
  EXPECT_EQ(sleepsAt([](double t) { return 1e-15 * std::exp(t); }, 0.02, 30), std::numeric_limits<double>::infinity());
  // A body that rings and creeps: the creep shows when the ringing is gone.
  const double end = sleepsAt([](double t) { return std::exp(-3 * t) + 1e-3 / 50 * std::exp(-t / 50); }, 0.02, 1e3);
  EXPECT_LT(1e-3 * std::exp(-end / 50), MAY_REMAIN);
}

TEST_F(RestWatchTest, NothingThatMovesSleepsAtOnceUnlessItIsUnsolvedOrItsLoadsChange)
{
  EXPECT_NEAR(sleepsAt([](double) { return 0.0; }, 0.02, 1), 0.3, 1e-9);
  EXPECT_EQ(sleepsAt([](double) { return 0.0; }, 0.02, 1, false), std::numeric_limits<double>::infinity());
  watch.wake();
  v.setZero();
  for (int k = 0; k < 100; ++k)
  {
    load[2].x() = 1 + 1e-3 * k;
    watch.stepped(v, load, 0.02, true);
    EXPECT_FALSE(watch.asleep());
  }
  for (int k = 0; k < 100; ++k) watch.stepped(v, load, 0.02, true);
  EXPECT_TRUE(watch.asleep());
  NodalField other = load;
  other[2].x() *= 1 + 1e-7;
  EXPECT_FALSE(watch.isOtherLoad(other));
  other[2].x() = load[2].x() * (1 + 1e-5);
  EXPECT_TRUE(watch.isOtherLoad(other));
  other = load;
  other[5].z() = std::nan("");
  EXPECT_TRUE(watch.isOtherLoad(other));
}

/** The bar of config/, damped so that it soon stands still. */
class Sleep : public testing::Test
{
protected:
  static std::string bar() { return TEST_DATA_DIR "/../../config/bar.yaml"; }
  static Simulation simulation(std::vector<std::string> overrides = {})
  {
    overrides.insert(overrides.begin(), "damping.mass=15");
    return Simulation(loadScene(bar(), overrides), 1, [](const std::string&) {});
  }
  /** Steps until it sleeps. */
  static int stepsAwake(Simulation& body, int most = 2000)
  {
    for (int k = 0; k < most; ++k)
    {
      if (body.step().asleep) return k;
    }
    return most;
  }
};

TEST_F(Sleep, EveryLawAndIntegratorComesToTheEquilibriumAndStaysThere)
{
  for (const char* kind : {"elasticity=corotated", "elasticity=green", "elasticity=linear", "element=linear",
                           "rotation=four", "integrator=sdirk2", "integrator=auto"})
  {
    Simulation body = simulation({kind});
    ASSERT_LT(stepsAwake(body), 1000) << kind;
    const NodalField x = body.state().x;
    const Vector3d held = body.reactions()[0].force;
    const Energies energies = body.energies();
    const double time = body.time();
    for (int k = 1; k <= 100; ++k)
    {
      const StepReport report = body.step();
      EXPECT_TRUE(report.asleep && report.converged && report.finite);
      EXPECT_EQ(report.iterations, 0);
      EXPECT_NEAR(body.time(), time + 0.02 * k, 1e-9);
    }
    EXPECT_EQ(body.state().v.matrix().norm(), 0);
    EXPECT_EQ((body.state().x.matrix() - x.matrix()).norm(), 0);
    EXPECT_EQ(body.reactions()[0].force, held);
    EXPECT_NEAR(held.y(), 9.81 * body.model().mass(), 1e-3 * held.y());
    EXPECT_EQ(body.energies().elastic, energies.elastic);
    EXPECT_EQ(body.energies().kinetic, 0);
    Simulation statics = simulation({kind, "solver.tolerance=1.0e-9"});
    EXPECT_TRUE(statics.solveStatic().converged);
    EXPECT_LT((statics.state().x.matrix() - x.matrix()).colwise().norm().maxCoeff(), MAY_REMAIN) << kind;
  }
}

TEST_F(Sleep, AStiffBodySleepsThoughRoundingShakesIt)
{
  for (const char* young : {"1.0e+8", "1.0e+9", "1.0e+12"})
  {
    Simulation body = simulation({"damping.mass=0", std::string("material.young=") + young});
    EXPECT_LT(stepsAwake(body), 500) << young;
  }
}

TEST_F(Sleep, AnUndampedBarIsAwakeForAllItsSwings)
{
  for (const char* time_step : {"time_step=0.02", "time_step=0.001"})
  {
    Simulation body = simulation({"damping.mass=0", "integrator=auto", time_step});
    EXPECT_EQ(stepsAwake(body, 500), 500) << time_step;
  }
}

TEST_F(Sleep, TheSameRunIsTheSameToTheBit)
{
  NodalField last;
  for (int run = 0; run < 2; ++run)
  {
    Simulation body = simulation();
    const int awake = stepsAwake(body);
    body.externalForces()[body.model().num_nodes - 1] = Vector3d(1, 2, 3);
    for (int k = 0; k < 20; ++k) EXPECT_FALSE(body.step().asleep);
    body.reset();
    EXPECT_FALSE(body.step().asleep);
    body.externalForces().setZero();
    body.reset();
    EXPECT_EQ(stepsAwake(body), awake);
    if (run == 1)
    {
      EXPECT_EQ((body.state().x.matrix() - last.matrix()).norm(), 0);
    }
    last = body.state().x;
  }
}

TEST_F(Sleep, WhateverActsWakesItAndItsAnswerIsThatOfABodyAwake)
{
  const auto lastNode = [](Simulation& body) { return body.model().num_nodes - 1; };
  const std::vector<std::pair<const char*, std::function<void(Simulation&)>>> inputs{
      {"force", [&](Simulation& body) { body.externalForces()[lastNode(body)] = Vector3d(0, 5, 0); }},
      {"gravity",
       [](Simulation& body) {
         body.setGravity({0, 0, -9.81});
       }},
      {"material",
       [](Simulation& body) {
         body.setMaterial({1e5, 0.3, 500});
       }},
      {"support",
       [](Simulation& body) { body.setRegionPose(0, Eigen::Isometry3d(Eigen::Translation3d(0, 0, 0.01))); }}};
  for (const auto& [name, act] : inputs)
  {
    Simulation body = simulation({"fixed[0].frame=hand"});
    const int awake = stepsAwake(body);
    ASSERT_LT(awake, 1000);
    Simulation other = simulation({"fixed[0].frame=hand"});
    for (int k = 0; k < awake; ++k) ASSERT_FALSE(other.step().asleep);
    // The same again is nothing new.
    body.setGravity({0, -9.81, 0});
    body.setDamping({15, 0});
    body.externalForces().setZero();
    body.setRegionPose(0, Eigen::Isometry3d::Identity());
    for (int k = 0; k < 50; ++k) EXPECT_TRUE(body.step().asleep);

    const NodalField rest = body.state().x;
    act(body);
    act(other);
    for (int k = 0; k < 10; ++k)
    {
      EXPECT_FALSE(body.step().asleep) << name;
      other.step();
    }
    EXPECT_GT((body.state().x.matrix() - rest.matrix()).colwise().norm().maxCoeff(), 100 * MAY_REMAIN) << name;
    EXPECT_LT((body.state().x.matrix() - other.state().x.matrix()).colwise().norm().maxCoeff(), MAY_REMAIN) << name;
    EXPECT_LT(stepsAwake(body), 1000) << name;
  }
}

TEST_F(Sleep, ASceneThatGoesOnWakesItByItself)
{
  const std::string file = testing::TempDir() + "sleep_motion.csv";
  std::ofstream(file) << "time,x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n20,0,0,0,0,0,0,1\n30,0,0,0.05,0,0,0,1\n";
  const std::string end = "box: {min: [-1, -1, 0.99], max: [1, 1, 1.01]}";
  for (const std::string& change : {"loads=[{" + end + ", force: [5, 0, 0], from: 20}]",
                                    "loads=[{" + end + ", pressure: 100, until: 20}]", "fixed[0].motion=" + file})
  {
    Simulation body = simulation({change});
    ASSERT_LT(stepsAwake(body), 900) << change;
    while (body.state().steps < 1000) EXPECT_TRUE(body.step().asleep) << change;
    EXPECT_NEAR(body.time(), 20, 1e-9);
    EXPECT_FALSE(body.step().asleep) << change;
  }
}

TEST_F(Sleep, AFreeBodyThatFloatsIsAwakeAndOneThatStandsSleeps)
{
  Simulation floats =
      simulation({"damping.mass=0", "gravity=[0, 0, 0]", "fixed=[]", "initial.velocity=[1.0e-5, 0, 0]"});
  EXPECT_EQ(stepsAwake(floats, 300), 300);
  EXPECT_NEAR(floats.state().v[0].x(), 1e-5, 1e-9);
  Simulation stands = simulation({"gravity=[0, 0, 0]", "fixed=[]"});
  EXPECT_EQ(stepsAwake(stands), 15);
}

}  // namespace
}  // namespace bezier_fem
