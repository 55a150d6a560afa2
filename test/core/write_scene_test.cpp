#include "bezier_fem/write_scene.h"

#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>

#include "bezier_fem/error.h"
#include "bezier_fem/scene.h"
#include "yaml_tree.h"

namespace bezier_fem
{
namespace
{
namespace fs = std::filesystem;

bool same(const YamlNode& a, const YamlNode& b)
{
  return a.kind == b.kind && a.text == b.text && a.keys == b.keys && a.items.size() == b.items.size() &&
         std::equal(a.items.begin(), a.items.end(), b.items.begin(), same);
}

YamlNode read(const fs::path& path)
{
  std::ostringstream text;
  text << std::ifstream(path).rdbuf();
  return parseYaml(text.str(), path.string());
}

TEST(PrintYaml, IsReadBackAsTheSameTree)
{
  for (const char* text : {"a: 1\nb: [1, 2.0e+5, 'no', -3]\nc: {}\nd: []\n", "'x y': {p: [[1], {q: r}], s: ''}\n",
                           "t: \"line\\nbreak, \\\"quote\\\" \\\\ tab\\t {brace} # no comment: é\"\n",
                           "l:\n  - {a: 1}\n  - {b: '12'}\nm: package://x/y.off\n"})
  {
    SCOPED_TRACE(text);
    const YamlNode tree = parseYaml(text, "test");
    const std::string printed = printYaml(tree);
    const YamlNode again = parseYaml(printed, printed);
    EXPECT_TRUE(same(tree, again)) << printed;
    EXPECT_EQ(printYaml(again), printed);
  }
  // What was quoted stays text
  const YamlNode quoted = parseYaml(printYaml(parseYaml("a: 'no'\nb: '12'\nc: no\n", "test")), "test");
  EXPECT_FALSE(quoted.items[0].plain);
  EXPECT_FALSE(quoted.items[1].plain);
  EXPECT_TRUE(quoted.items[2].plain);
}

TEST(WriteScene, KeepsTheSceneAndItsFiles)
{
  std::string name = (fs::temp_directory_path() / "write_scene_test.XXXXXX").string();
  ASSERT_NE(mkdtemp(name.data()), nullptr);
  const fs::path folder = name;
  fs::create_directory(folder / "sub");
  const fs::path config = fs::path(TEST_DATA_DIR) / "../../config";
  for (const char* file : {"bar.yaml", "bar.msh", "recovery.yaml", "recovery.csv"})
  {
    fs::copy(config / file, folder / file);
  }
  for (const char* scene : {"bar.yaml", "recovery.yaml"})
  {
    const std::string from = (folder / scene).string();
    for (const fs::path& to : {folder / "tuned.yaml", folder / "sub/tuned.yaml"})
    {
      writeScene(from, {"element=linear", "solver.tolerance=1.0e-3"}, to.string(), {"first", "second: line"});
      const Scene before = loadScene(from), after = loadScene(to.string());
      EXPECT_EQ(after.element, Element::LINEAR);
      EXPECT_EQ(after.solver.tolerance, 1e-3);
      EXPECT_EQ(after.model.file, before.model.file);
      EXPECT_EQ(after.initial.positions, before.initial.positions);
      EXPECT_EQ(after.gravity, before.gravity);
      ASSERT_EQ(after.fixed.size(), 1u);
      EXPECT_EQ(after.fixed[0].region.box->max, before.fixed[0].region.box->max);
      EXPECT_EQ(after.probes, before.probes);
      std::ifstream written(to);
      std::string line;
      std::getline(written, line);
      EXPECT_EQ(line, "# first");
    }
    EXPECT_TRUE(same(read(folder / scene).items[0], read(folder / "tuned.yaml").items[0])) << "as it was written";
  }
  EXPECT_THROW(writeScene((folder / "bar.yaml").string(), {"element=cubic"}, (folder / "x.yaml").string(), {}),
               InputError);
  EXPECT_FALSE(fs::exists(folder / "x.yaml"));
  EXPECT_THROW(writeScene((folder / "bar.yaml").string(), {}, "/nowhere/x.yaml", {}), InputError);
  fs::remove_all(folder);
}

}  // namespace
}  // namespace bezier_fem
