"""The page's pictures: growth with the mesh, and the front before and after."""
import os

import claims
import tools
from analysis import pareto
from pictures import pyplot

BEFORE, NOW = "#D55E00", "#0072B2"
SHAPES = {"quadratic": "o", "linear": "^"}
RULES = {"font.family": "DejaVu Sans", "font.size": 8.5, "axes.titlesize": 9, "svg.hashsalt": "performance",
         "svg.fonttype": "none"}


def save(figure, name):
    os.makedirs(tools.PICTURES, exist_ok=True)
    for kind in ("png", "svg"):
        figure.savefig(os.path.join(tools.PICTURES, f"{name}.{kind}"), dpi=130,
                       metadata={"Date": None} if kind == "svg" else None)
    pyplot.close(figure)


def growth(rows):
    with pyplot.rc_context(RULES):
        figure, both = pyplot.subplots(1, 2, figsize=(9.5, 3.8))
        for how, words, marker, color in (("meshed", "meshed anew", "o", NOW), ("cut", "cut into eight", "s", BEFORE)):
            some = sorted((row for row in rows if row["how"] == how), key=lambda row: row["tets"])
            tets = [row["tets"] for row in some]
            both[0].plot(tets, [row["iterations"] for row in some], marker=marker, color=color, label=words)
            both[1].plot(tets, [claims.microseconds(row) for row in some], marker=marker, color=color, label=words)
        for axes, words in zip(both, ("iterations a step, median", "time per element and step (µs)")):
            axes.set(xscale="log", xlabel="tetrahedra", ylabel=words)
            axes.set_ylim(bottom=0)
            axes.legend(frameon=False)
        figure.tight_layout()
        save(figure, "growth")


def front(told):
    with pyplot.rc_context(RULES):
        figure, both = pyplot.subplots(1, 2, figsize=(9.5, 4.4), sharey=True)
        for axes, mode, words in zip(both, ("static", "dynamic"), ("equilibrium", "motion")):
            for when, color, label in (("before", BEFORE, told["revision"]), ("now", NOW, "now")):
                rows = [row for row in claims.corotated(told[when]) if row["mode"] == mode and
                        row["ms_per_second"] and row["error_tip"]]
                for element, marker in SHAPES.items():
                    some = [row for row in rows if row["element"] == element]
                    axes.scatter([row["ms_per_second"] for row in some], [100 * row["error_tip"] for row in some],
                                 marker=marker, s=18, color=color, alpha=0.45, linewidths=0)
                times, errors = zip(*((rows[k]["ms_per_second"], 100 * rows[k]["error_tip"]) for k in
                                      pareto([(row["ms_per_second"], row["error_tip"]) for row in rows])))
                axes.step(times, errors, where="post", color=color, lw=1.5, label=f"front, {label}")
            axes.set(xscale="log", yscale="log", title=f"Bar, {words}", xlabel="time per simulated second (ms/s)")
            axes.legend(frameon=False)
        both[0].set_ylabel("error of the tip (% of the largest displacement)")
        figure.tight_layout()
        save(figure, "front")
