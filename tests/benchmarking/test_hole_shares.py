# SPDX-License-Identifier: MIT
"""The table of holes holds what a plain loop over the pixels counts."""

import runpy
from pathlib import Path

import numpy as np
from scans import write_sequence

from salsanext_cli.training.data.other_sensors import (
    HOLE_SHARES,
    hole_cells,
)

SCRIPT = runpy.run_path(str(Path(__file__).parents[2] / "benchmarks/hole_shares.py"))
TINY = "fov_up = 3.0\nfov_down = -25.0\nheight = 16\nwidth = 64\n"


def test_counting():
    random = np.random.default_rng(0)
    ranges = np.where(random.random((8, 64)) < 0.3, 0, random.uniform(2, 60, (8, 64)))
    cells, kinds = hole_cells(ranges), HOLE_SHARES.shape[1]
    wanted = np.zeros((3, *HOLE_SHARES.shape), int)
    for row in range(8):
        for column in range(64):
            cell, right = cells[row, column], (column + 1) % 64
            if cell < 0:
                continue
            hole = ranges[row, column] == 0
            goes_on = hole and ranges[row, right] == 0 and cells[row, right] >= 0
            wanted[:, cell // kinds, cell % kinds] += [1, hole, goes_on]
    np.testing.assert_array_equal(SCRIPT["count_holes"](ranges), wanted)


def test_table(tmp_path, capsys):
    write_sequence(tmp_path / "streets/sequences/00", ["0", "1"], count=900)
    tiny = tmp_path / "tiny.toml"
    tiny.write_text(TINY)
    scan = tmp_path / "streets/sequences/00/velodyne/0.bin"
    SCRIPT["main"](f"two={tmp_path / 'streets'}", str(scan), "--sensor", str(tiny))
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[1:]] == ["two", "0", "mean"]
    columns = HOLE_SHARES.size + 4
    assert [len(line.split()) for line in lines[1:]] == [1 + columns] * 3
    assert 0 < float(lines[1].split()[1]) < 100
