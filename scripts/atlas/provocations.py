"""What provokes: scenes, each with the truth that it is judged by. A scene here is the default one but for what it names."""
import copy
import os
import threading

import numpy as np

import bodies
from tools import folder

YOUNG, POISSON, DENSITY, GRAVITY = 2.0e5, 0.34, 500.0, 9.81
STEP = 0.02  # s, the package's default
EXPLICIT_STEP = 0.0005  # s, of Weber et al. 2011, section 8.2
SPUN_YOUNG = 1.0e8  # Pa, of the bar that spins
CRITICAL = {"mass": 15.0}  # 1/s: about critical for the bar's first bending mode, so that it comes to rest in 2 s
SETTLING = {"mass": 5.0}
FAR = 1.0e4  # m along each axis
EVERYWHERE = 1.0e5
PUSH = 4000.0  # N
SEEDS = 100


def mesh(name, points, tets):
    """A file of them. Several threads may ask for it while programs read it: it is there as a whole, or not."""
    path = os.path.join(folder("meshes"), name)
    part = f"{path}.{threading.get_ident()}"
    bodies.write_msh(part, points, tets)
    os.replace(part, path)
    return path


def half_space(axis, low=-EVERYWHERE, high=EVERYWHERE):
    box = {"min": [-EVERYWHERE] * 3, "max": [EVERYWHERE] * 3}
    box["min"][axis], box["max"][axis] = low, high
    return box


def scene(file=None, wall=0.0, **values):
    """The bar of Weber et al. 2011, held at z = 0, under its weight; `values` replace keys, with `__` for the point."""
    tree = {"model": {"file": file or mesh("bar.msh", *bodies.bar())},
            "material": {"young": YOUNG, "poisson": POISSON, "density": DENSITY}, "gravity": [0, -GRAVITY, 0],
            "time_step": STEP, "fixed": [{"name": "wall", "box": half_space(2, high=wall + 0.01)}]}
    for key, value in values.items():
        at = tree
        *parents, last = key.split("__")
        for parent in parents:
            at = at.setdefault(parent, {})
        at[last] = value
    return copy.deepcopy(tree)


class Provocation:
    """
    key       for files
    group     of columns of the map
    label     of the column
    scene     tree of the scene file
    duration  s
    judge     name of the function in judges.py
    truth     what the judge needs
    own_step  the step is what is varied: the explicit methods take it too
    """

    def __init__(self, key, group, label, tree, duration, judge, own_step=False, **truth):
        self.key, self.group, self.label, self.scene, self.duration = key, group, label, tree, duration
        self.judge, self.own_step, self.truth = judge, own_step, truth


def swings():
    """Let go from rest. The truth: explicit steps of the same mesh with four rotations an element, which keep energy."""
    for step in (1e-4, 1e-3, 5e-3, 2e-2, 1e-1, 1.0):
        yield Provocation(f"step_{step:g}", "time step", f"{step * 1000:g} ms" if step < 1 else f"{step:g} s",
                          scene(time_step=step), max(2.0, 20 * step), "swing", own_step=True, reference="bar")
    yield Provocation("step_1_soft", "time step", "1 s, E 20 kPa", scene(time_step=1.0, material__young=2.0e4), 60.0,
                      "rest", own_step=True, static=scene(material__young=2.0e4))
    for young, name in ((1.0, "1 Pa"), (1e3, "1 kPa"), (2e5, "200 kPa"), (1e7, "10 MPa"), (1e9, "1 GPa"),
                        (1e12, "1 TPa")):
        reference = {1.0: "free_fall", 1e3: "soft", 2e5: "bar"}.get(young, "stiff")
        yield Provocation(f"young_{young:g}", "Young's modulus", name, scene(material__young=young), 2.0, "swing",
                          reference=reference, scale=1e7 / young if reference == "stiff" else 1.0)
    light = [{"box": half_space(2, high=0.5), "density": DENSITY * 1e-6}]
    yield Provocation("density", "contrast of 1e6", "density", scene(material__regions=light), 2.0, "swing",
                      reference="light")


REFERENCES = {  # the scenes that the truth of the swings is computed on
    "bar": scene, "soft": lambda: scene(material__young=1.0e3), "stiff": lambda: scene(material__young=1.0e7),
    # What is a thousandth as dense already weighs nothing.
    "light": lambda: scene(material__regions=[{"box": half_space(2, high=0.5), "density": DENSITY * 1e-3}])}


def settled():
    """Damped until it rests. The truth: the equilibrium of a finer mesh."""
    for poisson in (0.0, 0.3, 0.45, 0.49, 0.499, 0.4999):
        yield Provocation(f"poisson_{poisson:g}", "Poisson's ratio", f"{poisson:g}",
                          scene(material__poisson=poisson, damping=CRITICAL), 2.0, "rest",
                          static=fine(material__poisson=poisson))
    yield Provocation("size", "contrast of 1e6", "element size",
                      scene(mesh("size.msh", *bodies.refined_at_a_corner(20)), damping=CRITICAL), 2.0, "rest",
                      static=fine())
    for angle in (10, 2, 0.5):
        yield Provocation(f"sliver_{angle:g}", "slivers", f"{angle:g}°",
                          scene(mesh(f"sliver_{angle:g}.msh", *bodies.slivers(angle)), damping=CRITICAL), 2.0, "rest",
                          static=fine())
    points, tets = bodies.bar()
    for kind, moved, label in (("double", False, "double"), ("float", False, "single"),
                               ("float", True, "single, moved back")):
        path = os.path.join(folder("meshes"), f"far_{kind}.vtk")
        bodies.write_vtk(path, points + FAR, tets, kind)
        at = 0.0 if moved else FAR
        tree = scene(path, wall=at, damping=CRITICAL, model__pose={"xyz": [-FAR * moved] * 3})
        yield Provocation(f"far_{kind}{'_back' * moved}", "10 km from the origin", label, tree, 2.0, "rest",
                          static=fine(), origin=at)


def fine(**values):
    """For the equilibrium under the bar's weight, where the material laws are 1 % apart. Green's strain has none to offer
    on a fine mesh: it turns elements inside out at the clamped edges."""
    return scene(mesh("fine.msh", *bodies.graded((6, 6, 12))), wall=-0.009, elasticity="corotated", **values)


def locking():
    """What the elements do as Poisson's ratio goes to 0.5: ((element, cells, ratio), provocation)."""
    cases = []
    for cells in ((2, 2, 5), (4, 4, 10)):
        file = mesh("bar_{}_{}_{}.msh".format(*cells), *bodies.bar(cells))
        for name, keys in (("linear", {"element": "linear"}), ("quadratic, dilatation: full", {"dilatation": "full"}),
                           ("quadratic, dilatation: auto (the default)", {})):
            for poisson in (0.34, 0.49, 0.499, 0.4999):
                key = f"locking_{cells[0]}_{name.split(':')[-1].strip().split()[0]}_{poisson:g}"
                cases.append(((name, "{} x {} x {}".format(*cells), f"{poisson:g}"),
                              Provocation(key, "locking", f"{poisson:g}", scene(file, material__poisson=poisson, **keys),
                                          None, "rest", static=fine(material__poisson=poisson))))
    return cases


def twists():
    """One end turns in 2 s, then 2 s to settle. The truth: each section has turned by its share of the angle."""
    size = np.array([0.1, 0.1, 1.0])
    points, tets = bodies.bar((2, 2, 20), size)
    file = mesh("slender.msh", points - [0.05, 0.05, 0], tets)
    for angle in (180, 720):
        motion = os.path.join(folder("meshes"), f"twist_{angle}.csv")
        with open(motion, "w", encoding="ascii") as out:
            out.write("time,x,y,z,qx,qy,qz,qw\n")
            for part in np.linspace(0, 1, 73):
                half = np.radians(angle * part) / 2
                out.write(f"{2 * part:.9g},0,0,0,0,0,{np.sin(half):.12g},{np.cos(half):.12g}\n")
        tree = scene(file, gravity=[0, 0, 0], damping=SETTLING)
        tree["fixed"].append({"name": "hand", "box": half_space(2, low=0.99), "motion": motion})
        yield Provocation(f"twist_{angle}", "twist", f"{angle}°", tree, 4.0, "twist", angle=angle)


def spins():
    """A free bar turns across its length. The truth: it goes on turning, stretched by rho w^2 L^2/12 E."""
    for turn in (0.05, 0.2, 0.5, 1, 2, 5):
        rate = turn / STEP
        tree = scene(gravity=[0, 0, 0], material__young=SPUN_YOUNG, initial={"spin": [rate, 0, 0]})
        tree["fixed"] = []
        yield Provocation(f"spin_{turn:g}", "spin, ωΔt", f"{turn:g}", tree, 1.0, "spin", rate=rate)


def start(name, move):
    points, tets = bodies.bar()
    path = os.path.join(folder("meshes"), name + ".csv")
    with open(path, "w", encoding="ascii") as out:
        out.write("node,x,y,z\n")
        for node, point in enumerate(points, 1):
            if point[2] > 1e-9:
                out.write(f"{node}," + ",".join(map(repr, map(float, move(point)))) + "\n")
    return {"positions": path}


def scramble(seed):
    random = np.random.default_rng(seed)
    return start(f"scrambled_{seed}", lambda _: random.uniform(0, 1, 3) * bodies.SIZE)


# What might bring more bodies back: keys of the scene, and the duration of the run, s; None: static.
SCRAMBLE_REMEDIES = {
    "default, damping.mass 5/s": {},
    "damping.mass 50/s, 20 s": {"damping": {"mass": 50.0}, "duration": 20.0},
    "steps of 5 ms": {"time_step": 0.005},
    "steps of 0.1 s": {"time_step": 0.1},
    "steps of 1 s": {"time_step": 1.0, "duration": 60.0},
    "static solve instead of steps": {"duration": None},
    "linear elements": {"element": "linear"},
    "linear elasticity": {"elasticity": "linear"},
}


def scrambled(seed, keys):
    tree = scene(gravity=[0, 0, 0], damping=SETTLING, initial=scramble(seed),
                 **{key: value for key, value in keys.items() if key != "duration"})
    return Provocation(f"scrambled_{seed}", "start", "scrambled", tree, keys.get("duration", 6.0), "recovery")


def starts():
    """No weight; the free corners start elsewhere. The truth: the shape at rest."""
    for name, move in (("flattened", lambda p: [p[0], 0.2, p[2]]), ("mirrored", lambda p: [p[0], p[1], -p[2]]),
                       ("collapsed", lambda p: [0.2, 0.2, 0.5])):
        yield Provocation(name, "start", name, scene(gravity=[0, 0, 0], damping=SETTLING, initial=start(name, move)),
                          6.0, "recovery")
    yield scrambled(0, {})
    # Into the bar, at a corner of its free end that one element has alone.
    points, _ = bodies.bar()
    corner = int(np.argmin(np.linalg.norm(points - [0.4, 0, 1], axis=1))) + 1
    push = {"nodes": [corner], "force": (PUSH * np.array([-1, 1, -1]) / np.sqrt(3)).tolist(), "until": 1.0}
    yield Provocation("pushed", "start", "inverted by a force", scene(gravity=[0, 0, 0], damping=SETTLING, loads=[push]),
                      6.0, "recovery", pushed=True)


def all_of_them():
    return [p for family in (swings, settled, twists, spins, starts) for p in family()]
