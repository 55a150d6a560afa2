"""doc/performance.md, its pictures and data from what was measured."""
import csv
import os

import claims as judged
import pictures_of_speed as pictures
import scenes
import tools
from measured import TELL
from report import paragraph, table
from tools import REPOSITORY, machine

PAGE = os.path.join(REPOSITORY, "doc", "performance.md")


def percent(value):
    return f"{100 * value:.2g} %"


def short(value):
    return f"{value:.3g}" if value < 1000 else f"{value:.0f}"


def write(told):
    """Writes what has been measured; returns the claims that do not hold, and what is missing."""
    missing = list(judged.missing(told))
    os.makedirs(tools.PICTURES, exist_ok=True)
    if told["growth"]:
        pictures.growth(told["growth"])
    if whole_front(told):
        pictures.front(told["front"])
        with open(os.path.join(tools.PICTURES, "front.csv"), "w", encoding="utf-8", newline="") as out:
            rows = csv.writer(out, lineterminator="\n")
            rows.writerow(["when", *TELL])
            for when in ("before", "now"):
                for row in judged.corotated(told["front"][when]):
                    rows.writerow([when, *(f"{row[key]:.6g}" if isinstance(row[key], float) else row[key]
                                           for key in TELL)])
    checks = list(judged.claims(told))
    with open(PAGE, "w", encoding="utf-8") as out:
        out.write("\n".join(text(told, checks, missing)).rstrip() + "\n")
    return [claim for claim, _, holds in checks if not holds] + [f"not measured: {what}" for what in missing]


def whole_front(told):
    return told["front"] and "before" in told["front"]


def text(told, checks, missing):
    yield from paragraph("# Performance")
    yield from paragraph(f"""
        Written by `scripts/performance`, which measures all of it again. {machine()}. Machines differ and drift, so the
        unit is the run's own: one *product* is the time of the faster of two plain double 3×3-block CSR products of the
        same model on one thread (`bench/yardstick.h`), measured beside what it is compared with.""")
    if missing:
        yield from paragraph(f"**Not measured in this run:** {'; '.join(missing)}.")
    yield from paragraph("## What is claimed, and what came out")
    yield from table(["claim", "measured", "holds"],
                     [[claim, measured, "yes" if holds else "**no**"] for claim, measured, holds in checks])
    for name, part in (("steps", steps), ("linear", linear), ("growth", growth), ("kernels", kernels),
                       ("huge_pages", huge_pages)):
        if told[name]:
            yield from part(told[name])
    if whole_front(told):
        yield from front(told["front"])
    if told["front"]:
        yield from peers(told)
        yield from calculix(told)
        yield from losses(told)


def steps(rows):
    yield from paragraph("## Whole steps")
    yield from paragraph(f"""
        Quadratic elements, ν 0.45 where nothing else is said, steps of 20 ms, E 200 kPa, 500 kg/m³, longest side 1 m,
        the lowest 5 % held, falling from rest; medians of the first steps from rest, everything counted, by
        `bench/steps.cpp`. Each step is solved to {scenes.TOLERANCE:.0e}; the worst residual of all is given.
        *Classic*: CG with the 3×3 diagonal blocks on the assembled matrix, over as many steps for
        {scenes.CLASSIC_CLAIMED}, over the first {scenes.FEW_STEPS} for the others.
        *Before*: the default of the revision that
        the front below is compared with, in the same run.""")
    yield from table(["scene", "tets", "nodes", "iterations", "worst residual", "one product (ms)",
                      "step, one thread (ms)", "in products", "at most", "two threads (ms)", "of one's", "classic (ms)",
                      "classic / step", "before (ms)", "before, in products"],
                     [[row["name"], row["one"]["tets"], row["one"]["nodes"], row["one"]["iterations"],
                       f"{max(row[key]['worst residual'] for key in ('one', 'two')):.1e}",
                       f"{row['one']['one product']:.3f}", f"{row['one']['whole step']:.2f}",
                       f"{judged.products(row['one']):.1f}", most, f"{row['two']['whole step']:.2f}",
                       f"{row['two']['whole step'] / row['one']['whole step']:.2f}",
                       f"{row['classic']['whole step']:.1f}",
                       f"{row['classic']['whole step'] / row['one']['whole step']:.1f}",
                       f"{row['before']['whole step']:.1f}", f"{judged.products(row['before']):.0f}"]
                      for name, _, _, most in scenes.STEPS if (row := judged.named(rows, name))])
    yield from paragraph("""
        Stages of the step on one thread, ms. Rotations and forces find their data out of cache, which the solver has
        filled meanwhile; as kernels, with their data in cache, they are in the table of kernels.""")
    yield from table(["scene", "rotations", "in products", "diagonal", "force", "solve", "whole step", "longest step"],
                     [[row["name"], f"{row['one']['rotation']:.3f}", f"{judged.rotations(row):.2f}",
                       *(f"{row['one'][stage]:.2f}" for stage in
                         ("diagonal", "force", "solve", "whole step", "longest step"))]
                      for row in rows])


def linear(rows):
    yield from paragraph("## Linear elements")
    yield from paragraph(f"""
        The same scenes on linear elements, to {scenes.LINEAR_TOLERANCE:.0e}, beside CG with the 3×3 diagonal blocks
        from the same start and with the same rotations (`solver.preconditioner: block_jacobi`), and that on the
        assembled matrix (`solver.operator: assembled`). The longest step has a
        factorisation in it: what it takes more than the median is about what that costs. FEMFX (single precision, to
        1e-5) and VegaFEM (double, to 1e-6) are published figures for bodies of about this size **on another machine**,
        one core: an order of magnitude, not a race.""")
    yield from table(["scene", "tets", "nodes", "iterations", "worst residual", "step (ms)", "in products",
                      "longest step (ms)", "blocks: iterations", "blocks (ms)", "blocks / step", "at least",
                      "assembled (ms)",
                      "FEMFX, elsewhere (ms)", "VegaFEM, elsewhere (ms)"],
                     [[row["name"], row["own"]["tets"], row["own"]["nodes"], row["own"]["iterations"],
                       f"{row['own']['worst residual']:.1e}", f"{row['own']['whole step']:.2f}",
                       f"{judged.products(row['own']):.0f}", f"{row['own']['longest step']:.1f}",
                       row["blocks"]["iterations"], f"{row['blocks']['whole step']:.1f}",
                       f"{row['blocks']['whole step'] / row['own']['whole step']:.1f}", least,
                       f"{row['assembled']['whole step']:.1f}",
                       f"{there['FEMFX']} ({there['tets']} tets)", f"{there['VegaFEM']} ({there['tets']} tets)"]
                      for name, _, _, least, there in scenes.LINEAR if (row := judged.named(rows, name))])


def growth(rows):
    yield from paragraph("## Growth")
    yield from paragraph("""
        The bunny, quadratic elements, meshed ever finer (`model.cell_size`: other bodies, ever rounder), and the same
        mesh cut into eight (`model.refine`: the same body). One thread, medians of the first steps from rest. Up to
        3000 vertices, some 12 000 elements, the linear elements are factored; beyond, there are aggregates of vertices
        below them.""")
    yield from paragraph("![Iterations, and time per element and step, over tetrahedra](performance/growth.png)")
    yield from table(["", "tets", "nodes", "steps", "iterations", "worst residual", "step (ms)", "in products",
                      "µs an element", "longest step (ms)"],
                     [[{"meshed": "meshed anew", "cut": "cut into eight"}[row["how"]], row["tets"], row["nodes"],
                       row["steps"], row["iterations"], f"{row['worst residual']:.1e}", f"{row['whole step']:.1f}",
                       f"{judged.products(row):.0f}", f"{judged.microseconds(row):.2f}", f"{row['longest step']:.0f}"]
                      for row in rows])


def kernels(sizes):
    yield from paragraph("## Kernels")
    yield from paragraph(f"""
        One thread, {sizes['small']['set']}. A kernel's bound is the longer of what its arithmetic takes at the peak
        rate of multiply-adds and what its data take at the bandwidth of a triad or of a read of the same size, the
        faster one, all measured in this run; operations and bytes are counted from the formulas
        (`bench/roofline.cpp`). The peak takes every operation for half of a fused one; a kernel that also gathers,
        shuffles and adds singly cannot get near it. Bytes are those that a loop goes through, each place once, as a
        triad's three arrays are counted; elements store their shares, most of them by twos that share a face and store
        one share of each node there, and a second loop sums those up node by node. The product in double is what
        residuals are made of; that in single precision, the whole of it, is what the multigrid's own conjugate
        gradients iterate with. In its smoother, *smoother's product*, *prolonged product* and *Chebyshev's term*,
        elements leave the mass to the nodes, where it is lumped; that is what the solver does where the mass is a
        small share of the diagonal, else the smoother takes the whole product too. The diagonal's
        blocks are made in single precision unless an element is nearly incompressible. *Products* are
        of a plain product in double for all. Data are in cache if they fit.""")
    yield from table(["peak", ""], [list(row.values()) for row in sizes["small"]["peaks"]])
    for size in sizes.values():
        first = size["rows"][0]
        yield from paragraph(f"Bunny, {first['tets']} tets, {first['nodes']} nodes:")
        names = ["kernel", "precision", "ms", "products", "flop/byte", "GFlop/s", "GB/s", "of peak", "of bandwidth",
                 "bound by", "of the bound"]
        yield from table(names, [[row[name] for name in names] for row in size["rows"]])


def huge_pages(told):
    yield from paragraph("## Huge pages")
    yield from paragraph(f"""
        With `GLIBC_TUNABLES=glibc.malloc.hugetlb=1` in the environment glibc (2.35 or later) asks Linux for memory on
        pages of 2 MB where it can, whatever the program. Nothing else on this page has it. It does something where
        `/sys/kernel/mm/transparent_hugepage/enabled` says `madvise`, nothing where it says `never`, and is not needed
        where it says `always`; here: `{told['system']}`. Whole steps on one thread as above, without and with it in
        turns, medians of three runs of each. Where the plain product gains more than the step, the step takes more
        products than before for all that it is faster: the times count.""")
    rows = []
    for row in told["rows"]:
        before, after = row["without"], row["with"]
        rows.append([row["name"], row["tets"],
                     *(cell for key in ("whole step", "one product") for cell in (
                         f"{before[key]:.3g}", f"{after[key]:.3g}", f"{100 * (after[key] / before[key] - 1):+.0f} %")),
                     *(f"{of['whole step'] / of['one product']:.1f}" for of in (before, after))])
    yield from table(["scene", "tets", "step (ms)", "with huge pages", "", "one product (ms)", "with huge pages", "",
                      "step in products", "with huge pages"], rows)


def front(told):
    yield from paragraph("## Speed against accuracy, before and after")
    yield from paragraph(f"""
        The bar's co-rotated points of the usual settings ([doc/speed_accuracy.md](speed_accuracy.md) has many more),
        measured twice in the same run: by the
        programs of revision {told['revision']}, and by those of now ([front.csv](performance/front.csv)). Circles are
        quadratic elements, triangles linear ones. Drift: one product of the bunny took {told['products'][0]:.3f} ms
        between the two, {told['products'][1]:.3f} ms after them.""")
    yield from paragraph("![Error of the tip over time, before and after](performance/front.png)")


def peers(told):
    yield from paragraph("## Other programs")
    yield from paragraph("""
        The bar of `config/bar.yaml`, same run, one thread. Bullet's deformable body (linear elements, co-rotated,
        lumped masses, implicit) with its demos' settings and converged. Against each stands the fastest of our points
        that errs no more at the tip, of the same law. *At rest*: time of finding the equilibrium,
        which Bullet does by damped motion.""")
    rows = []
    for other, own, ratio in judged.peers(told):
        rows.append([other["program"], other["settings"], other["law"], other["tets"],
                     {"static": "at rest", "dynamic": "motion"}[other["mode"]],
                     other["time_step"] and f"{1000 * other['time_step']:g} ms", short(other["ms"]),
                     percent(other["error_tip"]),
                     own and f"{own['element']}, {own['tets']} tets" + (
                         f", {own['integrator']} {1000 * own['time_step']:g} ms" if own["mode"] == "dynamic" else ""),
                     own and short(judged.cost(own)), own and percent(own["error_tip"]), ratio and f"{ratio:.2g}"])
    yield from table(["program", "settings", "law", "tets", "", "time step", "ms (motion: ms/s)", "tip error",
                      "ours", "ours, ms", "ours, tip error", "theirs / ours"], rows)


LAWS = {"linear": ("linear", "`linear`, the same law"), "green": ("NLGEOM", "`green`, the same law"),
        "corotated": ("NLGEOM", "`corotated`, another law")}  # CalculiX's analysis beside which law of ours


def calculix(told):
    yield from paragraph("### CalculiX")
    if not told["front"].get("calculix"):
        yield from paragraph("Not measured in this run: `ccx` is missing. It is Debian's package calculix-ccx.")
        return
    apart = told["front"]["green_apart"]
    yield from paragraph(f"""
        The bar at rest in {told['front']['calculix'][0]['program']} (`bench/calculix_bar`), same run, one thread,
        double precision, its default direct solver: a program for analyses, not for motion in real time. Its linear
        analysis is our `elasticity: linear`, its nonlinear one (NLGEOM) is St. Venant-Kirchhoff's law, our
        `elasticity: green` (`scripts/compare_with_calculix` compares the displacements). Co-rotated elasticity, our
        default, is another law{"" if apart is None else f", whose tip rests {percent(apart)} of its way elsewhere"};
        there each one's error is to the converged equilibrium of its own law. Theirs are times of the whole
        process `ccx`; *without reading* is less that of the same input with `*NO ANALYSIS`, which reads it, finds the
        structure of the matrix, goes through the elements once and writes: what is left is favourable to CalculiX.
        Ours: the solve alone inside a program that has loaded the mesh, and the whole process `run_scene --static`
        with reading and writing. Times are the shortest of a few runs, of one where it takes long; the shortest
        differences are of the size of their scatter. Two ratios: process beside process, and theirs without reading
        beside our solve.
        Ours are solved to 1e-6, CalculiX to its defaults, and our fastest point at the same error may have another
        element and another mesh, which may be finer where the bar is held.""")
    rows = []
    for other, law, own, ratios in judged.calculix(told):
        rows.append([other["settings"], LAWS[law][0], other["tets"], short(other["ms"]),
                     short(other["ms"] - other["ms_idle"]), percent(other["error_tip"]), LAWS[law][1],
                     own and f"{own['element']}, {own['tets']} tets", own and short(judged.cost(own)),
                     own and short(own["ms_process"]), own and percent(own["error_tip"]),
                     *([f"{ratio:.2g}" for ratio in ratios] if own else [None, None])])
    yield from table(["element", "analysis", "tets", "process (ms)", "without reading (ms)", "tip error",
                      "ours, `elasticity`", "ours", "ours, solve (ms)", "ours, process (ms)", "ours, tip error",
                      "theirs / ours, processes", "theirs / ours, without reading"], rows)


def losses(told):
    lost = judged.lost(told)
    if lost:
        yield from paragraph("**Where we lose:** " + "; ".join(
            f"{name}, tip error {percent(other['error_tip'])}: " +
            ("we have no such point" if ratio is None else f"{1 / ratio:.2g} times as fast as ours")
            for name, other, ratio in lost) + ".")
    else:
        yield from paragraph("At equal tip error on this bar we lose to none of these points.")
