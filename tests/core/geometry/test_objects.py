# SPDX-License-Identifier: MIT
"""Objects and their boxes, compared with a slow clear search, and with shapes that are known."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from salsanext_cli import Scan, label_space, project, read_labels, sensor
from salsanext_cli.core.geometry import objects
from salsanext_cli.core.geometry.objects import components, find_objects, fit_box, fit_boxes
from salsanext_cli.core.records import RangeImage

THINGS = label_space().movable
CAR, PERSON, ROAD = (label_space().names.index(name) for name in ("car", "person", "road"))


def are_connected(a, b):
    near, far = sorted((a.astype(np.float64), b.astype(np.float64)), key=np.linalg.norm)
    line = far - near
    distance = np.linalg.norm(line)
    if distance <= objects.NEAR_M:
        return True
    cosine = far @ line / (np.linalg.norm(far) * distance)
    return distance <= objects.FAR_M and cosine < objects.MAX_COSINE


def slow_components(channels, labels):
    """Flood every component, pixel by pixel."""
    height, width = labels.shape
    right = [(0, step) for step in range(1, objects.COLUMNS + 1)]
    below = [(step, 0) for step in range(1, objects.ROWS + 1)]
    offsets = [(sign * v, sign * u) for v, u in right + below for sign in (-1, 1)]
    found = np.arange(height * width).reshape(height, width)
    seen = labels == 0
    for start in np.ndindex(height, width):
        todo = [] if seen[start] else [start]
        while todo:
            v, u = todo.pop()
            if seen[v, u]:
                continue
            seen[v, u], found[v, u] = True, start[0] * width + start[1]
            for dv, du in offsets:
                other = v + dv, (u + du) % width
                if 0 <= other[0] < height and labels[other] == labels[v, u]:
                    a, b = channels[1:4, v, u], channels[1:4, other[0], other[1]]
                    todo += [other] if are_connected(a, b) else []
    return found


@given(st.integers(0, 2**32 - 1), st.integers(1, 9), st.integers(1, 40))
def test_components_equal_a_flood(seed, height, width):
    random = np.random.default_rng(seed)
    azimuth = -np.linspace(-np.pi, np.pi, width, endpoint=False) / 8
    elevation = np.radians(-2.0 * np.arange(height))[:, None]
    distance = random.choice([6.0, 6.3, 7.0, 9.0], (height, width)) + random.random((height, width))
    flat = distance * np.cos(elevation)
    axes = flat * np.cos(azimuth), flat * np.sin(azimuth), distance * np.sin(elevation)
    channels = np.stack([distance, *axes, distance]).astype(np.float32)
    labels = random.choice([0, 1, 1, 4], (height, width)).astype(np.uint8)
    found = components(channels, labels).reshape(height, width)
    np.testing.assert_array_equal(found, slow_components(channels, labels))


def thing(azimuth_deg, distance, width=1.0, count=400, seed=0):
    """Return points on an upright sheet that faces the sensor."""
    random = np.random.default_rng(seed)
    across, z = random.uniform(-width / 2, width / 2, count), random.uniform(-1.4, 0.2, count)
    c, s = np.cos(np.radians(azimuth_deg)), np.sin(np.radians(azimuth_deg))
    flat = np.stack([c * distance - s * across, s * distance + c * across, z], axis=1)
    return flat.astype(np.float32)


def objects_of(clouds, labels):
    scan = Scan(np.concatenate(clouds), np.zeros(sum(map(len, clouds)), np.float32))
    image = project(scan, sensor("hdl64"))
    of_points = np.repeat(np.uint8(labels), [len(cloud) for cloud in clouds])
    found = find_objects(image, of_points, THINGS)
    return np.split(found, np.cumsum([len(cloud) for cloud in clouds])[:-1])


def test_objects_end_where_class_or_range_does_and_go_on_behind_the_sensor():
    clouds = [thing(180, 8), thing(0, 8), thing(0, 16), thing(30, 8), thing(37, 8), thing(90, 8)]
    found = objects_of(clouds, [CAR, CAR, CAR, CAR, PERSON, ROAD])
    numbers = [set(each[each > 0].tolist()) for each in found]
    assert [len(each) for each in numbers] == [1, 1, 1, 1, 1, 0]
    assert set.union(*numbers) == {1, 2, 3, 4, 5}
    assert (found[0] > 0).mean() > 0.95


def test_few_and_unmeasured_points_are_no_object_and_objects_beyond_16_bits_unnumbered(monkeypatch):
    few = thing(0, 8, count=objects.MIN_OBJECT_POINTS - 1, width=0.3)
    none = np.zeros((50, 3), np.float32)
    assert not np.concatenate(objects_of([few, none], [CAR, CAR])).any()
    empty = project(Scan(np.zeros((0, 3), np.float32), np.zeros(0, np.float32)), sensor("hdl64"))
    assert len(find_objects(empty, np.zeros(0, np.uint8), THINGS)) == 0
    assert fit_boxes(np.zeros((4, 3), np.float32), np.zeros(4, np.uint16), np.zeros(0, bool)) == []
    monkeypatch.setattr(objects, "MAX_OBJECTS", 2)
    found = objects_of([thing(angle, 8) for angle in (0, 30, 60)], [CAR] * 3)
    assert sorted({number for each in found for number in each[each > 0].tolist()}) == [1, 2]


@given(st.floats(-1.5, 1.5), st.floats(5, 40), st.floats(-3.1, 3.1))
def test_a_box_is_that_of_an_l_shape(yaw, distance, azimuth):
    """Two sides of a car, 4.2 m by 1.8 m, from a corner, with noise of 1 cm."""
    random = np.random.default_rng(1)
    along = np.stack([random.uniform(-2.1, 2.1, 300), np.full(300, -0.9)])
    across = np.stack([np.full(150, 2.1), random.uniform(-0.9, 0.9, 150)])
    own = np.concatenate([along, across], axis=1) + random.normal(0, 0.01, (2, 450))
    c, s = np.cos(yaw), np.sin(yaw)
    place = distance * np.array([[np.cos(azimuth)], [np.sin(azimuth)]])
    flat = np.array([[c, -s], [s, c]]) @ own + place
    points = np.concatenate([flat, random.uniform(-1.7, -0.2, (1, 450))]).T.astype(np.float32)
    x, y, z, length, width, height, found = fit_box(points)
    assert abs(np.sin(found - yaw)) < np.radians(2)
    assert (length, width, height) == pytest.approx((4.2, 1.8, 1.5), abs=0.2)
    assert (x, y, z) == pytest.approx((*place[:, 0], -0.95), abs=0.1)


def face_of(width, depth, distance, azimuth, yaw):
    """Return points of a sheet and of the side behind its end, yaw from the line of sight."""
    random = np.random.default_rng(3)
    front = np.stack([np.zeros(300), random.uniform(-width / 2, width / 2, 300)])
    side = np.stack([random.uniform(0, depth, 60), np.full(60, width / 2)])
    own = np.concatenate([front, side], axis=1) + random.normal(0, 0.01, (2, 360))
    c, s = np.cos(azimuth + yaw), np.sin(azimuth + yaw)
    place = distance * np.array([[np.cos(azimuth)], [np.sin(azimuth)]])
    flat = np.array([[c, -s], [s, c]]) @ own + place
    return np.concatenate([flat, random.uniform(-1.7, -0.2, (1, 360))]).T.astype(np.float32)


ONE = np.ones(360, np.uint16)


@given(st.floats(-3.1, 3.1), st.floats(-0.6, 0.6), st.floats(6, 40), st.floats(0.1, 1.2))
def test_a_car_whose_end_alone_is_seen_is_not_turned(azimuth, yaw, distance, depth):
    """Its end is 1.8 m wide; the part of its side that is seen is shorter."""
    points = face_of(1.8, depth, distance, azimuth, yaw)
    (box,) = fit_boxes(points, ONE, np.array([True]))
    assert abs(np.sin(box[6] - azimuth - yaw)) < np.sin(np.radians(4))
    assert abs(box[6]) <= np.pi / 2
    assert box[3] == pytest.approx(depth, abs=0.2)
    assert box[4] == pytest.approx(1.8, abs=0.2)
    # Nothing else differs from the box of another object.
    (other,) = fit_boxes(points, ONE, np.array([False]))
    assert other[:3] == box[:3]
    assert (other[3], other[4], other[5]) == (box[4], box[3], box[5])


@pytest.mark.parametrize(
    ("width", "depth", "yaw"), [(4.2, 1.7, 0.3), (2.6, 0.3, 0.0), (0.9, 0.2, 0.0), (1.8, 0.9, 1.57)]
)
def test_sides_pieces_and_ends_along_the_line_of_sight_stay(width, depth, yaw):
    """Nor is a side that is seen from its end an end."""
    points = face_of(width, depth, 12.0, 0.4, yaw)
    car, other = (fit_boxes(points, ONE, np.array([is_car])) for is_car in (True, False))
    assert car == other


def test_the_line_of_sight_is_that_of_the_sensor():
    """Seen from 20 m to the side, the same points show an end along the line of sight."""
    points = face_of(1.8, 0.5, 12.0, 0.0, 0.0)
    seen, aside = (
        fit_boxes(points, ONE, np.array([True]), position)[0] for position in ((0, 0), (12, 20))
    )
    assert (seen[3], seen[4]) == (aside[4], aside[3])


@pytest.mark.real
def test_true_labels_give_most_true_objects(real_scan, real_image: RangeImage, real_data):
    raw = read_labels(real_data / "data/semantickitti/sequences/08/labels/000000.label")
    truth = label_space().to_train(raw, strict=False)
    found = find_objects(real_image, truth, THINGS)
    numbers, counts = np.unique(raw[THINGS[truth]] >> 16, return_counts=True)
    true = numbers[counts >= 50]
    halves = 0
    for number in true:
        inside = (raw >> 16 == number) & THINGS[truth]
        best = np.bincount(found[inside]).argmax()
        halves += (inside & (found == best)).sum() > 0.5 * (inside | (found == best)).sum()
    assert halves >= 0.8 * len(true)
