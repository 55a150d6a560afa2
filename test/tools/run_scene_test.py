#!/usr/bin/env python3
"""run_scene from outside: its files, its exit status, and laws that a run must keep. First argument: the program."""
import csv
import json
import math
import operator
import os
import struct
import subprocess
import sys
import tempfile
import unittest
import xml.etree.ElementTree

RUN_SCENE = os.path.abspath(sys.argv[1])
BAR = os.path.join(os.path.dirname(os.path.abspath(__file__)), "../../config/bar.yaml")


class RunScene(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.TemporaryDirectory()
        self.addCleanup(self.folder.cleanup)

    def path(self, name):
        return os.path.join(self.folder.name, name)

    def call(self, *arguments, status=0):
        # Without anything of ROS in the environment.
        clean = {key: value for key, value in os.environ.items() if not key.startswith(("ROS", "CMAKE", "PYTHON"))}
        done = subprocess.run([RUN_SCENE, *map(str, arguments)], env=clean, stdout=subprocess.PIPE,
                              stderr=subprocess.PIPE, text=True, check=False, timeout=120)
        self.assertEqual(done.returncode, status, done.stderr)
        if status == 2:
            self.assertEqual(done.stderr.count("\n"), 1, done.stderr)
        return done.stderr

    def run_scene(self, *arguments, scene=BAR, status=0):
        """Returns the summary, the probes' rows and the nodes' rows {time: {node: [x, y, z]}} in order."""
        self.call(scene, "--summary", self.path("s.json"), "--probes", self.path("p.csv"), "--nodes", self.path("n.csv"),
                  *arguments, status=status)
        with open(self.path("s.json"), encoding="utf-8") as file:
            summary = json.load(file)
        with open(self.path("p.csv"), encoding="utf-8") as file:
            probes = [{key: float(value) for key, value in row.items()} for row in csv.DictReader(file)]
        nodes = [{}]
        with open(self.path("n.csv"), encoding="utf-8") as file:
            for row in csv.DictReader(file):
                if int(row["node"]) in nodes[-1]:
                    nodes.append({})
                nodes[-1][int(row["node"])] = [float(row[axis]) for axis in "xyz"]
        return summary, probes, nodes

    def test_rows_at_the_start_every_kth_step_and_the_end(self):
        for steps, every, expected in [(7, 1, [0, 1, 2, 3, 4, 5, 6, 7]), (7, 3, [0, 3, 6, 7]), (6, 3, [0, 3, 6]), (0, 1, [0])]:
            summary, probes, nodes = self.run_scene("--steps", steps, "--every", every)
            self.assertEqual([round(row["time"] / 0.02) for row in probes], expected)
            self.assertEqual(len(nodes), len(expected))
            self.assertEqual(summary["steps"], steps)
        self.assertEqual(list(probes[0]), ["time"] + [f"{p}.{a}" for p in ("lower_left", "lower_right") for a in "xyz"])
        self.assertEqual(self.run_scene()[0]["steps"], 50)
        self.assertEqual(self.run_scene("--duration", 0.1)[0]["steps"], 5)

    def test_summary_of_the_bar(self):
        summary, _, _ = self.run_scene("--steps", 5)
        self.assertEqual((summary["elements"], summary["nodes"], summary["degrees_of_freedom"]), (120, 275, 750))
        self.assertAlmostEqual(summary["mass"], 80)
        self.assertAlmostEqual(summary["volume"], 0.16)
        self.assertEqual((summary["status"], summary["settled"], summary["inverted_elements"]), ("ok", False, 0))
        self.assertLessEqual(summary["residual"], 1e-4)
        self.assertEqual(set(summary["ms_per_step"]), {"rotation", "assembly", "force", "solve", "contact", "surface", "total"})
        self.assertEqual(set(summary["energy"]), {"kinetic", "elastic", "gravity"})
        linear, _, nodes = self.run_scene("--steps", 1, "--set", "element=linear")
        self.assertEqual((linear["nodes"], len(nodes[0])), (54, 54))

    def test_an_assembled_matrix_changes_nothing(self):
        for law in ["rotation=corners"], ["rotation=centroid"], ["rotation=four"], ["elasticity=green"], ["element=linear"]:
            settings = ["--steps", 5, "--set", "solver.tolerance=1.0e-10", *law]
            _, expected, _ = self.run_scene(*settings)
            _, probes, _ = self.run_scene(*settings, "--set", "solver.operator=assembled")
            for row, other in zip(probes, expected):
                for key, value in row.items():
                    self.assertAlmostEqual(value, other[key], delta=1e-9)

    def test_the_swing_of_the_bar_without_numerical_damping(self):
        """Lowest point of the corner at 0.41 s: -0.44 to -0.45 m, for two material laws and three rotation rules."""
        explicit = ["--duration", 0.6, "--set", "integrator=explicit", "--set", "time_step=0.0005"]
        for law in "elasticity=green", "rotation=corners", "rotation=centroid", "rotation=four":
            _, probes, _ = self.run_scene(*explicit, "--set", law)
            lowest = min(probes, key=lambda row: row["lower_left.y"])
            self.assertAlmostEqual(lowest["lower_left.y"], -0.445, delta=0.006)
            self.assertAlmostEqual(lowest["time"], 0.41, delta=0.015)

    def test_a_body_that_spins_at_the_start(self):
        thrown = ["--set", "fixed=[]", "--set", "gravity=[0, 0, 0]", "--set", "initial.velocity=[0, 0, 2]", "--set",
                  "initial.spin=[3, 0, 0]"]
        summary, probes, _ = self.run_scene(*thrown, "--steps", 1, "--set", "time_step=0.001")
        # About the centre of mass: m (a^2 + l^2)/12.
        energy = 80 * (2 ** 2 + (0.4 ** 2 + 1) / 12 * 3 ** 2) / 2
        self.assertAlmostEqual(summary["energy"]["kinetic"], energy, delta=1e-3 * energy)
        # v + w x r of the corner at (-0.2, -0.2, 0.5) from there
        for axis, speed in (("x", 0), ("y", -3 * 0.5), ("z", 2 - 3 * 0.2)):
            moved = probes[1]["lower_left." + axis] - probes[0]["lower_left." + axis]
            self.assertAlmostEqual(moved, 0.001 * speed, delta=2e-5)

    def test_static_equilibrium(self):
        summary, probes, _ = self.run_scene("--static")
        self.assertEqual([row["time"] for row in probes], [0, 0])
        self.assertEqual((summary["steps"], summary["status"], summary["settled"]), (0, "ok", True))
        self.assertAlmostEqual(summary["reaction"]["wall"][1], 80 * 9.81, delta=0.1)
        self.assertLess(probes[1]["lower_left.y"], -0.2)
        # The key does the same as the option.
        again, other, _ = self.run_scene("--set", "integrator=static")
        self.assertEqual(other, probes)
        # And a damped simulation ends there.
        settled, moving, _ = self.run_scene("--duration", 20, "--every", 1000, "--set", "damping.mass=5")
        self.assertTrue(settled["settled"])
        for key, value in probes[1].items():
            if key != "time":
                self.assertAlmostEqual(moving[-1][key], value, delta=1e-4)

    def test_nodes_are_material_points_and_come_back_as_initial_positions(self):
        _, probes, nodes = self.run_scene("--static")
        with open(self.path("start.csv"), "w", encoding="utf-8") as file:
            file.write("node,x,y,z\n")
            for node, point in nodes[-1].items():
                file.write(f"{node},{point[0]!r},{point[1]!r},{point[2]!r}\n")
        _, _, started = self.run_scene("--steps", 0, "--set", f"initial.positions={self.path('start.csv')}")
        for node, point in nodes[-1].items():
            self.assertLess(math.dist(started[0][node], point), 1e-14)
        # At rest, mid-edge nodes lie halfway between the corners, whose ids come first.
        _, _, rest = self.run_scene("--steps", 0)
        self.assertEqual(sorted(rest[0]), list(range(1, 276)))
        self.assertEqual(rest[0][55], [(a + b) / 2 for a, b in zip(rest[0][1], rest[0][2])])
        self.assertEqual(len(probes), 2)

    def test_loads(self):
        weightless = ["--static", "--set", "gravity=[0,0,0]", "--set"]
        end = "box: {min: [-1,-1,0.99], max: [1,1,1.01]}"
        pull, by_force, _ = self.run_scene(*weightless, "loads=[{%s, force: [0, 0, 16]}]" % end)
        self.assertAlmostEqual(pull["reaction"]["wall"][2], -16, delta=1e-2)
        _, by_traction, _ = self.run_scene(*weightless, "loads=[{%s, traction: [0, 0, 100]}]" % end)
        self.assertAlmostEqual(by_force[-1]["lower_left.z"], by_traction[-1]["lower_left.z"], delta=1e-9)
        push, by_pressure, _ = self.run_scene(*weightless, "loads=[{%s, pressure: 100}]" % end)
        self.assertAlmostEqual(push["reaction"]["wall"][2], 16, delta=0.1)
        self.assertLess(by_pressure[-1]["lower_left.z"], 1)
        # Node 46 is a corner of the free end, node 275 the middle of one of its edges.
        point, _, _ = self.run_scene(*weightless, "loads=[{nodes: [46, 275], force: [1, 0, 0]}]")
        self.assertAlmostEqual(point["reaction"]["wall"][0], -1, delta=1e-2)
        # A load that ends before the run does nothing at the end but has moved the body.
        _, kicked, _ = self.run_scene("--steps", 10, "--set", "gravity=[0,0,0]", "--set",
                                      "loads=[{%s, force: [100, 0, 0], from: 0.02, until: 0.1}]" % end)
        self.assertEqual(kicked[1]["lower_left.x"], 0)
        self.assertGreater(kicked[-1]["lower_left.x"], 0)

    def test_materials_by_region(self):
        summary, _, _ = self.run_scene("--steps", 1, "--set",
                                       "material.regions=[{box: {min: [0,0,0], max: [0.4,0.4,0.5]}, density: 1500}]")
        heavy = summary["mass"] - 80
        self.assertGreater(heavy, 30)
        stiff, probes, _ = self.run_scene("--static", "--set",
                                          "material.regions=[{sphere: {center: [0.2,0.2,0.5], radius: 2}, young: 2.0e+6}]")
        _, soft, _ = self.run_scene("--static")
        self.assertLess(abs(probes[-1]["lower_left.y"]), 0.2 * abs(soft[-1]["lower_left.y"]))
        self.assertEqual(stiff["status"], "ok")

    def test_motion_leads_a_region(self):
        with open(self.path("hand.csv"), "w", encoding="utf-8") as file:
            file.write("time,x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n0.1,0.05,0,0,0,0,0,1\n")
        with open(BAR, encoding="utf-8") as file:
            bar = os.path.join(os.path.dirname(BAR), "bar.msh")
            scene = file.read().replace("file: bar.msh", f"file: {bar}")
        with open(self.path("led.yaml"), "w", encoding="utf-8") as file:
            file.write(scene.replace("  - name: wall\n", "  - name: wall\n    motion: hand.csv\n"))
        _, _, nodes = self.run_scene("--steps", 10, scene=self.path("led.yaml"))
        self.assertAlmostEqual(nodes[1][1][0], 0.01)
        self.assertAlmostEqual(nodes[-1][1][0], 0.05)

    def test_the_same_run_twice_gives_the_same_bytes(self):
        def run():
            self.run_scene("--steps", 20)
            with open(self.path("n.csv"), "rb") as file:
                return file.read()
        self.assertEqual(run(), run())

    def test_a_body_at_rest_sleeps_and_wakes(self):
        end = "box: {min: [-1,-1,0.99], max: [1,1,1.01]}"
        summary, probes, _ = self.run_scene(
            "--duration", 12, "--set", "damping.mass=15",
            "--set", "loads=[{%s, force: [10, 0, 0], from: 10, until: 11}]" % end)
        asleep = summary["asleep_steps"]
        self.assertGreater(asleep, 100)
        self.assertEqual((summary["steps"], summary["substeps"], summary["status"]), (600, 600 - asleep, "ok"))
        self.assertGreater(summary["iterations"], 0)  # of the steps that were computed
        self.assertGreater(summary["ms_per_step"]["total"], 0)
        _, statics, _ = self.run_scene("--static", "--set", "solver.tolerance=1.0e-9")
        self.assertEqual(probes[450]["lower_left.y"], probes[500]["lower_left.y"])
        self.assertAlmostEqual(probes[500]["time"], 10)
        for name in ("lower_left.x", "lower_left.y", "lower_left.z"):
            self.assertAlmostEqual(probes[500][name], statics[-1][name], delta=1e-5)
        self.assertGreater(probes[501]["lower_left.x"], probes[500]["lower_left.x"] + 1e-5)
        self.assertEqual(self.run_scene("--steps", 60)[0]["asleep_steps"], 0)

    def test_paraview_series(self):
        self.call(BAR, "--steps", 4, "--every", 2, "--vtu", self.path("vtu"))
        index = xml.etree.ElementTree.parse(self.path("vtu/bar.pvd"))
        files = [entry.get("file") for entry in index.iter("DataSet")]
        self.assertEqual(len(files), 3)
        piece = xml.etree.ElementTree.parse(os.path.join(self.path("vtu"), files[-1])).find(".//Piece")
        self.assertEqual((piece.get("NumberOfPoints"), piece.get("NumberOfCells")), ("275", "120"))
        names = {array.get("Name") for array in piece.find("PointData")}
        self.assertLessEqual({"displacement", "velocity", "von_mises", "stress"}, names)

    def test_surface_series(self):
        _, _, nodes = self.run_scene("--steps", 4, "--every", 2, "--surface", self.path("ply"))
        self.assertEqual(sorted(os.listdir(self.path("ply"))), [f"bar_{row:06}.ply" for row in range(3)])
        for row, positions in enumerate(nodes):
            with open(os.path.join(self.path("ply"), f"bar_{row:06}.ply"), "rb") as file:
                header, data = file.read().split(b"end_header\n", 1)
            points, triangles = (int(header.split(b"element " + name + b" ")[1].split()[0]) for name in (b"vertex", b"face"))
            self.assertEqual(len(data), 24 * points + 13 * triangles)
            vertices = list(struct.iter_unpack("<6f", data[:24 * points]))
            corners = [face[1:] for face in struct.iter_unpack("<B3i", data[24 * points:])]
            # The surface is the mesh's own: every point a node, every normal on the outer side of its triangles.
            known = {struct.pack("<3f", *position) for position in positions.values()}
            self.assertLessEqual({struct.pack("<3f", *vertex[:3]) for vertex in vertices}, known)
            for a, b, c in corners:
                u, v = ([vertices[end][k] - vertices[a][k] for k in range(3)] for end in (b, c))
                normal = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
                for corner in (a, b, c):
                    self.assertAlmostEqual(math.hypot(*vertices[corner][3:]), 1, 5)
                    self.assertGreater(sum(map(operator.mul, normal, vertices[corner][3:])), 0)

    def test_recovery_from_inversion(self):
        scene = os.path.join(os.path.dirname(BAR), "recovery.yaml")
        self.assertEqual(self.run_scene("--steps", 0, scene=scene)[0]["inverted_elements"], 120)
        summary, probes, _ = self.run_scene("--duration", 4, scene=scene)
        self.assertEqual(summary["inverted_elements"], 0)
        _, settled, _ = self.run_scene("--static", scene=BAR)  # the same bar, from rest
        for name in ("lower_left.x", "lower_left.y", "lower_left.z", "lower_right.y"):
            self.assertAlmostEqual(probes[-1][name], settled[-1][name], delta=0.005)

    def test_a_solver_cut_short_says_so_and_writes_everything(self):
        summary, probes, _ = self.run_scene("--steps", 5, "--set", "solver.max_iterations=3", status=1)
        self.assertEqual((summary["status"], len(probes)), ("not_converged", 6))
        self.assertGreater(summary["residual"], 1e-4)

    def test_wrong_input_is_one_line_and_status_2(self):
        for arguments, expected in [
                (["missing.yaml"], "missing.yaml"),
                ([self.folder.name], self.folder.name),
                ([BAR, "--steps", "-1"], "--steps"),
                ([BAR, "--duration", "nan"], "--duration"),
                ([BAR, "--bogus"], "--bogus"),
                ([], "SCENE"),
                ([BAR, "--set", "material.poisson=0.5"], "material.poisson"),
                ([BAR, "--set", "no_such_key=1"], "no_such_key"),
                ([BAR, "--set", "solver.preconditioner=ilu"], "block_jacobi, pmultigrid, direct"),
                ([BAR, "--set", "integrator=explicit", "--set", "material.young=1.0e+14"], "time_step: is 0.02 s"),
                ([BAR, "--set", "fixed[0].frame=hand"], "frame"),
                ([BAR, "--set", "fixed[0].box={min: [5,5,5], max: [6,6,6]}"], "fixed[0]"),
                ([BAR, "--set", "loads=[{nodes: [99999], force: [1,0,0]}]"], "99999"),
                ([BAR, "--set", "probes.far=[9,9,9]"], "probes.far"),
                ([BAR, "--static", "--set", "fixed=[]"], "6 of 6"),
                ([BAR, "--static", "--set", "fixed[0].axes=[z]"], "3 of 6"),
                ([BAR, "--probes", "/no/such/folder/p.csv"], "/no/such/folder/p.csv")]:
            with self.subTest(arguments=arguments):
                self.assertIn(expected, self.call(*arguments, status=2))


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1], verbosity=2)
