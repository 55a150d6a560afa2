"""What became of a run: an outcome, its error and the figures behind it, against a truth computed in another way."""
import hashlib
import json

import numpy as np

import bodies
from methods import reference
from provocations import DENSITY, GRAVITY, REFERENCES, SPUN_YOUNG
from tools import Failed, read_nodes

RIGHT, WRONG, NOT_RECOVERED, BLOWN_UP, REFUSED = OUTCOMES = ("stable and right", "stable but wrong", "not recovered",
                                                             "blown up", "refused")
TOLERANCE = 0.05  # relative error up to which a result is right
MOVING = 0.01  # of its displacement that a body at rest may still move by over the last tenth of the run
RECOVERED = 1e-3  # m, largest distance of a node from where it rests
BLOWN = 10.0  # times the largest extent that the truth has
REFERENCE_DURATION = 4.0  # s
RIGHTLY_KEPT = 0.01  # of its energy that a reference may lose or win


class Verdict(dict):
    def __init__(self, outcome, error, text, **figures):
        super().__init__(outcome=outcome, error=error, text=text, **figures)


def percent(value):
    if not np.isfinite(value):
        return "∞"
    return f"{100 * value:+.0f} %" if abs(value) >= 0.0995 else f"{100 * value:+.2g} %"


# The truth ---------------------------------------------------------------------------------------------------------
def law(method):
    """The material law whose truth a method has to meet. Small strain has to meet the co-rotated one's: nature turns."""
    return "green" if "green" in method else "corotated"


class Truths:
    """References, each computed once. Threads may share what prepare() has computed."""

    def __init__(self):
        self.known = {}
        self.told = {}

    @staticmethod
    def wanted(provocation, method):
        """What has to be computed: key, and how."""
        truth = provocation.truth
        if "static" in truth:
            return "static", json.dumps({"elasticity": law(method), **truth["static"]}, sort_keys=True)
        if truth.get("reference") in REFERENCES:
            return "path", f"{truth['reference']}_{law(method)}"
        return None

    def prepare(self, wanted):
        kind, what = wanted
        self.known[wanted] = self.static(json.loads(what)) if kind == "static" else self.path(what)

    def static(self, tree):
        key = "static_" + hashlib.md5(json.dumps(tree, sort_keys=True).encode()).hexdigest()[:12]
        tree["solver"] = {"tolerance": 1e-5, "max_iterations": 20000}
        done = reference(key, tree, None)
        rows = read_nodes(done.nodes)[1]
        tip = tip_of(rows[0])
        return rows[-1][tip] - rows[0][tip]

    def path(self, what):
        name, kind = what.rsplit("_", 1)
        tree = {**REFERENCES[name](), "time_step": 1e-3, "integrator": "explicit", "elasticity": kind,
                "rotation": "four", "solver": {"tolerance": 1e-6}}
        duration = REFERENCE_DURATION / 2 if name == "light" else REFERENCE_DURATION  # of small steps
        done = reference(what, tree, duration)
        rows = read_nodes(done.nodes)[1]
        tip = rows[:, tip_of(rows[0])]
        energy = done.summary["energy"]
        # From rest; gravity's energy is zero at the world's origin.
        size = DENSITY * 0.16 * GRAVITY * np.abs(tip[:, 1]).max()
        start = done.summary["mass"] * GRAVITY * 0.2 if name != "light" else None
        kept = None if start is None else (sum(energy.values()) - start) / size
        self.told[what] = {"energy_change": kept, "inverted": done.summary["inverted_elements"]}
        return np.linspace(0, duration, len(tip)), tip - tip[0]


truths = Truths()


def tip_of(points):
    """The lower corner of the free end, wherever the bar is."""
    low, high = points.min(axis=0), points.max(axis=0)
    return int(np.argmin(np.linalg.norm(points - [low[0], low[1], high[2]], axis=1)))


# What became of it -------------------------------------------------------------------------------------------------
def judge(provocation, method, run):
    if run.status == "refused":
        return Verdict(REFUSED, None, run.line.split(": ", 1)[-1], seconds=run.seconds)
    rows = read_nodes(run.nodes)[1]
    times = np.linspace(0, provocation.duration or 0, len(rows))
    verdict = blown(rows, run, provocation) or JUDGES[provocation.judge](provocation, method, run, times, rows)
    if run.status == "not_converged":
        verdict["text"] += f"; not converged, residual {run.summary['residual'] or np.inf:.0e}"
        if verdict["outcome"] == RIGHT:
            verdict["outcome"] = WRONG
    verdict.update(seconds=run.seconds, status=run.status, inverted=run.summary["inverted_elements"])
    return verdict


def blown(rows, run, provocation):
    """The verdict where it has, else None."""
    size = np.ptp(rows[0], axis=0).max()
    if provocation.truth.get("reference") in ("free_fall", "soft"):
        size = GRAVITY * provocation.duration ** 2 / 2  # it may fall
    size = max(size, 1.0)
    last = len(rows) - 1
    for number, points in enumerate(rows):
        if not np.isfinite(points).all() or np.abs(points - rows[0].mean(axis=0)).max() > BLOWN * size:
            last = number
            break
    else:
        if run.status != "diverged":
            return None
    first = None if provocation.judge != "spin" else lengths(rows)[1] / bodies.SIZE[2]
    return Verdict(BLOWN_UP, None, f"within {run.times()[last]:.2g} s", first=first)


def lengths(rows):
    """From the middle of one end of the bar to that of the other."""
    ends = [np.abs(rows[0][:, 2] - z) < 1e-9 for z in (0, bodies.SIZE[2])]
    return np.linalg.norm(rows[:, ends[1]].mean(axis=1) - rows[:, ends[0]].mean(axis=1), axis=1)


def swing(provocation, method, run, times, rows):
    tip = rows[:, tip_of(rows[0])]
    ours = tip - tip[0]
    duration, kind = provocation.duration, provocation.truth["reference"]
    late = times >= duration / 2 - 1e-9
    if kind == "free_fall":
        # The wall's pull takes 20 s to the tip.
        path = np.zeros_like(ours)
        path[:, 1] = -GRAVITY * times ** 2 / 2
        theirs, size = path[late], np.linalg.norm(path, axis=1).max()
    else:
        at, path = truths.known["path", f"{kind}_{law(method)}"]
        scale = provocation.truth.get("scale", 1.0)
        path = scale * path  # displacements this small are inversely proportional to E
        size = np.linalg.norm(path, axis=1).max()
        if scale == 1.0 and duration <= at[-1] and kind != "stiff":
            theirs = np.stack([np.interp(times[late], at, column) for column in path.T], axis=1)
        else:
            theirs = path
    ours = ours[late]
    way = theirs.mean(axis=0)
    mean = (ours.mean(axis=0) - way) @ way / np.linalg.norm(way) / size
    aside = np.linalg.norm(ours.mean(axis=0) - way) / size

    def spread(path):
        return np.sqrt(((path - path.mean(axis=0)) ** 2).sum(axis=1).mean())

    amplitude = spread(ours) / spread(theirs) - 1
    error = max(aside, abs(amplitude))
    text = f"swing {percent(amplitude)}, mean {percent(mean if abs(mean) > 0.7 * aside else aside)}"
    return Verdict(RIGHT if error <= TOLERANCE else WRONG, error, text, swing=amplitude, mean=mean)


def rest(provocation, method, run, times, rows):
    tip = rows[:, tip_of(rows[0])]
    theirs = truths.known[Truths.wanted(provocation, method)]
    size = np.linalg.norm(theirs)
    ours = tip - tip[0]
    late = ours[times >= 0.9 * provocation.duration - 1e-9] if provocation.duration else ours[-1:]
    moving = np.ptp(late, axis=0).max() / size
    middle = late.mean(axis=0)
    error = np.linalg.norm(middle - theirs) / size
    length = np.linalg.norm(middle) / size - 1
    text = f"deflection {percent(length)}"
    if error > 2 * abs(length) and error > 0.005:
        text = f"position off by {100 * error:.2g} % of the deflection"
    if moving > MOVING:
        text += f", does not come to rest: moves by {100 * moving:.2g} %"
    return Verdict(RIGHT if error <= TOLERANCE and moving <= MOVING else WRONG, max(error, moving), text,
                   deflection=length, moving=moving)


def twist(provocation, method, run, times, rows):
    first, last = rows[0], rows[-1]
    heights = np.unique(np.round(first[:, 2], 6))
    angles = []
    for height in heights:
        section = np.abs(first[:, 2] - height) < 1e-6
        a, b = (points[section, :2] - points[section, :2].mean(axis=0) for points in (first, last))
        angles.append(np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum()))
    angles = np.degrees(np.unwrap(angles))
    angle = provocation.truth["angle"]
    wanted = angle * heights
    error = np.abs(angles - angles[0] - wanted).max() / angle
    text = f"turned by {angles[-1] - angles[0]:.0f}°"
    lost = round((angle - angles[-1] + angles[0]) / 360)
    if lost:
        text += f", {lost} turn{'s' * (abs(lost) > 1)} lost"
    elif error > TOLERANCE:
        text += f", a section off by {100 * error:.2g} %"
    if run.summary["inverted_elements"]:
        text += f", {run.summary['inverted_elements']} elements inverted"
    right = error <= TOLERANCE and run.summary["inverted_elements"] == 0
    return Verdict(RIGHT if right else WRONG, error, text, angle=angles[-1] - angles[0])


def spin(provocation, method, run, times, rows):
    rate, size = provocation.truth["rate"], bodies.SIZE
    mass = DENSITY * size.prod()
    kinetic = mass * (size[1] ** 2 + size[2] ** 2) / 24 * rate ** 2
    stretched = 1 + DENSITY * rate ** 2 * size[2] ** 2 / (12 * SPUN_YOUNG)
    length = lengths(rows)
    inflation = length.max() / stretched - 1
    energy = (run.summary["energy"]["kinetic"] or np.inf) / kinetic - 1
    error = max(abs(energy), abs(inflation))
    return Verdict(RIGHT if error <= TOLERANCE else WRONG, error,
                   f"energy of motion {percent(energy)}, length up to {percent(inflation)}", energy=energy,
                   inflation=inflation, first=length[1] / length[0])


def recovery(provocation, method, run, times, rows):
    points, tets = bodies.bar()
    error = np.linalg.norm(rows[-1][:len(points)] - points, axis=1).max()
    if provocation.truth.get("pushed"):
        inverted = max((bodies.volumes(row[:len(points)], tets) <= 0).sum() for row in rows)
        if not inverted:
            raise Failed(f"{provocation.key}, {method}: the force inverts no element")
    inverted = int((bodies.volumes(rows[-1][:len(points)], tets) <= 0).sum())
    if error <= RECOVERED and not inverted:
        return Verdict(RIGHT, error, f"within {1000 * error:.1g} mm")
    return Verdict(NOT_RECOVERED, error, f"{1000 * error:.2g} mm off, {inverted} elements inverted")


JUDGES = {judge.__name__: judge for judge in (swing, rest, twist, spin, recovery)}
