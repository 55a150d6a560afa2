"""The methods, and how one is run on a provocation."""
import json
import os
import time

import yaml

from provocations import EXPLICIT_STEP
from tools import Failed, attempt, folder, program

# Name, program, what it is told beside the scene, keys of the scene
METHODS = {
    "explicit_green": ("explicit, Green strain", "bench_stability", ["--method", "explicit"], {"elasticity": "green"}),
    "explicit_corotated": ("explicit, co-rotated", "bench_stability", ["--method", "explicit"], {}),
    "substepped_green": ("explicit in stable sub-steps, Green strain", "run_scene", [],
                         {"integrator": "explicit", "elasticity": "green"}),
    "substepped_corotated": ("explicit in stable sub-steps, co-rotated", "run_scene", [], {"integrator": "explicit"}),
    "plain_polar": ("implicit, co-rotated, plain polar decomposition", "bench_stability", ["--method", "plain_polar"],
                    {}),
    "linear": ("implicit, linear elasticity", "run_scene", [], {"elasticity": "linear"}),
    "green": ("implicit, Green strain", "run_scene", [], {"elasticity": "green"}),
    "sdirk2": ("implicit, second order, co-rotated", "run_scene", [], {"integrator": "sdirk2"}),
    "auto": ("the same with integrator: auto", "run_scene", [], {"integrator": "auto"}),
    "default": ("implicit, co-rotated, inversion-safe: the default", "run_scene", [], {}),
}
DEFAULT = "default"
ROWS = 200  # about so many are written of a run
LONGEST = 600  # s, before a run is given up


class Run:
    """What came of a run: `status` is ok, not_converged, diverged or refused; `nodes` the path of the rows."""

    def __init__(self, out, tree, duration, arguments, name):
        os.makedirs(out, exist_ok=True)
        path, self.nodes, summary = (os.path.join(out, file) for file in ("scene.yaml", "nodes.csv", "summary.json"))
        with open(path, "w", encoding="ascii") as file:
            yaml.safe_dump(tree, file, sort_keys=False)
        if os.path.exists(summary):
            os.remove(summary)
        command = [program(name), path, "--nodes", self.nodes, "--summary", summary, *arguments]
        if duration is not None:
            steps = max(1, round(duration / tree["time_step"]))
            command += ["--steps", steps, "--every", max(1, round(steps / ROWS))]
        else:
            command.append("--static")
        begin = time.monotonic()
        done = attempt(*command, timeout=LONGEST)
        self.seconds = time.monotonic() - begin
        self.summary, self.line = {}, done.stderr.strip()
        if done.returncode == 2:
            self.status = "refused"
            return
        if not os.path.exists(summary):
            raise Failed(f"{path}: {self.line or done.returncode}")
        with open(summary, encoding="utf-8") as file:
            self.summary = json.load(file)
        self.status = self.summary["status"]

    def times(self):
        """Of the rows, s."""
        with open(self.nodes, encoding="ascii") as file:
            return sorted({float(line.split(",", 1)[0]) for line in file if line[0].isdigit()})


def run(provocation, method):
    _, name, arguments, keys = METHODS[method]
    tree = {**provocation.scene, **keys}
    if name == "bench_stability":
        # It has the diagonal blocks alone.
        tree["solver"] = {"max_iterations": 20000}
        if method != "plain_polar" and not provocation.own_step:
            tree["time_step"] = EXPLICIT_STEP
    return Run(folder(provocation.key, method), tree, provocation.duration, arguments, name)


def reference(key, tree, duration, **keys):
    """A run that has to succeed."""
    done = Run(folder("references", key), {**tree, **keys}, duration, [], "run_scene")
    if done.status != "ok":
        raise Failed(f"reference {key}: {done.line or done.status}")
    return done
