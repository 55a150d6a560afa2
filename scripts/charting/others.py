"""The bar in other programs: Bullet's deformable body in motion and at rest, CalculiX at rest."""
import json
import os

import numpy as np

from engine import digest, folder
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


def ways(study, law):
    """Where the references' tip goes: at rest, and over time."""
    references = {mode: study.references[f"{mode} {law}"]["overrides"] for mode in ("static", "dynamic")}

    def compute():
        result = {}
        for mode, arguments in (("static", ["--static"]), ("dynamic", ["--duration", study.duration])):
            out = folder(study.name, "ways")
            values = {key.replace(".", "__"): value for key, value in references[mode].items()}
            run_scene(study.scene, out, *arguments, "--probes", os.path.join(out, "probes.csv"), **values)
            times, way = read_probe(os.path.join(out, "probes.csv"), TIP)
            result[mode] = [times.tolist(), way.tolist()]
        return result

    result = kept(f"reference_{law}", [digest(program("run_scene")), references], compute)
    return {mode: tuple(np.array(part) for part in pair) for mode, pair in result.items()}


def at_rest(ways_of_law, tip):
    _, way = ways_of_law["static"]
    return float(np.linalg.norm(np.array(tip) - way[-1]) / np.linalg.norm(way[-1] - way[0]))


def in_motion(ways_of_law, trajectory, duration):
    """Root mean square in time of the tip's distance, as bench_variants has it."""
    times, way = ways_of_law["dynamic"]
    rows = np.array([row for row in trajectory if row[0] <= duration + 1e-9])
    there = np.stack([np.interp(rows[:, 0], times, way[:, axis]) for axis in range(3)], axis=1)
    apart = np.linalg.norm(rows[:, 1:] - there, axis=1)
    return float(np.sqrt((apart**2).mean()) / np.linalg.norm(way - way[0], axis=1).max())


def measure(study):
    """Rows: program, settings, tets, mode, error of the tip, ms a simulated second or in all."""
    rows = []
    corotated = ways(study, "corotated")
    for precision, name in BULLET.items():
        tool = f"bench_bullet_{precision}"
        told = kept(tool, [digest(program(tool))], lambda tool=tool: lines(
            program(tool), "--law", "corotated", "--across", 2, 4, 8, "--time-step", 0.02, 0.005,
            "--duration", study.duration))
        for row in told:
            moving = row["run"] == "swing"
            if not moving and not row["settled"]:
                continue
            rows.append({"program": name, "settings": row["settings"], "law": "corotated", "element": "linear",
                         "tets": row["tets"], "mode": "dynamic" if moving else "static",
                         "time_step": row["time_step"] if moving else None,
                         "ms": row["ms_per_simulated_second"] if moving else row["ms"],
                         "error_tip": in_motion(corotated, row["tip"], study.duration) if moving else
                         at_rest(corotated, row["tip"])})
    for law, flags in (("green", []), ("linear", ["--linear"])):
        of_law = ways(study, law)
        tool = os.path.join(REPOSITORY, "bench", "calculix_bar")
        for row in kept(f"calculix_{law}", [digest(tool)], lambda flags=flags, tool=tool: lines(tool, *flags)):
            rows.append({"program": "CalculiX " + (row["version"] or ""), "settings": row["element"], "law": law,
                         "element": "linear" if row["element"] == "C3D4" else "quadratic", "tets": row["tets"],
                         "mode": "static", "time_step": None, "ms": 1000 * row["seconds"],
                         "error_tip": at_rest(of_law, row["tip"])})
    return rows
