# SPDX-License-Identifier: MIT
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from las_files import write_las
from scans import SMALL, make_scan, refused, write_bin, write_sequence

from salsanext_cli import LabelSpace, Scan, label_space, project, read_scan, write_labels
from salsanext_cli.core.errors import LabelError, NoInputError, UsageError
from salsanext_cli.core.geometry.intensity import match_intensity
from salsanext_cli.core.geometry.network_input import with_image_statistics
from salsanext_cli.core.geometry.row_gaps import with_filled_gaps
from salsanext_cli.training.data.dataset import Samples, SamplingPlan
from salsanext_cli.training.data.sources import (
    Source,
    fitted_source,
    further_source,
    labelled_split,
    scans_to_train_on,
)
from salsanext_cli.training.data.targets import class_sets, to_targets
from salsanext_cli.training.recipe import Recipe

SPACE, COARSE = label_space(), label_space("coarse")
NOTHING = Recipe(rotate=0.0, shift=0.0, flip=0.0, drop=0.0)
NEVER = np.zeros(SPACE.class_count, bool)


@pytest.mark.parametrize(("also", "counts"), [(0.4, [7, 3, 5]), (1.0, [3, 4]), (0.0, [3, 4])])
def test_further_data_sets_have_their_share_and_each_scan_its_turn(also, counts):
    plan = SamplingPlan(
        scan_counts=counts, recipe=Recipe(epochs=10, batch=4, samples_per_epoch=60, also=also)
    )
    drawn = [index for batch in plan.batches() for _, index in batch]
    ends = np.cumsum(counts)
    sources = np.searchsorted(ends, drawn, side="right")
    share = Counter(sources.tolist())
    for source in range(1, len(counts)):
        assert share[source] == pytest.approx(600 * also / (len(counts) - 1), abs=1)
    for source in range(len(counts)):
        own = [i for i, s in zip(drawn, sources, strict=True) if s == source]
        rounds = [own[i : i + counts[source]] for i in range(0, len(own), counts[source])]
        assert all(len(set(each)) == counts[source] for each in rounds[:-1])
    for first in (1, 17, 100):
        assert list(plan.batches(first)) == list(plan.batches())[first:]


@pytest.fixture
def roots(tmp_path: Path) -> list[Path]:
    """Two data sets; the second has another sensor, another intensity and fewer classes."""
    for name in ("one", "two"):
        for sequence in ("00", "01"):
            write_sequence(tmp_path / name / "sequences" / sequence, ["0", "1"], count=3000)
    for number, path in enumerate(sorted((tmp_path / "two").glob("sequences/*/velodyne/*.bin"))):
        scan = make_scan(3000, number)
        up = np.radians(30)
        turned = scan.points @ np.array(
            [[1, 0, 0], [0, np.cos(up), np.sin(up)], [0, -np.sin(up), np.cos(up)]], np.float32
        )
        write_bin(path, Scan(turned, 100 * scan.intensity))
    space = replace(SPACE, alternatives={70: (15, 16)})
    (tmp_path / "two" / "labels.yaml").write_text(yaml.safe_dump(space.to_dict()))
    return [tmp_path / "one", tmp_path / "two"]


def seen(roots: list[Path]) -> tuple[Source, Source]:
    _, files = labelled_split(roots[0], None, "train")
    plain = Source(files=files, space=SPACE, sensor=SMALL)
    images = [project(plain.read(file, ()).scan, SMALL).channels for file in files]
    sensor = with_image_statistics(SMALL, images)
    return Source(files=files, space=SPACE, sensor=sensor), further_source(roots[1], SPACE, sensor)


def test_samples_come_from_all_data_sets_with_their_own_labels(roots: list[Path]) -> None:
    first, second = seen(roots)
    sets = class_sets([first.space, second.space])
    recipe = NOTHING.with_changes(also=0.5)
    samples = Samples(
        sources=[first, second], sensor=first.sensor, recipe=recipe, rare=NEVER, sets=sets
    )
    kinds = {index // 4: samples[0, index][1].max() for index in (0, 4)}
    assert kinds == {0: 19, 1: 20}
    mixed = Samples(
        sources=[first, second],
        sensor=first.sensor,
        recipe=recipe.with_changes(mix=1.0),
        rare=NEVER,
        sets=sets,
    )
    drawn = [mixed[position, 0][1] for position in range(12)]
    assert any((truth == 20).any() for truth in drawn)
    assert not all((truth == 20).any() for truth in drawn)
    with pytest.raises(IndexError):
        samples.scan_at(8)


def test_a_fitted_sequence_is_seen_as_predict_sees_it(roots: list[Path]) -> None:
    """Mounting, intensity and gaps; one sequence at a time, whatever the number of threads."""
    first, second = seen(roots)
    fitted = fitted_source(second)
    assert fitted.fitted == fitted_source(second, jobs=2).fitted
    assert fitted.fitted.keys() == {"00", "01"}
    file = second.files[0]
    own = fitted.sensor_of(file)
    assert own.up != SMALL.up
    image = project(read_scan(file.path), own)
    quantiles = (own.intensity_quantiles, first.sensor.intensity_quantiles)
    channels = match_intensity(image.channels, *quantiles)
    expected = with_filled_gaps(channels, own, first.sensor)
    recipe = NOTHING.with_changes(also=1.0)
    found = Samples(
        sources=[first, fitted],
        sensor=first.sensor,
        recipe=recipe,
        rare=NEVER,
        sets=class_sets([second.space]),
    )[0, 4]
    means, stds = (np.array(v)[:, None, None] for v in (SMALL.means, SMALL.stds))
    occupied = expected[0] > 0
    shown = np.where(occupied, found[0] * stds + means, 0)
    np.testing.assert_allclose(shown, expected, atol=2e-4)


def changed(roots: list[Path], **chances: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a sample of the first data set with some changes."""
    first, _ = seen(roots)
    return Samples(
        sources=[first], sensor=first.sensor, recipe=NOTHING.with_changes(**chances), rare=NEVER
    )[5, 1][:2]


@pytest.mark.parametrize("key", ["intensity", "mount", "view"])
def test_each_change_to_another_sensor_is_made(roots: list[Path], key: str) -> None:
    """Each by a drawing of its own: intensities stay in their pixels, others move points."""
    (found, truth), (plain, own) = changed(roots, **{key: 1.0}), changed(roots)
    assert not np.array_equal(found[4], plain[4])
    same = np.array_equal(found[:4], plain[:4]), np.array_equal(truth, own)
    assert same == (key == "intensity",) * 2


def test_further_data_sets_are_checked(roots: list[Path], tmp_path: Path) -> None:
    with pytest.raises(NoInputError):
        further_source(write_sequence(tmp_path / "other" / "sequences" / "08"), SPACE, SMALL)
    other = SPACE.to_dict()
    other["learning_map_inv"] = {**SPACE.learning_map_inv, 1: 252}
    other["learning_map"] = {**SPACE.learning_map, 256: 1}
    (roots[1] / "labels.yaml").write_text(yaml.safe_dump(other))
    refused(LabelError, roots[1], further_source, roots[1], SPACE, SMALL)
    describe(roots[1], COARSE)
    with pytest.raises(LabelError):
        further_source(roots[1], SPACE, SMALL)


def describe(root: Path, space: LabelSpace, **changes: Any) -> None:
    """Write the label space of a data set."""
    (root / "labels.yaml").write_text(yaml.safe_dump(space.to_dict() | changes))


def test_a_label_space_that_is_named_keeps_its_own_splits(roots: list[Path]) -> None:
    describe(roots[0], SPACE, split={"train": [0, 1], "valid": ["01"]})
    mine = replace(COARSE, splits={"train": ("01",), "valid": ("00",)})
    for split, sequence in (("train", "01"), ("valid", "00")):
        space, files = labelled_split(roots[0], mine, split)
        assert {file.sequence for file in files} == {sequence}
        assert (space.splits, space.fits(COARSE)) == (mine.splits, True)
    space, files = labelled_split(roots[0], COARSE, "train")
    assert {file.sequence for file in files} == {"00", "01"}
    _, files = labelled_split(roots[0], space, "valid")
    assert {file.sequence for file in files} == {"01"}
    (roots[0] / "labels.yaml").write_text("labels: 3")
    assert labelled_split(roots[0], mine, "train")[0].splits == mine.splits
    for unknown in (None, COARSE):
        refused(UsageError, roots[0] / "labels.yaml", labelled_split, roots[0], unknown, "train")
    (roots[0] / "labels.yaml").unlink()
    assert labelled_split(roots[0], COARSE, "train")[0].splits == SPACE.splits


@pytest.mark.parametrize("described", [False, True])
def test_further_data_sets_are_merged_as_the_first(roots: list[Path], described: bool) -> None:
    describe(roots[0], SPACE, learning_alternatives={80: [18, 19], 40: [9, 13]})
    if not described:
        (roots[1] / "labels.yaml").unlink()
    first, files = labelled_split(roots[0], COARSE, "train")
    further = further_source(roots[1], first, SMALL)
    assert (first.alternatives, len(files)) == ({40: (3, 4)}, 4)
    assert further.space.fits(first)
    assert further.space.alternatives == ({70: (5, 6)} if described else {})
    sets = class_sets([first, further.space])
    raw = np.uint32([10, 252, 40, 70, 71])
    found = to_targets(raw, further.space, sets, "labels").tolist()
    assert found == [1, 1, 3, 8 + sets.index((5, 6)) if described else 5, 6]


def test_las_scans_without_label_files_are_read_by_their_classification(tmp_path: Path) -> None:
    pytest.importorskip("laspy")
    pytest.importorskip("lazrs")
    folder = tmp_path / "survey"
    codes = np.uint8([2, 5, 6] * 100)
    for number, name in enumerate(("a.las", "b.laz", "c.las")):
        points = make_scan(300, number).points
        write_las(folder / name, points, classification=codes if name != "c.las" else 0 * codes)
    scans = scans_to_train_on(folder, COARSE, divisible=True)
    assert [file.stem for file in scans.training] == ["a", "b"]
    source = Source(files=scans.training, space=COARSE, sensor=SMALL)
    expected = COARSE.to_train(np.uint32([48, 70, 50] * 100))
    for file in scans.training:
        np.testing.assert_array_equal(source.read(file, ()).labels, expected)
    # One label file makes all other scans unlabelled: their classification may be another.
    write_labels(folder / "c.label", np.full(300, 50, np.uint32))
    scans = scans_to_train_on(folder, COARSE, divisible=True)
    assert [file.stem for file in scans.training] == ["c"]
    split = replace(COARSE, splits={"train": (folder.name,)})
    refused(NoInputError, folder / "a.label", labelled_split, folder, split, "train")
