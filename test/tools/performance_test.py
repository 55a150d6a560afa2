#!/usr/bin/env python3
"""What scripts/performance computes from: the benchmarks' tables, its claims and its page, from made-up measurements.

    performance_test.py [BENCH_STEPS BENCH_ROOFLINE]
"""
import copy
import os
import subprocess
import sys
import tempfile
import unittest

HERE = os.path.dirname(os.path.abspath(__file__))
REPOSITORY = os.path.join(HERE, "..", "..")
sys.dont_write_bytecode = True
sys.path[:0] = [os.path.join(REPOSITORY, "scripts", part) for part in ("speed", "charting", "reproduction")]
import claims  # noqa: E402  (the path comes first)
import page  # noqa: E402
import scenes  # noqa: E402
import tools  # noqa: E402
from tables import tables  # noqa: E402

PROGRAMS = [os.path.abspath(path) for path in sys.argv[1:]]
del sys.argv[1:]


def step(ms, tets=3000, residual=1e-5, iterations=10):
    """A row of bench_steps; one product is 1 ms."""
    return {"scene": "x.yaml", "tets": tets, "nodes": 2 * tets, "threads": 1, "rotation": 0.1, "diagonal": 0.1,
            "force": 0.1, "solve": ms - 0.3, "whole step": ms, "iterations": iterations, "worst residual": residual,
            "one product": 1.0, "step in products": ms, "own product in products": 0.2, "longest step": 2 * ms}


def kernel(name, products, precision="double"):
    return {"scene": "x.yaml", "tets": 3000, "nodes": 6000, "kernel": name, "precision": precision, "ms": 1.0,
            "products": products, "flop/byte": 1.0, "GFlop/s": 1.0, "GB/s": 1.0, "of peak": 0.5, "of bandwidth": 0.5,
            "bound by": "arithmetic", "of the bound": 0.5}


def point(mode, ms, error, law="corotated"):
    return {"element": "quadratic", "tets": 100, "mode": mode, "integrator": "implicit_euler", "time_step": 0.02,
            "elasticity": law, "solver.tolerance": 1e-4, "ms_per_second": ms, "ms_static": ms, "error_tip": error,
            "ms_process": ms + 10}


def bullet(mode, ms, error):
    return {"program": "Bullet, double precision", "settings": "default", "law": "corotated", "element": "linear",
            "tets": 960, "mode": mode, "time_step": 0.02 if mode == "dynamic" else None, "ms": ms, "error_tip": error}


def calculix(law, ms, error):
    return {"program": "CalculiX 2.20", "settings": "C3D10", "law": law, "element": "quadratic", "tets": 960,
            "mode": "static", "time_step": None, "ms": ms, "ms_idle": 20, "error_tip": error}


def huge_pages(name):
    return {"name": name, "tets": 3000, "without": {"whole step": 8.0, "one product": 0.4},
            "with": {"whole step": 7.6, "one product": 0.3}}


def everything():
    """Measurements by which every claim holds."""
    told = {"steps": [{"name": name, "one": step(15), "two": step(8), "classic": step(400), "before": step(50)}
                      for name, *_ in scenes.STEPS],
            "linear": [{"name": name, "own": step(2, residual=1e-6), "blocks": step(12, residual=1e-6),
                        "assembled": step(14, residual=1e-6)}
                       for name, *_ in scenes.LINEAR],
            "growth": [{"how": "meshed", "steps": 20, **step(tets / 1000, tets, iterations=8 + tets // 10000)}
                       for tets in (1041, 3183, 30929, 106345)] +
                      [{"how": "cut", "steps": 20, **step(8, tets)} for tets in (8328, 8330, 8332)],
            "front": {"now": [point("dynamic", 5, 0.2), point("dynamic", 50, 0.01), point("static", 5, 0.05),
                              point("static", 4, 0.05, "linear"), point("static", 8, 0.05, "green")],
                      "before": [point("dynamic", 9, 0.2), point("static", 9, 0.05)], "revision": "abc of 2020-01-01",
                      "products": [0.2, 0.21],
                      "others": [bullet("dynamic", 20, 0.25), bullet("static", 100, 0.2)],
                      "calculix": [calculix("green", 60, 0.1), calculix("linear", 56, 0.1)], "green_apart": 0.02},
            "huge_pages": {"system": "madvise", "rows": [huge_pages(name) for name, *_ in scenes.HUGE_PAGES]}}
    rows = [kernel("product", 0.25), kernel("rotations", 0.15), kernel("product", 0.2, "single")]
    told["kernels"] = {size: {"peaks": [{"peak": "multiply-add, double", "": "60 GFlop/s"}],
                              "rows": copy.deepcopy(rows), "set": "avx2"}
                       for size in ("small", "large")}
    return told


def broken(told):
    return [claim for claim, _, holds in claims.claims(told) if not holds]


class Tables(unittest.TestCase):
    def test_every_table_of_a_text(self):
        found = tables("Words\n\n| a | |\n|---|---|\n| 1 | x y |\n| 2.5 | 1e-05 |\n\n| b |\n|---|\n| nan |\nend\n| c |\n")
        self.assertEqual(found[0], [{"a": 1, "": "x y"}, {"a": 2.5, "": 1e-5}])
        self.assertNotEqual(found[1][0]["b"], found[1][0]["b"])
        self.assertEqual(found[2], [])


class Claims(unittest.TestCase):
    def setUp(self):
        self.told = everything()

    def breaks(self, *words):
        """What does not hold any more: one claim, with these words in it."""
        found = broken(self.told)
        self.assertEqual(len(found), 1, found)
        for word in words:
            self.assertIn(word, found[0])

    def test_all_hold(self):
        self.assertEqual(broken(self.told), [])

    def test_a_step_too_long(self):
        self.told["steps"][2]["one"] = step(17)
        self.breaks("Whole step", "10 000", "16 products")

    def test_a_step_not_converged(self):
        self.told["steps"][3]["two"]["worst residual"] = 1.1e-4
        self.breaks("Every step")

    def test_a_step_that_is_not_a_number(self):
        self.told["steps"][3]["one"]["step in products"] = float("nan")
        self.breaks("Whole step")

    def test_two_threads(self):
        self.told["steps"][1]["two"] = step(10)
        self.breaks("Two threads", "armadillo")

    def test_classic(self):
        self.told["steps"][0]["classic"] = step(290)
        self.breaks("20 times")

    def test_linear_elements(self):
        self.told["linear"][0]["blocks"] = step(9.9, residual=1e-6)
        self.breaks("Linear elements", "bunny")
        self.told["linear"][0]["blocks"] = step(12, residual=2e-5)  # in time, but not what was asked
        self.breaks("Linear elements", "bunny")

    def test_growth(self):
        self.assertAlmostEqual(claims.grown(self.told["growth"], lambda row: row["iterations"]), 11 / 8)
        self.told["growth"][2]["iterations"] = 12
        self.breaks("Iterations")
        self.told["growth"][2]["iterations"] = 10
        self.told["growth"][2]["whole step"] *= 2.1
        self.breaks("Time per element")
        del self.told["growth"][2]  # nothing near 30 000
        self.assertIsNone(claims.grown(self.told["growth"], claims.microseconds))
        self.assertEqual(len(broken(self.told)), 2)

    def test_kernels(self):
        self.told["kernels"]["small"]["rows"][1]["products"] = 0.21
        self.breaks("Kernels", "rotations")
        self.told["kernels"]["small"]["rows"][1]["products"] = 0.2
        self.told["kernels"]["small"]["rows"][2]["products"] = 0.29
        self.breaks("Kernels", "single")

    def test_rotations_in_a_step(self):
        self.told["steps"][0]["one"]["rotation"] = 0.21
        self.breaks("Rotations", "in a step")

    def test_other_programs(self):
        matches = [(claims.cost(own), ratio) for _, own, ratio in claims.peers(self.told)]
        self.assertEqual(matches, [(5, 4), (5, 20)])
        self.assertEqual(claims.lost(self.told), [])
        self.told["front"]["others"].append(bullet("dynamic", 40, 0.02))  # ours takes 50 for that
        self.breaks("Bullet")
        self.told["front"]["others"][-1] = bullet("dynamic", 40, 0.001)  # an error that none of ours has
        self.breaks("Bullet")
        self.assertEqual([ratio for *_, ratio in claims.lost(self.told)], [None])

    def test_calculix(self):
        matches = [(law, claims.cost(own), ratios) for _, law, own, ratios in claims.calculix(self.told)]
        self.assertEqual(matches, [("green", 8, (60 / 18, 5)), ("corotated", 5, (4, 8)), ("linear", 4, (4, 9))])
        self.told["front"]["calculix"][1]["ms"] = 13  # ours takes 14 as a process
        self.told["front"]["calculix"][1]["ms_idle"] = 5
        self.breaks("CalculiX", "process beside process")
        self.assertEqual([(name, ratio) for name, _, ratio in claims.lost(self.told)],
                         [("CalculiX 2.20, C3D10, linear, 960 tets, beside linear", 13 / 14)])
        self.told["front"]["calculix"][1].update(ms=20, ms_idle=17)  # ours takes 4 to solve
        self.breaks("CalculiX", "without reading")
        self.told["front"]["calculix"][1]["error_tip"] = 0.001  # which none of ours has
        self.assertEqual(len(broken(self.told)), 2)


class Page(unittest.TestCase):
    def test_tells_what_does_not_hold(self):
        told = everything()
        told["steps"][0]["one"] = step(18)
        told["front"]["others"].append(bullet("dynamic", 40, 0.02))
        told["front"]["calculix"].append(calculix("linear", 100, 0.001))
        with tempfile.TemporaryDirectory() as folder:
            page.PAGE, tools.PICTURES = os.path.join(folder, "performance.md"), os.path.join(folder, "performance")
            self.assertEqual(len(page.write(told)), 4)
            self.assertEqual(sorted(os.listdir(tools.PICTURES)),
                             ["front.csv", "front.png", "front.svg", "growth.png", "growth.svg"])
            with open(page.PAGE, encoding="utf-8") as file:
                text = file.read()
        self.assertIn("| Whole step, bunny, about 3200: at most 16 products | 18.0 | **no** |", text)
        self.assertIn("**Where we lose:** Bullet, double precision, default, 960 tets, motion", text)
        self.assertIn("CalculiX 2.20, C3D10, linear, 960 tets, beside linear, tip error 0.1 %: we have no such point",
                      text)
        self.assertIn("| C3D10 | NLGEOM | 960 | 60 | 40 | 10 % | `corotated`, another law | quadratic, 100 tets | 5 | "
                      "15 | 5 % | 4 | 8 |", text)
        self.assertIn("| 3000 | 8 | 7.6 | -5 % | 0.4 | 0.3 | -25 % | 20.0 | 25.3 |", text)
        for rows in tables(text):
            self.assertTrue(rows)

    def test_is_of_what_there_is(self):
        told = everything()
        told["growth"] = None
        del told["steps"][1:], told["front"]["before"], told["kernels"]["large"], told["huge_pages"]["rows"][1:]
        told["front"]["calculix"] = []
        with tempfile.TemporaryDirectory() as folder:
            page.PAGE, tools.PICTURES = os.path.join(folder, "performance.md"), os.path.join(folder, "performance")
            broken_or_missing = page.write(told)
            with open(page.PAGE, encoding="utf-8") as file:
                text = file.read()
        missing = ["growth", *(f"steps: {name}" for name, *_ in scenes.STEPS[1:]), "kernels: the larger model",
                   "front: the revision before", "front: CalculiX, which takes Debian's package calculix-ccx",
                   "huge_pages: the larger model"]
        self.assertEqual(broken_or_missing, [f"not measured: {what}" for what in missing])
        for what in missing:
            self.assertIn(what, " ".join(text.split()))
        self.assertIn("Whole step, bunny, about 3200", text)
        self.assertNotIn("Whole step, armadillo", text)
        self.assertNotIn("Growth is shown", text)
        self.assertIn("## Other programs", text)
        self.assertIn("`ccx` is missing", text)


class Programs(unittest.TestCase):
    def test_tells_the_parts(self):
        script = os.path.join(REPOSITORY, "scripts", "performance")
        done = subprocess.run([script, "--programs", ".", "nonsense"], check=False, capture_output=True, text=True)
        self.assertEqual(done.returncode, 1)
        self.assertEqual(done.stderr, "performance: there is no part nonsense; parts are steps linear growth kernels "
                                      "huge_pages front\n")

    def run_on_bar(self, program, *arguments):
        done = subprocess.run([program, os.path.join(REPOSITORY, "config", "bar.yaml"), *arguments], check=False,
                              capture_output=True, text=True)
        self.assertEqual(done.returncode, 0, done.stderr)
        return tables(done.stdout)

    @unittest.skipUnless(PROGRAMS, "built without benchmarks")
    def test_columns_are_what_the_script_reads(self):
        (row,), = self.run_on_bar(PROGRAMS[0], "--threads", "1", "--steps", "3")
        self.assertEqual(set(step(1)), set(row))
        self.assertLessEqual(row["whole step"], row["longest step"])
        peaks, rows = self.run_on_bar(PROGRAMS[1])
        self.assertEqual(set(kernel("product", 1)), set(rows[0]))
        self.assertIn("multiply-add, single", [peak["peak"] for peak in peaks])
        for row in rows:  # how much is for a machine to tell that has nothing else to do
            self.assertGreater(row["of peak"], 0)
            self.assertGreater(row["of the bound"], 0)
        for name, precision in (("product", "double"), ("product", "single"), ("rotations", "double"),
                                ("smoother's product: shares", "single"), ("prolonged product: shares", "single"),
                                ("sums and Chebyshev's term", "single")):  # which the claims and the page name
            claims.kernel({"kernels": {"small": {"rows": rows}}}, name, precision)


if __name__ == "__main__":
    unittest.main()
