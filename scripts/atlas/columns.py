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


NAMES = list(columns())


def run(name, each):
    return cells(name, each)
