# SPDX-License-Identifier: MIT
"""Labels of a drive teach with their probability, and its scans are mixed with simulated ones."""

import numpy as np
import pytest
from scans import SMALL, write_sequence

from benchmarks.studies.adaptation import (
    CERTAIN,
    PROBABILITIES,
    REJECTED_SHARE,
    ProbableLabels,
    ProbableSamples,
    StudiedDrive,
    least_probabilities,
    probable_labels,
)
from salsanext_cli import label_space
from salsanext_cli.io.formats.kitti_labels import read_labels, write_labels
from salsanext_cli.runs.results.folder_names import DISAGREEMENT, ERROR, FUSED
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.training.data.sources import Source
from salsanext_cli.training.recipe import Recipe

SPACE = label_space()
POINTS = 1500
AACHEN = "benchmarks/weights/aachen.yaml"


def drive_of(folder, work, truth="semantic-kitti"):
    return StudiedDrive(folder=folder, work=work, truth=label_space(truth), classes=SPACE)


def test_the_least_probable_labels_of_each_class_are_rejected_unless_they_are_certain():
    random = np.random.default_rng(0)
    labels = random.integers(1, 4, 2000).astype(np.uint8)
    probability = (random.random(2000) ** labels).astype(np.float32)
    probability[labels == 1] = 0.95
    halves = [
        ProbableLabels(labels=labels[half], probability=probability[half])
        for half in (slice(700), slice(700, None))
    ]
    least = least_probabilities(halves)
    assert least[1] == pytest.approx(CERTAIN)
    for train_id in (2, 3):
        of_class = np.sort(probability[labels == train_id])
        rejected = of_class[of_class < least[train_id]]
        assert len(rejected) == pytest.approx(REJECTED_SHARE * len(of_class), abs=1)


def test_a_changed_label_has_the_share_of_the_votes_and_another_one_its_error(tmp_path):
    folder = write_sequence(tmp_path / "sequences/00", count=4)
    drive = drive_of(folder, tmp_path / "work")
    out = tmp_path / "out"
    (file,) = find_scans(drive.scans())
    raw = {out: [40, 40, 0, 50], out / FUSED: [40, 48, 0, 50]}
    for root, ids in raw.items():
        path = root / "sequences/00/predictions/000000.label"
        path.parent.mkdir(parents=True)
        write_labels(path, np.array(ids, np.uint32))
    values = {out / f"sequences/00/{ERROR}": [0.2, 0.9, 0.5, np.nan]}
    values[out / FUSED / f"sequences/00/{DISAGREEMENT}"] = [0.7, 0.1, np.nan, 0.3]
    for path, numbers in values.items():
        path.mkdir(parents=True)
        np.save(path / "000000.npy", np.array(numbers, np.float32))
    found = probable_labels(drive, out, file)
    assert [SPACE.names[i] for i in found.labels] == [
        "road",
        "sidewalk",
        SPACE.names[0],
        "building",
    ]
    np.testing.assert_allclose(found.probability, [0.8, 0.9, 0, 0], rtol=1e-6)


def test_points_of_the_drive_have_labels_with_their_probability(tmp_path):
    """The other scans are simulated: they keep their labels, and are the partners of the drive."""
    sources = []
    for name in ("drive", "simulated"):
        folder = write_sequence(tmp_path / name / "sequences/00", ["0", "1"], count=POINTS)
        files = find_scans(folder)
        sources.append(Source(files=files, space=SPACE, sensor=SMALL))
    probability = np.repeat(np.float32([0, 0.3, 1]), POINTS // 3)
    place = tmp_path / "drive/sequences/00" / PROBABILITIES
    place.mkdir()
    for stem in "01":
        np.save(place / f"{stem}.npy", probability)
    samples = ProbableSamples(
        sources=sources, sensor=SMALL, recipe=Recipe(), rare=np.zeros(SPACE.class_count, bool)
    )
    random = np.random.default_rng(0)
    labels = samples._read(0, random).labels
    truth = SPACE.to_train(read_labels(sources[0].files[0].label_path))
    assert set(labels[labels != truth]) == {0}
    shares = [np.mean(labels[part][truth[part] > 0] > 0) for part in np.split(np.arange(POINTS), 3)]
    assert shares == pytest.approx([0, 0.3, 1], abs=0.07)
    assert (samples._read(2, random).labels > 0).mean() > 0.9
    of_drive = [(samples._partner(index, random).labels > 0).mean() < 0.6 for index in (0, 1, 2, 3)]
    assert of_drive == [False, False, True, True]


def test_a_label_of_several_classes_counts_for_each_of_them(tmp_path):
    """A sidewalk of Aachen may be terrain, but no road."""
    folder = write_sequence(tmp_path / "sequences/00", count=4)
    write_labels(folder / "labels/000000.label", np.array([48, 48, 48, 10], np.uint32))
    path = tmp_path / "out/sequences/00/predictions/000000.label"
    path.parent.mkdir(parents=True)
    write_labels(path, np.array([48, 72, 40, 10], np.uint32))
    drive = drive_of(folder, tmp_path / "work", AACHEN)
    found = drive.scores(tmp_path / "out")
    assert found["accuracy"] == 75.0
    assert found["sidewalk"] == pytest.approx(66.67)
    assert found["miou"] == pytest.approx((100 + 66.67) / 2, abs=0.01)
