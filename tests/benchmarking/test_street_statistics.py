# SPDX-License-Identifier: MIT
"""The table of streets holds what a plain loop over the pixels finds."""

import json
import runpy
from pathlib import Path

import numpy as np
import pytest
from scans import write_sequence

from salsanext_cli import label_space, project, read_labels, read_scan, sensor

SCRIPT = runpy.run_path(str(Path(__file__).parents[2] / "benchmarks/street_statistics.py"))
TINY = "fov_up = 3.0\nfov_down = -25.0\nheight = 16\nwidth = 64\n"
GROUND = np.array([False, True, False, False])


def columns_of(classes, occupied):
    """Yield the class and the row of the occupied pixels of each column, from the top."""
    for column in range(classes.shape[1]):
        rows = [row for row in range(len(classes)) if occupied[row, column]]
        yield column, [(int(classes[row, column]), row) for row in rows]


@pytest.mark.parametrize("seed", range(4))
def test_segments(seed):
    random = np.random.default_rng(seed)
    classes = random.integers(0, 4, (12, 9)).astype(np.uint8)
    heights = random.normal(size=(12, 9)).astype(np.float32)
    occupied = random.random((12, 9)) < 0.6
    usual = np.median(heights[occupied & (classes == 1)])
    wanted = []
    for column, pixels in columns_of(classes, occupied):
        for place, (which, row) in enumerate(pixels):
            if which == 0 or (place > 0 and pixels[place - 1][0] == which):
                continue
            lower = [other for other, _ in pixels[place:] if other != which]
            feet = [heights[below, column] for other, below in pixels[place:] if other == 1]
            top = heights[row, column] - (feet[0] if feet else usual)
            wanted.append((which, pytest.approx(top), lower[0] if lower else -1))
    found = SCRIPT["segments"](classes, heights, occupied, GROUND)
    assert list(zip(*(each.tolist() for each in found), strict=True)) == wanted


def test_table(tmp_path, capsys):
    folder = write_sequence(tmp_path / "streets/sequences/00", ["0"], count=900)
    tiny = tmp_path / "tiny.toml"
    tiny.write_text(TINY)
    words = (f"simulated={tmp_path / 'streets'}", str(tmp_path / "streets"), "--sensor", str(tiny))
    SCRIPT["main"](*words, "--json")
    found = json.loads(capsys.readouterr().out)
    assert [*found] == ["simulated", "streets"]
    labels = label_space().to_train(read_labels(folder / "labels/0.label"))
    ranges = project(read_scan(folder / "velodyne/0.bin"), sensor(str(tiny))).point_range
    row = found["simulated"]["car"]
    assert row["share"] == pytest.approx((labels == 1).sum() / (labels > 0).sum())
    quartiles = np.quantile(ranges[labels == 1], (0.25, 0.5, 0.75))
    assert row["range"] == pytest.approx(quartiles.tolist())
    assert row["nearer"][1] == pytest.approx((ranges[labels == 1] < 10).mean())
    assert 0 < row["columns"] < 1
    assert 0 <= row["to_top"] <= 1
    SCRIPT["main"](*words)
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2 + 2 * 19
    assert {line.count("|") for line in lines} == {11}
