"""
What is run for the charts. Not every combination of all choices: each choice is varied where it matters, on a coarse
and a finer mesh around the settings that a user would begin with, and meshes and time steps, which matter most,
together.
"""
import json
import os

import numpy as np
import yaml

import meshes
import others
from analysis import own_error
from engine import DEFAULTS, Comparison, digest, folder
from pictures import read_vtu
from tools import Failed, call, config, program, run_scene, say

WANTED = 0.015  # static tip error at which the elements are compared
MOST_TETS = 30000     # of the adapted meshes, the last of which has more: the reference of equilibria
MOST_EVEN = 75000     # of a scene's mesh cut evenly
MOST_STEPPED = 12000  # of meshes that both elements are stepped on
MOST_MOVED = 6000     # of the reference of motion
LAWS = ("corotated", "linear", "green")
ERRORS = ("tip", "field_rms", "field_max", "von_mises", "period", "decay")
NO_REFERENCE = 0.2  # own error of the tip above which a reference is none
STRICT = 1e-6  # tolerance of equilibria and references: their errors are the mesh's
FOUR = {"rotation": "four"}  # the gradient of an energy: converges from one side, which references need
DEEP = {"solver.tolerance": STRICT, "solver.preconditioner": "pmultigrid"}  # also above the vertices that auto stops at
BLOCKS = {"solver.preconditioner": "block_jacobi"}


def settings(mesh, *changes):
    """A variant: every choice named, so that equal ones are equal."""
    result = {"model.file": mesh, **DEFAULTS, "solver.max_iterations": 20000}
    for change in changes:
        result.update(change)
    return result


def quadratic(mesh, *changes):
    return settings(mesh, {"element": "quadratic"}, *changes)


def linear(mesh, *changes):
    return settings(mesh, {"element": "linear"}, *changes)


def stepping(integrator, milliseconds):
    return {"integrator": integrator, "time_step": milliseconds / 1000}


def of_scene(path, folder):
    """Points and tetrahedra of the scene's own mesh, scaled and posed."""
    call(program("run_scene"), path, "--steps", 0, "--vtu", folder, "--set", "element=linear")
    vtu = read_vtu(os.path.join(folder, os.path.splitext(os.path.basename(path))[0] + "_000000.vtu"))
    return vtu["Points"].copy(), vtu["connectivity"].copy()


class Study:
    """One scene: its meshes, references and points."""

    def __init__(self, name, scene_path, duration):
        self.name, self.duration = name, duration
        self.tree = meshes.read_scene(scene_path)
        self.scene = os.path.join(folder(name), "scene.yaml")
        self.rows, self.own, self.orders, self.references = [], {}, {}, {}
        self.left_out = {}  # law: why it could not be charted
        self.others = []  # rows of other programs
        self.times = []  # rows of steps that are compared with nothing
        self.still, self.apart = {}, {}  # by law: the comparison of equilibria; how far the tip rests from co-rotated's
        self.time_limit = 60

    def write_scene(self, body):
        """The scene of the variants; `body` is what stands for its mesh where a variant names none."""
        self.own_mesh = self.mesh("own", body)
        self.tree["model"] = {"file": os.path.relpath(self.own_mesh, os.path.dirname(self.scene))}
        self.tree.pop("element", None)
        self._write()
        self.tree["probes"] = {**self.tree.get("probes", {}), **self.stress_probes(body)}
        self._write()

    def _write(self):
        with open(self.scene, "w", encoding="utf-8") as out:
            yaml.safe_dump(meshes.by_groups(self.tree), out, sort_keys=False)

    def mesh(self, name, body):
        path = os.path.join(folder(self.name, "meshes"), name + ".msh")
        body.write(path)
        digest.cache_clear()
        return path

    def equilibrium(self, mesh):
        """Fields of the equilibrium on a mesh, quadratic elements."""
        out = folder(self.name, "equilibrium")
        variant = quadratic(mesh, FOUR, DEEP, {"solver.tolerance": 1e-5})
        values = {key.replace(".", "__"): value for key, value in variant.items()}
        run_scene(self.scene, out, "--static", "--vtu", out, **values)
        return read_vtu(os.path.join(out, "scene_000001.vtu"))

    def stress_probes(self, body, count=4):
        """Inner points of high stress, away from what is held or loaded and from each other."""
        vtu = self.equilibrium(self.own_mesh)
        points, size = vtu["Points"], np.ptp(vtu["Points"], axis=0).max()
        corners = vtu["connectivity"][:, :4]
        _, first, times = np.unique(np.sort(corners[:, meshes.SIDES].reshape(-1, 3), axis=1), axis=0,
                                        return_index=True, return_counts=True)
        outer = np.zeros(len(points), bool)
        # the six points of a boundary face: all of its tetrahedron that do not lean on the opposite corner
        middle = {(0, 1): 4, (1, 2): 5, (0, 2): 6, (0, 3): 7, (1, 3): 8, (2, 3): 9}
        for place in first[times == 1]:
            tet, opposite = divmod(int(place), 4)
            outer[vtu["connectivity"][tet][list(meshes.SIDES[opposite])]] = True
            outer[[vtu["connectivity"][tet][k] for pair, k in middle.items() if opposite not in pair]] = True
        away = [body.points[body.corners(group)] for group in body.faces]
        chosen = []
        for k in np.argsort(-vtu["von_mises"]):
            near = [np.linalg.norm(some - points[k], axis=1).min() for some in away + [points[[c]] for c in chosen]]
            if not outer[k] and min(near, default=size) > 0.15 * size:
                chosen.append(k)
            if len(chosen) == count:
                break
        return {f"stress_{number}": [float(x) for x in points[k]] for number, k in enumerate(chosen, 1)}

    def adapted(self, body, most):
        """The body refined where its equilibrium is uneven and at the rims of what is held; a list, ever finer."""
        known = os.path.join(folder(self.name), "adapted.json")
        signature = [digest(self.scene), digest(program("run_scene")),
                     digest(os.path.join(os.path.dirname(os.path.abspath(__file__)), "meshes.py"))]
        try:
            with open(known, encoding="utf-8") as file:
                told = json.load(file)
            enough = [k for k, (_, tets) in enumerate(told["meshes"], 1) if tets > most and k >= 3]
            if told["of"] == signature and enough:
                return told["meshes"][:enough[0]]
        except FileNotFoundError:
            pass
        result = []
        rims = [name for name in body.faces if name.startswith("fixed")]
        while True:
            path = self.mesh(f"adapted_{len(body.tets)}", body)
            result.append([path, len(body.tets)])
            say(f"{self.name}: adapted to {len(body.tets)} tets")
            if len(body.tets) > most and len(result) >= 3:
                break
            vtu = self.equilibrium(path)
            jumps = meshes.gradient_jumps(vtu["Points"], vtu["displacement"], vtu["connectivity"])
            chosen = meshes.worst(jumps, 0.8)
            if len(result) <= 3:
                chosen |= body.near_rims(rims)
            body = body.bisected(chosen)
        with open(known, "w", encoding="utf-8") as out:
            json.dump({"of": signature, "meshes": result}, out)
        return result

    def compare(self, law, duration, reference, variants, checks=(), sizes=None, steps=None):
        """
        Runs variants against a reference and keeps their rows.
        checks  variants that show how far the reference itself is off: two coarser meshes of its kind
        sizes   element sizes of those two and the reference
        steps   for motion: a mesh on which the time step is halved twice, instead of on the finest one
        """
        mode = "dynamic" if duration else "static"
        comparison = Comparison(f"{self.name}, {mode}, {law}", self.scene, duration, reference, self.time_limit)
        own = {error: 0.0 for error in ERRORS}
        orders = {}
        reference_row = comparison.reference_row()
        strong = stressed(reference_row)

        def judge(rows, sizes_of):
            for row in rows:
                if row["status"] != "ok":
                    raise Failed(f"{comparison.name}: a model to verify the reference with was {row['status']}")
            rows = [errors_of(row, strong) for row in rows]
            for error in ERRORS:
                pair = [row[error] for row in rows]
                if None in pair:
                    own[error] = None
                    continue
                order, off = own_error(sizes_of, pair)
                orders.setdefault(error, []).append(order)
                if own[error] is not None:
                    own[error] += off
        judge(comparison.run(list(checks), patient=True), sizes)
        if steps:
            finer = Comparison(f"{self.name}, {mode}, {law}, time steps", self.scene, duration,
                               steps["reference"], self.time_limit)
            judge(finer.run(steps["variants"], patient=True), steps["sizes"])
        if own["tip"] is None or own["tip"] > NO_REFERENCE:
            told = "" if own["tip"] is None else f", tips differ by {100 * own['tip']:.0f} %"
            raise Failed(f"{mode}: finer meshes and smaller steps tell of no limit{told}")
        key = f"{mode} {law}"
        self.own[key], self.orders[key] = own, orders
        self.references[key] = {"overrides": reference, "tets": reference_row["tets"],
                                "nodes": reference_row["nodes"], "period": reference_row["period"],
                                "decay": reference_row["decay"]}
        for variant, row in zip(variants, comparison.run(variants)):
            if row["status"] in ("ok", "not_converged"):
                self.rows.append(point(self.name, mode, variant, row, strong))
            else:
                say(f"{self.name}: left out, {row['status']}: {row['reason']}")
        return comparison

    def join_times(self):
        """Equilibria get the time of the steps of 20 ms on the same model."""
        times = {identity(row): row for row in [*self.rows, *self.times] if row["mode"] == "dynamic"}
        for row in self.rows:
            if row["mode"] == "static":
                row["ms_static"] = row["ms_per_step"]
                moving = times.get(identity({**row, "solver.tolerance": 1e-4}))
                row["ms_per_step"] = moving["ms_per_step"] if moving else None
                row["ms_per_second"] = moving["ms_per_second"] if moving else None


def identity(row):
    return tuple(row[key] for key in ("mesh", *DEFAULTS))


def stressed(reference_row):
    """Probes whose stress is worth comparing: at least half of the largest."""
    values = np.array([value or 0 for value in reference_row["von_mises"]])
    return np.flatnonzero(values >= values.max(initial=0) / 2) if len(values) else []


def errors_of(row, strong):
    result = {name: row["error"][name] for name in ERRORS}
    of_probes = [row["error"]["von_mises_of_probes"][k] for k in strong]
    result["von_mises"] = max(of_probes) if len(of_probes) and None not in of_probes else None
    return result


def point(scene, mode, variant, row, strong):
    """A row of the CSV."""
    path = variant["model.file"]
    return {"scene": scene, "mode": mode, "path": path, "mesh": os.path.splitext(os.path.basename(path))[0],
            "tets": row["tets"], "nodes": row["nodes"], "degrees_of_freedom": row["degrees_of_freedom"],
            **{key: variant[key] for key in DEFAULTS}, "status": row["status"], "residual": row["residual"],
            "iterations": row["iterations"], "ms_per_step": row["ms_per_step"], "ms_per_second": row["ms_per_second"],
            "ms_static": None, **{f"error_{name}": value for name, value in errors_of(row, strong).items()}}


def at_rest(study, law, statics, static_reference):
    """Static rows, against their law's reference."""
    still = study.compare(law, 0, variants=[{**variant, "solver.tolerance": STRICT} for variant in statics],
                          **static_reference)
    study.still[law] = still
    if law != "corotated":
        row = study.still["corotated"].run([static_reference["reference"]])[0]
        study.apart[law] = row["error"]["tip"]


def both_ways(study, law, statics, swings, static_reference, swing_reference):
    """Static rows, their times from steps of 20 ms, and the motion's rows; each against its law's references."""
    at_rest(study, law, statics, static_reference)
    moving = list({json.dumps(variant, sort_keys=True): variant for variant in [*statics, *swings]}.values())
    if swing_reference:
        try:
            study.compare(law, study.duration, variants=moving, **swing_reference)
        except Failed as error:
            if law == LAWS[0]:
                raise
            study.left_out[law] = str(error)
            say(f"{study.name}: {law}: {error}")
            swing_reference = None
    if not swing_reference:
        # Without a reference of this law only the times count.
        timing = Comparison(f"{study.name}, steps, {law}", study.scene, 0.4, statics[0], study.time_limit)
        study.times += [point(study.name, "dynamic", variant, row, []) for variant, row in
                        zip(statics, timing.run(statics)) if row["status"] == "ok"]


def either_way(study, law, *arguments, run=both_ways):
    """What `run` does, but a law other than the first that proves too much for a body is left out, and told."""
    try:
        run(study, law, *arguments)
    except Failed as error:
        if law == LAWS[0]:
            raise
        study.left_out[law] = str(error)
        say(f"{study.name}: {law}: {error}")


def bar(in_short=False, laws=LAWS):
    """
    in_short  points of the usual settings alone, other laws than the co-rotated one at rest only; no search at equal
              accuracy and no other programs
    """
    study = Study("bar", config("bar.yaml"), 2.0)
    study.title = "Bar"
    study.about = "`config/bar.yaml`, meshes of `scripts/make_bar` with 1 to 12 cells across; falls from rest."
    made = {}

    def mesh(cells, halvings=0):
        name = "x".join(map(str, cells)) + (f"_graded_{halvings}" if halvings else "")
        if name not in made:
            made[name] = study.mesh(name, meshes.settle(study.tree, *meshes.of_bar(cells)).graded(halvings))
        return made[name]

    study.write_scene(meshes.settle(study.tree, *meshes.of_bar((2, 2, 5))))
    coarse = [(1, 1, 2), (1, 1, 3), (2, 2, 3), (2, 2, 5), (3, 3, 8), (4, 4, 10), (6, 6, 15)]
    fine = [(8, 8, 20), (12, 12, 30)]
    graded = [mesh((1, 1, 3), 1), mesh((2, 2, 5), 1), mesh((2, 2, 5), 2), mesh((1, 1, 3), 2)]
    usual, finer, simple = mesh((2, 2, 5)), mesh((4, 4, 10)), mesh((8, 8, 20))

    for law in laws:
        of_law = {"elasticity": law}
        statics = [quadratic(m, of_law) for m in [*map(mesh, coarse), *graded]]
        statics += [linear(m, of_law) for m in [*map(mesh, coarse), *graded, simple]]
        swings = []
        if in_short:
            swings += [quadratic(m, stepping("sdirk2", 5)) for m in [*map(mesh, coarse), *graded]]
            swings += [linear(m, stepping("sdirk2", 5)) for m in [*map(mesh, coarse)]]
        elif law == "corotated":
            statics += [quadratic(mesh(cells), {"rotation": rule}) for rule in ("centroid", "four") for cells in coarse]
            statics += [linear(mesh(fine[1]))]
            for ms in (40, 10, 5, 2, 1):
                swings += [quadratic(m, stepping("implicit_euler", ms)) for m in (usual, finer)]
            for ms in (40, 10, 5, 2):
                swings += [linear(simple, stepping("implicit_euler", ms))]
            for ms in (40, 20, 10, 5, 2):
                swings += [quadratic(m, stepping("sdirk2", ms)) for m in (usual, finer)]
                swings += [linear(simple, stepping("sdirk2", ms))]
            swings += [quadratic(m, stepping("sdirk2", 5)) for m in [*map(mesh, coarse), *graded]]
            swings += [linear(m, stepping("sdirk2", 5)) for m in [*map(mesh, coarse)]]
            swings += [quadratic(m, stepping("explicit", 5)) for m in [*map(mesh, coarse), *graded[:2]]]
            swings += [linear(m, stepping("explicit", 5)) for m in [*map(mesh, coarse), simple]]
            for rule in ("centroid", "four"):
                swings += [quadratic(m, stepping(*way), {"rotation": rule}) for m in (usual, finer)
                           for way in (("implicit_euler", 5), ("sdirk2", 5), ("explicit", 5))]
            for tolerance in (1e-1, 1e-2, 1e-3, 1e-6):
                swings += [quadratic(usual, stepping(*way), {"solver.tolerance": tolerance})
                           for way in (("implicit_euler", 20), ("implicit_euler", 5), ("sdirk2", 5))]
                swings += [linear(simple, {"solver.tolerance": tolerance})]
            for preconditioner in ("block_jacobi", "pmultigrid"):
                swings += [make(m, {"solver.preconditioner": preconditioner})
                           for make, m in ((quadratic, usual), (quadratic, finer), (linear, simple))]
            swings += [make(m, {"solver.operator": "assembled"})
                       for make, m in ((quadratic, usual), (quadratic, finer), (linear, simple))]
        else:
            for ms in (10, 5, 2):
                swings += [quadratic(usual, of_law, stepping(way, ms)) for way in ("implicit_euler", "sdirk2")]
            swings += [quadratic(m, of_law, stepping("explicit", 5)) for m in (usual, finer)]
            swings += [linear(simple, of_law, stepping("explicit", 5))]

        # Green strain softens where it is compressed: on meshes that resolve the rim well it finds another equilibrium,
        # and explicit steps turn elements inside out.
        across = (2, 4, 6) if law == "green" else (4, 6, 8)
        still = [quadratic(mesh((n, n, (5 * n + 1) // 2), 2), of_law, FOUR, DEEP) for n in across]
        if law == "green":
            swinging, halvings, way, halved_ms = (2, 4, 6), 0, ("sdirk2", 4), (8, 4, 2)
        else:
            swinging, halvings, way, halved_ms = (2, 3, 4), 1, ("explicit", 2), (0.2, 0.1, 0.05)
        free = [quadratic(mesh((n, n, (5 * n + 1) // 2), halvings), of_law, FOUR, stepping(*way)) for n in swinging]
        halved = [quadratic(usual, of_law, FOUR, stepping(way[0], ms)) for ms in halved_ms]
        swing = {"reference": free[2], "checks": free[:2], "sizes": [1 / n for n in swinging],
                 "steps": {"reference": halved[2], "variants": halved[:2], "sizes": (4, 2, 1)}}
        rest = {"reference": still[2], "checks": still[:2], "sizes": [1 / n for n in across]}
        if in_short and law != LAWS[0]:
            either_way(study, law, statics, rest, run=at_rest)
        else:
            either_way(study, law, statics, swings, rest, swing)
    if not in_short:
        search = BarSearch(study, mesh, study.still["corotated"])
        search.quadratic()
        search.linear()
        study.equal = equal_accuracy(study, search.candidates())
    study.join_times()
    if not in_short:
        study.others = others.bullet(study) + others.calculix(study)
    return study


def bodies(name, scene_path, duration):
    """A scene with any body: its own mesh cut evenly, and adapted to its equilibrium."""
    study = Study(name, scene_path, duration)
    body = meshes.settle(study.tree, *of_scene(scene_path, folder(name, "own")))
    study.write_scene(body)
    adapted = study.adapted(body.subdivided(1), MOST_TETS)
    even = {parts: study.mesh(f"even_{parts}", body.subdivided(parts)) for parts in range(1, 7)
            if parts == 1 or len(body.tets) * parts**3 <= MOST_EVEN}
    within = [path for parts, path in even.items() if len(body.tets) * parts**3 <= MOST_STEPPED]
    lighter = [path for path, tets in adapted[1:] if tets <= MOST_STEPPED]
    light = [pair for pair in adapted if pair[1] <= MOST_MOVED][-3:]
    if len(light) < 3:
        light = adapted[:3]  # own errors take three meshes
    moving = [path for path, _ in light]
    own, sizes = even[1], {path: tets ** (-1 / 3) for path, tets in adapted}
    for law in LAWS:
        of_law = {"elasticity": law}
        # Green strain takes the blocks alone, and long.
        some = [*within, *lighter] if law != "green" else [own, *moving[1:-1]]
        statics = [make(m, of_law) for make in (quadratic, linear) for m in some]
        swings = []
        if law == "corotated":
            statics += [quadratic(own, {"rotation": rule}) for rule in ("centroid", "four")]
            statics += [linear(m) for m in even.values() if m not in within]
            statics += [quadratic(adapted[-3][0])]
            swings += [quadratic(own, stepping(way, ms)) for way in ("implicit_euler", "sdirk2")
                       for ms in (20, 10, 5, 2, 1)]
            swings += [linear(within[-1], stepping(way, ms)) for way in ("implicit_euler", "sdirk2")
                       for ms in (20, 10, 5)]
            swings += [quadratic(m, stepping("sdirk2", 5)) for m in moving[1:-1]]
            swings += [make(own, stepping("explicit", 5)) for make in (quadratic, linear)]
            swings += [quadratic(own, {"rotation": rule}, stepping("sdirk2", 5)) for rule in ("centroid", "four")]
            swings += [quadratic(own, {"solver.tolerance": tolerance}, stepping("sdirk2", 5))
                       for tolerance in (1e-1, 1e-2, 1e-3, 1e-6)]
            swings += [make(own, BLOCKS) for make in (quadratic, linear)]
        elif law == "linear":
            swings += [quadratic(own, of_law, stepping(way, 5)) for way in ("implicit_euler", "sdirk2")]
        finest = adapted[-3:] if law != "green" else light
        still = [quadratic(path, of_law, FOUR, DEEP) for path, _ in finest]
        moved = [quadratic(path, of_law, FOUR, stepping("sdirk2", 4)) for path in moving]
        halved = [quadratic(own, of_law, FOUR, stepping("sdirk2", ms)) for ms in (8, 4, 2)]
        swing = {"reference": moved[-1], "checks": moved[:-1],
                 "sizes": [sizes[variant["model.file"]] for variant in moved],
                 "steps": {"reference": halved[2], "variants": halved[:2], "sizes": (4, 2, 1)}}
        rest = {"reference": still[-1], "checks": still[:-1], "sizes": [tets ** (-1 / 3) for _, tets in finest]}
        either_way(study, law, statics, swings, rest, swing if law != "green" else None)
    return study


def equal_accuracy(study, candidates):
    """
    The fastest mesh of each element whose equilibrium's tip is within WANTED of the reference, and a step of 20 ms of
    implicit Euler on it: with the diagonal blocks and no matrix for both, and with whatever is fastest for each.
    candidates  for each element static rows of the co-rotated law, default rotation
    """
    result = {"wanted": WANTED, "scene": study.name, "reference_error": study.own["static corotated"]["tip"]}
    for element, rows in candidates.items():
        good = [row for row in rows if row["error_tip"] <= WANTED]
        # What reaches it: the three of fewest elements, of which the fastest counts. If nothing: the most accurate.
        tried = sorted(good, key=lambda row: row["tets"])[:3] or [min(rows, key=lambda row: row["error_tip"])]
        plan = [(row, solver) for row in tried for solver in SOLVERS]
        timing = Comparison(f"{study.name}, steps of {element} elements", study.scene, 0.6,
                            quadratic(study.own_mesh), 120)
        measured = timing.run([settings(row["path"], {"element": element}, solver) for row, solver in plan])
        steps = [(row, solver, told["ms_per_step"], told["iterations"])
                 for (row, solver), told in zip(plan, measured) if told["status"] == "ok"]
        same = [step for step in steps if step[1] == SOLVERS[0]]
        result[element] = {"reached": bool(good)}
        for name, some in (("same", same), ("best", steps)):
            if not some:
                raise Failed(f"{study.name}: no step of {element} elements was solved")
            row, solver, ms, iterations = min(some, key=lambda step: step[2])
            result[element][name] = {"mesh": row["mesh"], "tets": row["tets"], "nodes": row["nodes"],
                                     "error": row["error_tip"], "ms": ms, "iterations": iterations,
                                     "solver": solver["solver.preconditioner"] + ", " + solver["solver.operator"]}
    return result


SOLVERS = [{"solver.preconditioner": preconditioner, "solver.operator": operator}
           for preconditioner, operator in (("block_jacobi", "matrix_free"), ("pmultigrid", "matrix_free"),
                                            ("block_jacobi", "assembled"))]


class BarSearch:
    """Looks for the bar's coarsest meshes of a static tip error, cells of any proportion."""

    def __init__(self, study, mesh, comparison):
        self.study, self.mesh, self.comparison, self.known = study, mesh, comparison, {}

    def measure(self, element, many):
        variants = [settings(self.mesh(cells), {"element": element, "solver.tolerance": 1e-5}) for cells in many]
        rows = self.comparison.run(variants, patient=True)
        strong = stressed(self.comparison.reference_row())
        for cells, variant, row in zip(many, variants, rows):
            if row["status"] != "ok":
                raise Failed(f"bar, search: {element} {cells}: {row['status']}")
            told = point(self.study.name, "static", variant, row, strong)
            self.known[element, cells] = told
        return [self.known[element, cells]["error_tip"] for cells in many]

    def quadratic(self):
        self.measure("quadratic", [(x, y, z) for x in (1, 2, 3) for y in (1, 2, 3) for z in range(2, 9)])

    def linear(self):
        """The error as a x^-p + b y^-p + c z^-p of the cells along the axes, fitted, and again where it leads to."""
        start = [(4, 4, 10), (8, 8, 20), (12, 8, 20), (8, 12, 20), (8, 8, 30)]
        errors = self.measure("linear", start)
        order = np.log(errors[0] / errors[1]) / np.log(2)
        powers = np.array(start, float) ** -order
        factors = np.maximum(np.linalg.lstsq(powers / np.array(errors)[:, None], np.ones(len(start)), rcond=None)[0], 0)
        grid = np.stack(np.meshgrid(range(2, 41), range(2, 41), range(5, 81), indexing="ij"), axis=-1).reshape(-1, 3)
        predicted = (grid.astype(float) ** -order) @ factors
        tets = 6 * grid.prod(axis=1)
        scale, reached = 1.0, np.inf
        for _ in range(6):
            fit = np.flatnonzero((scale * predicted <= 0.99 * WANTED) & (tets < 0.97 * reached))
            if len(fit) == 0:
                break
            best = fit[np.argmin(tets[fit])]
            error = self.measure("linear", [tuple(int(n) for n in grid[best])])[0]
            scale = error / predicted[best]
            if error <= WANTED:
                reached = tets[best]

    def candidates(self):
        return {element: [row for (kind, _), row in self.known.items() if kind == element]
                for element in ("quadratic", "linear")}


def even_or_adapted(study):
    """Static rows of the co-rotated law with the default rotation, by element: where the elements are compared."""
    result = {"quadratic": [], "linear": []}
    for row in study.rows:
        if (row["mode"], row["elasticity"], row["rotation"]) == ("static", "corotated", "corners"):
            result[row["element"]].append(row)
    return result


def any_scene(path):
    study = bodies(os.path.splitext(os.path.basename(path))[0], path, 0.5)
    study.title, study.about = study.name, ""
    study.equal = equal_accuracy(study, even_or_adapted(study))
    study.join_times()
    return study


def armadillo():
    study = any_scene(config("armadillo.yaml"))
    study.title = "Armadillo with a pulled leg"
    study.about = "`config/armadillo.yaml`; pulled from rest at time 0, and not let go."
    return study


def bear():
    study = any_scene(config("bear.yaml"))
    study.title = "Bear under its own weight"
    study.about = "`config/bear.yaml`; falls from rest."
    return study
