# SPDX-License-Identifier: MIT
"""The softmax of points in an output folder, or their votes."""

from pathlib import Path

import numpy as np
import pytest

from salsanext_cli import label_space
from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.fusion.top_classes import STORED, top_classes
from salsanext_cli.runs.drives.stored_softmax import stored_softmax
from salsanext_cli.runs.results.output_paths import output_path
from salsanext_cli.runs.scans.scan_file import ScanFile

SPACE = label_space()
FILE = ScanFile(sequence="08", stem="000000", path=Path("/drive/000000.bin"))
POINTS = 50


@pytest.fixture
def softmax():
    """Return probabilities (N, C), of which three are most of the whole."""
    random = np.random.default_rng(0)
    values = random.random((POINTS, SPACE.class_count)) ** 40
    return (values / values.sum(axis=1, keepdims=True)).astype(np.float32)


def store(out, folder, array):
    path = output_path(out, FILE.sequence, folder, FILE.stem)
    path.parent.mkdir(parents=True, exist_ok=True)
    np.save(path, array)
    return path


def test_votes_are_the_largest_probabilities_in_steps_of_a_byte(tmp_path, softmax):
    store(tmp_path, "votes", top_classes(softmax))
    read = stored_softmax(tmp_path, FILE, POINTS, SPACE)
    for point in range(POINTS):
        largest = np.argsort(-softmax[point])[:STORED]
        expected = np.zeros(SPACE.class_count)
        expected[largest] = softmax[point, largest]
        assert np.abs(read[point] - expected).max() <= 0.5 / 255 + 1e-6


def test_the_whole_softmax_is_preferred(tmp_path, softmax):
    store(tmp_path, "votes", top_classes(softmax))
    store(tmp_path, "probabilities", softmax.astype(np.float16))
    read = stored_softmax(tmp_path, FILE, POINTS, SPACE)
    assert read.dtype == np.float32
    np.testing.assert_array_equal(read, softmax.astype(np.float16).astype(np.float32))


@pytest.mark.parametrize("change", ["class", "points"])
def test_votes_of_other_classes_or_points_are_refused(tmp_path, softmax, change):
    votes = top_classes(softmax)
    if change == "class":
        votes[7, 1] = 256 * SPACE.class_count + 3
    else:
        votes = votes[1:]
    path = store(tmp_path, "votes", votes)
    with pytest.raises(FormatError) as caught:
        stored_softmax(tmp_path, FILE, POINTS, SPACE)
    assert caught.value.subject == str(path)
