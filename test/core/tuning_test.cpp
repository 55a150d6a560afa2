#include "bezier_fem/tuning.h"

#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <random>
#include <sstream>

#include "bezier_fem/error.h"
#include "bezier_fem/tuning_chart.h"

namespace bezier_fem
{
namespace
{
/** A body whose swing, and whose errors, are known: what tune() is to find out. */
struct Made
{
  double quadratic_order = 1.8, linear_order = 1, quadratic = 0.02, linear = 0.1;  // error of the mesh at h = 0.1 m
  double scatter = 0;                                                              // of the meshes, of that
  double euler = 0.08, second = 0.01;  // error of the time step, of first and second order, at 20 ms
  double tolerance = 0.1;              // error of the tolerance, over it
  bool mesh_is_surface = true;
  mutable int runs = 0;

  Scene scene() const
  {
    Scene s;
    s.model.file = mesh_is_surface ? "/body.off" : "/body.msh";
    if (mesh_is_surface) s.model.cell_size = 0.1;
    return s;
  }

  Recording run(const Scene& s, const RunPlan& plan) const
  {
    ++runs;
    const bool quadratic_element = s.element == Element::QUADRATIC;
    const double h = (s.model.cell_size ? *s.model.cell_size : 0.1) * std::pow(0.5, s.model.refine);
    std::mt19937 random(static_cast<unsigned>(h * 1e6) + (quadratic_element ? 1 : 0));
    const double chance = scatter * std::uniform_real_distribution<double>(-1, 1)(random) * h / 0.1;
    const double space = quadratic_element ? quadratic * (std::pow(h / 0.1, quadratic_order) + chance)
                                           : linear * (std::pow(h / 0.1, linear_order) + chance);
    const double dt = s.time_step / 0.02;
    const double time = plan.statics ? 0 : s.integrator == Integrator::IMPLICIT_EULER ? euler * dt : second * dt * dt;
    Recording r;
    r.nodes = static_cast<int>((quadratic_element ? 2000 : 300) * std::pow(0.1 / h, 3));
    r.ms_per_step = 1e-3 * r.nodes * (1 + std::log10(1 / s.solver.tolerance)) *
                    (s.integrator == Integrator::IMPLICIT_EULER ? 1 : 1.3);
    r.body = {Eigen::Matrix3Xd::Zero(3, 1), Eigen::VectorXd::Ones(1)};
    r.probe_rest = r.body.rest;
    r.von_mises = Eigen::VectorXd::Constant(1, 1 + space);
    const int steps = plan.statics ? 0 : static_cast<int>(std::lround(plan.duration / s.time_step));
    r.ms_per_second = plan.statics ? 0 : r.ms_per_step * steps / plan.duration;
    for (int k = 0; k <= steps; ++k)
    {
      const double t = plan.statics ? 1 : k * s.time_step;
      const double swing = plan.statics ? 1 : std::sin(7 * t);
      // Too stiff, too damped, not quite solved
      const double x = swing * (1 - space) * (1 - time * t) - tolerance * s.solver.tolerance * (plan.statics ? 1 : t);
      r.times.push_back(t);
      r.probes.emplace_back(Eigen::Vector3d(0, x, 0));
    }
    r.points = r.probes;
    return r;
  }

  Recording truth(const TuneRequest& request) const
  {
    Made perfect = *this;
    perfect.quadratic = perfect.second = perfect.tolerance = 0;
    Scene s = scene();
    s.integrator = Integrator::AUTO;
    s.time_step = 0.0025;
    return perfect.run(s, request.plan);
  }

  Tuning tuned(const TuneRequest& request) const
  {
    runs = 0;
    const Scene s = scene();
    return tune(s, request, [&](const Scene& v, const RunPlan& plan, const BodyPoints*) { return run(v, plan); }, {});
  }

  /** Cost of the cheapest model of the whole grid whose true error is below the wanted one. */
  double best(const TuneRequest& request) const
  {
    const Recording exact = truth(request);
    double least = std::numeric_limits<double>::infinity();
    for (const Element element : {Element::LINEAR, Element::QUADRATIC})
    {
      for (int level = mesh_is_surface ? -4 : 0; level <= (mesh_is_surface ? 16 : 4); ++level)
      {
        for (const Integrator integrator : {Integrator::IMPLICIT_EULER, Integrator::AUTO})
        {
          for (int j = -1; j <= 8; ++j)
          {
            for (const double tolerance_ : {1e-1, 1e-2, 1e-3})
            {
              Scene s = scene();
              s.element = element;
              if (mesh_is_surface) s.model.cell_size = 0.1 * std::pow(2, -level / 4.0);
              if (!mesh_is_surface) s.model.refine = level;
              s.integrator = integrator;
              s.time_step = 0.02 * std::pow(2, -j);
              s.solver.tolerance = tolerance_;
              const Recording r = run(s, request.plan);
              const double cost = request.plan.statics ? r.ms_per_step : r.ms_per_second * 0.02;
              if (cost < least && compare(r, exact).tip <= request.error) least = cost;
            }
          }
        }
      }
    }
    return least;
  }

  double trueError(const Tuning& tuning, const TuneRequest& request) const
  {
    return compare(run(with(scene(), tuning.chosen), request.plan), truth(request)).tip;
  }
};

TEST(Tune, MeetsTheErrorAtNoMoreThanTwiceTheLeastCost)
{
  for (const bool surface : {true, false})
  {
    for (const bool statics : {true, false})
    {
      for (const double order : {1.2, 1.8, 2.5})
      {
        for (const double error : {0.05, 0.02, 0.007})
        {
          SCOPED_TRACE(testing::Message() << (surface ? "surface, " : "tetrahedra, ") << (statics ? "static, " : "")
                                          << "order " << order << ", wanted " << error);
          Made made;
          made.mesh_is_surface = surface;
          made.quadratic_order = order;
          TuneRequest request;
          request.error = error;
          request.plan.statics = statics;
          request.plan.duration = 0.5;
          const Tuning tuning = made.tuned(request);
          const int runs = made.runs;
          ASSERT_TRUE(tuning.accurate) << tuning.why;
          EXPECT_LE(tuning.error, error);
          const double true_error = made.trueError(tuning, request);
          EXPECT_LE(true_error, tuning.error) << "the estimate is honest";
          // What misses the error by less than the reference is uncertain by cannot be told from what meets it.
          TuneRequest narrower = request;
          narrower.error = 0.8 * error;
          EXPECT_LE(tuning.cost, 2 * made.best(narrower)) << tuning.why;
          EXPECT_LT(runs, 60) << "it stops early";
        }
      }
    }
  }
}

// Neighbouring meshes of a surface scatter; differences cannot know all of it.
TEST(Tune, EstimatesHoldForMeshesThatScatter)
{
  int wrong = 0, missed = 0, accurate = 0;
  for (int k = 0; k < 20; ++k)
  {
    Made made;
    made.scatter = 0.02 * k;
    made.quadratic = 0.015 + 0.003 * k;
    TuneRequest request;
    request.plan.statics = true;
    const Tuning tuning = made.tuned(request);
    accurate += tuning.accurate;
    wrong += made.trueError(tuning, request) > tuning.error;
    missed += tuning.accurate && made.trueError(tuning, request) > request.error;
  }
  EXPECT_LE(wrong, 4);
  EXPECT_LE(missed, 1);
  EXPECT_GT(accurate, 10);
}

TEST(Tune, SaysWhatABudgetBuys)
{
  const Made made;
  TuneRequest request;
  const Tuning free = made.tuned(request);
  ASSERT_TRUE(free.accurate);
  request.budget_ms = free.cost / 5;
  const Tuning bound = made.tuned(request);
  EXPECT_FALSE(bound.accurate);
  EXPECT_TRUE(bound.affordable);
  EXPECT_LE(bound.cost, *request.budget_ms);
  EXPECT_GT(bound.error, request.error);
  EXPECT_LE(made.trueError(bound, request), bound.error);
  EXPECT_NE(bound.why.find("budget"), std::string::npos) << bound.why;
  request.budget_ms = free.cost * 1.5;
  EXPECT_TRUE(made.tuned(request).accurate);
}

TEST(Tune, TakesAGradedMeshWhereThatIsCheaper)
{
  const Made made;
  const std::string file = testing::TempDir() + "tuning.sizing.csv";
  TuneRequest request;
  const Tuning uniform = made.tuned(request);
  request.local = {file, [](const Scene& s, const RunPlan&) {
                     return std::vector<SizePoint>(3, {Eigen::Vector3d::Zero(), *s.model.cell_size});
                   }};
  for (const double gain : {0.3, 1.5})  // of error, of as many elements
  {
    const Runner run = [&](const Scene& s, const RunPlan& plan, const BodyPoints*) {
      if (!s.model.sizing) return made.run(s, plan);
      Made graded = made;
      graded.quadratic *= gain;
      Scene as_many = s;
      as_many.model.cell_size = readSizing(*s.model.sizing).front().size;
      return graded.run(as_many, plan);
    };
    std::remove(file.c_str());
    const Tuning tuning = tune(made.scene(), request, run, {});
    EXPECT_TRUE(tuning.accurate);
    EXPECT_EQ(tuning.chosen.sizing.has_value(), gain < 1) << tuning.why;
    EXPECT_EQ(std::ifstream(file).good(), gain < 1) << "written, or taken back";
    EXPECT_LT(tuning.cost, (gain < 1 ? 0.7 : 1.01) * uniform.cost);
  }
  Made tetrahedra;
  tetrahedra.mesh_is_surface = false;
  EXPECT_THROW(tetrahedra.tuned(request), InputError);
}

TEST(Tune, SaysWhenTheErrorCannotBeShown)
{
  Made made;
  made.quadratic_order = 0.3;  // no mesh comes near
  made.linear_order = 0.2;
  TuneRequest request;
  request.error = 0.001;
  const Tuning tuning = made.tuned(request);
  EXPECT_FALSE(tuning.accurate);
  EXPECT_GT(tuning.error, request.error);
  EXPECT_NE(tuning.why.find("could not be shown"), std::string::npos) << tuning.why;
}

TEST(Tune, RefusesWhatHasNoError)
{
  const Made made;
  const Scene scene = made.scene();
  TuneRequest request;
  request.quantity = Quantity::STRESS;
  const Runner without_probes = [&](const Scene& s, const RunPlan& plan, const BodyPoints*) {
    Recording r = made.run(s, plan);
    r.probe_rest.resize(3, 0);
    for (auto& x : r.probes) x.resize(3, 0);
    return r;
  };
  EXPECT_THROW(tune(scene, request, without_probes, {}), InputError);
  const Runner refused = [](const Scene&, const RunPlan&, const BodyPoints*) {
    Recording r;
    r.status = RunStatus::REFUSED;
    r.reason = "wrong";
    return r;
  };
  EXPECT_THROW(tune(scene, {}, refused, {}), InputError);
}

TEST(TuningChart, HasEveryTrialAndIsXml)
{
  const Made made;
  const Tuning tuning = made.tuned({});
  const std::string csv = testing::TempDir() + "tuning.csv", svg = testing::TempDir() + "tuning.svg";
  writeTuningCsv(csv, tuning);
  writeTuningChart(svg, tuning, {});
  std::ifstream rows(csv);
  std::string line;
  std::size_t count = 0;
  const auto commas = [](const std::string& text) { return std::count(text.begin(), text.end(), ','); };
  std::getline(rows, line);
  const auto columns = commas(line);
  while (std::getline(rows, line))
  {
    EXPECT_EQ(commas(line), columns);
    ++count;
  }
  EXPECT_EQ(count, tuning.trials.size());
  std::ostringstream picture;
  picture << std::ifstream(svg).rdbuf();
  const std::string text = picture.str();
  EXPECT_EQ(text.rfind("<svg", 0), 0u);
  EXPECT_NE(text.find("</svg>"), std::string::npos);
  std::size_t circles = 0;
  for (std::size_t at = text.find("<circle"); at != std::string::npos; at = text.find("<circle", at + 1)) ++circles;
  EXPECT_GT(circles, 5u);
  EXPECT_EQ(text.find("nan"), std::string::npos);
  EXPECT_THROW(writeTuningCsv("/nowhere/x.csv", tuning), InputError);
}

}  // namespace
}  // namespace bezier_fem
