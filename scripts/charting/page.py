"""doc/speed_accuracy.md, its pictures and data from what the studies measured."""
import csv
import os

import drawing
import energy
from claims import INTEGRATORS, LAWS, advice, claims, ms, percent, ratio_of
from drawing import REAL_TIME, TOLD
from engine import folder
from report import paragraph, table
from tools import REPOSITORY, machine

PAGE = os.path.join(REPOSITORY, "doc", "speed_accuracy.md")
LEFT_OUT = ("path",)  # of the rows, in the CSV
SHOWN = {"tip": "tip", "field_rms": "body, RMS", "field_max": "body, worst point", "von_mises": "von Mises stress",
         "period": "period", "decay": "decay"}


def write_data(place, study):
    """Pictures and CSV."""
    drawing.draw(study.name, study.title, study.rows, study.own, place, study.others)
    write_csv(os.path.join(place, f"{study.name}.csv"), study.rows)
    if study.others:
        write_csv(os.path.join(place, f"{study.name}_others.csv"), study.others)


def write_csv(path, rows):
    with open(path, "w", encoding="utf-8", newline="") as out:
        writer = csv.writer(out, lineterminator="\n")
        keys = [key for key in rows[0] if key not in LEFT_OUT]
        writer.writerow(keys)
        for row in rows:
            writer.writerow([f"{row[key]:.6g}" if isinstance(row[key], float) else row[key] for key in keys])


def references(study):
    """How each reference was shown to be converged."""
    rows = []
    for key, told in study.references.items():
        mode, law = key.split()
        own = study.own[key]
        rows.append([{"static": "equilibrium", "dynamic": "motion"}[mode], LAWS[law], told["tets"], told["nodes"],
                     *(percent(own[name]) if own[name] is not None else None for name in SHOWN),
                     ", ".join("none" if p is None else f"{p:.1f}" for p in study.orders[key]["tip"])])
    yield from table(["", "law", "tets", "nodes", *SHOWN.values(), "order, tip"], rows)


def comparison_of_elements(studies):
    def cell(told, name):
        one = told[name]
        return [one["mesh"], one["tets"], percent(one["error"]), one["solver"], f"{one['iterations']:.0f}",
                ms(one["ms"])]

    rows = []
    for study in studies:
        for name, words in (("same", "same solver"), ("best", "each one's best")):
            for element in ("quadratic", "linear"):
                told = study.equal[element]
                factor = ratio_of(study, name)
                rows.append([study.title if (name, element) == ("same", "quadratic") else None,
                             words if element == "quadratic" else None, element, *cell(told, name),
                             factor if element == "linear" else None])
    yield from table(["scene", "", "element", "mesh", "tets", "tip error", "solver", "iterations", "ms a step",
                      "linear / quadratic"], rows)


def write_scene(study):
    """Pictures and data of one scene, beside what it was computed from."""
    place = folder(study.name)
    write_data(place, study)
    print("\n".join([*references(study), *comparison_of_elements([study])]))
    return place


def write(studies):
    """Writes everything; returns the claims and advice that do not hold."""
    os.makedirs(drawing.PLACE, exist_ok=True)
    for study in studies:
        write_data(drawing.PLACE, study)
    free_motion = energy.measured()
    energy.draw(free_motion)
    checks = list(claims(studies))
    lines = list(advice(studies))
    with open(PAGE, "w", encoding="utf-8") as out:
        out.write("\n".join(text(studies, checks, lines, free_motion)).rstrip() + "\n")
    return ([claim for claim, _, holds in checks if not holds] +
            [said.split("**")[1] for said, holds in lines if not holds])


def text(studies, checks, lines, free_motion):
    yield from paragraph("# Speed against accuracy")
    yield from paragraph(f"""
        Written by `scripts/chart`, which measures all of it again (`scripts/chart SCENE.yaml`: for another scene).
        {machine()}; one thread, double precision. Every system is solved to the tolerance of its row, 1e-4 unless the
        row says otherwise, equilibria to 1e-6; the times are wall clock, all steps of 1 s of motion (bar: of 2 s).""")
    yield from paragraph("## What to choose when")
    for number, (said, holds) in enumerate(lines, 1):
        yield f"{number}. {' '.join(said.split())}{'' if holds else ' **Not borne out by this run.**'}"
    yield ""
    yield from paragraph("## What is claimed, and what came out")
    yield from table(["claim", "measured", "holds"],
                     [[claim, measured, "yes" if holds else "**no**"] for claim, measured, holds in checks])
    yield from paragraph("## The charts")
    yield from paragraph(f"""
        A point is one variant: element, mesh, law, rotation rule, integrator, time step, tolerance, preconditioner and
        operator, all in the CSV file. Lower left is better; the line is the Pareto front; *real time* is {REAL_TIME} ms
        a simulated second. Each law is judged against its own converged reference. Errors of displacement are relative
        to the largest displacement of the reference. Equilibria take their time from steps of 20 ms of implicit Euler
        on the same model, for a chart must have one measure of time; the time of finding the equilibrium itself is
        `ms_static` in the CSV. Stress is compared at inner points away from what is held, where it has a limit.
        Hollow points are nearer to zero than {TOLD} times the reference's own error: not told apart from 0.""")
    for study in studies:
        count = {mode: sum(row["mode"] == mode for row in study.rows) for mode in ("static", "dynamic")}
        yield from paragraph(f"### {study.title}")
        yield from paragraph(f"""{count['static']} equilibria and {count['dynamic']} motions of {study.duration:g} s:
            [{study.name}.csv](speed_accuracy/{study.name}.csv). {study.about}""")
        for mode, words in (("static", "Error of the equilibrium over time per simulated second"),
                            ("rest", "Error of the equilibrium over the time of finding it"),
                            ("dynamic", "Error of the motion over time per simulated second")):
            yield from paragraph(f"![{words}](speed_accuracy/{study.name}_{mode}.png)")
        if study.others:
            yield from paragraph(f"""
                Stars are other programs, on the bar's own meshes and against the same references
                ([{study.name}_others.csv](speed_accuracy/{study.name}_others.csv)): Bullet's deformable body, linear
                tetrahedra with lumped masses, co-rotated, with its demos' settings (*default*: one Newton iteration)
                and with four (*converged*), at rest damped until it stands still; CalculiX with C3D4 and C3D10, Green
                strain (NLGEOM) and small strain, the whole run with reading and writing.""")
            yield from table(["program", "settings", "law", "tets", "", "time step", "time", "error of the tip"],
                             [[row["program"], row["settings"], LAWS[row["law"]], row["tets"],
                               {"static": "at rest", "dynamic": "motion"}[row["mode"]],
                               row["time_step"] and f"{1000 * row['time_step']:g} ms",
                               f"{ms(row['ms'])} ms" + ("/s" if row["mode"] == "dynamic" else ""),
                               percent(row["error_tip"])] for row in study.others])
    yield from paragraph("## Quadratic against linear elements at equal accuracy")
    yield from paragraph(f"""
        Of each element the fastest model whose tip at rest is within {percent(studies[0].equal['wanted'])} of the
        reference, co-rotated; a step of 20 ms of implicit Euler, tolerance 1e-4. For the bar cells of any proportion
        were searched; for the others the meshes of the chart, against references that err themselves, see below.
        *Same solver*: conjugate gradients with the 3×3 diagonal blocks, matrix-free.
        *Best*: the fastest of that, `pmultigrid` and the assembled matrix.""")
    yield from comparison_of_elements(studies)
    yield from paragraph("## What integrators make of the energy")
    yield from paragraph("""
        A free bar of 120 quadratic elements for 10 s without damping: let go bent, or tumbling. Exact is a straight line
        at 1. Explicit steps show what the law itself does: with rotations from the corners the force is not the gradient
        of an energy, and the swing gains some (`rotation: four` does not, see
        [the paper's tables](reproduction.md#what-one-rotation-an-element-costs)).""")
    yield from paragraph("![Energy over time, by integrator and time step](speed_accuracy/energy.png)")
    yield from table(["share of the energy left after 10 s", "time step", "swing, co-rotated", "swing, Green strain",
                      "spin, co-rotated", "spin, Green strain"],
                     [[INTEGRATORS[integrator], f"{1000 * step:g} ms", *(f"{share:.2g}" for share in shares)]
                      for integrator, step, *shares in energy.left(free_motion)])
    yield from paragraph("## How the references were verified")
    yield from paragraph("""
        Quadratic elements with `rotation: four`, which is the gradient of an energy and so converges from one side;
        finer at the rims of what is held. Two coarser models of the same kind give the order p and, by Richardson, the
        reference's own error C hᵖ (*none*: the differences tell of no order, and the larger one is taken); for motion
        the same with two larger time steps, and both are added. h of adapted meshes is the cube root of the body's
        share for a tetrahedron. Own
        errors, relative as in the charts (decay: difference of the shares of the amplitude lost in a period):""")
    for study in studies:
        yield from paragraph(f"**{study.title}**")
        yield from references(study)
        told = ", ".join(f"{LAWS[law]} {percent(apart)}" for law, apart in study.apart.items())
        yield from paragraph(f"Tip of the other laws at rest, from the co-rotated reference: {told}.")
        for law, why in study.left_out.items():
            yield from paragraph(f"Left out: {LAWS[law]}, {why}.")
    yield from paragraph("""
        Meshes of a surface at other cell sizes are not compared: they are other bodies, because CGAL rounds a surface
        differently and boxes and spheres hold other corners. What is held and loaded is what the scene selects on its
        own mesh, whole faces, and stays so while that mesh is cut: evenly, every edge into equal parts, or adapted,
        where the equilibrium's gradient is uneven and at the rims of what is held.""")
