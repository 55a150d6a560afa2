"""What is promised, beside what was measured. Knows no pictures."""
import scenes
from analysis import cheapest

SAME_SIZE = 1.5  # sizes of two meshes that count as the same


def products(row):
    return row["step in products"]


def worst_residual(told):
    return max(row[key]["worst residual"] for row in told["steps"] for key in ("one", "two"))


def named(rows, name):
    """The row of that name, or None where it has not been measured."""
    return next((row for row in rows if row["name"] == name), None)


def missing(told):
    """What a page of all would have and this one has not."""
    for part, found in told.items():
        if not found:
            yield part
    for part, expected in (("steps", scenes.STEPS), ("linear", scenes.LINEAR)):
        if told[part]:
            yield from (f"{part}: {name}" for name, *_ in expected if named(told[part], name) is None)
    if told["growth"] and len(told["growth"]) < len(scenes.GROWTH):
        yield f"growth: {len(scenes.GROWTH) - len(told['growth'])} meshes"
    if told["kernels"] and "large" not in told["kernels"]:
        yield "kernels: the larger model"
    if told["front"] and "before" not in told["front"]:
        yield "front: the revision before"
    if told["front"] and {row["law"] for row in told["front"].get("calculix", ())} != {"linear", "green"}:
        yield "front: CalculiX, which takes Debian's package calculix-ccx"
    if told["huge_pages"] and len(told["huge_pages"]["rows"]) < len(scenes.HUGE_PAGES):
        yield "huge_pages: the larger model"


def nearest(rows, tets):
    """The row of the mesh nearest to a size, or None."""
    found = min(rows, key=lambda row: max(row["tets"] / tets, tets / row["tets"]))
    return found if max(found["tets"] / tets, tets / found["tets"]) < SAME_SIZE else None


def microseconds(row):
    """Time per element and step."""
    return 1000 * row["whole step"] / row["tets"]


def grown(rows, value):
    """How many times the value is at the largest of the claims' sizes what it is at the smallest, or None."""
    ends = [nearest(rows, tets) for tets in (scenes.GROWTH_FROM, scenes.GROWTH_TO)]
    return None if None in ends else value(ends[1]) / value(ends[0])


def kernel(told, name, precision, size="small"):
    return next(row for row in told["kernels"][size]["rows"]
                if row["kernel"] == name and row["precision"] == precision)


def own_match(rows, other, law):
    """Our fastest point of the same mode and of a law that errs no more than another program's, or None."""
    some = [row for row in rows if row["mode"] == other["mode"] and row["elasticity"] == law and cost(row) and
            row["error_tip"]]
    found = cheapest([(cost(row), row["error_tip"]) for row in some], other["error_tip"])
    return None if found is None else some[found]


def cost(row):
    """ms of one of our points: a simulated second of motion, or finding the equilibrium."""
    return row["ms_per_second" if row["mode"] == "dynamic" else "ms_static"]


def corotated(rows):
    return [row for row in rows if row["elasticity"] == "corotated"]


def peers(told):
    """Bullet's rows, each with ours, and how many times as long theirs took; None where we have no such point."""
    for other in told["front"]["others"]:
        own = own_match(told["front"]["now"], other, other["law"])
        yield other, own, own and other["ms"] / cost(own)


def calculix_pairs(rows, others):
    """
    CalculiX's rows, each with a law of ours and our point of it: small strain beside the same, NLGEOM, which is Green's
    strain, beside that and beside the co-rotated law, which is another one.
    """
    for other in others:
        for law in ("linear",) if other["law"] == "linear" else ("green", "corotated"):
            yield other, law, own_match(rows, other, law)


def calculix(told):
    """The same, and how many times as long theirs took: process beside process, and what is in it beside our solve."""
    for other, law, own in calculix_pairs(told["front"]["now"], told["front"].get("calculix", ())):
        yield other, law, own, own and (other["ms"] / own["ms_process"], (other["ms"] - other["ms_idle"]) / cost(own))


def claims(told):
    """(claim, what was measured, whether it holds) of the parts that have been measured"""
    for part, judge in (("steps", of_steps), ("linear", of_linear), ("growth", of_growth), ("kernels", of_kernels),
                        ("front", of_front)):
        if told[part]:
            yield from judge(told)


def of_steps(told):
    worst = worst_residual(told)
    yield (f"Every step of every scene is solved to {scenes.TOLERANCE:.0e}", f"{worst:.1e}", worst <= scenes.TOLERANCE)
    for name, _, _, most in scenes.STEPS:
        row = named(told["steps"], name)
        if row is None:
            continue
        yield (f"Whole step, {name}: at most {most} products", f"{products(row['one']):.1f}",
               products(row["one"]) <= most)
        ratio = row["two"]["whole step"] / row["one"]["whole step"]
        yield (f"Two threads, {name}: at most {scenes.TWO_THREADS} of one's time", f"{ratio:.2f}",
               ratio <= scenes.TWO_THREADS)
    row = named(told["steps"], scenes.CLASSIC_CLAIMED)
    if row is None:
        return
    ratio = row["classic"]["whole step"] / row["one"]["whole step"]
    yield (f"{row['name']}: 20 times as fast as block-diagonal CG on the assembled matrix", f"{ratio:.1f}", ratio >= 20)
    yield (f"{row['name']}: real time at {1000 / scenes.REAL_TIME:.0f} Hz on one core",
           f"{row['one']['whole step']:.1f} ms", row["one"]["whole step"] <= scenes.REAL_TIME)
    yield (f"Rotations, {row['name']}, in a step: at most {scenes.ROTATIONS} of a plain product",
           f"{rotations(row):.2f}", rotations(row) <= scenes.ROTATIONS)


def rotations(row):
    """Of a row of steps, in products: with data that the solver has driven out of cache meanwhile."""
    return row["one"]["rotation"] / row["one"]["one product"]


def of_linear(told):
    for name, _, _, least, _ in scenes.LINEAR:
        row = named(told["linear"], name)
        if row is None:
            continue
        ratio = row["blocks"]["whole step"] / row["own"]["whole step"]
        met = max(row[key]["worst residual"] for key in ("own", "blocks")) <= scenes.LINEAR_TOLERANCE
        yield (f"Linear elements to {scenes.LINEAR_TOLERANCE:.0e}, {name}: {least} times as fast as block-diagonal CG",
               f"{ratio:.1f}" + ("" if met else ", not to that tolerance"), met and ratio >= least)


def of_growth(told):
    meshed = [row for row in told["growth"] if row["how"] == "meshed"]
    for what, value, most in (("Iterations", lambda row: row["iterations"], scenes.ITERATIONS_GROW),
                              ("Time per element", microseconds, scenes.TIME_GROWS)):
        ratio = grown(meshed, value)
        yield (f"{what} from {scenes.GROWTH_FROM} to {scenes.GROWTH_TO} tets: less than {most} times",
               "not measured" if ratio is None else f"{ratio:.2f} times", ratio is not None and ratio < most)
    largest = max(row["tets"] for row in told["growth"])
    yield (f"Growth is shown to {scenes.GROWTH_END} tets", f"{largest}", largest >= scenes.GROWTH_END)


def of_kernels(told):
    for size in told["kernels"]:
        tets = told["kernels"][size]["rows"][0]["tets"]
        for name, precision, words, most in (
                ("product", "double", "product in double, which makes residuals", scenes.PRODUCT),
                ("product", "single", "product in single precision with p·q, which the solver iterates with",
                 scenes.PRODUCT),
                ("rotations", "double", "rotations, data in cache if they fit", scenes.ROTATIONS)):
            ratio = kernel(told, name, precision, size)["products"]
            yield (f"Kernels, bunny, {tets} tets, {words}: at most {most} of a plain product in double",
                   f"{ratio:.2f}", ratio <= most)


def of_front(told):
    judged = [("Bullet's points at most its time", [ratio for *_, ratio in peers(told)])]
    of_calculix = [ratios or (None, None) for *_, ratios in calculix(told)]
    if of_calculix:
        processes, solves = zip(*of_calculix)
        judged += [("CalculiX's points at most its time, process beside process", processes),
                   ("CalculiX's points at most its time, without reading and writing", solves)]
    for words, ratios in judged:
        slowest = None if None in ratios else min(ratios, default=None)
        yield (f"At the tip error of each of {words}",
               "not reached everywhere" if slowest is None else f"at least {slowest:.2g} times as fast",
               slowest is not None and slowest >= 1)


def lost(told):
    """Other programs' points at which theirs is the faster one, or that we do not reach: which, the least ratio."""
    found = [(f"{other['program']}, {other['settings']}, {other['tets']} tets, "
              f"{'at rest' if other['mode'] == 'static' else 'motion'}", other, ratio)
             for other, _, ratio in peers(told)]
    found += [(f"{other['program']}, {other['settings']}, {other['law']}, {other['tets']} tets, beside {law}", other,
               ratios and min(ratios)) for other, law, _, ratios in calculix(told)]
    return [row for row in found if row[-1] is None or row[-1] < 1]
