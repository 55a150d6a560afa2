#!/usr/bin/env python3
"""What scripts/chart computes from, against closed forms; and bench_variants on a tiny grid, kept and taken up again.

    chart_test.py BENCH_VARIANTS
"""
import json
import math
import os
import sys
import tempfile
import unittest

import numpy as np

HERE = os.path.dirname(os.path.abspath(__file__))
sys.dont_write_bytecode = True
sys.path[:0] = [os.path.join(HERE, "..", "..", "scripts", part) for part in ("charting", "reproduction")]
import analysis  # noqa: E402  (the path comes first)
import claims  # noqa: E402
import engine  # noqa: E402
import meshes  # noqa: E402
import others  # noqa: E402
import tools  # noqa: E402

PROGRAM = os.path.abspath(sys.argv.pop()) if len(sys.argv) > 1 else None
SCENE = """model: {file: bar.msh}
material: {young: 2.0e+5, poisson: 0.34, density: 500}
gravity: [0, -9.81, 0]
fixed: [{name: wall, group: fixed_0}]
probes: {tip: [0, 0, 1], middle: [0.2, 0.2, 0.5]}
"""


class Analysis(unittest.TestCase):
    def test_front_is_what_no_point_beats(self):
        # By definition, without sorting
        random = np.random.default_rng(1)
        points = [tuple(point) for point in random.uniform(0, 1, (60, 2))] + [(0.5, 2), (2, 0.5)]
        beaten = [any(b[0] <= a[0] and b[1] <= a[1] and b != a for b in points) for a in points]
        front = analysis.pareto(points)
        self.assertEqual(sorted(front), [k for k, worse in enumerate(beaten) if not worse])
        self.assertEqual([points[k][0] for k in front], sorted(points[k][0] for k in front))

    def test_front_takes_one_of_equals(self):
        self.assertEqual(len(analysis.pareto([(1, 1), (1, 1), (1, 2), (2, 1)])), 1)

    def test_own_error_of_a_power_law(self):
        for order in (0.7, 1, 2, 3.5):
            for sizes in ((4, 2, 1), (1 / 2, 1 / 3, 1 / 4), (0.3, 0.11, 0.1)):
                distances = [0.05 * (h**order - sizes[2]**order) for h in sizes[:2]]
                found, own = analysis.own_error(sizes, distances)
                self.assertAlmostEqual(found, order, 6)
                self.assertAlmostEqual(own / (0.05 * sizes[2]**order), 1, 6)

    def test_own_error_without_convergence(self):
        self.assertEqual(analysis.own_error((4, 2, 1), (0.1, 0.1)), (None, 0.1))
        self.assertEqual(analysis.own_error((4, 2, 1), (0.1, 0.2)), (None, 0.2))
        self.assertEqual(analysis.own_error((4, 2, 1), (0, 0)), (None, 0))
        # Logarithms are the slowest convergence that an order can tell of
        self.assertIsNone(analysis.own_error((4, 2, 1), (math.log(4), math.log(2)))[0])

    def test_order_is_not_believed_above_four(self):
        order, own = analysis.own_error((4, 2, 1), (4**9 - 1, 2**9 - 1))
        self.assertAlmostEqual(order, 4, 9)
        self.assertAlmostEqual(own, (2**9 - 1) / (2**4 - 1), 6)
        self.assertRaises(ValueError, analysis.own_error, (1, 2, 4), (0.2, 0.1))

    def test_cheapest(self):
        points = [(5, 0.01), (3, 0.02), (1, 0.5), (4, 0.001)]
        self.assertEqual(analysis.cheapest(points, 0.02), 1)
        self.assertEqual(analysis.cheapest(points, 0.01), 3)
        self.assertIsNone(analysis.cheapest(points, 1e-4))


class Others(unittest.TestCase):
    def test_distances_of_a_tip(self):
        # A fall along a parabola to 0.5 m, sampled finely; another program that is 3 cm aside, or ends 5 cm higher
        times = np.linspace(0, 1, 1001)
        fall = np.stack([0 * times, -0.5 * times**2, 0 * times], axis=1)
        aside = [[t, 0.03, -0.5 * t**2, 0] for t in np.linspace(0, 1.5, 16)]
        self.assertAlmostEqual(others.in_motion((times, fall), aside, 1), 0.03 / 0.5, 5)
        self.assertAlmostEqual(others.at_rest((times, fall), [0, -0.45, 0]), 0.1, 12)
        # Off by t: the mean square of t at 0, 1/4, ... 1 is 0.375
        drifting = [[t, t, -0.5 * t**2, 0] for t in np.linspace(0, 1, 5)]
        self.assertAlmostEqual(others.in_motion((times, fall), drifting, 1), math.sqrt(0.375) / 0.5, 5)


class Meshes(unittest.TestCase):
    scene = {"material": {"regions": [{"box": {"min": [0, 0, 0], "max": [1, 1, 0.5]}}]},
             "fixed": [{"box": {"min": [-1, -1, -1e-9], "max": [1, 1, 1e-9]}}],
             "loads": [{"sphere": {"center": [0.4, 0.4, 1], "radius": 0.1}},
                       {"box": {"min": [-1, -1, 0.4], "max": [1, 1, 1]}}]}

    def body(self):
        return meshes.settle({**self.scene, "loads": self.scene["loads"][1:]}, *meshes.of_bar((2, 2, 5)))

    def volumes(self, body):
        return np.linalg.det(body.points[body.tets[:, 1:]] - body.points[body.tets[:, :1]]) / 6

    def check(self, body):
        self.assertGreater(self.volumes(body).min(), 0)
        self.assertAlmostEqual(self.volumes(body).sum(), 0.16, 12)
        # Face to face: a face has one tetrahedron or two, and those with one make up the bar's surface
        faces = np.sort(body.tets[:, meshes.SIDES].reshape(-1, 3), axis=1)
        unique, count = np.unique(faces, axis=0, return_counts=True)
        self.assertLessEqual(count.max(), 2)
        a, b, c = body.points[unique[count == 1]].transpose(1, 0, 2)
        self.assertAlmostEqual(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2, 2 * 0.16 + 4 * 0.4, 12)
        # The parts stay where they were
        held = np.abs(body.points[:, 2]) < 1e-9
        np.testing.assert_array_equal(body.corners("fixed_0"), held)
        np.testing.assert_array_equal(body.corners("loads_0"), body.points[:, 2] > 0.4 - 1e-9)
        self.assertAlmostEqual(self.volumes(body)[body.blocks["material_0"]].sum(), self.soft, 12)

    def setUp(self):
        body = self.body()
        self.soft = self.volumes(body)[body.blocks["material_0"]].sum()
        self.assertGreater(self.soft, 0)

    def test_cut_evenly(self):
        for parts in (1, 2, 3):
            body = self.body().subdivided(parts)
            self.assertEqual(len(body.tets), 120 * parts**3)
            self.check(body)

    def test_bisected(self):
        random = np.random.default_rng(2)
        body = self.body()
        for _ in range(6):
            chosen = random.uniform(size=len(body.tets)) < 0.1
            finer = body.bisected(chosen)
            self.assertGreaterEqual(len(finer.tets), len(body.tets) + chosen.sum())
            body = finer
        self.check(body)

    def test_graded_towards_the_rim(self):
        body = self.body().graded(2)
        self.check(body)
        size = np.cbrt(self.volumes(body))
        at_rim = body.near_rims(["fixed_0"])
        far = (body.points[body.tets][:, :, 2] > 0.6).all(axis=1)
        self.assertLess(size[at_rim].max(), size[far].min() / 2)

    def test_a_region_without_a_face_is_told(self):
        with self.assertRaisesRegex(tools.Failed, r"loads\[0\]: holds no whole face"):
            meshes.settle(self.scene, *meshes.of_bar((2, 2, 5)))

    def test_regions_by_group_are_told(self):
        with self.assertRaisesRegex(tools.Failed, r"fixed\[0\]: selects by group"):
            meshes.settle({"material": {}, "fixed": [{"group": "wall"}]}, *meshes.of_bar((1, 1, 2)))

    def test_jumps_of_gradients(self):
        points, tets = meshes.of_bar((2, 2, 5))
        order = [(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)]
        middles = {}
        ten = []
        points = list(points)
        for tet in tets:
            row = list(tet)
            for a, b in order:
                edge = tuple(sorted((tet[a], tet[b])))
                if edge not in middles:
                    middles[edge] = len(points)
                    points.append((points[edge[0]] + points[edge[1]]) / 2)
                row.append(middles[edge])
            ten.append(row)
        points, ten = np.array(points), np.array(ten)
        x, y, z = points.T
        # What the elements hold exactly has a continuous gradient: no jumps
        smooth = np.stack([x * y + z**2, 3 * x - y * z, y**2], axis=1)
        self.assertLess(meshes.gradient_jumps(points, smooth, ten).max(), 1e-25)
        # A kink at z = 0.4 is seen by the tetrahedra that touch it, and by no others
        kink = np.stack([0 * x, np.abs(z - 0.4), 0 * x], axis=1)
        jumps = meshes.gradient_jumps(points, kink, ten)
        touches = (np.abs(points[ten[:, :4]][:, :, 2] - 0.4) < 1e-9).any(axis=1)
        np.testing.assert_array_equal(jumps > 1e-12, touches)

    def test_worst(self):
        np.testing.assert_array_equal(meshes.worst(np.array([1.0, 6, 0, 3]), 0.7), [False, True, False, True])
        np.testing.assert_array_equal(meshes.worst(np.array([1.0, 6, 0, 3]), 0.5), [False, True, False, False])


class Claims(unittest.TestCase):
    """A made-up bar whose errors and times follow formulas, and what is said of it."""

    tets = {"2x2x5": 120, "2x2x5_graded_1": 240, "4x4x10": 960}

    class Study:
        name, title = "bar", "Bar"

    def study(self, ratios=(900, 300), **bent):
        """`bent` multiplies the error or the time of what it names."""
        study = self.Study()
        study.rows, study.times = [], []
        study.own = {"static corotated": {"tip": 0.001}}
        study.apart = {"green": 0.02 * bent.get("green", 1), "linear": 0.1}
        study.equal = {"wanted": 0.015}
        for element in ("quadratic", "linear"):
            study.equal[element] = {"reached": True, **{
                name: {"ms": 0.1 * (ratio if element == "linear" else 1), "tets": 9} for name, ratio in
                zip(("same", "best"), ratios)}}

        def add(mode, mesh, **changes):
            row = {**engine.DEFAULTS, "mode": mode, "mesh": mesh, "tets": self.tets[mesh], **changes}
            step, rule = row["time_step"], row["rotation"]
            of_mesh = 1.5 / row["tets"] * (20 * bent.get("linear", 1) if row["element"] == "linear" else 1)
            of_mesh *= {"corners": 1, "centroid": 1.5, "four": 2 * bent.get("four", 1)}[rule]
            of_mesh *= 0.1 * bent.get("graded", 1) if "graded" in mesh else 1
            of_step = {"implicit_euler": 7 * bent.get("euler", 1) * step, "sdirk2": 25 * step**2, "explicit": 0}
            loose = 0.1 * row["solver.tolerance"] * bent.get("tolerance", 1)
            row["error_tip"] = of_mesh + (mode == "dynamic") * (of_step[row["integrator"]] + loose)
            cost = {"implicit_euler": 1, "sdirk2": 2 * bent.get("sdirk2", 1), "explicit": 0.5}[row["integrator"]]
            cost *= row["tets"] * 1e-3
            cost *= {"auto": 1, "block_jacobi": 2}[row["solver.preconditioner"]]
            cost *= {"matrix_free": 1, "assembled": 2 * bent.get("assembled", 1)}[row["solver.operator"]]
            cost *= bent.get("explicit", 3) if "graded" in mesh and row["integrator"] == "explicit" else 1
            row["ms_per_step"], row["ms_per_second"] = cost, cost / step
            study.rows.append(row)

        for mesh in self.tets:
            for element in ("quadratic", "linear"):
                for law in claims.LAWS:
                    add("static", mesh, element=element, elasticity=law)
                    add("dynamic", mesh, element=element, elasticity=law)
            for step in (0.01, 0.005, 0.002):
                add("dynamic", mesh, time_step=step)
            for step in (0.02, 0.01, 0.005):
                add("dynamic", mesh, integrator="sdirk2", time_step=step)
            for rule in ("centroid", "four"):
                add("static", mesh, rotation=rule)
            for rule in ("corners", "centroid", "four"):
                add("dynamic", mesh, rotation=rule, integrator="explicit", time_step=0.005)
            for tolerance in (1e-1, 1e-2, 1e-3, 1e-6):
                add("dynamic", mesh, integrator="sdirk2", time_step=0.005, **{"solver.tolerance": tolerance})
            add("dynamic", mesh, **{"solver.preconditioner": "block_jacobi"})
            add("dynamic", mesh, **{"solver.operator": "assembled"})
        return study

    def broken(self, **bent):
        return [k for k, (_, holds) in enumerate(claims.advice([self.study(**bent)]), 1) if not holds]

    def test_ten_lines_that_hold(self):
        self.assertEqual(self.broken(), [])
        self.assertEqual(len(list(claims.advice([self.study()]))), 10)

    def test_each_line_can_be_refuted(self):
        for line, bent in ((1, {"linear": 0.01}), (2, {"ratios": (199, 300)}), (2, {"ratios": (900, 99)}),
                           (3, {"graded": 3}), (4, {"euler": 0.02}), (5, {"sdirk2": 3}), (6, {"explicit": 0.9}),
                           (7, {"tolerance": 1e5}), (8, {"four": 0.3}), (9, {"green": 10}), (10, {"assembled": 0.3})):
            self.assertIn(line, self.broken(**bent), bent)

    def test_promises(self):
        checks = {claim: holds for claim, _, holds in claims.claims([self.study()])}
        self.assertEqual([claim for claim, holds in checks.items() if not holds], ["At least 200 points for the bar"])
        study = self.study(ratios=(199, 99))
        study.own["static corotated"]["tip"] = 0.006
        self.assertEqual([holds for _, _, holds in claims.claims([study])], [False] * 4)

    def test_what_is_not_reached_is_a_bound(self):
        study = self.study()
        study.equal["linear"]["reached"] = False
        self.assertEqual(claims.ratio_of(study, "best"), "not reached with 9 tets, so more than 300")
        study.equal["quadratic"]["reached"] = False
        self.assertIn("not reached by quadratic", claims.ratio_of(study, "best"))


@unittest.skipIf(PROGRAM is None, "no program given")
class Engine(unittest.TestCase):
    def test_tiny_grid(self):
        with tempfile.TemporaryDirectory() as folder:
            engine.WORK = os.path.join(folder, "work")
            tools.program.folder = os.path.dirname(PROGRAM)
            tools.say = engine.say = lambda text: None
            with open(os.path.join(folder, "scene.yaml"), "w", encoding="ascii") as out:
                out.write(SCENE)
            paths = []
            for cells in ((1, 1, 2), (2, 2, 5), (4, 4, 10)):
                body = meshes.settle({"material": {}, "fixed": Meshes.scene["fixed"]}, *meshes.of_bar(cells))
                paths.append(os.path.join(folder, "x".join(map(str, cells)) + ".msh"))
                body.write(paths[-1])
            body.write(os.path.join(folder, "bar.msh"))
            variants = [{"model.file": path, "element": element}
                        for path in paths for element in ("linear", "quadratic")]
            grid = engine.Comparison("test", os.path.join(folder, "scene.yaml"), 0, variants[-1])
            rows = grid.run(variants)
            self.assertEqual([row["tets"] for row in rows], [12, 12, 120, 120, 960, 960])
            for element in range(2):
                errors = [row["error"]["tip"] for row in rows[element::2]]
                self.assertEqual(errors, sorted(errors, reverse=True))
            for linear, quadratic in zip(rows[::2], rows[1::2]):
                self.assertGreater(linear["error"]["tip"], 5 * quadratic["error"]["tip"])
            self.assertEqual(rows[-1]["error"]["tip"], 0)

            # What was kept is not run again, and what is new is, against the kept reference
            runs = []
            really = engine.Comparison._run

            def counted(self, missing, time_limit):
                runs.append(len(missing))
                really(self, missing, time_limit)

            engine.Comparison._run = counted
            try:
                again = engine.Comparison("test", os.path.join(folder, "scene.yaml"), 0, variants[-1])
                self.assertEqual(again.run(variants), rows)
                self.assertEqual(runs, [])
                more = again.run([*variants, {**variants[3], "elasticity": "linear"}])
                self.assertEqual(runs, [1])
                self.assertEqual(more[:-1], rows)
                self.assertGreater(more[-1]["error"]["tip"], 0.05)
            finally:
                engine.Comparison._run = really
            self.assertEqual(json.dumps(grid.reference_row()["overrides"]), json.dumps(engine.words(variants[-1])))


if __name__ == "__main__":
    unittest.main()
