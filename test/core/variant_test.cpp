#include "bezier_fem/variant.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>

#include "core/bar.h"

namespace bezier_fem
{
namespace
{
const auto NO_LOG = [](const std::string&) {};

Scene bar(const std::vector<std::string>& overrides = {})
{
  return loadScene(TEST_DATA_DIR "/../../config/bar.yaml", overrides);
}

/** One probe at 0 and one body point that follow x = reach cos(w t) exp(-d t), recorded every `interval`. */
Recording oscillator(double interval, double reach = 1, double w = 10, double d = 0.5, double phase = 0)
{
  Recording r;
  r.starts_at_rest = false;
  r.body = {Eigen::Matrix3Xd::Zero(3, 1), Eigen::VectorXd::Ones(1)};
  r.probe_rest = Eigen::Matrix3Xd::Zero(3, 1);
  r.von_mises = Eigen::VectorXd::Constant(1, reach);
  for (int k = 0; k * interval <= 2 + 1e-9; ++k)
  {
    const double t = k * interval;
    r.times.push_back(t);
    r.probes.emplace_back(Eigen::Vector3d(0, reach * std::exp(-d * t) * std::cos(w * t + phase), 0));
  }
  r.points = r.probes;
  return r;
}

TEST(BodyPoints, StandForTheVolume)
{
  const Model model = test::boxModel(test::irregularBox({4, 3, 5}, {0.4, 0.3, 1}), Element::LINEAR);
  const BodyPoints points = bodyPoints(model);
  const double volume = 0.4 * 0.3;
  EXPECT_NEAR(points.weights.sum(), volume, 1e-12);
  const Eigen::Array3d size(0.4, 0.3, 1);
  EXPECT_TRUE((points.rest.array() >= -1e-12).all());
  EXPECT_TRUE((points.rest.array() <= size.replicate(1, points.rest.cols()) + 1e-12).all());
  // Means of x, x^2 and xy over the body, which integrals of a smooth field are made of
  const Eigen::Vector3d mean = points.rest * points.weights / volume;
  const Eigen::Matrix3d moments = points.rest * points.weights.asDiagonal() * points.rest.transpose() / volume;
  for (int i = 0; i < 3; ++i)
  {
    EXPECT_NEAR(mean[i], size[i] / 2, 0.01 * size[i]);
    for (int j = 0; j < 3; ++j)
    {
      EXPECT_NEAR(moments(i, j), size[i] * size[j] / (i == j ? 3 : 4), 0.012 * size[i] * size[j]);
    }
  }
}

TEST(TurningPoints, PeriodAndDecayOfADampedCosine)
{
  const double w = 10, d = 0.5;
  for (const double interval : {0.04, 0.01})
  {
    const Swing swing = swingOf(oscillator(interval, 0.3, w, d, 0.4));
    EXPECT_NEAR(swing.period, 2 * M_PI / w, interval * interval);
    EXPECT_NEAR(swing.decay, 1 - std::exp(-d * 2 * M_PI / w), interval * interval * 5);
  }
}

TEST(TurningPoints, NoSwingWhereNothingSwings)
{
  std::vector<double> times, creeping, still;
  for (int k = 0; k < 100; ++k)
  {
    times.push_back(0.01 * k);
    creeping.push_back(1 - std::exp(-0.05 * k) + 1e-3 * std::sin(k));  // a ripple is no swing
    still.push_back(0);
  }
  EXPECT_LT(turningPoints(times, creeping, true).size(), 3u);
  EXPECT_TRUE(turningPoints(times, still, true).empty());
  EXPECT_TRUE(std::isnan(swingOf({}, 0).period));
}

TEST(Compare, KnownDifferences)
{
  const Recording reference = oscillator(0.01);
  const VariantErrors none = compare(reference, reference);
  EXPECT_EQ(none.tip, 0);
  EXPECT_EQ(none.field_max, 0);
  EXPECT_EQ(none.period, 0);
  EXPECT_EQ(none.decay, 0);

  const VariantErrors larger = compare(oscillator(0.01, 1.1), reference);  // everything a tenth larger
  EXPECT_NEAR(larger.field_max, 0.1, 1e-12);
  EXPECT_NEAR(larger.von_mises, 0.1, 1e-12);
  double squares = 0;
  for (const Eigen::Matrix3Xd& x : reference.probes) squares += x.squaredNorm();
  EXPECT_NEAR(larger.tip, 0.1 * std::sqrt(squares / static_cast<double>(reference.times.size())), 1e-12);
  EXPECT_EQ(larger.tip, larger.field_rms);
  EXPECT_NEAR(larger.period, 0, 1e-9);
  EXPECT_NEAR(larger.decay, 0, 1e-9);

  const VariantErrors slower = compare(oscillator(0.01, 1, 10 / 1.05, 0.8), reference);
  EXPECT_NEAR(slower.period, 0.05, 2e-3);
  const auto lost = [](double w, double d) { return 1 - std::exp(-d * 2 * M_PI / w); };
  EXPECT_NEAR(slower.decay, lost(10 / 1.05, 0.8) - lost(10, 0.5), 5e-3);
}

// What the header says that different times of recording cost
TEST(Compare, TimesInBetweenAreInterpolated)
{
  for (const double interval : {0.04, 0.02})
  {
    const double bound = 0.023 * std::pow(10 * interval, 4);
    const VariantErrors errors = compare(oscillator(interval), oscillator(interval * 0.7));
    EXPECT_GT(errors.field_max, 0);
    EXPECT_LT(errors.field_max, 1.1 * bound);
  }
}

TEST(Record, TheSameSceneTwiceIsTheSame)
{
  RunPlan plan;
  plan.duration = 0.1;
  const Recording reference = record(bar(), plan, nullptr, NO_LOG);
  ASSERT_EQ(reference.status, RunStatus::OK) << reference.reason;
  EXPECT_EQ(reference.tets, 120);
  EXPECT_EQ(reference.degrees_of_freedom, 750);
  EXPECT_EQ(reference.steps, 5);
  EXPECT_EQ(reference.times.size(), 6u);
  EXPECT_GT(reference.ms_per_step, 0);
  EXPECT_GT(reference.ms_per_second, 0);
  const VariantErrors errors = compare(record(bar(), plan, &reference.body, NO_LOG), reference);
  EXPECT_EQ(errors.tip, 0);
  EXPECT_EQ(errors.field_max, 0);
  EXPECT_EQ(errors.von_mises, 0);
}

TEST(Record, FinerMeshesAndStepsComeNearer)
{
  RunPlan statics;
  statics.statics = true;
  const Recording truth = record(bar({"model.refine=2"}), statics, nullptr, NO_LOG);
  double last = 1;
  for (const char* mesh : {"element=linear", "model.refine=0", "model.refine=1"})
  {
    const VariantErrors errors = compare(record(bar({mesh}), statics, &truth.body, NO_LOG), truth);
    EXPECT_LT(errors.tip, 0.6 * last) << mesh;
    EXPECT_LE(errors.field_rms, errors.field_max);
    last = errors.tip;
  }
  RunPlan plan;
  plan.duration = 0.4;
  const Recording moved = record(bar({"time_step=0.00125"}), plan, nullptr, NO_LOG);
  last = 1;
  for (const char* step : {"time_step=0.04", "time_step=0.02", "time_step=0.01", "time_step=0.005"})
  {
    const double error = compare(record(bar({step}), plan, &moved.body, NO_LOG), moved).tip;
    EXPECT_LT(error, 0.75 * last) << step;
    last = error;
  }
}

TEST(Record, WhatGoesWrongIsInTheStatus)
{
  RunPlan plan;
  plan.duration = 0.1;
  const Recording reference = record(bar(), plan, nullptr, NO_LOG);
  Scene nowhere = bar();
  nowhere.fixed[0].region.box = Region::Box{{9, 9, 9}, {10, 10, 10}};
  const Recording refused = record(nowhere, plan, &reference.body, NO_LOG);
  EXPECT_EQ(refused.status, RunStatus::REFUSED);
  EXPECT_NE(refused.reason.find("fixed[0]"), std::string::npos) << refused.reason;
  EXPECT_TRUE(std::isnan(compare(refused, reference).tip));

  const Recording rough =
      record(bar({"solver.max_iterations=1", "solver.preconditioner=block_jacobi"}), plan, &reference.body, NO_LOG);
  EXPECT_EQ(rough.status, RunStatus::NOT_CONVERGED);
  EXPECT_GT(compare(rough, reference).tip, 0);

  plan.time_limit = 1e-9;
  EXPECT_EQ(record(bar(), plan, &reference.body, NO_LOG).status, RunStatus::STOPPED);
  plan.statics = true;
  EXPECT_EQ(record(bar(), plan, &reference.body, NO_LOG).status, RunStatus::STOPPED);
  plan = {};
  EXPECT_EQ(record(bar({"integrator=static"}), plan, &reference.body, NO_LOG).status, RunStatus::REFUSED);
}

}  // namespace
}  // namespace bezier_fem
