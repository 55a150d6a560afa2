"""Runs variants of a scene with bench_variants, and keeps every result so that an interrupted run goes on."""
import functools
import hashlib
import json
import os
import subprocess

from tools import REPOSITORY, Failed, program, say

WORK = os.path.join(REPOSITORY, "build", "chart")
# A key of the scene file, and what the chart calls it where it differs; the defaults are the scene file's.
DEFAULTS = {"element": "quadratic", "elasticity": "corotated", "rotation": "corners", "integrator": "implicit_euler",
            "time_step": 0.02, "solver.tolerance": 1e-4, "solver.preconditioner": "auto",
            "solver.operator": "matrix_free"}


def folder(*names):
    path = os.path.join(WORK, *names)
    os.makedirs(path, exist_ok=True)
    return path


@functools.lru_cache(maxsize=None)
def digest(path):
    with open(path, "rb") as file:
        return hashlib.sha256(file.read()).hexdigest()


def words(variant):
    """KEY=VALUE, as bench_variants reads them."""
    return [f"{key}={value}" for key, value in variant.items()]


class Comparison:
    """
    Variants of one scene against one reference.
    scene      path of the scene file
    duration   s; 0: the equilibrium
    reference  overrides of the scene
    """

    def __init__(self, name, scene, duration, reference, time_limit=60):
        self.name, self.scene, self.duration, self.reference = name, scene, duration, reference
        self.time_limit = time_limit
        self.kept = folder("results")
        self.settings = ["--static"] if duration == 0 else ["--duration", str(duration)]

    def _key(self, variant):
        parts = [digest(program("bench_variants")), digest(self.scene), self.settings, str(self.time_limit)]
        for tree in (self.reference, variant):  # a mesh counts by what is in it
            parts.append(sorted(words({key: digest(value) if key == "model.file" else value
                                       for key, value in tree.items()})))
        return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:24]

    def _kept(self, variant, patient=False):
        try:
            with open(os.path.join(self.kept, self._key(variant) + ".json"), encoding="utf-8") as file:
                row = json.load(file)
                return None if patient and row["status"] == "stopped" else row
        except FileNotFoundError:
            return None

    def _keep(self, variant, row):
        path = os.path.join(self.kept, self._key(variant) + ".json")
        with open(path + ".part", "w", encoding="utf-8") as out:
            json.dump(row, out)
        os.replace(path + ".part", path)

    def reference_row(self):
        """What the reference itself came to."""
        if self._kept({"role": "reference"}) is None:
            self.run([])
        return self._kept({"role": "reference"})

    def run(self, variants, patient=False):
        """
        The rows of the variants (each a mapping of scene keys to values), in their order.
        patient  let them take as long as they need
        """
        missing = [variant for variant in variants if self._kept(variant, patient) is None]
        if missing or self._kept({"role": "reference"}) is None:
            self._run(missing, 3600 if patient else self.time_limit)
        return [self._kept(variant) for variant in variants]

    def _run(self, missing, time_limit):
        command = [program("bench_variants"), self.scene, *self.settings, "--time-limit", str(time_limit),
                   "--reference", " ".join(words(self.reference))]
        recording = os.path.join(self.kept, self._key({"role": "recording"}) + ".cbor")
        if os.path.exists(recording) and self._kept({"role": "reference"}) is not None:
            command += ["--load-reference", recording]
        else:
            say(f"{self.name}: reference, {short(self.reference)}")
            command += ["--save-reference", recording]
        log = os.path.join(folder(), "bench_variants.log")
        with open(log, "w", encoding="utf-8") as errors, subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, text=True) as process:
            try:
                process.stdin.write("".join(" ".join(words(variant)) + "\n" for variant in missing))
                process.stdin.close()
                for number, line in enumerate(process.stdout):
                    row = json.loads(line)
                    self._keep(missing[number - 1] if number else {"role": "reference"}, row)
                    if number:
                        say(f"{self.name}: {number} of {len(missing)}, {short(missing[number - 1])}: {outcome(row)}")
            except BaseException:
                process.kill()
                raise
        if process.returncode != 0:
            with open(log, encoding="utf-8") as errors:
                lines = errors.read().strip().splitlines()
            raise Failed(lines[-1] if lines else f"bench_variants: status {process.returncode}")


def short(variant):
    """A variant in a few words: its mesh, and what is not the default."""
    mesh = os.path.splitext(os.path.basename(variant["model.file"]))[0]
    changed = [f"{key.split('.')[-1]} {value}" for key, value in variant.items()
               if key != "element" and value != DEFAULTS.get(key, value)]
    return ", ".join([f"{variant['element']} {mesh}", *changed])


def outcome(row):
    if row["status"] not in ("ok", "not_converged"):
        return f"{row['status']}, {row['reason']}"
    error = row["error"]["tip"]
    return (f"{row['tets']} tets, {row['ms_per_step']:.3g} ms a step, error "
            + ("-" if error is None else f"{100 * error:.2g} %") + ("" if row["status"] == "ok" else ", not converged"))

