# SPDX-License-Identifier: MIT
"""Clouds of the page come back from their bytes."""

import base64
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scans import SMALL, make_scan

from salsanext_cli import Scan, label_space, project
from salsanext_cli.report.page.clouds import NO_VALUE, encode_cloud, scales_of
from salsanext_cli.report.page.run_results import ShownScan
from salsanext_cli.runs.results.scan_results import ScanResults

SEMANTIC_KITTI = label_space()


def shown(scan, **known):
    return ShownScan(name="08/000000", reason="named", results=ScanResults(scan=scan, **known))


def numbers(text, dtype):
    return np.frombuffer(base64.b64decode(text), dtype)


def encoded(one):
    return encode_cloud(one, SEMANTIC_KITTI, SMALL, scales_of([one]))


def of_pixel(data):
    return numbers(data["of_pixel"], f"<u{data['of_pixel_bytes']}")


def in_order_of_pixels(scan):
    """Sort points by pixel, the nearest of each first, by a slow clear loop."""
    image = project(scan, SMALL)
    of_pixel = {}
    for point, pixel in enumerate(image.pixel_of_point.tolist()):
        of_pixel.setdefault(pixel if pixel >= 0 else SMALL.height * SMALL.width, []).append(point)
    order, counts = [], np.zeros(SMALL.height * SMALL.width + 1, int)
    for pixel, points in sorted(of_pixel.items()):
        order += sorted(points, key=lambda point: image.point_range[point])
        counts[pixel] = len(points)
    return order, counts[:-1]


@example(0, 0)
@example(0, 1)
@given(st.integers(0, 10_000), st.integers(0, 400))
def test_positions_and_pixels_come_back(seed, count):
    scan = make_scan(count, seed)
    data = encoded(shown(scan))
    order, counts = in_order_of_pixels(scan)
    assert data["shown"] == data["points"] == count
    assert np.isfinite([*data["low"], *data["step"]]).all()
    assert np.array_equal(of_pixel(data), counts)
    steps = numbers(data["position"], "<u2").reshape(-1, 3)
    positions = np.array(data["low"]) + np.array(data["step"]) * steps
    assert np.abs(positions - scan.points[order]).max(initial=0) <= max(data["step"])


def test_values_come_back_on_their_scale_and_none_stays_none():
    scan = make_scan(300)
    order, _ = in_order_of_pixels(scan)
    entropy = np.linspace(0, 2, 300, dtype=np.float32)
    entropy[7] = np.nan
    error = np.linspace(0, 1, 300, dtype=np.float32)
    kinds = {"entropy": entropy, "error": error, "least_confidence": error / 2}
    one = shown(scan, uncertainty=kinds)
    scales = scales_of([one])
    assert scales["least_confidence"] == {"marks": (0, 1), "unit": ""}
    assert 1.9 < scales["entropy"]["marks"][1] <= 2
    values = encoded(one)["values"]
    assert [*values] == ["error", "entropy", "least_confidence", "range", "intensity"]
    for name, exact in kinds.items():
        steps, marks = numbers(values[name], "u1"), scales[name]["marks"]
        wanted = np.minimum(exact[order], marks[-1])
        known = ~np.isnan(wanted)
        assert np.array_equal(steps == NO_VALUE, ~known)
        back = np.interp(steps[known], np.linspace(0, 254, len(marks)), marks)
        # Steps of the error are finer where it is small.
        step = np.where(wanted[known] < 0.02, marks[1], marks[-1] - marks[-2])
        assert (np.abs(back - wanted[known]) <= 0.5 * step * (len(marks) - 1) / 254 + 1e-6).all()


def test_classes_are_train_ids_wrong_points_two_and_unmeasured_ones_skipped():
    scan = Scan(np.array([[1, 0, 0], [2, 1, 0], [3, -1, 0]], np.float32), np.zeros(3, np.float32))
    raw = np.array([10, 40, 10], np.uint32), np.array([10, 10, 0], np.uint32)
    one = shown(scan, label=raw[0], truth=raw[1])
    order, _ = in_order_of_pixels(scan)
    values = {name: numbers(text, "u1") for name, text in encoded(one)["values"].items()}
    assert values["label"].tolist() == np.array([1, 9, 1])[order].tolist()
    assert values["truth"].tolist() == np.array([1, 1, 0])[order].tolist()
    assert values["wrong"].tolist() == np.array([1, 2, 0])[order].tolist()
    scan = make_scan(50)
    points = scan.points.copy()
    points[3], points[4], points[5, 0] = np.nan, np.inf, 1e8
    data = encoded(shown(replace(scan, points=points)))
    assert (data["points"], data["shown"]) == (50, 47)
    assert max(data["step"]) < 0.01


@pytest.mark.parametrize(("count", "size"), [(255, 1), (256, 2), (70_000, 4)])
def test_many_points_of_one_pixel_are_counted(count, size):
    points = np.tile(np.array([[5, 0, 0]], np.float32), (count, 1))
    data = encoded(shown(Scan(points, np.zeros(count, np.float32))))
    assert data["of_pixel_bytes"] == size
    assert of_pixel(data).max() == count
