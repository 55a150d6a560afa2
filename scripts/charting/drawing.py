"""The charts: error over time per simulated second, a point a variant."""
import os

from matplotlib import lines, ticker
from pictures import pyplot

from analysis import pareto
from claims import INTEGRATORS, LAWS, usable
from tools import REPOSITORY

PLACE = os.path.join(REPOSITORY, "doc", "speed_accuracy")
REAL_TIME = 1000  # ms per simulated second
TOLD = 3          # points nearer to zero than so many times the reference's own error are hollow
# Okabe and Ito's colours, told apart by everyone
LAW_COLORS = {"corotated": "#0072B2", "green": "#009E73", "linear": "#CC79A7"}
INTEGRATOR_COLORS = {"implicit_euler": "#0072B2", "sdirk2": "#D55E00", "explicit": "#009E73"}
SHAPES = {"quadratic": "o", "linear": "^"}
LAW_SHAPES = {("quadratic", "corotated"): "o", ("linear", "corotated"): "^", ("quadratic", "green"): "s",
              ("linear", "green"): "D", ("quadratic", "linear"): "P", ("linear", "linear"): "X"}
TITLES = {"tip": "tip", "field_rms": "whole body, root mean square", "field_max": "whole body, worst point",
          "von_mises": "von Mises stress, worst of the inner probes", "period": "period of the main swing",
          "decay": "amplitude lost in a period"}


def panel(axes, rows, error, own, color, shape, unit, real_time=True):
    """One error of one mode. Hollow: too near to the reference's own error to be told."""
    for row in rows:
        value = 100 * row[f"error_{error}"]
        off = own.get(f"{row['mode']} {row['elasticity']}", {}).get(error)
        told = off is not None and value >= 100 * TOLD * off
        tone = color(row)
        axes.scatter(row["ms_per_second"], value, marker=shape(row), s=26, linewidths=0.8 if told else 1.1,
                     facecolors=tone if told else "none", edgecolors="white" if told else tone, zorder=3)
    points = [(row["ms_per_second"], 100 * row[f"error_{error}"]) for row in rows]
    front = pareto(points)
    if front:
        times, errors = zip(*(points[k] for k in front))
        axes.step(times, errors, where="post", color="0.25", lw=1.1, zorder=2)
    axes.set(xscale="log", yscale="log", title=TITLES[error], ylabel=f"error ({unit})")
    if real_time:
        axes.axvline(REAL_TIME, color="0.35", lw=1, ls=(0, (5, 3)), zorder=1)
        axes.annotate("real time", (REAL_TIME, 0.99), xycoords=("data", "axes fraction"), rotation=90, fontsize=7.5,
                      color="0.35", ha="right", va="top")
    axes.grid(which="major", alpha=0.35)
    axes.grid(which="minor", alpha=0.12)
    axes.yaxis.set_major_locator(ticker.LogLocator(subs=(1, 2, 5)))
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(ticker.FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(ticker.NullFormatter())


def foreign(axes, rows, mode, colors):
    """Other programs' points: stars, named."""
    for row in rows:
        if row["mode"] == mode:
            axes.scatter(row["ms"], 100 * row["error_tip"], marker="*", s=70, color=colors[row["program"]],
                         edgecolors="black", linewidths=0.5, zorder=4)


def heading(figure, text):
    figure.text(0.5, 0.985, text, ha="center", va="top", fontsize=11)


def legend(figure, entries, columns):
    handles = []
    for label, marker, color, fill in entries:
        star = marker == "*"
        handles.append(lines.Line2D([], [], ls="" if marker else "-", marker=marker or None, color=color,
                                    ms=9 if star else 6, lw=1.1, mfc=color if fill else "none",
                                    mec="white" if fill and not star else color, label=label))
    figure.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, 0.965), ncol=columns, frameon=False,
                  fontsize=8, handletextpad=0.3, columnspacing=1.4)


def save(figure, place, name):
    for kind in ("png", "svg"):
        figure.savefig(os.path.join(place, f"{name}.{kind}"), dpi=130,
                       metadata={"Date": None} if kind == "svg" else None)
    pyplot.close(figure)


def draw(scene, title, rows, own, place, others=()):
    """
    Three pictures: equilibria over the time of steps, equilibria over the time of finding them, and motion.
    others  rows of other programs
    """
    names = sorted({row["program"] for row in others})
    colors = dict(zip(names, ("#E69F00", "#F0E442", "#56B4E9", "0.6")))
    stars = lambda mode: [(name, "*", colors[name], True) for name in names  # noqa: E731
                          if any((row["program"], row["mode"]) == (name, mode) for row in others)]
    rules = {"font.family": "DejaVu Sans", "font.size": 8.5, "axes.titlesize": 9, "svg.hashsalt": scene,
             "svg.fonttype": "none"}
    with pyplot.rc_context(rules):
        figure, all_axes = pyplot.subplots(2, 2, figsize=(9.5, 8), sharex=True)
        for axes, error in zip(all_axes.ravel(), ("tip", "field_rms", "field_max", "von_mises")):
            panel(axes, usable(rows, "static", error), error, own, lambda row: LAW_COLORS[row["elasticity"]],
                  lambda row: SHAPES[row["element"]], "% of the largest displacement" if error != "von_mises" else
                  "% of the probe's stress")
        for axes in all_axes[1]:
            axes.set_xlabel("time per simulated second, implicit Euler steps of 20 ms (ms/s)")
        heading(figure, f"{title}: equilibrium, error against the law's own reference")
        entries = [(f"{LAWS[law]}, {element}", SHAPES[element], LAW_COLORS[law], True)
                   for law in LAWS for element in SHAPES
                   if any((row["elasticity"], row["element"]) == (law, element) for row in rows)]
        entries += [("below 3 × reference's error", "o", "0.4", False), ("Pareto front", None, "0.25", False)]
        legend(figure, entries, 4)
        figure.tight_layout(rect=(0, 0, 1, 0.92))
        save(figure, place, f"{scene}_static")

        figure, axes = pyplot.subplots(figsize=(6.5, 5))
        rests = [{**row, "ms_per_second": row["ms_static"]} for row in rows if row["mode"] == "static"]
        panel(axes, usable(rests, "static", "tip"), "tip", own, lambda row: LAW_COLORS[row["elasticity"]],
              lambda row: SHAPES[row["element"]], "% of the largest displacement", real_time=False)
        foreign(axes, others, "static", colors)
        axes.set(xlabel="time of finding the equilibrium (ms)", title="")
        heading(figure, f"{title}: equilibrium, error of the tip")
        legend(figure, entries + stars("static"), 3)
        figure.tight_layout(rect=(0, 0, 1, 0.84 if others else 0.88))
        save(figure, place, f"{scene}_rest")

        figure, all_axes = pyplot.subplots(2, 2, figsize=(9.5, 8), sharex=True)
        for axes, error in zip(all_axes.ravel(), ("tip", "field_rms", "period", "decay")):
            panel(axes, usable(rows, "dynamic", error), error, own,
                  lambda row: INTEGRATOR_COLORS[row["integrator"]],
                  lambda row: LAW_SHAPES[row["element"], row["elasticity"]],
                  {"period": "%", "decay": "percentage points"}.get(error, "% of the largest displacement"))
        foreign(all_axes[0, 0], others, "dynamic", colors)
        all_axes[0, 0].set_title("way of the tip, root mean square in time")
        all_axes[0, 1].set_title("whole body, root mean square in space and time")
        for axes in all_axes[1]:
            axes.set_xlabel("time per simulated second (ms/s)")
        heading(figure, f"{title}: motion, error against the law's own reference")
        entries = [(name, "o", INTEGRATOR_COLORS[key], True) for key, name in INTEGRATORS.items()]
        present = {(row["element"], row["elasticity"]) for row in rows if row["mode"] == "dynamic"}
        entries += [(f"{element}, {LAWS[law]}", shape, "0.4", True) for (element, law), shape in LAW_SHAPES.items()
                    if (element, law) in present]
        entries += [("below 3 × reference's error", "o", "0.4", False), ("Pareto front", None, "0.25", False)]
        entries += stars("dynamic")
        legend(figure, entries, 4)
        figure.tight_layout(rect=(0, 0, 1, 0.965 - 0.02 * -(-len(entries) // 4)))
        save(figure, place, f"{scene}_dynamic")
