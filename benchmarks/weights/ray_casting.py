# SPDX-License-Identifier: MIT
"""Ray casting for simulated scans where open3d is not installed: a bounding volume hierarchy.

`RayScene` takes the place of `synthesis.lidar.Scene` and returns the same hits, about as
fast. Only numba and numpy are needed.
"""

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.compiled import compiled
from salsanext_cli.synthesis.lidar import Scene
from salsanext_cli.synthesis.mesh import Array, Mesh

BINS = 16  # Candidates of a split along each axis
LEAF_TRIANGLES = 4
MAX_DEPTH = 60  # A node so deep is a leaf, whatever it holds
MISSED = np.uint32(0xFFFFFFFF)  # Triangle of a ray that hits nothing


class RayScene(Scene):
    """Triangles that rays can hit, in a tree of boxes."""

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh
        corners = mesh.vertices.astype(np.float32)[mesh.triangles]  # (T, 3, 3), metres
        order = np.arange(len(corners))
        boxes = np.empty((2 * len(corners), 6), np.float32)
        links = np.zeros((2 * len(corners), 2), np.int32)
        count = build(corners.min(1), corners.max(1), order, boxes, links)
        self._order, self._boxes, self._links = order, boxes[:count].copy(), links[:count].copy()
        self._corners = corners[order]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self._normals = normals / np.maximum(np.linalg.norm(normals, axis=1), 1e-12)[:, None]

    def cast(self, rays: Array) -> tuple[Array, npt.NDArray[np.uint32], Array]:
        """Return distance (inf where nothing is hit), triangle and |cos| of incidence per ray."""
        distance = np.full(len(rays), np.inf)
        triangle = np.full(len(rays), MISSED, np.uint32)
        cast(rays.astype(np.float64), self._corners, self._boxes, self._links, distance, triangle)
        hit = triangle != MISSED
        triangle[hit] = self._order[triangle[hit]]
        cosine = np.zeros(len(rays))
        cosine[hit] = np.abs((self._normals[triangle[hit]] * rays[hit, 3:]).sum(1))
        return distance, triangle, cosine


@compiled
def build(
    low: npt.NDArray[np.float32],
    high: npt.NDArray[np.float32],
    order: npt.NDArray[np.int64],
    boxes: npt.NDArray[np.float32],
    links: npt.NDArray[np.int32],
) -> int:
    """Divide the boxes (T, 3) of triangles where the surface area heuristic is least.

    Fills the boxes (N, 6) of the nodes, lower and upper corner, and their links (N, 2): the first
    of two children and 0, or the first triangle in `order` and their number. Returns N.
    """
    waiting = np.empty((2 * MAX_DEPTH + 8, 4), np.int64)  # node, first, end, depth
    waiting[0] = (0, 0, len(order), 0)
    top, nodes = 1, 1
    while top:
        top -= 1
        node, first, end, depth = waiting[top]
        for axis in range(3):
            lower, upper = np.float32(np.inf), np.float32(-np.inf)
            for place in range(first, end):
                lower = min(lower, low[order[place], axis])
                upper = max(upper, high[order[place], axis])
            boxes[node, axis], boxes[node, 3 + axis] = lower, upper
        links[node] = (first, end - first)
        if end - first <= LEAF_TRIANGLES or depth == MAX_DEPTH:
            continue
        axis, border = best_split(low, high, order[first:end])
        middle = first
        for place in range(first, end):
            each = order[place]
            if low[each, axis] + high[each, axis] < border:
                order[place], order[middle] = order[middle], each
                middle += 1
        if middle in (first, end):  # All centres are the same, but for rounding
            continue
        links[node] = (nodes, 0)
        waiting[top] = (nodes, first, middle, depth + 1)
        waiting[top + 1] = (nodes + 1, middle, end, depth + 1)
        top += 2
        nodes += 2
    return nodes


@compiled
def best_split(
    low: npt.NDArray[np.float32], high: npt.NDArray[np.float32], part: npt.NDArray[np.int64]
) -> tuple[int, float]:
    """Return the axis along which some triangles lie farthest apart, and the best border there.

    The border is one of double centres, the lowest if all are the same.
    """
    starts, stops = np.full(3, np.inf), np.full(3, -np.inf)
    for each in part:
        for side in range(3):
            centre = np.float64(low[each, side] + high[each, side])
            starts[side], stops[side] = min(starts[side], centre), max(stops[side], centre)
    axis = int(np.argmax(stops - starts))
    start, width = starts[axis], (stops[axis] - starts[axis]) / BINS
    if not width > 1e-9:
        return axis, start
    counts = np.zeros(BINS, np.int64)
    corners = np.empty((BINS, 6))
    corners[:, :3], corners[:, 3:] = np.inf, -np.inf
    for each in part:
        centre = np.float64(low[each, axis] + high[each, axis])
        cell = min(BINS - 1, int((centre - start) / width))
        counts[cell] += 1
        for side in range(3):
            corners[cell, side] = min(corners[cell, side], low[each, side])
            corners[cell, 3 + side] = max(corners[cell, 3 + side], high[each, side])
    best, border = np.inf, start + width * (BINS // 2)
    costs, box = np.empty(BINS), np.empty(6)
    # Costs of all cells up to a border, then of those behind it.
    for direction in (1, -1):
        total = 0
        box[:3], box[3:] = np.inf, -np.inf
        for step in range(BINS - 1):
            cell = step if direction == 1 else BINS - 1 - step
            total += counts[cell]
            for side in range(3):
                box[side] = min(box[side], corners[cell, side])
                box[3 + side] = max(box[3 + side], corners[cell, 3 + side])
            x, y, z = box[3] - box[0], box[4] - box[1], box[5] - box[2]
            cost = total * (x * y + y * z + z * x) if total else np.inf
            if direction == 1:
                costs[cell] = cost
            elif costs[cell - 1] + cost < best:
                best, border = costs[cell - 1] + cost, start + cell * width
    return axis, border


@compiled
def cast(
    rays: npt.NDArray[np.float64],
    corners: npt.NDArray[np.float32],
    boxes: npt.NDArray[np.float32],
    links: npt.NDArray[np.int32],
    distance: npt.NDArray[np.float64],
    triangle: npt.NDArray[np.uint32],
) -> None:
    """Fill in the nearest hit of each ray (R, 6): its distance and triangle in the tree's order."""
    waiting = np.empty(2 * MAX_DEPTH + 8, np.int64)
    for number in range(len(rays)):
        ray = rays[number]
        inverse = np.empty(3)
        for axis in range(3):
            slope = ray[3 + axis]
            inverse[axis] = 1 / slope if abs(slope) > 1e-12 else 1e12
        waiting[0], top = 0, 1
        while top:
            top -= 1
            node = waiting[top]
            if entry(ray, inverse, boxes[node]) >= distance[number]:
                continue
            first, count = links[node, 0], links[node, 1]
            for place in range(first, first + count):
                reached = hit(ray, corners[place])
                if reached < distance[number]:
                    distance[number], triangle[number] = reached, place
            if count == 0:
                one, other = first, first + 1
                if entry(ray, inverse, boxes[one]) < entry(ray, inverse, boxes[other]):
                    one, other = other, one
                waiting[top], waiting[top + 1] = one, other  # The nearer one comes next
                top += 2


@compiled
def entry(
    ray: npt.NDArray[np.float64], inverse: npt.NDArray[np.float64], box: npt.NDArray[np.float32]
) -> float:
    """Return the distance at which a ray enters a box, inf if it does not."""
    start, stop = 0.0, np.inf
    for axis in range(3):
        one = (box[axis] - ray[axis]) * inverse[axis]
        other = (box[3 + axis] - ray[axis]) * inverse[axis]
        start = max(start, min(one, other))
        stop = min(stop, max(one, other))
    return start if start <= stop * (1 + 1e-9) else np.inf


@compiled
def hit(ray: npt.NDArray[np.float64], corners: npt.NDArray[np.float32]) -> float:
    """Return the distance at which a ray hits a triangle, inf if it does not.

    Möller and Trumbore, "Fast, minimum storage ray/triangle intersection" (1997).
    """
    x, y, z = np.float64(corners[0, 0]), np.float64(corners[0, 1]), np.float64(corners[0, 2])
    ux, uy, uz = corners[1, 0] - x, corners[1, 1] - y, corners[1, 2] - z
    vx, vy, vz = corners[2, 0] - x, corners[2, 1] - y, corners[2, 2] - z
    ax, ay, az = ray[0] - x, ray[1] - y, ray[2] - z  # From the first corner to the origin
    dx, dy, dz = ray[3], ray[4], ray[5]
    px, py, pz = dy * vz - dz * vy, dz * vx - dx * vz, dx * vy - dy * vx
    determinant = ux * px + uy * py + uz * pz
    if abs(determinant) < 1e-12:  # Parallel, or a triangle without an area
        return np.inf
    u = (ax * px + ay * py + az * pz) / determinant
    if u < 0 or u > 1:
        return np.inf
    qx, qy, qz = ay * uz - az * uy, az * ux - ax * uz, ax * uy - ay * ux
    v = (dx * qx + dy * qy + dz * qz) / determinant
    if v < 0 or u + v > 1:
        return np.inf
    reached = (vx * qx + vy * qy + vz * qz) / determinant
    return reached if reached > 0 else np.inf
