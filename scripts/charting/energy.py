"""What integrators make of the energy of a body that nothing damps: bench_accuracy's free spin and swing."""
import json
import os
import subprocess

from pictures import pyplot

import drawing
from claims import INTEGRATORS, LAWS
from engine import digest, folder
from tools import Failed, program, say

TITLES = {"swing": "swing, let go bent by 0.6 rad", "spin": "spin at 5 rad/s"}
STYLES = {0.02: "-", 0.01: "--", 0.005: ":", 0.001: "-.", 0.0005: "-"}  # by time step


def measured():
    """A row every 0.1 s of each run, quadratic elements, rotations from the corners."""
    kept = os.path.join(folder("results"), f"energy_{digest(program('bench_accuracy'))[:24]}.json")
    if not os.path.exists(kept):
        say("energy of free motion over 10 s, every integrator")
        done = subprocess.run([program("bench_accuracy"), "spin", "--json", kept + ".part"], stdin=subprocess.DEVNULL,
                              stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, check=False)
        if done.returncode != 0:
            raise Failed(done.stderr.strip().splitlines()[-1])
        os.replace(kept + ".part", kept)
    with open(kept, encoding="utf-8") as file:
        rows = json.load(file)
    return [row for row in rows if row["element"] == "quadratic" and row["rotation"] in (None, "corners")]


def runs(rows):
    """{(motion, elasticity, integrator, time step): rows in order of time}"""
    found = {}
    for row in rows:
        found.setdefault((row["motion"], row["elasticity"], row["integrator"], row["time_step"]), []).append(row)
    return found


def draw(rows):
    rules = {"font.family": "DejaVu Sans", "font.size": 8.5, "axes.titlesize": 9, "svg.hashsalt": "energy",
             "svg.fonttype": "none"}
    with pyplot.rc_context(rules):
        figure, all_axes = pyplot.subplots(2, 2, figsize=(9.5, 6.6), sharex=True)
        for (motion, law, integrator, step), ours in runs(rows).items():
            axes = all_axes[list(TITLES).index(motion), ("corotated", "green").index(law)]
            axes.plot([row["time"] for row in ours], [row["energy"] for row in ours], ls=STYLES[step], lw=1.3,
                      color=drawing.INTEGRATOR_COLORS[integrator],
                      label=f"{INTEGRATORS[integrator]}, {1000 * step:g} ms")
            axes.set_title(f"{TITLES[motion]}, {LAWS[law]}")
        for axes in all_axes.ravel():
            axes.set_ylim(0, 2)
            axes.grid(alpha=0.3)
        for axes in all_axes[:, 0]:
            axes.set_ylabel("energy, relative to the start")
        for axes in all_axes[1]:
            axes.set_xlabel("time (s)")
        handles, labels = all_axes[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="upper center", ncol=4, frameon=False, fontsize=8)
        figure.tight_layout(rect=(0, 0, 1, 0.93))
        drawing.save(figure, drawing.PLACE, "energy")


def left(rows):
    """Table rows: integrator, time step in s, and the shares of energy left after 10 s."""
    found = runs(rows)
    kinds = dict.fromkeys((integrator, step) for _, _, integrator, step in found)
    for integrator, step in kinds:
        yield [integrator, step, *(found[motion, law, integrator, step][-1]["energy"]
                                   for motion in TITLES for law in ("corotated", "green"))]
