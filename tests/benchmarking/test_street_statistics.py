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
