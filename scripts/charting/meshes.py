"""
Meshes of one and the same body: what is held and what is loaded is settled on the scene's own mesh, and stays that part
of the body however finely it is cut. Meshes of other cell sizes are other bodies, because CGAL rounds a surface
differently and a box selects other corners.
"""
import copy
import importlib.machinery
import importlib.util
import itertools
import os

import numpy as np
import yaml

from tools import REPOSITORY, Failed

EDGES = np.array(list(itertools.combinations(range(4), 2)))
SIDES = np.array([[k for k in range(4) if k != opposite] for opposite in range(4)])  # corners of the face opposite


def kuhn(parts):
    """
    A tetrahedron cut into parts^3 of at most three shapes (Edelsbrunner and Grayson, Edgewise subdivision of a simplex,
    2000): the lattice of Kuhn's simplex parts >= x >= y >= z >= 0, its cubes walked in all six ways. Returns the
    places as weights of the four corners (p x 4, they sum to `parts`), and the tetrahedra (parts^3 x 4).
    """
    lattice = [(x, y, z) for x in range(parts + 1) for y in range(x + 1) for z in range(y + 1)]
    number = {place: k for k, place in enumerate(lattice)}
    tets = []
    for place in lattice:
        for axes in itertools.permutations(range(3)):
            walk, here = [place], list(place)
            for axis in axes:
                here[axis] += 1
                walk.append(tuple(here))
            if all(step in number for step in walk):
                tets.append([number[step] for step in walk])
    x, y, z = np.array(lattice).T
    return np.stack([parts - x, x - y, y - z, z], axis=1), np.array(tets)


class Body:
    """
    Tetrahedra and the parts of them that the scene names.
    points  n x 3, m
    tets    m x 4, of positive volume
    faces   name: m x 4, whether the face opposite to a corner belongs to the part. A support or a load needs faces: on
            an edge or a point alone the displacement has no limit when the mesh becomes finer.
    blocks  name: m, whether a tetrahedron belongs to the part
    """

    def __init__(self, points, tets, faces, blocks):
        self.points, self.tets, self.faces, self.blocks = points, tets, faces, blocks

    def corners(self, name):
        """Which points lie on the faces of a part."""
        result = np.zeros(len(self.points), bool)
        for opposite in range(4):
            result[self.tets[self.faces[name][:, opposite]][:, SIDES[opposite]]] = True
        return result

    def subdivided(self, parts):
        """Every tetrahedron cut into parts^3."""
        weights, small = kuhn(parts)
        # The order of the corners decides how a face is cut: by increasing index it is the same on both of its sides.
        order = np.argsort(self.tets, axis=1)
        corners = np.take_along_axis(self.tets, order, axis=1)
        # A place of the mesh is its corners with their weights, the same seen from all tetrahedra around it.
        codes = np.where(weights > 0, corners[:, None, :] * (parts + 1) + weights, -1)
        places, index = np.unique(np.sort(codes.reshape(-1, 4), axis=1), axis=0, return_inverse=True)
        used = places >= 0
        shares = np.where(used, places % (parts + 1), 0) / parts
        points = np.einsum("nk,nkx->nx", shares, self.points[np.where(used, places // (parts + 1), 0)])
        tets = index.reshape(len(corners), -1)[:, small].reshape(-1, 4)

        faces = {}
        for name, flags in self.faces.items():
            flags = np.take_along_axis(flags, order, axis=1)
            cut = np.broadcast_to(flags.all(axis=1)[:, None, None], (len(flags), len(small), 4)).copy()
            for opposite in range(4):
                on = (weights[small][:, SIDES[opposite]] == 0).all(axis=1)  # small tets x faces of the large one
                cut[:, :, opposite] |= (flags[:, None, :] & on).any(axis=2)
            faces[name] = cut.reshape(-1, 4)
        turned = np.linalg.det(points[tets[:, 1:]] - points[tets[:, :1]]) < 0
        for array in (tets, *faces.values()):
            array[turned, 2:] = array[turned, :1:-1]
        return Body(points, tets, faces, {name: np.repeat(part, len(small)) for name, part in self.blocks.items()})

    def near_rims(self, names):
        """Which tetrahedra touch the rim of a held part, where a held face of the boundary meets a free one."""
        all_faces = np.sort(self.tets[:, SIDES].reshape(-1, 3), axis=1)
        _, first, count = np.unique(all_faces, axis=0, return_index=True, return_counts=True)
        boundary = first[count == 1]
        held = np.zeros(4 * len(self.tets), bool)
        for name in names:
            held |= self.faces[name].ravel()
        ends = {}
        for kind in (True, False):
            faces = all_faces[boundary[held[boundary] == kind]]
            edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [0, 2]]])
            ends[kind] = np.unique(edges[:, 0] * len(self.points) + edges[:, 1])
        rim = np.intersect1d(ends[True], ends[False])
        on_rim = np.zeros(len(self.points), bool)
        on_rim[np.concatenate([rim // len(self.points), rim % len(self.points)])] = True
        return on_rim[self.tets].any(axis=1)

    def bisected(self, chosen):
        """The chosen tetrahedra halved at their longest edges, and others where that is needed to meet face to face
        (Rivara, Algorithms for refining triangular grids, 1984; in space Rivara and Levin 1992)."""
        points, tets, faces, blocks = list(self.points), self.tets, dict(self.faces), dict(self.blocks)
        middles = {}  # edge: its middle
        wanted = np.array([], np.int64)
        many = 1 << 31
        first = chosen
        while True:
            at = np.array(points)
            ends = np.sort(tets[:, EDGES], axis=2)
            codes = ends[..., 0] * many + ends[..., 1]
            squares = ((at[ends[..., 0]] - at[ends[..., 1]])**2).sum(axis=2)
            # Equal lengths are told apart by their ends, so that all tetrahedra around an edge agree.
            edges, back = np.unique(codes, return_inverse=True)
            length = np.zeros(len(edges))
            length[back] = squares.ravel()
            rank = np.empty(len(edges), int)
            rank[np.lexsort((edges, np.round(length / length.max(), 12)))] = np.arange(len(edges))
            longest = rank[back].reshape(codes.shape).argmax(axis=1)
            own = np.take_along_axis(codes, longest[:, None], axis=1)[:, 0]
            if first is not None:
                wanted = np.union1d(wanted, own[first])
                first = None
            while True:
                hit = np.isin(codes, wanted).any(axis=1)
                more = np.union1d(wanted, own[hit])
                if len(more) == len(wanted):
                    break
                wanted = more
            if not hit.any():
                return Body(at, tets, faces, blocks)
            for code in np.unique(own[hit]):
                if code not in middles:
                    middles[code] = len(points)
                    points.append((at[code // many] + at[code % many]) / 2)
            middle = np.array([middles[code] for code in own[hit]])
            i, j = EDGES[longest[hit]].T
            row = np.arange(len(middle))
            lower, upper = tets[hit].copy(), tets[hit].copy()
            lower[row, j], upper[row, i] = middle, middle
            tets = np.concatenate([tets[~hit], lower, upper])
            for name, flags in faces.items():
                low, high = flags[hit].copy(), flags[hit].copy()
                whole = flags[hit].all(axis=1)
                low[row, i], high[row, j] = whole, whole  # the new face between the halves
                faces[name] = np.concatenate([flags[~hit], low, high])
            for name, part in blocks.items():
                blocks[name] = np.concatenate([part[~hit], part[hit], part[hit]])

    def graded(self, halvings):
        """Edges at the rims of what is held halved so often, where the stress has no limit."""
        body = self
        for _ in range(3 * halvings):
            body = body.bisected(body.near_rims([name for name in self.faces if name.startswith("fixed")]))
        return body

    def write(self, path):
        """Gmsh 2.2: the points of a part's faces, and its tetrahedra, as physical groups."""
        tags = {name: tag for tag, name in enumerate([*self.faces, *self.blocks], 1)}
        rows = [f"15 2 {tags[name]} 1 {corner + 1}" for name in self.faces
                for corner in np.flatnonzero(self.corners(name))]
        ids = list(range(1, len(rows) + 1))
        members = [[tags[name] for name in self.blocks if self.blocks[name][k]] or [0] for k in range(len(self.tets))]
        for number, (corners, groups) in enumerate(zip(self.tets + 1, members), len(rows) + 1):
            for tag in groups:  # an element of several groups is written once for each
                rows.append(f"4 2 {tag} 1 {corners[0]} {corners[1]} {corners[2]} {corners[3]}")
                ids.append(number)
        with open(path, "w", encoding="ascii") as out:
            out.write(f"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n{len(tags)}\n")
            out.writelines(f'{0 if name in self.faces else 3} {tag} "{name}"\n' for name, tag in tags.items())
            out.write(f"$EndPhysicalNames\n$Nodes\n{len(self.points)}\n")
            out.writelines(f"{number} {x:.17g} {y:.17g} {z:.17g}\n" for number, (x, y, z) in enumerate(self.points, 1))
            out.write(f"$EndNodes\n$Elements\n{len(rows)}\n")
            out.writelines(f"{number} {row}\n" for number, row in zip(ids, rows))
            out.write("$EndElements\n")


def gradient_jumps(points, displacements, tets):
    """
    How uneven the displacement's gradient is: for each quadratic tetrahedron (m x 10, VTK's order) its volume times the
    mean square distance of its gradients at the corners from the mean of all tetrahedra there (after Zienkiewicz and
    Zhu 1987). Large where the mesh is too coarse.
    """
    corners = tets[:, :4]
    inverse = np.linalg.inv(points[corners[:, 1:]] - points[corners[:, :1]])
    slopes = np.concatenate([-inverse.sum(axis=2, keepdims=True), inverse], axis=2).transpose(0, 2, 1)  # of lambda_a
    volumes = 1 / np.abs(np.linalg.det(inverse)) / 6
    middle = {pair: 4 + k for k, pair in enumerate([(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)])}
    u = displacements[tets]
    gradients = np.zeros((len(tets), 4, 3, 3))
    for c in range(4):
        for a in range(4):
            gradients[:, c] += (3 if a == c else -1) * np.einsum("mi,mj->mij", u[:, a], slopes[:, a])
            if a != c:
                edge = middle[min(a, c), max(a, c)]
                gradients[:, c] += 4 * np.einsum("mi,mj->mij", u[:, edge], slopes[:, a])
    mean, weight = np.zeros((len(points), 3, 3)), np.zeros(len(points))
    for c in range(4):
        np.add.at(mean, corners[:, c], gradients[:, c] * volumes[:, None, None])
        np.add.at(weight, corners[:, c], volumes)
    mean /= np.maximum(weight, 1e-300)[:, None, None]
    return volumes * ((gradients - mean[corners])**2).sum(axis=(2, 3)).mean(axis=1)


def worst(jumps, share):
    """Which tetrahedra, the worst first, make up this share of the whole."""
    order = np.argsort(-jumps)
    count = np.searchsorted(np.cumsum(jumps[order]), share * jumps.sum()) + 1
    chosen = np.zeros(len(jumps), bool)
    chosen[order[:count]] = True
    return chosen


def inside(region, points, key):
    """Which points a region's box or sphere holds."""
    if "box" in region:
        low, high = (np.array(region["box"][end], float) for end in ("min", "max"))
        return np.all((points >= low) & (points <= high), axis=1)
    if "sphere" in region:
        center = np.array(region["sphere"]["center"], float)
        return np.linalg.norm(points - center, axis=1) <= float(region["sphere"]["radius"])
    raise Failed(f"{key}: selects by group or by nodes, must be a box or a sphere for the chart")


def read_scene(path):
    """The scene as a tree; paths made absolute, the fine surface left out."""
    with open(path, encoding="utf-8") as file:
        scene = yaml.safe_load(file)
    if "positions" in scene.get("initial", {}):
        raise Failed(f"{path}: initial.positions: names nodes, which the chart's finer meshes do not have")
    for region in scene.get("fixed", []):
        if "motion" in region:
            region["motion"] = os.path.join(os.path.dirname(os.path.abspath(path)), region["motion"])
    scene.pop("surface", None)
    return scene


def of_bar(cells):
    """Points and tetrahedra of the bar of scripts/make_bar."""
    path = os.path.join(REPOSITORY, "scripts", "make_bar")
    loader = importlib.machinery.SourceFileLoader("make_bar", path)
    module = importlib.util.module_from_spec(importlib.util.spec_from_loader("make_bar", loader))
    loader.exec_module(module)
    points, tets = module.bar(cells, (0.4, 0.4, 1.0))
    return np.array(points), np.array(tets) - 1


def regions(scene):
    """What the scene selects: (group, its key, the region's tree)."""
    for kind in ("fixed", "loads"):
        for k, region in enumerate(scene.get(kind, [])):
            yield f"{kind}_{k}", f"{kind}[{k}]", region
    for k, region in enumerate(scene["material"].get("regions", [])):
        yield f"material_{k}", f"material.regions[{k}]", region


def settle(scene, points, tets):
    """The body with the parts that the scene's boxes and spheres select on this mesh."""
    body = Body(points, tets, {}, {})
    for group, key, region in regions(scene):
        if group.startswith("material"):
            body.blocks[group] = inside(region, points[tets].mean(axis=1), key)
            continue
        chosen = inside(region, points, key)[tets]
        body.faces[group] = np.stack([chosen[:, side].all(axis=1) for side in SIDES], axis=1)
        if not body.faces[group].any():
            raise Failed(f"{key}: holds no whole face of an element, must for the chart")
    return body


def by_groups(scene):
    """The scene with its regions named as groups of the mesh, as Body.write() writes them."""
    scene = copy.deepcopy(scene)
    for group, _, region in regions(scene):
        region.pop("box", None)
        region.pop("sphere", None)
        region["group"] = group
    return scene
