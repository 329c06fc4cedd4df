# SPDX-License-Identifier: MIT
"""Thumbnails of scans: they show most points, in the colours of their labels."""

import base64
import io

import numpy as np
import pytest
from evaluation_runs import CAR, ROAD, SPACE, World
from matplotlib.image import imread
from scans import write_array, write_bin

from salsanext_cli import Scan
from salsanext_cli.commands.stages.report import read_run
from salsanext_cli.report.colours import EMPTY, screen_colours
from salsanext_cli.report.page.thumbnails import PNG, SIZE_PX, thumbnail
from salsanext_cli.runs.results.output_paths import output_path
from salsanext_cli.runs.results.query import ResultQuery

COLOURS = screen_colours(SPACE)


def pixels(world) -> np.ndarray:
    """Return the picture of the only scan of a run, (H, W, 3) uint8."""
    run, _ = read_run(world.out, query=ResultQuery(world.dataset))
    name, address = thumbnail(run.rows[0].file, run.reader, COLOURS)
    assert name == "08/000000"
    png = base64.b64decode(address.removeprefix(PNG))
    return (imread(io.BytesIO(png))[..., :3] * 255).round().astype(np.uint8)


def spread(world, points):
    path = world.dataset / "sequences/08/velodyne/000000.bin"
    write_bin(path, Scan(np.array(points, np.float32), np.zeros(len(points), np.float32)))


@pytest.fixture
def world(tmp_path):
    return World(tmp_path)


def test_points_have_the_colour_of_their_class_with_forward_up(world):
    person = 30
    world.add("000000", None, [CAR, ROAD, person, person])
    spread(world, [[30, 3, 0], [20, -3, 0], [50, 0, 0], [1, 0, 0]])
    picture = pixels(world)
    assert picture.shape == (SIZE_PX, SIZE_PX, 3)
    car = np.argwhere((picture == COLOURS[SPACE.names.index("car")]).all(axis=2))
    road = np.argwhere((picture == COLOURS[SPACE.names.index("road")]).all(axis=2))
    assert (len(car), len(road)) == (1, 1)
    assert (car < road).all()
    assert (picture != EMPTY).any(axis=2).sum() <= 4


def test_most_points_of_a_sector_are_shown(world):
    count = 400
    world.add("000000", None, [ROAD] * count)
    random = np.random.default_rng(0)
    spread(world, np.column_stack([random.uniform(50, 90, (count, 2)), np.zeros(count)]))
    shown = (pixels(world) != EMPTY).any(axis=2).sum()
    # Few of so many points share a pixel.
    assert 0.8 * count < shown <= count


def test_without_labels_values_give_the_colours(world):
    world.add("000000", None, [ROAD] * 4)
    output_path(world.out, "08", "predictions", "000000").unlink()
    write_array(output_path(world.out, "08", "uncertainty/error", "000000"), np.full(4, 0.5, "f4"))
    picture = pixels(world)
    shown = picture[(picture != EMPTY).any(axis=2)]
    assert len(shown) > 1
    assert len(np.unique(shown, axis=0)) == 1
