"""What to choose when, and what is promised, each beside what the points say about it. Knows no pictures."""
import math

from analysis import cheapest, pareto
from engine import DEFAULTS
from report import power

LAWS = {"corotated": "co-rotated", "green": "Green strain", "linear": "small strain"}
INTEGRATORS = {"implicit_euler": "implicit Euler", "sdirk2": "SDIRK2", "explicit": "explicit"}


def percent(value, digits=2):
    return "–" if value is None or not math.isfinite(value) else f"{100 * value:.{digits}g} %"


def ms(value):
    return f"{value:.2g}" if value < 10 else f"{value:.0f}"


def pick(rows, mode, **wanted):
    """The rows of a mode with these settings, `__` for the point; what is not named has its default."""
    wanted = {**DEFAULTS, **{key.replace("__", "."): value for key, value in wanted.items()}}
    if mode == "static":
        wanted.pop("solver.tolerance")
    free = [key for key, value in wanted.items() if value is None]
    return [row for row in rows if row["mode"] == mode and
            all(row[key] == value for key, value in wanted.items() if key not in free)]


def on(rows, mesh):
    return [row for row in rows if row["mesh"] == mesh]


def usable(rows, mode, error):
    """Rows that have a time and this error, which is not 0."""
    return [row for row in rows if row["mode"] == mode and row["ms_per_second"] and row[f"error_{error}"]]


def ratio(study, name):
    return study.equal["linear"][name]["ms"] / study.equal["quadratic"][name]["ms"]


def ratio_of(study, name):
    """In words: a bound where an element does not reach the error."""
    reached = [study.equal[element]["reached"] for element in ("quadratic", "linear")]
    if not reached[0]:
        return f"not reached by quadratic elements of up to {study.equal['quadratic'][name]['tets']} tets"
    told = f"{ratio(study, name):.0f}"
    return told if reached[1] else f"not reached with {study.equal['linear'][name]['tets']} tets, so more than {told}"


def front_members(rows, mode, error):
    some = usable(rows, mode, error)
    return [some[k] for k in pareto([(row["ms_per_second"], row[f"error_{error}"]) for row in some])]


def fastest(rows, mode, error, wanted):
    some = usable(rows, mode, error)
    found = cheapest([(row["ms_per_second"], row[f"error_{error}"]) for row in some], wanted)
    return None if found is None else some[found]


def described(row):
    return (f"{row['element']}, {row['tets']} tets, {INTEGRATORS[row['integrator']]}, "
            f"{1000 * row['time_step']:g} ms: {ms(row['ms_per_second'])} ms/s")


def times(row, other):
    """How many times as long one takes as the other."""
    return row["ms_per_second"] / other["ms_per_second"]


def advice(studies):
    """What to choose when: (text, whether the data bear it out). The data are the bar's where no scene is named."""
    bar = next((study for study in studies if study.name == "bar"), studies[0])
    rows = bar.rows
    usual = "2x2x5"

    # 1 elements
    members = {study.title: front_members([row for row in study.rows if row["elasticity"] == "corotated"], "static",
                                          "tip") for study in studies}
    accurate = [row for some in members.values() for row in some if row["error_tip"] <= 0.1]
    yield (f"**Quadratic elements, unless you need no more than a rough shape.** Of the {len(accurate)} points of the "
           f"fronts for the tip's equilibrium with an error below 10 %, over all scenes, "
           f"{sum(row['element'] == 'quadratic' for row in accurate)} are quadratic.",
           bool(accurate) and all(row["element"] == "quadratic" for row in accurate))

    # 2 how much that is worth
    yield (f"**At {percent(bar.equal['wanted'])} of the bar's tip** a step on linear elements takes "
           f"{ratio_of(bar, 'same')} times as long with the same solver and operator, {ratio_of(bar, 'best')} times "
           "with each one's best.",
           all(bar.equal[element]["reached"] for element in ("quadratic", "linear")) and ratio(bar, "same") >= 200 and
           ratio(bar, "best") >= 100)

    # 3 where to refine
    static = pick(rows, "static")
    plain, fine = on(static, "4x4x10")[0], on(static, "2x2x5_graded_1")[0]
    yield (f"**Refine where the body is held, before refining it all.** {fine['tets']} quadratic tets that are finer "
           f"at the rim of the clamped end err by {percent(fine['error_tip'])} at the tip, {plain['tets']} even ones "
           f"by {percent(plain['error_tip'])}.", fine["error_tip"] < plain["error_tip"])

    # 4 time step
    euler = sorted(on(pick(rows, "dynamic", time_step=None), usual), key=lambda row: row["time_step"])
    second = sorted(on(pick(rows, "dynamic", time_step=None, integrator="sdirk2"), usual),
                    key=lambda row: row["time_step"])
    e20, e5, s20 = (next(row for row in some if row["time_step"] == step)
                    for some, step in ((euler, 0.02), (euler, 0.005), (second, 0.02)))
    fine20 = on(pick(rows, "dynamic"), "4x4x10")[0]
    yield (f"**The time step limits motion, not the mesh.** With implicit Euler steps of 20 ms the bar's tip is off by "
           f"{percent(e20['error_tip'])} over 2 s on 120 quadratic tets, by {percent(fine20['error_tip'])} on 960, "
           f"with 5 ms by {percent(e5['error_tip'])}; its equilibrium on the 120 by "
           f"{percent(on(static, usual)[0]['error_tip'])}.",
           e20["error_tip"] > 3 * on(static, usual)[0]["error_tip"] and e5["error_tip"] < e20["error_tip"] and
           abs(fine20["error_tip"] / e20["error_tip"] - 1) < 0.1)

    # 5 second order
    yield (f"**`integrator: sdirk2` where motion matters.** At 20 ms its error is {percent(s20['error_tip'])} against "
           f"{percent(e20['error_tip'])} of implicit Euler, for {times(s20, e20):.1f} times the time; implicit Euler "
           f"at 5 ms takes {times(e5, e20):.1f} times the time for {percent(e5['error_tip'])}.",
           s20["error_tip"] < e5["error_tip"] and s20["ms_per_second"] < e5["ms_per_second"])

    # 6 explicit
    winners = {}
    for study in studies:
        for wanted in (0.1, 0.05, 0.02):
            row = fastest([row for row in study.rows if row["elasticity"] == "corotated"], "dynamic", "tip", wanted)
            if row is not None:
                winners[study.title, wanted] = row
    told = "; ".join(f"{title}, {percent(wanted)}: {described(row)}" for (title, wanted), row in winners.items())
    slower = {way: [on(pick(rows, "dynamic", integrator=way, time_step=0.005), mesh)[0]["ms_per_second"]
                    for mesh in (usual, "2x2x5_graded_1")] for way in ("explicit", "sdirk2")}
    factors = {way: graded / even for way, (even, graded) in slower.items()}
    yield (f"**Fastest for the tip's motion within an error**: {told}. Small elements cost `explicit` more: twice as "
           f"many at the bar's rim make it {factors['explicit']:.1f} times as slow, `sdirk2` "
           f"{factors['sdirk2']:.1f} times.",
           bool(winners) and factors["explicit"] > factors["sdirk2"])

    # 7 tolerance
    loose = {row["solver.tolerance"]: row for row in on(pick(rows, "dynamic", solver__tolerance=None, time_step=0.005,
                                                             integrator="sdirk2"), usual)}
    change = {tolerance: abs(row["error_tip"] - loose[1e-6]["error_tip"]) for tolerance, row in loose.items()}
    enough = max(tolerance for tolerance in loose if change[tolerance] <= 0.1 * loose[1e-6]["error_tip"])
    yield (f"**`solver.tolerance: {power(enough)}` is enough** for the bar in motion: the tip's error changes by "
           f"{percent(change[enough])} of the displacement, and a step takes "
           f"{times(loose[enough], loose[1e-4]):.2f} of the time of the default 1e-4; at 1e-1 it changes "
           f"by {percent(change[1e-1])}.", enough >= 1e-4)

    # 8 rotation
    still = {rule: on(pick(rows, "static", rotation=rule), usual)[0] for rule in ("corners", "centroid", "four")}
    free = {rule: on(pick(rows, "dynamic", rotation=rule, integrator="explicit", time_step=0.005), usual)[0]
            for rule in still}
    yield ("**Leave `rotation: corners`.** On 120 tets its equilibrium is off by "
           + ", ".join(f"{percent(row['error_tip'])} ({rule})" for rule, row in still.items()) + "; explicit motion by "
           + ", ".join(f"{percent(row['error_tip'])} ({rule})" for rule, row in free.items())
           + ". `four` is for explicit steps that must keep energy.",
           still["corners"]["error_tip"] == min(row["error_tip"] for row in still.values()))

    # 9 laws
    apart = bar.apart
    cost = {law: times(on(pick([*rows, *bar.times], "dynamic", elasticity=law), usual)[0], e20)
            for law in ("green", "linear")}
    yield (f"**`elasticity` is a choice of material, not of accuracy.** Converged, Green strain puts the bar's tip "
           f"{percent(apart['green'])} of its displacement from where co-rotated elasticity does, for "
           f"{cost['green']:.1f} times the time; small strain {percent(apart['linear'])}, for "
           f"{cost['linear']:.2f} of the time: it is for small turns only.",
           apart["linear"] > apart["green"])

    # 10 solver
    solver = {name: on(pick(rows, "dynamic", solver__preconditioner=name), "4x4x10")[0]
              for name in ("block_jacobi", "auto")}
    assembled = on(pick(rows, "dynamic", solver__operator="assembled"), "4x4x10")[0]
    yield (f"**Leave `solver` alone.** On 960 quadratic tets the diagonal blocks alone take "
           f"{times(solver['block_jacobi'], solver['auto']):.1f} times the time of `auto`, the assembled matrix "
           f"{times(assembled, solver['auto']):.1f} times.",
           times(solver["block_jacobi"], solver["auto"]) > 0.9 and times(assembled, solver["auto"]) > 1)


def claims(studies):
    """What was promised: (claim, measured, whether it holds)."""
    bar = next(study for study in studies if study.name == "bar")
    distinct = {tuple(row[key] for key in ("mode", "mesh", *DEFAULTS)) for row in bar.rows}
    yield "At least 200 points for the bar", f"{len(distinct)}", len(distinct) >= 200
    for name, least, words in (("same", 200, "the same solver and operator"), ("best", 100, "each one's best")):
        yield (f"At {percent(bar.equal['wanted'])} tip error of the bar quadratic elements are at least {least} times "
               f"as fast as linear ones, with {words}", ratio_of(bar, name),
               bar.equal["quadratic"]["reached"] and ratio(bar, name) >= least)
    own = bar.own["static corotated"]["tip"]
    yield (f"The bar's reference errs at the tip by less than a third of {percent(bar.equal['wanted'])}", percent(own),
           own is not None and own <= bar.equal["wanted"] / 3)
