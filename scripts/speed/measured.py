"""What is measured, a part each."""
import os
import shutil
import statistics
import subprocess

import claims
import engine
import others
import scenes
import studies
import tools
from tables import tables

TELL = ("element", "tets", "mode", "integrator", "time_step", "elasticity", "solver.tolerance", "ms_per_second",
        "ms_static", "error_tip")


def steps_of(scene, overrides, steps, threads=(1,), environment=()):
    """Rows of bench_steps, one for each number of threads; `environment`: NAME=VALUE."""
    settings = [word for value in [*scenes.FALL, *overrides] for word in ("--set", value)]
    text = tools.call(*(["env", *environment] if environment else []), tools.program("bench_steps"),
                      tools.config(f"{scene}.yaml"), "--threads", *threads, "--steps", steps, *settings)
    return tables(text)[0]


def earlier(revision):
    """The programs of an earlier revision, built once, beside its sources; a folder."""
    source = os.path.join(tools.folder("before"), revision)
    build = source + "_build"
    programs = os.path.join(build, "lib", "bezier_fem")
    needed = ("bench_steps", "bench_variants", "run_scene")
    if not all(os.access(os.path.join(programs, name), os.X_OK) for name in needed):
        tools.say(f"building {revision}")
        if not os.path.isdir(source):
            tools.call("git", "-C", tools.REPOSITORY, "worktree", "prune")
            tools.call("git", "-C", tools.REPOSITORY, "worktree", "add", "--detach", source, revision)
        tools.call("cmake", "-S", source, "-B", build, "-DCMAKE_BUILD_TYPE=Release", "-DBEZIER_FEM_ROS=OFF",
                   "-DBEZIER_FEM_BENCH=ON", "-DBUILD_TESTING=OFF")
        tools.call("cmake", "--build", build, "--parallel", os.cpu_count(), "--target", "bench_steps",
                   "bench_variants", "bezier_fem_programs")
    return programs


class ProgramsOf:
    """Within it programs are those of another folder."""

    def __init__(self, folder):
        self.folder = folder

    def __enter__(self):
        self.kept, tools.program.folder = tools.program.folder, self.folder

    def __exit__(self, *_):
        tools.program.folder = self.kept


def told(name, row):
    """Says what a row of bench_steps has."""
    tools.say(f"{name}: {row['tets']} tets, {row['iterations']} iterations, {row['whole step']:.2f} ms, "
              f"{row['step in products']:.1f} products")
    return row


def steps(arguments):
    """Scene by scene, what is not claimed last, and over fewer steps where it takes long."""
    before = earlier(arguments.before)
    rows = []
    for name, scene, overrides, _ in scenes.STEPS:
        one, two = steps_of(scene, overrides, arguments.steps, (1, 2))
        told(name, one)
        rows.append({"name": name, "one": one, "two": told(f"{name}, two threads", two)})
        few = arguments.steps if name == scenes.CLASSIC_CLAIMED else min(arguments.steps, scenes.FEW_STEPS)
        with ProgramsOf(before):
            rows[-1]["before"] = told(f"{name}, before", steps_of(scene, overrides, arguments.steps)[0])
        rows[-1]["classic"] = told(f"{name}, classic", steps_of(scene, [*overrides, *scenes.CLASSIC], few)[0])
        yield rows


def linear(arguments):
    rows = []
    settings = ["element=linear", f"solver.tolerance={scenes.LINEAR_TOLERANCE}"]
    for name, scene, overrides, _, _ in scenes.LINEAR:
        row = {"name": name}
        for key, how in (("own", []), ("blocks", scenes.BLOCKS), ("assembled", scenes.CLASSIC)):
            row[key] = told(f"{name}, linear elements, {key}",
                            steps_of(scene, [*overrides, *settings, *how], arguments.steps)[0])
        rows.append(row)
        yield rows


def growth(arguments):
    rows = []
    for how, overrides, most in scenes.GROWTH:
        count = min(most, arguments.steps)
        row, = steps_of("bunny", overrides, count)
        rows.append({"how": how, "steps": count, **told(f"bunny, {how}", row)})
        yield rows


def kernels(_):
    settings = [word for value in scenes.FALL for word in ("--set", value)]
    found = {}
    for name, overrides in (("small", []), ("large", ["--set", scenes.BUNNY_10000])):
        text = tools.call(tools.program("bench_roofline"), tools.config("bunny.yaml"), *settings, *overrides)
        peaks, rows = tables(text)
        found[name] = {"peaks": peaks, "rows": rows, "set": text.split("Instruction set: ")[1].split()[0]}
        tools.say(f"kernels, {name}")
        yield found


def huge_pages(arguments):
    """With and without in turns, for what a machine does otherwise drifts; the medians of three of each."""
    try:
        with open("/sys/kernel/mm/transparent_hugepage/enabled", encoding="ascii") as file:
            system = file.read().split("[")[1].split("]")[0]
    except OSError:
        system = "unknown"
    found = {"system": system, "rows": []}
    for name, scene, overrides, _ in scenes.HUGE_PAGES:
        told = {"without": [], "with": []}
        for _ in range(3):
            for how, tunables in (("without", ""), ("with", "glibc.malloc.hugetlb=1")):
                told[how] += steps_of(scene, overrides, arguments.steps, environment=[f"GLIBC_TUNABLES={tunables}"])
        row = {"name": name, "tets": told["with"][0]["tets"]}
        for how, runs in told.items():
            row[how] = {key: statistics.median(run[key] for run in runs) for key in ("whole step", "one product")}
            tools.say(f"{name}, {how} huge pages: {row[how]['whole step']:.2f} ms")
        found["rows"].append(row)
        yield found


def unit():
    """ms of a product, the bunny's: what the machine is worth at the moment."""
    return steps_of("bunny", [], 1)[0]["one product"]


def points(study):
    return [{key: row.get(key) for key in (*TELL, "ms_process")} for row in study.rows]


def front(arguments):
    """A few of the bar's points, Bullet's and CalculiX's, then the points of the revision before."""
    engine.WORK = os.path.join(tools.WORK, "chart")
    shutil.rmtree(engine.WORK, ignore_errors=True)  # nothing kept from another run
    before = earlier(arguments.before)  # now, lest it come between the two
    now = studies.bar(in_short=True)
    revision = subprocess.run(["git", "-C", tools.REPOSITORY, "log", "-1", "--format=%h of %as", arguments.before],
                              capture_output=True, text=True, check=True).stdout.strip()
    bullet, calculix = others.bullet(now), others.calculix(now, (2, 4, 6))
    for *_, own in claims.calculix_pairs(now.rows, calculix):
        if own and "ms_process" not in own:
            own["ms_process"] = others.process(now, own)
    found = {"now": points(now), "revision": revision, "others": bullet, "calculix": calculix,
             "green_apart": now.apart.get("green"), "products": [unit()]}
    yield found
    with ProgramsOf(before):
        found["before"] = points(studies.bar(in_short=True, laws=studies.LAWS[:1]))
    found["products"].append(unit())
    yield found


# Generators: each yields what it has so far, time and again
PARTS = {"steps": steps, "linear": linear, "growth": growth, "kernels": kernels, "huge_pages": huge_pages,
         "front": front}
