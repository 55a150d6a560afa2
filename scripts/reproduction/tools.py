"""What the parts share: where things are, running the package's programs, scenes of falling bodies, reading results."""
import csv
import json
import os
import subprocess
import time

import numpy as np
import yaml

REPOSITORY = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
WORK = os.path.join(REPOSITORY, "build", "reproduction")
PICTURES = os.path.join(REPOSITORY, "doc", "reproduction")

TOLERANCE = 1e-4
STEPS = 60
# [W11] does not tell its preconditioner; the simplest one is the same for both elements.
SOLVER = {"preconditioner": "block_jacobi", "tolerance": TOLERANCE, "max_iterations": 20000}

# Rotations that put a surface's upward direction along z.
POSES = {"armadillo": [1.5708, 0, -1.5708], "bunny": [1.5708, 0, 3.1416], "elephant": [0, -1.5708, 0],
         "anchor_dense": [0, 0, 0]}


class Failed(Exception):
    """Ends the script with one line."""


def program(name):
    path = os.path.join(program.folder, name)
    if not os.access(path, os.X_OK):
        raise Failed(f"there is no program {path}")
    return path


program.folder = os.path.join(REPOSITORY, "build", "devel", "lib", "bezier_fem")


def say(text):
    print(f"[{time.monotonic() - say.start:5.0f} s] {text}", flush=True)


say.start = time.monotonic()


def attempt(*command, cwd=None, timeout=None):
    """Runs a command; what became of it."""
    return subprocess.run([str(word) for word in command], cwd=cwd, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                          stderr=subprocess.PIPE, text=True, check=False, timeout=timeout)


def call(*command, cwd=None):
    """Runs a command and returns its stdout; its last line on stderr is the error."""
    done = attempt(*command, cwd=cwd)
    if done.returncode != 0:
        lines = (done.stderr.strip() or done.stdout.strip()).splitlines()
        name, line = os.path.basename(str(command[0])), lines[-1] if lines else f"status {done.returncode}"
        raise Failed(line if line.startswith(name) else f"{name}: {line}")
    return done.stdout


def folder(*names):
    path = os.path.join(WORK, *names)
    os.makedirs(path, exist_ok=True)
    return path


def picture(figure, name):
    os.makedirs(PICTURES, exist_ok=True)
    figure.savefig(os.path.join(PICTURES, name + ".png"), dpi=110)


def overrides(values):
    for key, value in values.items():
        yield "--set"
        yield f"{key}={value if isinstance(value, str) else json.dumps(value)}"


def run_scene(scene, out, *arguments, **values):
    """Runs a scene; `values` override its keys, with `__` for the point. Returns the summary."""
    summary = os.path.join(out, "summary.json")
    values = {key.replace("__", "."): value for key, value in values.items()}
    call(program("run_scene"), scene, "--summary", summary, *arguments, *overrides(values))
    with open(summary, encoding="utf-8") as file:
        return json.load(file)


def config(name):
    return os.path.join(REPOSITORY, "config", name)


def model_file(name):
    path = os.path.join(REPOSITORY, "models", name + ".off")
    if not os.path.exists(path):
        raise Failed(f"{path} is missing: scripts/install_dependencies puts it there")
    return path


def rotation(rpy):
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    return (np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]]) @ np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]]) @
            np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]]))


def falling(surface, cell_size, element, carried):
    """A scene's path: a soft body 1 m long, its lowest twentieth held, falls under its weight from rest."""
    path = model_file(surface)
    with open(path, encoding="ascii") as file:
        words = file.read().split()
    points = np.array(words[4:4 + 3 * int(words[1])], float).reshape(-1, 3)
    height = (points / np.ptp(points, axis=0).max() @ rotation(POSES[surface]).T)[:, 2]
    top = float(height.min() + 0.05 * np.ptp(height))
    scene = {"model": {"file": path, "longest_side": 1.0, "cell_size": cell_size, "pose": {"rpy": POSES[surface]}},
             "element": element, "rotation": "corners", "time_step": 0.02,
             "material": {"young": 2.0e5, "poisson": 0.45, "density": 500.0}, "solver": SOLVER,
             "fixed": [{"name": "foot", "box": {"min": [-9, -9, -9], "max": [9, 9, top]}}]}
    if carried:
        scene["surface"] = {"file": path}
    name = os.path.join(folder("scenes"), f"{surface}_{cell_size}_{element}{'_carrying' if carried else ''}.yaml")
    with open(name, "w", encoding="ascii") as out:
        yaml.safe_dump(scene, out, sort_keys=False)
    return name


def read_probe(path, name):
    """Times and positions (n x 3) of a probe."""
    with open(path, encoding="ascii") as file:
        rows = list(csv.DictReader(file))
    return (np.array([float(row["time"]) for row in rows]),
            np.array([[float(row[f"{name}.{axis}"]) for axis in "xyz"] for row in rows]))


def read_nodes(path):
    """Ids, and positions (rows x nodes x 3)."""
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    count = len(np.unique(table[:, 1]))
    return table[:count, 1].astype(int), table[:, 2:].reshape(-1, count, 3)


def write_start(path, ids, positions):
    with open(path, "w", encoding="ascii") as out:
        out.write("node,x,y,z\n")
        for node, (x, y, z) in zip(ids, positions):
            out.write(f"{node},{x:.9g},{y:.9g},{z:.9g}\n")


def machine():
    """Processor, cores and compiler, in words."""
    with open("/proc/cpuinfo", encoding="ascii", errors="replace") as file:
        lines = [line.split(":", 1) for line in file if ":" in line]
    facts = {key.strip(): value.strip() for key, value in lines}
    flags = facts.get("flags", "").split()
    kernels = "AVX-512" if "avx512dq" in flags else "AVX2" if "avx2" in flags else "the portable kernels"
    mhz = f" at {float(facts['cpu MHz']) / 1000:.1f} GHz" if "cpu MHz" in facts else ""
    compiler = call("c++", "--version").splitlines()[0]
    return f"{facts.get('model name', os.uname().machine)}{mhz}, {os.cpu_count()} cores, {kernels}; {compiler}"


def save(part, result):
    os.makedirs(WORK, exist_ok=True)
    with open(os.path.join(WORK, part + ".json"), "w", encoding="utf-8") as out:
        json.dump(result, out, indent=1, default=lambda number: number.item())  # NumPy's


def saved(part):
    """What a part left, or None."""
    try:
        with open(os.path.join(WORK, part + ".json"), encoding="utf-8") as file:
            return json.load(file)
    except FileNotFoundError:
        return None


