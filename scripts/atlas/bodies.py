"""Bars of tetrahedra, whole and spoilt: points (n x 3, m) and elements (m x 4, from 0), and files of them."""
import importlib.machinery
import importlib.util
import itertools
import os

import numpy as np

from tools import REPOSITORY

SIZE = np.array([0.4, 0.4, 1.0])  # m, of the bar
CELLS = (2, 2, 5)


def _make_bar():
    path = os.path.join(REPOSITORY, "scripts", "make_bar")
    loader = importlib.machinery.SourceFileLoader("make_bar", path)
    module = importlib.util.module_from_spec(importlib.util.spec_from_loader("make_bar", loader))
    loader.exec_module(module)
    return module


make_bar = _make_bar()


def bar(cells=CELLS, size=SIZE):
    points, tets = make_bar.bar(cells, size)
    return np.array(points), np.array(tets) - 1


def graded(cells):
    """The bar with smaller elements towards its four long sides and the wall, where the stress has no limit."""
    points, tets = bar(cells)
    part = points / SIZE
    inward = np.minimum(part[:, :2], 1 - part[:, :2])
    part[:, :2] = np.where(part[:, :2] < 0.5, 2 * inward ** 2, 1 - 2 * inward ** 2)
    part[:, 2] **= 2
    return part * SIZE, tets


def volumes(points, tets):
    edges = points[tets[:, 1:]] - points[tets[:, :1]]
    return np.linalg.det(edges) / 6


def upright(points, tets):
    """The same elements with the right hand's order of corners."""
    tets = tets.copy()
    wrong = volumes(points, tets) < 0
    tets[wrong, 2:] = tets[wrong, :1:-1]
    return tets


def dihedral_angles(points, tets):
    """Degrees, six an element."""
    angles = []
    for a, b in itertools.combinations(range(4), 2):
        c, d = (k for k in range(4) if k not in (a, b))
        p, q, r, s = (points[tets[:, k]] for k in (a, b, c, d))
        along = (q - p) / np.linalg.norm(q - p, axis=1)[:, None]
        sides = [v - (v * along).sum(axis=1)[:, None] * along for v in (r - p, s - p)]
        cosine = (sides[0] * sides[1]).sum(axis=1) / np.prod([np.linalg.norm(v, axis=1) for v in sides], axis=0)
        sine = np.linalg.norm(np.cross(*sides), axis=1) / np.prod([np.linalg.norm(v, axis=1) for v in sides], axis=0)
        angles.append(np.degrees(np.arctan2(sine, cosine)))
    return np.array(angles)


def slivers(angle, every=2):
    """Every second element of the bar gets a corner over the middle of a face, so that the element between the two has
    no dihedral angle above `angle` degrees at that face and one of just so many."""
    points, tets = bar()
    points, kept = list(points), []
    for number, tet in enumerate(tets):
        if number % every:
            kept.append(tet)
            continue
        base, top = tet[:3], tet[3]
        corners = np.array([points[k] for k in base])
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        twice_area = np.linalg.norm(normal)
        normal *= np.sign(normal @ (points[top] - corners[0])) / twice_area
        sides = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
        # The centre of the inscribed circle is equally far from the three edges.
        centre = (np.roll(sides, -1)[:, None] * corners).sum(axis=0) / sides.sum()
        radius = twice_area / sides.sum()
        points.append(centre + radius * np.tan(np.radians(angle)) * normal)
        new = len(points) - 1
        kept.append([*base, new])
        kept += [[base[i], base[j], new, top] for i, j in ((0, 1), (1, 2), (2, 0))]
    points, tets = np.array(points), np.array(kept)
    return points, upright(points, tets)


def refined_at_a_corner(levels):
    """The bar with its elements at the corner (0.4, 0, 1) cut in two towards it again and again: sizes 2^levels
    apart, of one shape each time."""
    points, tets = bar()
    points, tets = list(points), [list(tet) for tet in tets]
    corner = int(np.argmin(np.linalg.norm(np.array(points) - [0.4, 0, 1], axis=1)))
    for _ in range(levels):
        middle, left = {}, []
        for tet in tets:
            if corner not in tet:
                left.append(tet)
                continue
            far = sorted(k for k in tet if k != corner)
            for k in far:
                if k not in middle:
                    points.append((points[corner] + points[k]) / 2)
                    middle[k] = len(points) - 1
            a, b, c = far
            # The prism between the triangle far from the corner and its half-way image, by the order of numbers, so
            # that neighbours agree.
            left += [[corner, middle[a], middle[b], middle[c]], [a, b, c, middle[c]], [a, b, middle[b], middle[c]],
                     [a, middle[a], middle[b], middle[c]]]
        tets = left
    points, tets = np.array(points), np.array(tets)
    return points, upright(points, tets)


def write_msh(path, points, tets):
    with open(path, "w", encoding="ascii") as out:
        make_bar.write(out, points.tolist(), (tets + 1).tolist())


def write_vtk(path, points, tets, kind):
    """Legacy VTK; `kind` is float or double, and coordinates are rounded to it."""
    points = np.asarray(points, {"float": np.float32, "double": np.float64}[kind]).astype(float)
    with open(path, "w", encoding="ascii") as out:
        out.write("# vtk DataFile Version 3.0\na bar\nASCII\nDATASET UNSTRUCTURED_GRID\n")
        out.write(f"POINTS {len(points)} {kind}\n")
        out.writelines(" ".join(map(repr, point)) + "\n" for point in points.tolist())
        out.write(f"CELLS {len(tets)} {5 * len(tets)}\n")
        out.writelines("4 " + " ".join(map(str, tet)) + "\n" for tet in tets.tolist())
        out.write(f"CELL_TYPES {len(tets)}\n" + "10\n" * len(tets))
