"""Drawings of bodies: shaded, depth-sorted triangles seen in parallel projection, z (or `up`) upwards."""
import base64
import xml.etree.ElementTree

import matplotlib

matplotlib.use("Agg")
from matplotlib import cm, collections, colors, pyplot  # noqa: E402  (the backend comes first)
import numpy as np  # noqa: E402

CLAY = (0.80, 0.62, 0.46)
INSIDE = (0.36, 0.50, 0.70)  # a surface seen from its inner side: the body is inside out there
PAIR = {"linear": "tab:orange", "quadratic": "tab:blue"}

pyplot.rcParams.update({"font.size": 9, "axes.grid": True, "grid.alpha": 0.3, "axes.spines.top": False,
                        "axes.spines.right": False, "figure.dpi": 110, "savefig.bbox": "tight"})


def read_ply(path):
    """Points, normals and triangles of a .ply as run_scene writes it."""
    with open(path, "rb") as file:
        header, data = file.read().split(b"end_header\n", 1)
    points, faces = (int(header.split(b"element " + name + b" ")[1].split()[0]) for name in (b"vertex", b"face"))
    vertices = np.frombuffer(data, "<f4", 6 * points).reshape(-1, 6).astype(float)
    triangles = np.frombuffer(data, [("count", "u1"), ("corners", "<i4", 3)], faces, 24 * points)["corners"]
    return vertices[:, :3], vertices[:, 3:], triangles


def read_vtu(path):
    """The arrays of a .vtu as run_scene writes it, by name; elements as rows of `connectivity`."""
    kinds = {"Float64": "<f8", "Int64": "<i8", "UInt8": "u1"}
    arrays = {}
    for array in xml.etree.ElementTree.parse(path).iter("DataArray"):
        values = np.frombuffer(base64.b64decode(array.text)[8:], kinds[array.get("type")])
        width = int(array.get("NumberOfComponents"))
        arrays[array.get("Name")] = values.reshape(-1, width) if width > 1 else values
    arrays["connectivity"] = arrays["connectivity"].reshape(len(arrays["types"]), -1)
    return arrays


class Camera:
    """Parallel projection. Angles in degrees: `azimuth` about the upward axis from x, `elevation` above the ground."""

    def __init__(self, azimuth, elevation, up=(0, 0, 1)):
        up = np.array(up, float)
        front = np.array([up[1], up[2], up[0]])  # a right-handed frame: front, left, up
        left = np.cross(up, front)
        azimuth, elevation = np.radians([azimuth, elevation])
        level = np.cos(azimuth) * front + np.sin(azimuth) * left
        self.to_eye = np.cos(elevation) * level + np.sin(elevation) * up
        self.right = np.cross(up, level)
        self.up = np.cross(self.to_eye, self.right)
        light = self.to_eye + 0.5 * self.up - 0.6 * self.right
        self.light = light / np.linalg.norm(light)

    def project(self, points):
        return np.stack([points @ self.right, points @ self.up], axis=-1)

    def depth(self, points):
        return points @ self.to_eye

    def shade(self, base, normals, ambient):
        """Lambert from a light at the upper left, a little of it from below, and a highlight."""
        halfway = self.light + self.to_eye
        shine = np.clip(normals @ (halfway / np.linalg.norm(halfway)), 0, 1) ** 25
        lit = np.clip(normals @ self.light, 0, 1) + 0.15 * np.clip(-normals @ self.light, 0, 1)
        return np.clip(base * (ambient + (1 - ambient) * lit)[:, None] + 0.2 * (1 - ambient) * shine[:, None], 0, 1)


def draw_polygons(axes, camera, triangles, base, normals, segments=(), segment_depths=(), ambient=0.38):
    """Triangles (n x 3 x 3) in colours (n x 3), and line segments (m x 2 x 3), the farthest first."""
    inner = unit(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])) @ camera.to_eye < 0
    towards = np.where(inner & (normals @ camera.to_eye < 0), -1, 1)
    faces = camera.shade(np.where(inner[:, None], INSIDE, base), normals * towards[:, None], ambient)
    depths = camera.depth(triangles.mean(axis=1))
    shapes, face_colors = list(camera.project(triangles)), list(faces)
    edge_colors, widths = list(faces), [0.25] * len(shapes)
    if len(segments):
        shapes += list(camera.project(segments))
        face_colors += [(0, 0, 0)] * len(segments)
        edge_colors += [(0.15, 0.15, 0.15)] * len(segments)
        widths += [0.5] * len(segments)
        depths = np.concatenate([depths, segment_depths])
    order = np.argsort(depths, kind="stable")
    pick = lambda values: [values[k] for k in order]  # noqa: E731
    axes.add_collection(collections.PolyCollection(pick(shapes), facecolors=pick(face_colors),
                                                   edgecolors=pick(edge_colors), linewidths=pick(widths)))
    axes.set_aspect("equal")
    axes.axis("off")


def unit(vectors):
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-30)


def draw_surface(axes, camera, points, normals, triangles, color=CLAY):
    """A fine surface, shaded by the mean of its corners' normals."""
    draw_polygons(axes, camera, points[triangles], np.broadcast_to(color, (len(triangles), 3)),
                  unit(normals[triangles].mean(axis=1)))


def draw_elements(axes, camera, vtu, values=None, norm=None, cmap="viridis", pieces=6):
    """
    The boundary of quadratic or linear tetrahedra, its curved faces cut into pieces^2 triangles, with the elements'
    edges; coloured by nodal `values`, or clay.
    """
    now = vtu["Points"] + vtu["displacement"]
    tets = vtu["connectivity"]
    faces = {}
    middle = {pair: 4 + k for k, pair in enumerate([(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)])}  # VTK's order
    for tet in tets:
        for a, b, c in ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)):  # counter-clockwise from outside
            nodes = [tet[a], tet[b], tet[c]]
            if len(tet) > 4:
                nodes += [tet[middle[tuple(sorted(pair))]] for pair in ((a, b), (b, c), (c, a))]
            key = tuple(sorted(nodes[:3]))
            faces[key] = None if key in faces else nodes
    faces = np.array([nodes for nodes in faces.values() if nodes is not None])

    # Weights of the nodes of a face at the corners of the pieces it is cut into.
    grid = [(i, j) for i in range(pieces + 1) for j in range(pieces + 1 - i)]
    index = {ij: k for k, ij in enumerate(grid)}
    a, b = (np.array(grid).T / pieces)
    c = 1 - a - b
    weights = np.stack([a, b, c] if faces.shape[1] == 3 else
                       [a * (2 * a - 1), b * (2 * b - 1), c * (2 * c - 1), 4 * a * b, 4 * b * c, 4 * c * a], axis=1)
    small = [(index[i, j], index[i + 1, j], index[i, j + 1]) for i, j in grid if i + j < pieces]
    small += [(index[i + 1, j], index[i + 1, j + 1], index[i, j + 1]) for i, j in grid if i + j < pieces - 1]
    small = np.array(small)[:, [1, 2, 0]]
    rims = [(index[i, 0], index[i + 1, 0]) for i in range(pieces)]
    rims += [(index[0, j], index[0, j + 1]) for j in range(pieces)]
    rims += [(index[i, pieces - i], index[i + 1, pieces - i - 1]) for i in range(pieces)]
    rims = np.array(rims)

    points = np.einsum("kn,fnx->fkx", weights, now[faces])
    triangles = points[:, small].reshape(-1, 3, 3)
    normals = unit(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]))
    if values is None:
        base = np.broadcast_to(CLAY, (len(triangles), 3))
    else:
        at = np.einsum("kn,fn->fk", weights, values[faces])[:, small].mean(axis=2).ravel()
        base = pyplot.get_cmap(cmap)(norm(at))[:, :3]
    segments = points[:, rims].reshape(-1, 2, 3)
    nudge = 0.5 * np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1).mean()
    draw_polygons(axes, camera, triangles, base, normals, segments, camera.depth(segments.mean(axis=1)) + nudge,
                  ambient=0.38 if values is None else 0.7)


def same_window(all_axes, camera, clouds, margin=0.03):
    """The same window for several pictures: around all points."""
    flat = camera.project(np.concatenate(clouds))
    low, high = flat.min(axis=0), flat.max(axis=0)
    pad = margin * (high - low).max()
    for axes in all_axes:
        axes.set_xlim(low[0] - pad, high[0] + pad)
        axes.set_ylim(low[1] - pad, high[1] + pad)


def colour_bar(figure, axes, norm, label, cmap="viridis"):
    figure.colorbar(cm.ScalarMappable(norm, cmap), ax=axes, label=label, shrink=0.8)


def scale(low, high):
    return colors.Normalize(low, high)
