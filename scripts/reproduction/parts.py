"""The measurements: each part runs programs, draws its pictures and returns what the report needs."""
import json
import os
import re
import shutil
import subprocess

import numpy as np

from pictures import (PAIR, Camera, colour_bar, draw_elements, draw_surface, pyplot, read_ply, read_vtu, same_window,
                      scale)
from tools import (SOLVER, STEPS, TOLERANCE, Failed, call, config, falling, folder, picture, program, read_nodes,
                   read_probe, run_scene, say, write_start, REPOSITORY)

# Name in the paper, element, surface, cell size (m, of a body 1 m long); as printed: tets, nodes, and ms for rotations,
# element matrices, matrix, matrix by the usual traversal, force, solve, surface, all
TABLE_1 = [
    ("mechanical part", "linear", "anchor_dense", 0.0283, 34446, 6896, (81, 45, 49, None, 70, 58, None, 304)),
    ("bunny huge", "linear", "bunny", 0.047, 9997, 2087, (22, 13, 13, None, 20, 16, None, 85)),
    ("armadillo high", "linear", "armadillo", 0.055, 3159, 1016, (8, 4, 4, None, 7, 10, None, 33)),
]
TABLE_2 = [
    ("armadillo", "linear", "armadillo", 0.0346, 9715, 2304, (22, 12, 13, None, 20, 18, 3, 89)),
    ("armadillo", "quadratic", "armadillo", 0.081, 1112, 2238, (3, 16, 7, None, 3, 35, 2, 68)),
    ("bunny", "linear", "bunny", 0.0715, 3213, 960, (7, 4, 3, None, 6, 4, 5, 30)),
    ("bunny", "quadratic", "bunny", 0.167, 450, 1014, (1, 7, 3, None, 1, 5, 5, 22)),
]
TABLE_3 = [
    ("armadillo low", "quadratic", "armadillo", 0.081, 1112, 2238, (3, 16, 8, 13, 3, 14, 2, 47)),
    ("armadillo medium", "quadratic", "armadillo", 0.0631, 2044, 4015, (5, 30, 14, 25, 6, 26, 2, 85)),
    ("armadillo high", "quadratic", "armadillo", 0.055, 3159, 6098, (7, 45, 23, 39, 10, 44, 2, 133)),
    ("tweety low", "quadratic", "elephant", 0.155, 364, 757, (1, 5, 2, 4, 2, 5, 5, 19)),
    ("tweety medium", "quadratic", "elephant", 0.0817, 960, 1902, (2, 14, 7, 12, 3, 12, 5, 43)),
    ("tweety high", "quadratic", "elephant", 0.06, 2019, 3900, (5, 29, 14, 25, 6, 26, 5, 86)),
    ("bunny low", "quadratic", "bunny", 0.11, 1006, 1973, (2, 15, 7, 12, 3, 13, 5, 46)),
    ("bunny medium", "quadratic", "bunny", 0.0819, 2183, 4145, (5, 31, 15, 28, 7, 29, 5, 94)),
    ("bunny high", "quadratic", "bunny", 0.0715, 3213, 5949, (8, 46, 24, 40, 10, 44, 5, 138)),
]
BAR = {"cells": (2, 2, 5), "probe": "lower_left"}


def measure(name, rows, carried):
    """Whole steps with the assembled operator and without, and the assembly stage by stage."""
    out = folder(name)
    models = []
    for label, element, surface, cell_size, tets, nodes, printed in rows:
        say(f"{name}: {label}, {element}, about {tets} tets")
        scene = falling(surface, cell_size, element, carried)
        assembled = run_scene(scene, out, "--steps", STEPS, solver__operator="assembled")
        matrix_free = run_scene(scene, out, "--steps", STEPS, solver__operator="matrix_free")
        stages = os.path.join(out, "assembly.json")
        call(program("bench_assembly"), scene, "--runs", 31, "--json", stages)
        with open(stages, encoding="utf-8") as file:
            stages = json.load(file)[0]
        models.append({
            "label": label, "element": element, "surface": surface, "printed": printed,
            "tets": assembled["elements"], "nodes": assembled["nodes"], "printed_tets": tets, "printed_nodes": nodes,
            "assembled": assembled, "matrix_free": matrix_free, "stages": stages})
    worst = max(abs(m["tets"] / m["printed_tets"] - 1) for m in models)
    return {"models": models, "checks": [
        [f"{name.replace('table', 'Table ')}: models of the printed number of tets, within 5 %",
         f"within {100 * worst:.1f} %", worst <= 0.05]]}


def table1():
    return measure("table1", TABLE_1, carried=False)


def table2():
    return measure("table2", TABLE_2, carried=True)


def table3():
    result = measure("table3", TABLE_3, carried=True)
    gains = [m["stages"]["ms"]["conventional"] / m["stages"]["ms"]["mesh_oriented"] for m in result["models"]]
    result["checks"].append(["Table 3: mesh-oriented traversal at least 2.5 times as fast as the usual one",
                             f"{min(gains):.1f} to {max(gains):.1f} times", min(gains) >= 2.5])
    return result


def tolerance():
    """Table 2's models again, stopped at several tolerances, against a solve to 1e-9."""
    out = folder("tolerance")
    models = []
    tolerances = [1e-1, 1e-2, 1e-3, 1e-4]
    for label, element, surface, cell_size, *_ in TABLE_2:
        scene = falling(surface, cell_size, element, False)
        nodes = os.path.join(out, "nodes.csv")

        def positions(tolerance, operator):
            summary = run_scene(scene, out, "--steps", STEPS, "--every", STEPS, "--nodes", nodes,
                                solver__operator=operator, solver__tolerance=tolerance)
            return summary, read_nodes(nodes)[1]

        say(f"tolerance: {label}, {element}, 1e-9")
        rest, exact = positions(1e-9, "matrix_free")[1]
        moved = np.linalg.norm(exact - rest, axis=1).max()
        runs = []
        for value in tolerances:
            say(f"tolerance: {label}, {element}, {value:.0e}")
            free, end = positions(value, "matrix_free")
            assembled, _ = positions(value, "assembled")
            runs.append({"tolerance": value, "iterations": free["iterations"],
                         "matrix_free": free["ms_per_step"]["total"], "assembled": assembled["ms_per_step"]["total"],
                         "error": np.linalg.norm(end[1] - exact, axis=1).max() / moved})
        models.append({"label": label, "element": element, "tets": free["elements"], "nodes": free["nodes"],
                       "moved": moved, "runs": runs})

    figure, (speed, error) = pyplot.subplots(1, 2, figsize=(9, 3.2))
    for model, line in zip(models, ("-", "-", "--", "--")):
        color = PAIR[model["element"]]
        name = f"{model['label']}, {model['element']}"
        speed.loglog(tolerances, [r["assembled"] for r in model["runs"]], line, color=color, marker="o", label=name)
        error.loglog(tolerances, [100 * r["error"] for r in model["runs"]], line, color=color, marker="o", label=name)
    speed.set(xlabel="tolerance", ylabel="ms a step, assembled")
    error.set(xlabel="tolerance", ylabel="error, % of the largest way")
    for axes in (speed, error):
        axes.invert_xaxis()
    figure.legend(*speed.get_legend_handles_labels(), loc="upper center", ncol=4, frameon=False)
    figure.tight_layout(rect=(0, 0, 1, 0.93))
    picture(figure, "tolerance")
    return {"models": models, "checks": []}


def fig6():
    """The armadillo's leg pulled and let go: linear elements, as many and as large, against quadratic ones."""
    kinds = [("linear", 0.081), ("linear", 0.0346), ("quadratic", 0.081), ("quadratic", 0.0346)]
    probes = ("nose", "right_foot", "right_ear", "tail")
    models = []
    for element, cell_size in kinds:
        out = folder("fig6", f"{element}_{cell_size}")
        say(f"fig6: {element}, cell size {cell_size} m")
        table = os.path.join(out, "probes.csv")
        summary = run_scene(config("armadillo.yaml"), out, "--duration", 2.2, "--every", 10, "--surface", out,
                            "--probes", table, element=element, rotation="corners", model__cell_size=cell_size,
                            solver__max_iterations=SOLVER["max_iterations"])
        ways = {name: read_probe(table, name) for name in probes}
        models.append({"element": element, "tets": summary["elements"], "nodes": summary["nodes"],
                       "ms": summary["ms_per_step"]["total"], "folder": out,
                       "ways": {name: way[1].tolist() for name, way in ways.items()}})
    times = ways["nose"][0]
    fine = models[-1]
    for model in models:
        apart = {name: np.subtract(model["ways"][name], fine["ways"][name]) for name in probes}
        model["apart"] = {name: np.linalg.norm(distance, axis=1).max() for name, distance in apart.items()}

    camera = Camera(-35, 8)
    instants = [10, 11]  # rows of 0.2 s
    figure, all_axes = pyplot.subplots(len(instants), 3, figsize=(10.5, 8))
    clouds = []
    for row, axes_row in zip(instants, all_axes):
        for model, axes in zip(models, axes_row):
            points, normals, triangles = read_ply(os.path.join(model["folder"], f"armadillo_{row:06}.ply"))
            draw_surface(axes, camera, points, normals, triangles)
            axes.set_title(f"{model['element']}, {model['tets']} tets, {times[row]:.1f} s")
            clouds.append(points)
    same_window(all_axes.ravel(), camera, clouds)
    figure.tight_layout()
    picture(figure, "fig6")
    for model in models:
        del model["folder"], model["ways"]
    return {"models": models, "checks": []}


def swing(out, **values):
    """The bar's swing: the way of its lower corner."""
    probes = os.path.join(out, "probes.csv")
    run_scene(config("bar.yaml"), out, "--duration", 0.9, "--probes", probes, rotation="corners",
              solver__tolerance=TOLERANCE, solver__max_iterations=SOLVER["max_iterations"], **values)
    return read_probe(probes, BAR["probe"])


def at(times, way, wanted):
    return np.stack([np.interp(wanted, times, way[:, axis]) for axis in range(3)], axis=1)


def fig8():
    out = folder("fig8")
    laws = {"corotated": ("co-rotated", "tab:blue"), "green": ("Green strain", "tab:red")}
    steps = [0.02, 0.01, 0.005, 0.002, 0.001]
    ways, errors, orders = {}, {}, {}
    for law in laws:
        say(f"fig8: {law}, explicit")
        ways[law] = swing(out, elasticity=law, integrator="explicit", time_step=0.0005)
    common = ways["corotated"][0]
    lowest = {law: int(np.argmin(way[:, 1])) for law, (_, way) in ways.items()}
    apart = np.linalg.norm(ways["corotated"][1] - at(*ways["green"], common), axis=1).max()

    figure, all_axes = pyplot.subplots(2, 2, figsize=(9, 6), sharex=True)
    for axes, (law, (name, _)) in zip(all_axes.T, laws.items()):
        for other, (label, shade) in laws.items():
            for panel, axis in zip(axes, (1, 2)):
                panel.plot(1000 * common, ways[other][1][:, axis], color=shade, lw=1.6,
                           label=f"{label}, explicit, 0.5 ms")
        errors[law] = []
        for number, step in enumerate(steps):
            say(f"fig8: {law}, implicit, {1000 * step:g} ms")
            times, way = swing(out, elasticity=law, time_step=step)
            errors[law].append(float(np.linalg.norm(way - at(*ways[law], times), axis=1).max()))
            for panel, axis in zip(axes, (1, 2)):
                panel.plot(1000 * times, way[:, axis], color=str(0.75 - 0.15 * number), lw=0.9,
                           label=f"implicit, {1000 * step:g} ms")
        orders[law] = float(np.log(errors[law][-2] / errors[law][-1]) / np.log(steps[-2] / steps[-1]))
        axes[0].set(title=f"implicit steps: {name}", ylabel="y (m)")
        axes[1].set(ylabel="z (m)", xlabel="time (ms)")
    figure.legend(*all_axes[0, 0].get_legend_handles_labels(), loc="upper center", ncol=4, frameon=False)
    figure.tight_layout(rect=(0, 0, 1, 0.91))
    picture(figure, "fig8")
    low = {law: [float(common[k]), *map(float, ways[law][1][k, 1:])] for law, k in lowest.items()}
    y, t = low["corotated"][1], low["corotated"][0]
    return {"lowest": low, "apart": float(apart), "steps": steps, "errors": errors, "orders": orders, "checks": [
        ["Fig. 8: lowest point between -0.44 and -0.45 m at 0.41 s (co-rotated, explicit, 0.5 ms)",
         f"{y:.4f} m at {t:.3f} s", -0.45 <= y <= -0.44 and abs(t - 0.41) <= 0.01],
        ["Fig. 8: co-rotated and Green strain within 5 cm of each other", f"{100 * apart:.1f} cm", apart <= 0.05],
        ["Fig. 8: implicit steps approach the explicit curve at first order (2 ms to 1 ms)",
         ", ".join(f"{laws[law][0]} {order:.2f}" for law, order in orders.items()),
         all(0.85 <= order <= 1.4 for order in orders.values())]]}


def fig7():
    """Von Mises stress where the bar hangs lowest, on the mesh of Fig. 8 and a finer one."""
    camera = Camera(-140, 14, up=(0, 1, 0))
    stresses, pictures = [], []
    for cells in (BAR["cells"], (4, 4, 10)):
        name = "x".join(map(str, cells))
        out = folder("fig7", name)
        say(f"fig7: {name} cells")
        mesh = os.path.join(out, "bar.msh")
        call(os.path.join(REPOSITORY, "scripts", "make_bar"), mesh, "--cells", *cells)
        probes = os.path.join(out, "probes.csv")
        values = {"model__file": mesh, "time_step": 0.002, "rotation": "corners",
                  "solver__max_iterations": SOLVER["max_iterations"]}
        run_scene(config("bar.yaml"), out, "--duration", 0.9, "--probes", probes, **values)
        times, way = read_probe(probes, BAR["probe"])
        until = float(times[np.argmin(way[:, 1])])
        summary = run_scene(config("bar.yaml"), out, "--duration", until, "--every", 10000, "--vtu", out, **values)
        vtu = read_vtu(os.path.join(out, "bar_000001.vtu"))
        pictures.append((f"{name} cells, {summary['elements']} tets, {until:.2f} s", vtu))
        stresses.append({"cells": name, "tets": summary["elements"], "time": until, "lowest": float(way[:, 1].min()),
                         "largest": summary["max_von_mises"], "median": float(np.median(vtu["von_mises"]))})
    norm = scale(0, float(np.percentile(pictures[-1][1]["von_mises"], 99)) / 1000)
    figure, all_axes = pyplot.subplots(1, 2, figsize=(9, 4.6))
    for axes, (title, vtu) in zip(all_axes, pictures):
        draw_elements(axes, camera, vtu, vtu["von_mises"] / 1000, norm)
        axes.set_title(title)
    same_window(all_axes, camera, [vtu["Points"] + vtu["displacement"] for _, vtu in pictures])
    colour_bar(figure, list(all_axes), norm, "von Mises stress (kPa)")
    picture(figure, "fig7")
    return {"bars": stresses, "checks": []}


def recovery():
    """Bodies that start in impossible shapes, and where they come to rest."""
    ground = 0.1  # config/bear.yaml holds what is below
    rows = [0, 1, 2, 5, 10, 20, 40, 200]  # of 20 ms
    seconds = 0.02 * rows[-1]
    series = []

    def follow(scene, out, **values):
        """Runs a scene, and compares its last row with the equilibrium reached from rest."""
        nodes = os.path.join(out, "nodes.csv")
        start = run_scene(config(scene), out, "--steps", 0, **values)
        end = run_scene(config(scene), out, "--steps", rows[-1], "--nodes", nodes, "--vtu", out, "--surface", out,
                        **values)
        _, positions = read_nodes(nodes)
        begun = os.path.join(os.path.dirname(config(scene)), "bar.yaml" if scene == "recovery.yaml" else scene)
        run_scene(begun, out, "--static", "--nodes", nodes, solver__max_iterations=SOLVER["max_iterations"])
        _, at_rest = read_nodes(nodes)
        return {"elements": start["elements"], "inverted_before": start["inverted_elements"], "seconds": seconds,
                "inverted_after": end["inverted_elements"],
                "apart": float(np.linalg.norm(positions[-1] - at_rest[-1], axis=1).max())}

    say("recovery: bar")
    out = folder("recovery", "bar")
    series.append({"body": "bar", "start": "mirrored at its wall", **follow("recovery.yaml", out)})
    figure, all_axes = pyplot.subplots(2, 4, figsize=(13, 4.6))
    camera = Camera(-150, 14, up=(0, 1, 0))
    wall = np.array([[0, 0, 0], [0.4, 0, 0], [0.4, 0.4, 0], [0, 0.4, 0], [0, 0, 0]])
    clouds = []
    for row, axes in zip(rows, all_axes.ravel()):
        vtu = read_vtu(os.path.join(out, f"recovery_{row:06}.vtu"))
        draw_elements(axes, camera, vtu)
        axes.plot(*camera.project(wall).T, color="k", lw=1.2)
        axes.set_title(f"{0.02 * row:.2f} s")
        clouds.append(vtu["Points"] + vtu["displacement"])
    same_window(all_axes.ravel(), camera, clouds)
    figure.subplots_adjust(wspace=0, hspace=0.1)
    picture(figure, "recovery_bar")

    random = np.random.default_rng(1)
    starts = {
        "flattened": lambda rest, free: rest * [1, 1, 0] + [0, 0, ground],
        "mirrored at the ground": lambda rest, free: rest * [1, 1, -1] + [0, 0, 2 * ground],
        "collapsed to a point": lambda rest, free: np.broadcast_to([0, 0, ground], rest.shape),
        "scrambled": lambda rest, free: random.uniform(rest[free].min(axis=0), rest[free].max(axis=0), rest.shape),
    }
    figure, all_axes = pyplot.subplots(len(starts), len(rows), figsize=(14, 2.3 * len(starts)))
    camera = Camera(30, 12)
    for (name, deformed), axes_row in zip(starts.items(), all_axes):
        say(f"recovery: bear, {name}")
        out = folder("recovery", name.replace(" ", "_"))
        nodes, begin = os.path.join(out, "nodes.csv"), os.path.join(out, "start.csv")
        run_scene(config("bear.yaml"), out, "--steps", 0, "--nodes", nodes)
        ids, positions = read_nodes(nodes)
        free = positions[0][:, 2] > ground
        write_start(begin, ids, np.where(free[:, None], deformed(positions[0], free), positions[0]))
        series.append({"body": "bear", "start": name,
                       **follow("bear.yaml", out, initial__positions=begin, damping__mass=2,
                                solver__max_iterations=SOLVER["max_iterations"])})
        clouds = []
        for row, axes in zip(rows, axes_row):
            points, normals, triangles = read_ply(os.path.join(out, f"bear_{row:06}.ply"))
            draw_surface(axes, camera, points, normals, triangles)
            axes.set_title(f"{name}, 0 s" if row == 0 else f"{0.02 * row:.2f} s", fontsize=8)
            if row > 0 or name != "scrambled":  # what sticks out of the window there is cut off
                clouds.append(points)
        same_window(axes_row, camera, clouds)
    figure.subplots_adjust(wspace=0, hspace=0.12)
    picture(figure, "recovery_bear")
    shutil.rmtree(folder("recovery"))  # a gigabyte
    left = sum(one["inverted_after"] for one in series)
    apart = max(one["apart"] for one in series)
    return {"series": series, "checks": [
        [f"Recovery: after {seconds:g} s no element of the bar and the four bears is inverted, and every node within "
         "2 cm of where the body comes to rest", f"{left} inverted, {100 * apart:.1f} cm", left == 0 and apart < 0.02]]}


def surface():
    """What carrying a fine surface costs."""
    out = folder("surface")
    rows = []
    for name, cell_size in (("armadillo", 0.081), ("bunny", 0.11)):
        say(f"surface: {name}")
        scene = falling(name, cell_size, "quadratic", True)
        summary = run_scene(scene, out, "--steps", STEPS, "--every", STEPS, "--surface", out)
        ply = sorted(path for path in os.listdir(out) if path.startswith(os.path.basename(scene)[:-5]))[-1]
        points, _, triangles = read_ply(os.path.join(out, ply))
        rows.append({"surface": name, "triangles": len(triangles), "points": len(points), "tets": summary["elements"],
                     "ms": summary["ms_per_step"]["surface"], "all": summary["ms_per_step"]["total"]})
    return {"rows": rows, "checks": [["A fine surface of 52 000 triangles is carried, with normals",
                                      f"{rows[0]['triangles']} triangles in {rows[0]['ms']:.2f} ms",
                                      rows[0]["triangles"] >= 52000]]}


def study(name):
    """A study of bench_accuracy: its rows."""
    path = os.path.join(folder("accuracy"), name + ".json")
    say(name)
    call(program("bench_accuracy"), name, "--json", path)
    with open(path, encoding="utf-8") as file:
        return json.load(file)


def convergence():
    rows = study("convergence")
    figure, (smooth, stress, bar) = pyplot.subplots(1, 3, figsize=(11, 3.3))
    last, checks = {}, []
    for element in ("linear", "quadratic"):
        for axes, problem, quantity in ((smooth, "smooth", "displacement"), (stress, "smooth", "stress"),
                                        (bar, "clamped bar", "displacement")):
            ours = [row for row in rows if row["problem"] == problem and row["element"] == element]
            h, error = ([row[key] for row in ours] for key in ("h", quantity + "_error"))
            last[problem, quantity, element] = ours[-1][quantity + "_order"]
            axes.loglog(h, error, "o-", color=PAIR[element],
                        label=f"{element}: {last[problem, quantity, element]:.2f}")
    for axes, title in ((smooth, "smooth problem: displacement"), (stress, "smooth problem: stress"),
                        (bar, "clamped bar: deflection of the tip")):
        axes.set(title=title, xlabel="h (m)", ylabel="relative error", xticks=[0.03, 0.1, 0.3])
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter("")
        axes.legend(loc="upper left", fontsize=8, title="order at the end", title_fontsize=8)
    figure.tight_layout()
    picture(figure, "convergence")
    for element, quantity, least in (("quadratic", "displacement", 2.9), ("linear", "displacement", 1.9),
                                     ("quadratic", "stress", 1.9), ("linear", "stress", 0.95)):
        order = last["smooth", quantity, element]
        checks.append([f"Order of convergence of the {quantity}, {element} elements, at least {least}", f"{order:.2f}",
                       order >= least])
    return {"rows": rows, "checks": checks}


def frequencies():
    rows = study("frequencies")

    def worst(key, element):
        return max((abs(row["frequency"] / row[key] - 1) for row in rows
                    if row[key] is not None and row["element"] == element), default=None)

    dense = max(worst("dense_reference", element) for element in ("linear", "quadratic"))
    checks = [["Lowest ten frequencies of clamped bars equal those of a dense element of other making to 1e-6",
               f"{dense:.0e}", dense <= 1e-6]]
    calculix = worst("calculix", "quadratic")
    if calculix is not None:
        checks.append(["The same within 0.3 % of CalculiX's C3D10", f"{100 * calculix:.2f} %", calculix <= 0.003])
    return {"rows": rows, "checks": checks}


def equal_accuracy():
    rows = study("equal_accuracy")
    ratios = [row["ratio"] for row in rows if row["element"] == "linear"]
    return {"rows": rows, "checks": [["At 2 % error of the bar's deflection a step with quadratic elements costs less",
                                      f"by a factor of {min(ratios):.0f} or more", min(ratios) > 1]]}


def spin():
    rows = study("spin")
    laws = {}
    for row in rows:
        if row["element"] == "quadratic":
            law = "Green strain" if row["elasticity"] == "green" else "rotation: " + row["rotation"]
            laws.setdefault((law, row["integrator"], row["time_step"]), {}).setdefault(row["motion"], []).append(row)
    # What is drawn: explicit steps, and the smallest.
    integrator, step = min({(integrator, step) for _, integrator, step in laws},
                           key=lambda kind: (kind[0] != "explicit", kind[1]))
    figure, all_axes = pyplot.subplots(2, 2, figsize=(9, 5.6), sharex=True)
    for column, motion in enumerate(("spin", "swing")):
        for (law, *kind), motions in laws.items():
            if kind == [integrator, step]:
                ours = motions[motion]
                for axes, key in zip(all_axes[:, column], ("angular_momentum", "energy")):
                    axes.plot([row["time"] for row in ours], [row[key] for row in ours], label=law,
                              ls="--" if law == "Green strain" else "-")
        all_axes[0, column].set_title(f"{motion}, {integrator.replace('_', ' ')}, {1000 * step:g} ms")
        all_axes[1, column].set_xlabel("time (s)")
    all_axes[0, 0].set_ylabel("change of angular momentum")
    all_axes[1, 0].set_ylabel("energy, relative to the start")
    all_axes[0, 0].legend()
    figure.tight_layout()
    picture(figure, "spin")
    momentum = max(row["momentum"] for row in rows)
    table = [{"law": law, "integrator": kind[0], "time_step": kind[1],
              **{f"{name}_momentum": max(row["angular_momentum"] for row in ours) for name, ours in motions.items()},
              **{f"{name}_energy": ours[-1]["energy"] for name, ours in motions.items()}}
             for (law, *kind), motions in laws.items()]
    residual = max(row["worst_residual"] for row in rows)
    return {"table": table, "momentum": momentum, "residual": residual, "checks": [
        ["Free motion: linear momentum is kept to 1e-6", f"{momentum:.0e}", momentum <= 1e-6]]}


def calculix():
    say("calculix")
    command = [os.path.join(REPOSITORY, "scripts", "compare_with_calculix"), program("run_scene")]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, check=False)
    if done.stderr:
        raise Failed(done.stderr.strip().splitlines()[-1])
    apart = {tuple(names): float(percent) for *names, percent in
             re.findall(r"^(\w+), (\w+), .* apart by ([\d.]+) %", done.stdout, re.MULTILINE)}
    claims = [["small strain", "linear", 0.1], ["Green strain", "green", 0.1], ["co-rotated", "corotated", 1]]
    return {"told": done.stdout, "checks": [
        [f"The bar's deflection is that of CalculiX's C3D10, {name}, to {most} %", f"{apart['quadratic', law]} %",
         apart["quadratic", law] <= most] for name, law, most in claims]}
