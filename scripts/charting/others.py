"""The bar in other programs: Bullet's deformable body in motion and at rest, CalculiX at rest."""
import json
import os
import shutil
import time

import numpy as np

from engine import DEFAULTS, digest, folder
from tools import REPOSITORY, call, program, read_probe, run_scene, say

TIP = "lower_left"  # the corner that bench_bullet and calculix_bar follow: (0, 0, 1)
BULLET = {"single": "Bullet, single precision", "double": "Bullet, double precision"}


def kept(name, what, compute):
    """A result from build/chart, or computed and kept there; `what` it depends on."""
    path = os.path.join(folder("others"), name + ".json")
    try:
        with open(path, encoding="utf-8") as file:
            told = json.load(file)
        if told["of"] == what:
            return told["result"]
    except FileNotFoundError:
        pass
    say(f"bar, {name.replace('_', ' ')}")
    result = compute()
    with open(path, "w", encoding="utf-8") as out:
        json.dump({"of": what, "result": result}, out)
    return result


def lines(*command):
    return [json.loads(line) for line in call(*command).splitlines()]


def way(study, mode, law):
    """Times and positions of the reference's tip: over time, or the start and the equilibrium."""
    reference = study.references[f"{mode} {law}"]["overrides"]

    def compute():
        probes = os.path.join(folder(study.name, "way"), f"{mode}_{law}.csv")
        values = {key.replace(".", "__"): value for key, value in reference.items()}
        run_scene(study.scene, os.path.dirname(probes), *(["--static"] if mode == "static" else
                                                          ["--duration", study.duration]), "--probes", probes, **values)
        times, positions = read_probe(probes, TIP)
        return [times.tolist(), positions.tolist()]

    times, positions = kept(f"{mode}_reference_{law}", [digest(program("run_scene")), reference], compute)
    return np.array(times), np.array(positions)


def at_rest(reference, tip):
    _, positions = reference
    return float(np.linalg.norm(np.array(tip) - positions[-1]) / np.linalg.norm(positions[-1] - positions[0]))


def in_motion(reference, trajectory, duration):
    """Root mean square in time of the tip's distance, as bench_variants has it."""
    times, positions = reference
    rows = np.array([row for row in trajectory if row[0] <= duration + 1e-9])
    there = np.stack([np.interp(rows[:, 0], times, positions[:, axis]) for axis in range(3)], axis=1)
    apart = np.linalg.norm(rows[:, 1:] - there, axis=1)
    return float(np.sqrt((apart**2).mean()) / np.linalg.norm(positions - positions[0], axis=1).max())


def bullet(study):
    """Rows: program, settings, tets, mode, error of the tip, ms a simulated second or in all."""
    rows = []
    rest, motion = (way(study, mode, "corotated") for mode in ("static", "dynamic"))
    for precision, name in BULLET.items():
        tool = f"bench_bullet_{precision}"
        told = kept(tool, [digest(program(tool))], lambda tool=tool: lines(
            program(tool), "--law", "corotated", "--across", 2, 4, "--time-step", 0.02, 0.005,
            "--duration", study.duration))
        for row in told:
            moving = row["run"] == "swing"
            if not moving and not row["settled"]:
                continue
            rows.append({"program": name, "settings": row["settings"], "law": "corotated", "element": "linear",
                         "tets": row["tets"], "mode": "dynamic" if moving else "static",
                         "time_step": row["time_step"] if moving else None,
                         "ms": row["ms_per_simulated_second"] if moving else row["ms"],
                         "error_tip": in_motion(motion, row["tip"], study.duration) if moving else
                         at_rest(rest, row["tip"])})
    return rows


def calculix(study, across=(2, 4, 6, 8)):
    """The same rows, none without ccx; the time is the whole process's, `ms_idle` that of one with no analysis."""
    rows = []
    if not shutil.which("ccx"):
        say("bar, CalculiX: ccx is missing; it is Debian's package calculix-ccx")
        return rows
    for law, flags in (("green", []), ("linear", ["--linear"])):
        of_law = way(study, "static", law)
        tool = os.path.join(REPOSITORY, "bench", "calculix_bar")
        for row in kept(f"calculix_{law}", [digest(tool), list(across)], lambda flags=flags, tool=tool: lines(
                tool, *flags, "--across", *across)):
            rows.append({"program": "CalculiX " + (row["version"] or ""), "settings": row["element"], "law": law,
                         "element": "linear" if row["element"] == "C3D4" else "quadratic", "tets": row["tets"],
                         "mode": "static", "time_step": None, "ms": 1000 * row["seconds"],
                         "ms_idle": 1000 * row["idle_seconds"], "error_tip": at_rest(of_law, row["tip"])})
    return rows


def process(study, row):
    """
    ms of a whole process that finds the equilibrium of one of the study's static rows, with reading and writing: the
    shortest of up to ten runs within a second, as CalculiX's is.
    """
    out = folder(study.name, "process")
    values = {key.replace(".", "__"): row[key] for key in DEFAULTS}
    values.update(model__file=row["path"], solver__max_iterations=20000)
    times = []
    while len(times) < 10 and sum(times) < 1000:
        start = time.monotonic()
        run_scene(study.scene, out, "--static", "--probes", os.path.join(out, "probes.csv"), **values)
        times.append(1000 * (time.monotonic() - start))
    return min(times)
