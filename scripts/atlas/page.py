"""The map and the page, from what the parts left."""
import os

import numpy as np
from matplotlib import colors, patches

import columns
import judges
from judges import BLOWN_UP, NOT_RECOVERED, REFUSED, RIGHT, WRONG
from methods import DEFAULT, METHODS
from pictures import pyplot
from provocations import EXPLICIT_STEP, SEEDS, SPUN_YOUNG, STEP
from report import paragraph, table
from tools import REPOSITORY, Failed, machine, picture, saved

FILLS = {RIGHT: "#4d9a5b", NOT_RECOVERED: "#8a6bb1", BLOWN_UP: "#b2182b", REFUSED: "#c9c9c9"}
SHADES = colors.LinearSegmentedColormap.from_list("wrong", ["#fde9a9", "#f5a03c", "#d9652b"])
MARKS = {RIGHT: "", NOT_RECOVERED: "no", BLOWN_UP: "✕", REFUSED: "–"}


def fill(verdict):
    if verdict["outcome"] != WRONG:
        return FILLS[verdict["outcome"]]
    error = verdict["error"]
    return SHADES(1.0 if error is None else np.clip(np.log10(max(error, 0.01) / 0.01) / 2, 0, 1))


def mark(verdict):
    if verdict["outcome"] != WRONG:
        return MARKS[verdict["outcome"]]
    error = 100 * verdict["error"]
    text = f"{error:.0f}" if error >= 9.5 else f"{error:.1f}" if error < 999 else ">999"
    if error > 999:
        text = ">999"
    return text + ("*" if verdict.get("status") == "not_converged" else "")


def draw(verdicts):
    """Methods down, provocations across; `verdicts` by provocation and method."""
    groups = columns.columns()
    figure, axes = pyplot.subplots(figsize=(17, 5.6))
    x, ticks = 0.0, []
    methods = list(METHODS)[::-1]
    for provocations in groups.values():
        begin = x
        for provocation in provocations:
            for y, method in enumerate(methods):
                verdict = verdicts[provocation.key][method]
                color = fill(verdict)
                axes.add_patch(patches.Rectangle((x, y), 1, 1, facecolor=color, edgecolor="white", linewidth=1.2))
                dark = np.dot(colors.to_rgb(color), (0.3, 0.59, 0.11)) < 0.55
                axes.text(x + 0.5, y + 0.5, mark(verdict), ha="center", va="center", fontsize=7.5,
                          color="white" if dark else "black")
            ticks.append((x + 0.5, provocation.label))
            x += 1
        axes.text((begin + x) / 2, len(methods) + 0.12, provocations[0].group.replace("1e6", "10⁶").replace(
            " from the ", "\nfrom the ").replace(" of ", "\nof "), ha="center", va="bottom", fontsize=9)
        x += 0.35
    default = methods.index(DEFAULT)
    axes.add_patch(patches.Rectangle((-0.08, default - 0.06), x - 0.35 + 0.16, 1.12, fill=False, linewidth=2))
    axes.set(xlim=(-0.2, x - 0.1), ylim=(-0.15, len(methods) + 0.1), yticks=np.arange(len(methods)) + 0.5,
             yticklabels=[METHODS[method][0] for method in methods], xticks=[at for at, _ in ticks])
    axes.set_xticklabels([label for _, label in ticks], rotation=55, ha="right", rotation_mode="anchor", fontsize=8)
    axes.tick_params(length=0)
    axes.grid(False)
    for side in axes.spines.values():
        side.set_visible(False)
    legend = [patches.Patch(facecolor=FILLS[RIGHT], label=RIGHT),
              *(patches.Patch(facecolor=SHADES(s), label=f"{WRONG}, error {e}") for s, e in
                ((0.1, "of some %"), (0.5, "10 %"), (1.0, "100 % or more"))),
              *(patches.Patch(facecolor=FILLS[o], label=f"{o}{' (' + MARKS[o] + ')' if MARKS[o] else ''}")
                for o in (NOT_RECOVERED, BLOWN_UP, REFUSED))]
    axes.legend(handles=legend, ncol=7, loc="upper center", bbox_to_anchor=(0.5, -0.26), fontsize=8, frameon=False)
    figure.tight_layout()
    picture(figure, "atlas")
    pyplot.close(figure)


def cell(verdict):
    outcome = {RIGHT: "right", WRONG: "**wrong**", NOT_RECOVERED: "**not recovered**", BLOWN_UP: "**blown up**",
               REFUSED: "refused"}[verdict["outcome"]]
    return outcome if verdict["outcome"] == REFUSED else f"{outcome}: {verdict['text']}"


def claims(verdicts, scramble):
    """Claim, what came out, whether it holds."""
    ours = {p.key: verdicts[p.key][DEFAULT] for group in columns.columns().values() for p in group}
    blown = [key for key, verdict in ours.items() if verdict["outcome"] == BLOWN_UP]
    others = [key for key, verdict in ours.items()
              if verdict["outcome"] not in (RIGHT, WRONG, BLOWN_UP) and key != "scrambled"]
    unsaid = [key for key, verdict in ours.items() if verdict["outcome"] == WRONG and verdict["error"] is None]
    unsolved = [key for key, verdict in ours.items() if verdict.get("status") == "not_converged"]
    right = sum(verdict["outcome"] == RIGHT for verdict in ours.values())
    yield ["With default settings nothing blows up", f"{len(blown)} of {len(ours)} do", not blown]
    yield ["... every cell is right, or wrong by a given error", f"{right} right, "
           f"{sum(v['outcome'] == WRONG for v in ours.values())} wrong", not others and not unsaid]
    yield ["... every step's system is solved to its tolerance",
           "all" if not unsolved else "not in " + ", ".join(unsolved), not unsolved]
    if scramble:
        rate = scramble["rates"][0]
        yield ["Only a random scramble may not be recovered from", f"{rate['recovered']} of {SEEDS} are recovered from",
               rate["lost"] == 0]


def introduction(checks):
    yield from paragraph("# Where methods fail")
    yield from paragraph("""
        Written by `scripts/stability`. What provokes a method, across; methods, down; the default in the frame. A
        number is the error in %, `*`: a system was left above its tolerance.""")
    yield from paragraph("![Map of outcomes: methods against provocations](stability/atlas.png)")
    yield from paragraph("## What is claimed, and what came out")
    yield from table(["claim", "measured", "holds"],
                     [[claim, measured, "yes" if holds else "**no**"] for claim, measured, holds in checks])
    yield from paragraph("## Methods")
    yield from paragraph(f"""
        - **explicit**: velocity Verlet with the consistent mass matrix, one step a time step, of
        {1000 * EXPLICIT_STEP:g} ms (D. Weber et al. 2011, section 8.2) where the time step is not what is varied;
        `bench_stability --method explicit`.""")
    yield from paragraph("""
        - **explicit in stable sub-steps**: the package's `integrator: explicit`, cut by a bound on the elements'
        eigenvalues, refused beyond 1000 sub-steps a step.""")
    yield from paragraph("""
        - **plain polar decomposition**: linearised implicit Euler whose rotation is U Wᵀ of F = U Σ Wᵀ, a reflection
        where the element is inverted; no sub-steps; `bench_stability --method plain_polar`. With and without the sign,
        the decomposition is the same where nothing is inverted.""")
    yield from paragraph(f"""
        - **implicit**: the package's implicit Euler, every key that the scene does not need left at its default; steps
        of {1000 * STEP:g} ms where they are not what is varied.""")
    yield from paragraph("## Outcomes")
    yield from paragraph("""
        The body is the bar of D. Weber et al. 2011, Fig. 7: 0.4 × 0.4 × 1 m, 120 quadratic elements, E 200 kPa, ν
        0.34, 500 kg/m³, held at one end, its weight across it. The *tip* is the lower corner of its free end. A
        method has to meet the truth of its own material law; linear elasticity that of the co-rotated one.""")
    tolerance = f"{100 * judges.TOLERANCE:g} %"
    yield from table(["provocation", "truth", "right"], [
        ["time step, E, density (let go from rest)", "explicit steps at a tolerance of 1e-6, with four rotations an "
         "element where co-rotated, which keep energy; E 1 Pa: free fall; E above 10 MPa: E 10 MPa's path, displacement "
         "as 1/E. Density, 10⁶ times less in the half at the wall: 10³ times less, which is as little",
         f"tip in the second half of the run: mean position and root mean square of the swing about it both within "
         f"{tolerance} (of the largest displacement; of the swing)"],
        ["ν, element size, slivers, 10 km; 1 s with E 20 kPa (damped until it rests)",
         "static equilibrium, co-rotated, of 2592 elements graded towards the clamped edges (20 kPa: of the same mesh and "
         "law)",
         f"tip within {tolerance} of its displacement, and moving by at most {100 * judges.MOVING:g} % of it over the "
         "last tenth of the run"],
        ["twist (a bar of 0.1 × 0.1 × 1 m, one end turned in 2 s)", "each section turned by its share of the angle",
         f"each within {tolerance} of the angle, none inverted"],
        [f"spin (free, E {SPUN_YOUNG / 1e6:g} MPa, 1 s)", "½ I ω²; length stretched by ρω²L²/12E",
         f"kinetic energy at the end and the largest length both within {tolerance}"],
        ["starts (no weight)", "the shape at rest",
         f"after 6 s every corner within {1000 * judges.RECOVERED:g} mm of it and no element inverted; else not "
         "recovered"],
        ["all", "", f"blown up: positions no longer finite, or farther away than {judges.BLOWN:g} times the largest "
         "extent that the truth has. Refused: the package says so in a line"]])


def truths(parts):
    told = {}
    for part in parts.values():
        told.update(part.get("truths", {}))
    kept = {name: told[name]["energy_change"] for name in sorted(told) if told[name]["energy_change"] is not None}
    if kept:
        yield from paragraph("Energy that the explicit references won or lost over 4 s, of the largest that gravity "
                             "gave: " + ", ".join(f"{name.replace('_', ', ')} {judges.percent(value)}"
                                                  for name, value in kept.items()) + ".")


def shortcomings(verdicts):
    yield from paragraph("## Where the default is wrong")
    yield from paragraph("""
        Implicit Euler damps: what swings within some dozens of steps is gone, and where it ends is right. The same cells
        with `integrator: auto`, of second order:""")
    rows = []
    for provocations in columns.columns().values():
        for p in provocations:
            ours, second = (verdicts[p.key][method] for method in (DEFAULT, "auto"))
            if ours["outcome"] != RIGHT:
                rows.append([f"{p.group}: {p.label}".replace("1e6", "10⁶"), cell(ours), cell(second)])
    yield from table(["provocation", "the default", "`integrator: auto`"], rows)


def figures(verdicts):
    yield from paragraph("## Figures behind the cells")
    for provocations in columns.columns().values():
        yield from paragraph(f"### {provocations[0].group[0].upper()}{provocations[0].group[1:]}".replace("1e6", "10⁶"))
        yield from table(["", *(p.label for p in provocations)],
                         [[METHODS[m][0], *(cell(verdicts[p.key][m]) for p in provocations)] for m in METHODS])
        if provocations[0].judge == "spin":
            yield from lag(verdicts)


def lag(verdicts):
    """What a lagged step of a turn does to the length, beside the formula."""
    provocations = columns.columns()["spin"]
    firsts = [verdicts[p.key]["plain_polar"]["first"] for p in provocations]
    yield from paragraph("""
        A step of a co-rotated body that turns by α, with the rotations of its start, makes it longer by √(1 + α²); stiff
        bodies ring with that energy. The first step's length, with one lagged step (plain polar decomposition) and as the
        package does it, in sub-steps beyond 0.2 rad:""")
    yield from table(["α", *(p.label for p in provocations)],
                     [["√(1 + α²)", *(f"{np.hypot(1, float(p.label)):.3f}" for p in provocations)],
                      ["one lagged step", *("" if first is None else f"{first:.3f}" for first in firsts)],
                      ["the package", *(f"{verdicts[p.key][DEFAULT]['first']:.3f}" for p in provocations)]])


def scramble_section(part):
    yield from paragraph("## The random scramble")
    yield from paragraph(f"""
        Every free corner of the bar starts at a random place of its box: {SEEDS} seeds, 6 s, no weight. Where a body does
        not come back, elements are inside out against each other, or the bar is twisted by a whole turn: equilibria of
        their own. What changes the rate:""")
    yield from table(["", "recovered", "blown up", "s a run"],
                     [[rate["name"], f"{rate['recovered']} of {SEEDS}", rate["lost"], f"{rate['seconds']:.2f}"]
                      for rate in part["rates"]])


def locking_section(part):
    yield from paragraph("## Volumetric locking")
    yield from paragraph("""
        The bar at rest under its weight: the tip's deflection against that of the graded mesh. Linear elements lock; so
        do quadratic ones whose dilatation counts in full. `dilatation: auto` counts its mean over the element where ν
        exceeds 0.45.""")
    ratios = list(dict.fromkeys(row[2] for row in part["rows"]))
    rows = {}
    for element, cells, ratio, verdict in part["rows"]:
        rows.setdefault((element, cells), {})[ratio] = judges.percent(verdict["deflection"]) + (
            "" if verdict["status"] == "ok" else f" ({verdict['status'].replace('_', ' ')})")
    yield from table(["element", "cells", *(f"ν {ratio}" for ratio in ratios)],
                     [[*names, *(cells[ratio] for ratio in ratios)] for names, cells in rows.items()])


def write():
    """Returns the claims that do not hold."""
    parts = {name: saved(name) for name in columns.NAMES}
    missing = [name for name, part in parts.items() if part is None]
    if missing:
        raise Failed(f"doc/stability.md is left as it is, still to run: {' '.join(missing)}")
    verdicts = {key: methods for part in parts.values() for key, methods in part.get("cells", {}).items()}
    draw(verdicts)
    checks = list(claims(verdicts, parts["scramble"]))
    lines = [*introduction(checks), *truths(parts), *shortcomings(verdicts), *scramble_section(parts["scramble"]),
             *locking_section(parts["locking"]), *figures(verdicts)]
    lines += paragraph(f"Measured on {machine()}.")
    with open(os.path.join(REPOSITORY, "doc", "stability.md"), "w", encoding="utf-8") as out:
        out.write("\n".join(lines).rstrip() + "\n")
    return [claim for claim, _, holds in checks if not holds]
