"""The parts of the atlas: a group of columns each, and what else is measured."""
import functools

import judges
import methods
import provocations


def part_name(group):
    return group.lower().split(",")[0].replace("'s", "").replace("10 km from the origin", "far").replace(
        "contrast of 1e6", "contrast").replace(" ", "_")


@functools.lru_cache(None)
def columns():
    groups = {}
    for provocation in provocations.all_of_them():
        groups.setdefault(part_name(provocation.group), []).append(provocation)
    return groups


def cells(group, each):
    wanted = {judges.Truths.wanted(p, m) for p in columns()[group] for m in methods.METHODS} - {None}
    wanted = sorted(wanted - set(judges.truths.known))
    each(f"{group}, truth", [(what if kind == "path" else "equilibrium",
                              functools.partial(judges.truths.prepare, (kind, what))) for kind, what in wanted])

    def cell(provocation, method):
        return judges.judge(provocation, method, methods.run(provocation, method))

    pairs = [(p, m) for p in columns()[group] for m in methods.METHODS]
    verdicts = each(group, [(f"{p.label}, {methods.METHODS[m][0]}", functools.partial(cell, p, m)) for p, m in pairs])
    table = {}
    for (provocation, method), verdict in zip(pairs, verdicts):
        table.setdefault(provocation.key, {})[method] = verdict
    return {"cells": table, "truths": judges.truths.told}


def scramble(each):
    """How often the default comes back from a scrambled start, and what changes that."""
    rates = []
    for name, keys in provocations.SCRAMBLE_REMEDIES.items():
        runs = each(f"scramble, {name}", [(f"seed {seed}", functools.partial(recovered, seed, keys))
                                          for seed in range(provocations.SEEDS)])
        rates.append({"name": name, "keys": keys, "recovered": sum(r["outcome"] == judges.RIGHT for r in runs),
                      "lost": sum(r["outcome"] == judges.BLOWN_UP for r in runs),
                      "seconds": sum(r["seconds"] for r in runs) / len(runs)})
    return {"rates": rates}


def locking(each):
    """The equilibrium under the bar's weight, by element, with the remedy and without, on two meshes."""
    cases = provocations.locking()
    wanted = sorted({judges.Truths.wanted(p, methods.DEFAULT) for _, p in cases} - set(judges.truths.known))
    each("locking, truth", [("equilibrium", functools.partial(judges.truths.prepare, key)) for key in wanted])
    verdicts = each("locking", [(f"{names[0]}, {names[1]}, {names[2]}", functools.partial(default_cell, p))
                                for names, p in cases])
    return {"rows": [[*names, verdict] for (names, _), verdict in zip(cases, verdicts)]}


def default_cell(provocation):
    return judges.judge(provocation, methods.DEFAULT, methods.run(provocation, methods.DEFAULT))


def recovered(seed, keys):
    return default_cell(provocations.scrambled(seed, keys))


OTHERS = {"scramble": scramble, "locking": locking}
NAMES = [*columns(), *OTHERS]


def run(name, each):
    return OTHERS[name](each) if name in OTHERS else cells(name, each)
