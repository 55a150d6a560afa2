#include "bezier_fem/meshed_surface.h"

#include <gtest/gtest.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <set>

#include "bezier_fem/error.h"
#include "bezier_fem/simulation.h"
#include "core/surface_fixtures.h"

namespace bezier_fem
{
namespace
{
namespace fs = std::filesystem;

class MeshedSurface : public testing::Test
{
protected:
  void SetUp() override
  {
    setenv("XDG_CACHE_HOME", (directory_ / "cache").c_str(), 1);
    ball_ = directory_.write("ball.off", offText(sphere(3)));
  }

  std::string mesh(double cell_size = 0.5, double scale = 1, const std::vector<SizePoint>& sizing = {})
  {
    log_.clear();
    return meshedSurface(ball_, cell_size, scale, sizing, [this](const std::string& line) { log_.push_back(line); });
  }

  /** The message of the InputError that mesh() throws. */
  std::string refusal()
  {
    try
    {
      mesh();
    }
    catch (const InputError& error)
    {
      EXPECT_EQ(std::string(error.what()).find('\n'), std::string::npos) << error.what();
      return error.what();
    }
    ADD_FAILURE() << "no InputError";
    return "";
  }

  const TemporaryDirectory directory_;
  std::string ball_;
  std::vector<std::string> log_;
};

TEST_F(MeshedSurface, MeshesOnceAndRemembers)
{
  const std::string first = mesh();
  EXPECT_EQ(first.find(directory_ / "cache/bezier_fem/ball-"), 0u) << first;
  EXPECT_GE(log_.size(), 3u);  // what make_model prints
  const std::string content = contentOf(first);
  EXPECT_NE(content.find("$EndElements"), content.npos);

  EXPECT_EQ(mesh(), first);
  EXPECT_TRUE(log_.empty());  // make_model did not run

  // The same surface elsewhere is the same model; other content, cell size or scale is another.
  fs::create_directory(directory_ / "copy");
  ball_ = directory_.write("copy/ball.off", offText(sphere(3)));
  EXPECT_EQ(mesh(), first);
  EXPECT_TRUE(log_.empty());
  const std::string finer = mesh(0.4), larger = mesh(0.5, 1.1);
  ball_ = directory_.write("copy/ball.off", offText(sphere(2)));
  const std::string other = mesh();
  EXPECT_EQ((std::set<std::string>{first, finer, larger, other}.size()), 4u);
  EXPECT_EQ(contentOf(first), content);
}

TEST_F(MeshedSurface, ScalesTheSurface)
{
  const auto largest = [](const std::string& path) {
    std::istringstream file(contentOf(path).substr(contentOf(path).find("$Nodes")));
    std::string word;
    int count = 0, id = 0;
    double x = 0, y = 0, z = 0, found = 0;
    for (file >> word >> count; count > 0; --count)
    {
      file >> id >> x >> y >> z;
      found = std::max({found, x, y, z});
    }
    return found;
  };
  EXPECT_NEAR(largest(mesh(5e-4, 1e-3)), 1e-3, 1e-4);
}

TEST_F(MeshedSurface, GradesAndRemembersWhatItGraded)
{
  const SizePoint top{{0, 0, 1}, 0.2}, side{{1, 0, 0}, 0.2};
  const std::string plain = mesh(), graded = mesh(0.5, 1, {top});
  EXPECT_GT(fs::file_size(graded), fs::file_size(plain));
  EXPECT_EQ(mesh(0.5, 1, {top}), graded);
  EXPECT_TRUE(log_.empty());
  EXPECT_EQ((std::set<std::string>{plain, graded, mesh(0.5, 1, {side}), mesh(0.5, 1, {top, side}),
                                   mesh(0.5, 1, {{top.position, 0.21}})}
                 .size()),
            5u);
  for (const auto& entry : fs::directory_iterator(directory_ / "cache/bezier_fem"))
    EXPECT_NE(entry.path().extension(), ".csv") << entry.path();
}

// In a scene a sizing is given in the world, as regions and probes are: the same place, however the body is posed.
TEST_F(MeshedSurface, ASceneSizesInItsWorld)
{
  const auto pointsNear = [&](const Eigen::Vector3d& place, double x, double y, double z) {
    writeSizing(directory_ / "sizes.csv", {{{x, y, z}, 0.2}});
    const Scene scene = parseScene(
        "model: {file: ball.off, cell_size: 1, sizing: sizes.csv, scale: 2, "
        "pose: {xyz: [10, 0, 0], rpy: [0, 0, 1.5707963267948966]}}\n"
        "element: linear\nmaterial: {young: 1, poisson: 0, density: 1}",
        directory_ / "", "test");
    const Simulation simulation(scene, 1, [](const std::string&) {});
    int count = 0;
    for (int i = 0; i < simulation.model().num_nodes; ++i) count += (simulation.model().rest[i] - place).norm() < 0.5;
    return count;
  };
  const Eigen::Vector3d left(10, 2, 0);  // the surface's (1, 0, 0), scaled and turned
  EXPECT_GT(pointsNear(left, 10, 2, 0), 10);
  EXPECT_LT(pointsNear(left, 10, -2, 0), 5);
  EXPECT_LT(pointsNear(left, 2, 0, 0), 5);
}

TEST_F(MeshedSurface, HandsOnWarnings)
{
  ball_ = directory_.write("two.off", offText(sphere(2) + sphere(2).moved(5, 0, 0)));
  mesh();
  EXPECT_TRUE(std::any_of(log_.begin(), log_.end(), [](const auto& line) {
    return line.find("warning:") == 0 && line.find("2 separate bodies") != line.npos;
  }));
}

TEST_F(MeshedSurface, RefusesWithTheLineOfMakeModel)
{
  Shape open = cube();
  open.polygons.pop_back();
  ball_ = directory_.write("open.off", offText(open));
  EXPECT_EQ(refusal().find(ball_ + ": the surface is open: 4 boundary edges"), 0u) << refusal();
  ball_ = directory_.write("odd name; 'quoted' $(x).off", "OFF\nnothing\n");
  EXPECT_EQ(refusal().find(ball_ + ":2: "), 0u) << refusal();
  ball_ = directory_ / "missing.off";
  EXPECT_EQ(refusal(), ball_ + ": there is no such file");
  ball_ = directory_ / "";
  EXPECT_NE(refusal().find("is not a file"), std::string::npos);
  // Nothing but locks stays behind.
  for (const auto& entry : fs::directory_iterator(directory_ / "cache/bezier_fem"))
    EXPECT_EQ(entry.path().extension(), ".lock") << entry.path();
}

TEST_F(MeshedSurface, MakesADamagedFileAgain)
{
  const std::string path = mesh(), content = contentOf(path);
  for (const std::size_t size : {std::size_t{0}, content.size() / 2, content.size() - 1})
  {
    fs::resize_file(path, size);
    EXPECT_EQ(mesh(), path);
    EXPECT_FALSE(log_.empty());
    EXPECT_EQ(contentOf(path), content);
  }
}

TEST_F(MeshedSurface, TwoAtOnceMeshOnce)
{
  // As processes, since that is how a node and a tool meet; each writes down how many lines it was given.
  constexpr int PROCESSES = 3;
  for (int i = 0; i < PROCESSES; ++i)
  {
    const pid_t child = fork();
    ASSERT_GE(child, 0);
    if (child > 0) continue;
    int status = 1;
    try
    {
      const std::string path = mesh(0.3);
      directory_.write("ran" + std::to_string(i), std::to_string(log_.size()));
      status = contentOf(path).find("$EndElements") == std::string::npos;
    }
    catch (...)
    {
    }
    _exit(status);
  }
  for (int i = 0; i < PROCESSES; ++i)
  {
    int status = 1;
    wait(&status);
    EXPECT_EQ(status, 0);
  }
  int ran = 0;
  for (int i = 0; i < PROCESSES; ++i) ran += contentOf(directory_ / "ran" + std::to_string(i)) != "0";
  EXPECT_EQ(ran, 1);
}

TEST_F(MeshedSurface, FindsItsPlaceInHome)
{
  const std::string old_home = getenv("HOME") ? getenv("HOME") : "";
  setenv("HOME", (directory_ / "home").c_str(), 1);
  for (const char* xdg : {"", "relative/is/ignored"})
  {
    setenv("XDG_CACHE_HOME", xdg, 1);
    EXPECT_EQ(mesh().find(directory_ / "home/.cache/bezier_fem/"), 0u);
  }
  unsetenv("XDG_CACHE_HOME");
  EXPECT_EQ(mesh().find(directory_ / "home/.cache/bezier_fem/"), 0u);

  // A cache that cannot be made is named, with what to do about it.
  setenv("XDG_CACHE_HOME", (directory_ / "ball.off/inside").c_str(), 1);
  const std::string message = refusal();
  EXPECT_NE(message.find("ball.off/inside/bezier_fem"), message.npos) << message;
  EXPECT_NE(message.find("XDG_CACHE_HOME"), message.npos) << message;
  setenv("HOME", old_home.c_str(), 1);
}

/** Runs a copy of this very program in a directory with another `make_model`, and gives what() of its InputError. */
std::string refusalBeside(const TemporaryDirectory& directory, const std::string& surface,
                          const std::string& make_model)
{
  const std::string self = directory / "test_program", out = directory / "what";
  fs::copy_file("/proc/self/exe", self, fs::copy_options::overwrite_existing);
  std::remove((directory / "make_model").c_str());
  if (!make_model.empty())
  {
    directory.write("make_model", make_model);
    chmod((directory / "make_model").c_str(), 0755);
  }
  const std::string command = "BEZIER_FEM_TEST_SURFACE='" + surface + "' '" + self + "' > '" + out + "'";
  EXPECT_EQ(std::system(command.c_str()), 0);
  return contentOf(out);
}

TEST_F(MeshedSurface, AMissingOrDyingMakeModelIsAnInputError)
{
  const std::string missing = refusalBeside(directory_, ball_, "");
  EXPECT_NE(missing.find(directory_ / "make_model"), missing.npos) << missing;
  const std::string killed = refusalBeside(directory_, ball_, "#!/bin/sh\necho busy >&2\nkill -9 $$\n");
  EXPECT_NE(killed.find("killed by signal 9"), killed.npos) << killed;
  const std::string failed = refusalBeside(directory_, ball_, "#!/bin/sh\nexit 1\n");
  EXPECT_NE(failed.find("failed with status 1"), failed.npos) << failed;
  const std::string lying = refusalBeside(directory_, ball_, "#!/bin/sh\nexit 0\n");
  EXPECT_NE(lying.find("cannot be written"), lying.npos) << lying;
  const std::string broken = refusalBeside(directory_, ball_, "neither a script nor a program");
  EXPECT_NE(broken.find("make_model cannot be started"), broken.npos) << broken;
}

}  // namespace
}  // namespace bezier_fem

int main(int argc, char** argv)
{
  if (const char* surface = std::getenv("BEZIER_FEM_TEST_SURFACE"))
  {
    try
    {
      bezier_fem::meshedSurface(surface, 0.5, 1, {}, {});
    }
    catch (const bezier_fem::InputError& error)
    {
      std::fputs(error.what(), stdout);
    }
    return 0;
  }
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
