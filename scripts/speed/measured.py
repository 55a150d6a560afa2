"""What is measured, a part each."""
import os
import shutil
import subprocess

import engine
import scenes
import studies
import tools
from tables import tables

TELL = ("element", "tets", "mode", "integrator", "time_step", "elasticity", "solver.tolerance", "ms_per_second",
        "ms_static", "error_tip")


def steps_of(scene, overrides, steps, threads=(1,)):
    """Rows of bench_steps, one for each number of threads."""
    settings = [word for value in [*scenes.FALL, *overrides] for word in ("--set", value)]
    text = tools.call(tools.program("bench_steps"), tools.config(f"{scene}.yaml"), "--threads", *threads, "--steps",
                      steps, *settings)
    return tables(text)[0]


def earlier(revision):
    """The programs of an earlier revision, built beside its sources; a folder."""
    source = os.path.join(tools.folder("before"), revision)
    build = source + "_build"
    programs = os.path.join(build, "lib", "bezier_fem")
    if not os.path.isdir(source):
        tools.call("git", "-C", tools.REPOSITORY, "worktree", "prune")
        tools.call("git", "-C", tools.REPOSITORY, "worktree", "add", "--detach", source, revision)
    tools.say(f"building {revision}")
    tools.call("cmake", "-S", source, "-B", build, "-DCMAKE_BUILD_TYPE=Release", "-DBEZIER_FEM_ROS=OFF",
               "-DBEZIER_FEM_BENCH=ON", "-DBUILD_TESTING=OFF")
    tools.call("cmake", "--build", build, "--parallel", os.cpu_count(), "--target", "bench_steps", "bench_variants",
               "bezier_fem_programs")
    for name in ("bench_bullet_single", "bench_bullet_double"):  # which are not ours, and not measured twice
        link = os.path.join(programs, name)
        if os.path.lexists(link):
            os.remove(link)
        os.symlink(tools.program(name), link)
    return programs


class ProgramsOf:
    """Within it programs are those of another folder."""

    def __init__(self, folder):
        self.folder = folder

    def __enter__(self):
        self.kept, tools.program.folder = tools.program.folder, self.folder

    def __exit__(self, *_):
        tools.program.folder = self.kept


def steps(arguments):
    before = earlier(arguments.before)
    rows = []
    for name, scene, overrides, _ in scenes.STEPS:
        tools.say(name)
        one, two = steps_of(scene, overrides, arguments.steps, (1, 2))
        classic, = steps_of(scene, [*overrides, *scenes.CLASSIC], arguments.steps)
        with ProgramsOf(before):
            then, = steps_of(scene, overrides, arguments.steps)
        rows.append({"name": name, "one": one, "two": two, "classic": classic, "before": then})
    return rows


def linear(arguments):
    rows = []
    settings = ["element=linear", f"solver.tolerance={scenes.LINEAR_TOLERANCE}"]
    for name, scene, overrides, _, _ in scenes.LINEAR:
        tools.say(name)
        own, = steps_of(scene, [*overrides, *settings], arguments.steps)
        blocks = [steps_of(scene, [*overrides, *settings, *how], arguments.steps)[0]
                  for how in (scenes.BLOCKS, scenes.CLASSIC)]
        rows.append({"name": name, "own": own, "blocks": min(blocks, key=lambda row: row["whole step"])})
    return rows


def growth(arguments):
    rows = []
    for how, meshes in (("meshed", scenes.MESHED), ("cut", scenes.CUT)):
        for overrides in meshes:
            row, = steps_of("bunny", overrides, arguments.steps)
            tools.say(f"bunny, {row['tets']} tets: {row['iterations']} iterations, {row['whole step']} ms")
            rows.append({"how": how, **row})
    return rows


def kernels(_):
    settings = [word for value in scenes.FALL for word in ("--set", value)]
    found = {}
    for name, overrides in (("small", []), ("large", ["--set", scenes.BUNNY_10000])):
        text = tools.call(tools.program("bench_roofline"), tools.config("bunny.yaml"), *settings, *overrides)
        peaks, rows = tables(text)
        found[name] = {"peaks": peaks, "rows": rows, "set": text.split("Instruction set: ")[1].split()[0]}
    return found


def unit():
    """ms of a product, the bunny's: what the machine is worth at the moment."""
    return steps_of("bunny", [], 1)[0]["one product"]


def points(study):
    return [{key: row[key] for key in TELL} for row in study.rows]


def front(arguments):
    """The bar's points in both revisions, one after the other, and other programs'; nothing kept from another run."""
    engine.WORK = os.path.join(tools.WORK, "chart")
    shutil.rmtree(engine.WORK, ignore_errors=True)
    earlier(arguments.before)  # now, lest it come between the two
    now = studies.bar(equal_accuracy_too=False)
    units = [unit()]
    with ProgramsOf(earlier(arguments.before)):
        then = studies.bar(studies.LAWS[:1], equal_accuracy_too=False)
    units.append(unit())
    revision = subprocess.run(["git", "-C", tools.REPOSITORY, "log", "-1", "--format=%h of %as", arguments.before],
                              capture_output=True, text=True, check=True).stdout.strip()
    return {"now": points(now), "before": points(then), "revision": revision, "others": now.others,
            "products": units}


PARTS = {"steps": steps, "linear": linear, "growth": growth, "kernels": kernels, "front": front}
