# SPDX-License-Identifier: MIT
"""Objects of a scan: connected components of the range image, and boxes around them.

Pixels of one class are connected where the line between their points meets the beam of the farther
one at more than an angle (Bogoslavskyi & Stachniss, IROS 2016): along a surface it does, from one
thing to another behind it hardly. Near points are connected at any angle. The image goes on around
in azimuth, and gaps of some pixels are bridged. A box is the rectangle, upright in the frame of the
points, to whose sides they are closest (L-shape fit: Zhang, Xu, Dong, Dolan, IV 2017).
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes.label_space import TrainIds
from salsanext_cli.compiled import argument, compiled
from salsanext_cli.geometry.projection import pixels_from_points
from salsanext_cli.records import Float, Int, RangeImage

COLUMNS, ROWS = 6, 4
"""Pixels to the right and below that may be neighbours: those between have returned nothing."""
LARGEST_COSINE = np.float32(np.cos(np.radians(8.0)))
"""Of the angle between beam and line above which points are connected."""
NEAR_M, FAR_M = np.float32(0.4), np.float32(1.5)
"""Distances below which points are connected at any angle, and above which at none."""
SAME_M = np.float32(1.0)
"""Largest difference in range of a point to the pixel of its class whose object it joins."""
MIN_POINTS = 10
"""Fewest points of an object."""
MOST = np.iinfo(np.uint16).max
"""Most objects of a scan."""
ANGLES_RAD = np.radians(np.arange(0.0, 90.0, 1.0)).astype(np.float32)
"""Directions of the sides of a box that are tried."""
COSINES, SINES = np.cos(ANGLES_RAD), np.sin(ANGLES_RAD)
NEAREST_M = np.float32(0.05)
"""Distance from a side below which points are equally close to it."""
MAX_FITTED = 300
"""Points of an object that the direction of its box is fitted to, evenly spaced."""


class Box(NamedTuple):
    """Upright box around an object, in metres and radians, in the frame of the points."""

    x: float  # Centre
    y: float
    z: float
    length: float  # Of the longer side, which lies at `yaw` from x, −π/2 to π/2
    width: float
    height: float
    yaw: float


def find_objects(
    image: RangeImage, labels: TrainIds, things: npt.NDArray[np.bool_]
) -> npt.NDArray[np.uint16]:
    """Return the number of the object of each point.

    Parameters
    ----------
    image : RangeImage
        The scan's projection.
    labels : (N,) uint8
        Train ids of the points.
    things : (C,) bool
        Classes that consist of objects.

    Returns
    -------
    (N,) uint16
        From 1 in the order in which their first points come; 0 for points of no object.
    """
    wanted = (np.arange(len(things), dtype=np.uint8) * things)[labels]
    seen = pixels_from_points(wanted, image.point_of_pixel)
    channels = argument(image.channels, np.float32)
    component = components(channels, seen, COLUMNS, ROWS)
    pixels = argument(image.pixel_of_point, np.int32)
    ranges = argument(image.point_range, np.float32)
    return numbered(join_points(wanted, pixels, ranges, channels[0], seen, component))


@compiled
def root(parent: Int, pixel: int) -> int:
    """Return the first pixel of a pixel's component, and shorten the way there."""
    while parent[pixel] != pixel:
        parent[pixel] = parent[parent[pixel]]
        pixel = parent[pixel]
    return pixel


@compiled
def connected(image: Float, v: int, u: int, row: int, column: int) -> bool:
    """Say whether the points of two pixels of a range image (5, H, W) are of one surface."""
    if image[0, v, u] > image[0, row, column]:
        v, u, row, column = row, column, v, u
    x, y, z = image[1, row, column], image[2, row, column], image[3, row, column]
    dx, dy, dz = x - image[1, v, u], y - image[2, v, u], z - image[3, v, u]
    distance = np.sqrt(dx * dx + dy * dy + dz * dz)
    if distance <= NEAR_M or distance > FAR_M:
        return distance <= NEAR_M
    return x * dx + y * dy + z * dz < LARGEST_COSINE * image[0, row, column] * distance


@compiled
def components(image: Float, labels: TrainIds, columns: int, rows: int) -> Int:
    """Return the component of each pixel, (H, W) int32 from 1, 0 where the label is 0."""
    height, width = labels.shape
    parent = np.arange(height * width).astype(np.int32)
    for v in range(height):
        for u in range(width):
            if labels[v, u] == 0:
                continue
            for step in range(1, columns + rows + 1):
                row = v if step <= columns else v + step - columns
                column = (u + step) % width if step <= columns else u
                if row >= height or labels[row, column] != labels[v, u]:
                    continue
                if connected(image, v, u, row, column):
                    a, b = root(parent, v * width + u), root(parent, row * width + column)
                    parent[max(a, b)] = min(a, b)
    found = np.zeros((height, width), np.int32)
    for v in range(height):
        for u in range(width):
            if labels[v, u] > 0:
                found[v, u] = root(parent, v * width + u) + 1
    return found


@compiled
def join_points(
    labels: TrainIds,
    pixel_of_point: Int,
    point_range: Float,
    ranges: Float,
    seen: TrainIds,
    component: Int,
) -> Int:
    """Return each point's component: its pixel's, else that of its class nearest in range."""
    height, width = ranges.shape
    found = np.zeros(len(labels), np.int32)
    for i in range(len(labels)):
        if labels[i] == 0 or pixel_of_point[i] < 0:
            continue
        v, u = pixel_of_point[i] // width, pixel_of_point[i] % width
        least = SAME_M
        if seen[v, u] == labels[i] and abs(ranges[v, u] - point_range[i]) < least:
            found[i] = component[v, u]
            continue
        for row in range(max(v - 2, 0), min(v + 3, height)):
            for step in range(-2, 3):
                column = (u + step) % width
                if seen[row, column] == labels[i]:
                    difference = abs(ranges[row, column] - point_range[i])
                    if difference < least:
                        least = difference
                        found[i] = component[row, column]
    return found


@compiled
def numbered(component: Int) -> npt.NDArray[np.uint16]:
    """Return numbers, from 1 on, of the components (N,) of `MIN_POINTS` points or more."""
    size = np.zeros(component.max() + 1 if len(component) else 1, np.int32)
    number = np.zeros(len(size), np.uint16)
    for each in component:
        size[each] += 1
    count = 0
    found = np.zeros(len(component), np.uint16)
    for i in range(len(component)):
        own = component[i]
        if own > 0 and number[own] == 0 and size[own] >= MIN_POINTS and count < MOST:
            count += 1
            number[own] = count
        found[i] = number[own]
    return found


def fit_boxes(points: Float, objects: npt.NDArray[np.uint16]) -> list[Box]:
    """Return the box of each object, by the number of the object (N,) of each point (N, 3)."""
    inside = np.flatnonzero(objects)
    if not len(inside):
        return []
    inside = inside[np.argsort(objects[inside], kind="stable")]
    ends = np.cumsum(np.bincount(objects)[1:])
    return [fit_box(own) for own in np.split(points[inside], ends[:-1])]


def fit_box(points: Float) -> Box:
    """Return the upright box around points (N, 3) of an object that is seen from one side."""
    some = argument(points[:: len(points) // MAX_FITTED + 1, :2], np.float32)
    angle = ANGLES_RAD[closeness(some, COSINES, SINES).argmax()]
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    turned = points @ turn.T
    low, high = turned.min(axis=0), turned.max(axis=0)
    length, width, height = high - low
    if width > length:
        length, width, angle = width, length, angle - np.pi / 2
    return Box(*map(float, ((low + high) / 2 @ turn)), *map(float, (length, width, height, angle)))


@compiled
def closeness(points: Float, cosines: Float, sines: Float) -> Float:
    """Return how close points (M, 2) are to the sides of the rectangle around them, by angle (K,).

    The inner loops are over angles, which do not depend on each other.
    """
    count = len(cosines)
    ends = np.empty((4, count), np.float32)
    ends[:2], ends[2:] = np.inf, -np.inf
    score = np.zeros(count, np.float32)
    for x, y in points:
        for k in range(count):
            along, across = cosines[k] * x + sines[k] * y, cosines[k] * y - sines[k] * x
            ends[0, k] = along if along < ends[0, k] else ends[0, k]
            ends[1, k] = across if across < ends[1, k] else ends[1, k]
            ends[2, k] = along if along > ends[2, k] else ends[2, k]
            ends[3, k] = across if across > ends[3, k] else ends[3, k]
    for x, y in points:
        for k in range(count):
            along, across = cosines[k] * x + sines[k] * y, cosines[k] * y - sines[k] * x
            near, far = along - ends[0, k], ends[2, k] - along
            left, right = across - ends[1, k], ends[3, k] - across
            near = near if near < far else far
            left = left if left < right else right
            least = near if near < left else left
            score[k] += np.float32(1) / (least if least > NEAREST_M else NEAREST_M)
    return score
