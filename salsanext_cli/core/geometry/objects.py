# SPDX-License-Identifier: MIT
"""Objects of a scan: connected components of the range image, and boxes around them.

Pixels of one class are connected if the line between their points meets the beam of the farther
point at a large angle (Bogoslavskyi & Stachniss, IROS 2016), as along a surface. Near points are
connected at any angle. The image is periodic in azimuth, and pixels without a return are bridged.
A box is the upright rectangle to whose sides the points are closest (L-shape fit: Zhang, Xu, Dong,
Dolan, IV 2017).
"""

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.classes.label_space import TrainIds
from salsanext_cli.core.compiled import argument, compiled
from salsanext_cli.core.geometry.projection import pixels_from_points
from salsanext_cli.core.records import Float, Int, Mask, RangeImage

Objects = npt.NDArray[np.uint16]
COLUMNS, ROWS = 6, 4  # Pixels to the right and below that may be neighbours
MAX_COSINE = np.float32(np.cos(np.radians(8.0)))  # Of the least angle between beam and line
NEAR_M, FAR_M = np.float32(0.4), np.float32(1.5)
"""Distances below which points are connected at any angle, and above which at none."""
MAX_OBJECTS = np.iinfo(np.uint16).max  # Objects of a scan that have a number in 16 bits
SAME_M = np.float32(1.0)  # Largest difference in range to the pixel whose object a point joins
MIN_OBJECT_POINTS = 10
ANGLES_RAD = np.radians(np.arange(0.0, 90.0, 1.5))  # Directions of the sides of a box to try
BOX = ("x", "y", "z", "length", "width", "height", "yaw")
"""Numbers of a box: centre and sizes in metres; the angle of its length from x in radians.

The length is the longer side, except of a car whose front or rear alone was seen.
"""
LENGTH, WIDTH, YAW = map(BOX.index, ("length", "width", "yaw"))
NEAREST_M = np.float32(0.05)  # Distance below which points are equally close to a side
MAX_FITTED = 128  # Points of an object that a box is fitted to
CAR_WIDTH_M = (1.2, 2.1)
"""Least and largest width of the end of a car, between the quantiles `MOST_POINTS`."""
MOST_POINTS = (0.05, 0.95)  # Labels bleed to a few points beside a car


def find_objects(image: RangeImage, labels: TrainIds, things: Mask) -> Objects:
    """Return the object number of each point, (N,) uint16 from 1; 0 outside `things` (C,)."""
    wanted = (np.arange(len(things), dtype=np.uint8) * things)[labels]
    seen = pixels_from_points(wanted, image.point_of_pixel)
    channels = argument(image.channels, np.float32)
    component = components(channels, seen)
    pixels = argument(image.pixel_of_point, np.int32)
    ranges = argument(image.point_range, np.float32)
    nearest = nearest_pixels(wanted, pixels, ranges, channels, seen)
    inside = np.flatnonzero(nearest >= 0)
    members = component[nearest[inside]]
    _, place, sizes = np.unique(members, return_inverse=True, return_counts=True)
    large = sizes >= MIN_OBJECT_POINTS
    numbers = np.cumsum(large) * large
    objects = np.zeros(len(labels), np.uint16)
    objects[inside] = np.where(numbers <= MAX_OBJECTS, numbers, 0)[place]
    return objects


@compiled
def root(parent: Int, pixel: int) -> int:
    """Return the first pixel of the component of a pixel, and shorten the path to it."""
    while parent[pixel] != pixel:
        parent[pixel] = parent[parent[pixel]]
        pixel = parent[pixel]
    return pixel


@compiled
def connected(image: Float, v: int, u: int, row: int, column: int) -> bool:
    """Return whether the points of two pixels of a range image (5, H, W) are on one surface."""
    if image[0, v, u] > image[0, row, column]:
        v, u, row, column = row, column, v, u
    x, y, z = image[1, row, column], image[2, row, column], image[3, row, column]
    dx, dy, dz = x - image[1, v, u], y - image[2, v, u], z - image[3, v, u]
    distance = np.sqrt(dx * dx + dy * dy + dz * dz)
    along = (x * dx + y * dy + z * dz) / image[0, row, column]
    apart: bool = distance > NEAR_M and (distance > FAR_M or along >= MAX_COSINE * distance)
    return not apart


@compiled
def components(image: Float, labels: TrainIds) -> Int:
    """Return the first pixel of the component of each pixel of an image, (H · W,) int32."""
    height, width = labels.shape
    parent = np.arange(height * width).astype(np.int32)
    for v in range(height):
        for u in range(width):
            for step in range(1, (COLUMNS + ROWS + 1) * (labels[v, u] > 0)):
                row = v if step <= COLUMNS else v + step - COLUMNS
                column = (u + step) % width if step <= COLUMNS else u
                if row >= height or labels[row, column] != labels[v, u]:
                    continue
                if connected(image, v, u, row, column):
                    a, b = root(parent, v * width + u), root(parent, row * width + column)
                    parent[max(a, b)] = min(a, b)
    for pixel in range(height * width):
        parent[pixel] = root(parent, pixel)
    return parent


@compiled
def nearest_pixels(
    labels: TrainIds, pixel_of_point: Int, point_range: Float, image: Float, seen: TrainIds
) -> Int:
    """Return the pixel around each point of the same class and nearest range, (N,) int32, or -1."""
    height, width = seen.shape
    nearest = np.full(len(labels), -1, np.int32)
    for i in range(len(labels)):
        if labels[i] == 0 or pixel_of_point[i] < 0:
            continue
        v, u, least = pixel_of_point[i] // width, pixel_of_point[i] % width, SAME_M
        for row in range(max(v - 2, 0), min(v + 3, height)):
            for column in range(u - 2, u + 3):
                place = row * width + column % width
                if seen[row, column % width] == labels[i]:
                    difference = abs(image[0, row, column % width] - point_range[i])
                    if difference < least:
                        least, nearest[i] = difference, place
    return nearest


def fit_boxes(
    points: Float, objects: Objects, is_car: Mask, position: npt.ArrayLike = (0.0, 0.0)
) -> list[list[float]]:
    """Fit a box to each object of a scan.

    Parameters
    ----------
    points : ndarray (N, 3) float32
        Points in metres, z up.
    objects : ndarray (N,) uint16
        Number of the object of each point, from 1; 0 for none.
    is_car : ndarray (O,) bool
        Whether each of the O objects is a car.
    position : 2 floats
        x and y of the sensor in the frame of the points, metres.

    Returns
    -------
    list of lists of floats
        `BOX` of each object.
    """
    inside = np.flatnonzero(objects)
    inside = inside[np.argsort(objects[inside], kind="stable")]
    ends = np.cumsum(np.bincount(objects)[1:])
    boxes: list[list[float]] = []
    if not len(ends):
        return boxes
    for part, of_car in zip(np.split(points[inside], ends[:-1]), is_car, strict=True):
        box = fit_box(part)
        if of_car and is_end_of_car(part[:, :2] - np.asarray(position, np.float32), box[YAW]):
            box = turned_box(box)
        boxes.append(box)
    return boxes


def fit_box(points: Float) -> list[float]:
    """Return the upright `BOX` around points (N, 3) of an object that is seen from one side."""
    some = points[:: len(points) // MAX_FITTED + 1, :2]
    c, s = np.cos(ANGLES_RAD).astype(np.float32), np.sin(ANGLES_RAD).astype(np.float32)
    closest = np.full((len(some), len(c)), np.inf, np.float32)
    for coordinates in (some @ np.stack([c, s]), some @ np.stack([-s, c])):
        np.minimum(closest, coordinates - coordinates.min(axis=0), out=closest)
        np.minimum(closest, coordinates.max(axis=0) - coordinates, out=closest)
    best = (1 / np.maximum(closest, NEAREST_M)).sum(axis=0).argmax()
    yaw, c, s = ANGLES_RAD[best], c[best], s[best]
    turn = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    turned = points @ turn.T
    low, high = turned.min(axis=0), turned.max(axis=0)
    length, width, height = high - low
    if width > length:
        length, width, yaw = width, length, yaw - np.pi / 2
    return [*((low + high) / 2 @ turn).tolist(), float(length), float(width), float(height), yaw]


def is_end_of_car(flat: Float, yaw: float) -> bool:
    """Return whether the longer side of the points of a car is its front or rear.

    This side is across the line of sight and as wide as a car. `flat` (N, 2): points in metres from
    the sensor; `yaw`: angle of the longer side.
    """
    along = np.array([np.cos(yaw), np.sin(yaw)])
    across = np.array([-along[1], along[0]])
    sight = flat.mean(axis=0)
    if abs(sight @ along) > abs(sight @ across):
        return False
    start, end = np.quantile(flat @ np.stack([along, across], axis=1), MOST_POINTS, axis=0)
    length, width = end - start
    least, largest = CAR_WIDTH_M
    return bool(least <= length <= largest and width <= largest)


def turned_box(box: list[float]) -> list[float]:
    """Return a `BOX` whose length is its other side, with a yaw of -90° to 90°."""
    turned = list(box)
    turned[LENGTH], turned[WIDTH] = box[WIDTH], box[LENGTH]
    turned[YAW] = box[YAW] + np.pi / 2 if box[YAW] <= 0 else box[YAW] - np.pi / 2
    return turned
