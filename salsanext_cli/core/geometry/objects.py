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
COLUMNS = 6  # Pixels to the right that may be neighbours
ROWS = 4  # Pixels below that may be neighbours
MAX_COSINE = np.float32(np.cos(np.radians(8.0)))  # Of the least angle between beam and line
NEAR_M = np.float32(0.4)  # Distance below which points are connected at any angle
FAR_M = np.float32(1.5)  # Distance above which points are never connected
MAX_OBJECTS = np.iinfo(np.uint16).max  # Objects of a scan that have a number in 16 bits
SAME_M = np.float32(1.0)  # Largest difference in range to the pixel whose object a point joins
MIN_OBJECT_POINTS = 10
ANGLES_RAD = np.radians(np.arange(0.0, 90.0, 1.5))  # Directions of the sides of a box to try
BOX = ("x", "y", "z", "length", "width", "height", "yaw")
"""Numbers of a box: centre and sizes in metres; the angle of its length from x in radians.

The length is the longer side, except of a car whose front or rear alone was seen.
"""
LENGTH = BOX.index("length")
WIDTH = BOX.index("width")
YAW = BOX.index("yaw")
NEAREST_M = np.float32(0.05)  # Distance below which points are equally close to a side
MAX_FITTED = 128  # Points of an object that a box is fitted to
CAR_WIDTH_M = (1.2, 2.1)
"""Least and largest width of the end of a car, between the quantiles `MOST_POINTS`."""
MOST_POINTS = (0.05, 0.95)  # Labels bleed to a few points beside a car


def find_objects(image: RangeImage, labels: TrainIds, things: Mask) -> Objects:
    """Return the number of the object that each point belongs to.

    Parameters
    ----------
    image : RangeImage
        H × W pixels of N points.
    labels : (N,) uint8
        Train ids.
    things : (C,) bool
        Whether a class is of things that can be counted, such as cars, unlike roads.

    Returns
    -------
    (N,) uint16
        Numbers from 1; 0 for none.
    """
    thing_labels = (np.arange(len(things), dtype=np.uint8) * things)[labels]
    pixel_labels = pixels_from_points(thing_labels, image.point_of_pixel)
    channels = argument(image.channels, np.float32)
    component = components(channels, pixel_labels)
    pixels = argument(image.pixel_of_point, np.int32)
    ranges = argument(image.point_range, np.float32)
    nearest = nearest_pixels(thing_labels, pixels, ranges, channels, pixel_labels)
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
    """Return whether the points of two pixels are on one surface.

    Parameters
    ----------
    image : (5, H, W) float32
        Range image.
    v : int
        Row of the first pixel.
    u : int
        Column of the first pixel.
    row : int
        Row of the second pixel.
    column : int
        Column of the second pixel.
    """
    if image[0, v, u] > image[0, row, column]:
        v, u, row, column = row, column, v, u
    x = image[1, row, column]
    y = image[2, row, column]
    z = image[3, row, column]
    dx = x - image[1, v, u]
    dy = y - image[2, v, u]
    dz = z - image[3, v, u]
    distance = np.sqrt(dx * dx + dy * dy + dz * dz)
    along = (x * dx + y * dy + z * dz) / image[0, row, column]
    apart: bool = distance > NEAR_M and (distance > FAR_M or along >= MAX_COSINE * distance)
    return not apart


@compiled
def components(image: Float, labels: TrainIds) -> Int:
    """Return the first pixel of the component of each pixel.

    Parameters
    ----------
    image : (5, H, W) float32
        Range image.
    labels : (H, W) uint8
        Train ids of the pixels; 0 for pixels of no object.

    Returns
    -------
    (H · W,) int32
        Flat pixel indices.
    """
    height, width = labels.shape
    parent = np.arange(height * width).astype(np.int32)
    for v in range(height):
        for u in range(width):
            if labels[v, u] == 0:
                continue
            for step in range(1, COLUMNS + ROWS + 1):
                row = v if step <= COLUMNS else v + step - COLUMNS
                column = (u + step) % width if step <= COLUMNS else u
                if row >= height or labels[row, column] != labels[v, u]:
                    continue
                if connected(image, v, u, row, column):
                    first = root(parent, v * width + u)
                    second = root(parent, row * width + column)
                    parent[max(first, second)] = min(first, second)
    for pixel in range(height * width):
        parent[pixel] = root(parent, pixel)
    return parent


@compiled
def nearest_pixels(
    labels: TrainIds, pixel_of_point: Int, point_range: Float, image: Float, pixel_labels: TrainIds
) -> Int:
    """Return the pixel around each point of the same class and nearest range.

    Parameters
    ----------
    labels : (N,) uint8
        Train ids of the points; 0 for points of no object.
    pixel_of_point : (N,) int32
        Flat pixel index of each point, -1 for none.
    point_range : (N,) float32
        Range of each point in metres.
    image : (5, H, W) float32
        Range image.
    pixel_labels : (H, W) uint8
        Train ids of the pixels; 0 for pixels of no object.

    Returns
    -------
    (N,) int32
        Flat pixel indices; -1 for none.
    """
    height, width = pixel_labels.shape
    nearest = np.full(len(labels), -1, np.int32)
    for i in range(len(labels)):
        if labels[i] == 0 or pixel_of_point[i] < 0:
            continue
        v = pixel_of_point[i] // width
        u = pixel_of_point[i] % width
        least = SAME_M
        for row in range(max(v - 2, 0), min(v + 3, height)):
            for step in range(-2, 3):
                column = (u + step) % width
                if pixel_labels[row, column] == labels[i]:
                    difference = abs(image[0, row, column] - point_range[i])
                    if difference < least:
                        least = difference
                        nearest[i] = row * width + column
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
    if not len(ends):
        return []
    boxes: list[list[float]] = []
    sensor = np.asarray(position, np.float32)
    for members, is_of_car in zip(np.split(points[inside], ends[:-1]), is_car, strict=True):
        box = fit_box(members)
        if is_of_car and is_end_of_car(members[:, :2] - sensor, box[YAW]):
            box = turned_box(box)
        boxes.append(box)
    return boxes


def fit_box(points: Float) -> list[float]:
    """Return the upright box around an object that is seen from one side.

    Parameters
    ----------
    points : (N, 3) float32
        Points of the object in metres.

    Returns
    -------
    list of float
        Numbers of `BOX`.
    """
    step = len(points) // MAX_FITTED + 1
    cosines = np.cos(ANGLES_RAD).astype(np.float32)
    sines = np.sin(ANGLES_RAD).astype(np.float32)
    best = _best_side(points[::step, :2], cosines, sines)
    yaw = ANGLES_RAD[best]
    cosine = cosines[best]
    sine = sines[best]
    turn = np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]])
    turned = points @ turn.T
    low = turned.min(axis=0)
    high = turned.max(axis=0)
    x, y, z = ((low + high) / 2 @ turn).tolist()
    along, across, height = (high - low).tolist()
    if across > along:
        return [x, y, z, across, along, height, yaw - np.pi / 2]
    return [x, y, z, along, across, height, yaw]


def _best_side(flat: Float, cosines: Float, sines: Float) -> int:
    """Return the index of the direction along which the points are nearest to the sides of a box.

    Parameters
    ----------
    flat : (N, 2) float32
        x and y of the points in metres.
    cosines : (A,) float32
        Cosines of the angles of one side.
    sines : (A,) float32
        Their sines.
    """
    closest = np.full((len(flat), len(cosines)), np.inf, np.float32)
    along = flat @ np.stack([cosines, sines])
    across = flat @ np.stack([-sines, cosines])
    for coordinates in (along, across):
        np.minimum(closest, coordinates - coordinates.min(axis=0), out=closest)
        np.minimum(closest, coordinates.max(axis=0) - coordinates, out=closest)
    return int((1 / np.maximum(closest, NEAREST_M)).sum(axis=0).argmax())


def is_end_of_car(flat: Float, yaw: float) -> bool:
    """Return whether the longer side of the points of a car is its front or rear.

    This side is across the line of sight and as wide as a car.

    Parameters
    ----------
    flat : (N, 2) float32
        x and y of the points from the sensor in metres.
    yaw : float
        Angle of the longer side in radians.
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
    turned[LENGTH] = box[WIDTH]
    turned[WIDTH] = box[LENGTH]
    turned[YAW] = box[YAW] + np.pi / 2 if box[YAW] <= 0 else box[YAW] - np.pi / 2
    return turned
