# SPDX-License-Identifier: MIT
import csv
import io
from dataclasses import asdict
from pathlib import Path

import matplotlib.image
import numpy as np
from scans import SMALL, make_scan

from salsanext_cli import label_space, project
from salsanext_cli.fitting.label_scan import LabelledScan
from salsanext_cli.fitting.scan_checks import UNCHECKED
from salsanext_cli.labelling.scan_choice import Choice
from salsanext_cli.report.canvas import MARGIN_PX
from salsanext_cli.report.colours import EMPTY, map_on_dark, screen_colours
from salsanext_cli.report.picked import (
    HEAD_PX,
    NO_CLASS,
    STRIP_HEIGHT_PX,
    STRIP_WIDTH_PX,
    TITLE_PX,
    PickedLabels,
    picked_csv,
    picked_scans,
    picked_sheet,
)
from salsanext_cli.results.layout import ScanFile

SPACE = label_space()
FILES = [ScanFile("$0$", f"[{i}]", Path(f"/s/[{i}].bin")) for i in range(3)]
CHOICES = [Choice(2, 0.5, 1), Choice(0, 0.25, 3, 1.25, 2), Choice(1, 0.375, 2, 0.0, 0)]
PICKED = picked_scans(CHOICES, FILES, "both")


def test_the_csv_file_holds_every_value():
    rows = list(csv.DictReader(io.StringIO(picked_csv(PICKED).decode())))
    empty = {key: "" if value is None else str(value) for key, value in asdict(PICKED[0]).items()}
    assert rows[0] == empty
    assert float(rows[1]["distance"]) == 1.25


def preview(seed=0, sensor=SMALL):
    scan = make_scan(800, seed)
    image = project(scan, sensor)
    labels = np.random.default_rng(seed).integers(0, 20, len(scan)).astype(np.uint8)
    values = np.random.default_rng(seed).random(image.point_of_pixel.shape, np.float32)
    file = ScanFile("00", "000000", Path("000000.bin"))
    softmax = np.empty((0, *image.point_of_pixel.shape), np.float32)
    labelled = LabelledScan(file, scan, image, UNCHECKED, sensor, softmax, labels)
    return PickedLabels.of(labelled, values, SPACE)


def test_the_sheet_shows_both_pictures_of_every_scan():
    previews = [preview(seed) for seed in range(3)]
    png = picked_sheet(PICKED, previews, SPACE)
    pixels = (matplotlib.image.imread(io.BytesIO(png))[..., :3] * 255).round().astype(np.uint8)
    for number, each in enumerate(previews):
        top = HEAD_PX + number * (TITLE_PX + STRIP_HEIGHT_PX) + TITLE_PX
        rows = top + (np.arange(16) * 2 + 1) * STRIP_HEIGHT_PX // 32
        columns = (np.arange(128) * 2 + 1) * STRIP_WIDTH_PX // 256
        labels = pixels[rows[:, None], MARGIN_PX + columns]
        filled = each.classes != NO_CLASS
        np.testing.assert_array_equal(labels[filled], screen_colours(SPACE)[each.classes[filled]])
        assert (labels[~filled] == EMPTY).all()
        doubt = pixels[rows[:, None], 2 * MARGIN_PX + STRIP_WIDTH_PX + columns]
        assert (doubt[~filled] == EMPTY).all()
        lowest = filled & (each.uncertainty < 0.01)
        assert (doubt[lowest] == map_on_dark()[0]).all()
