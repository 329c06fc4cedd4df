# SPDX-License-Identifier: MIT
"""`train` and `inspect` check scans as `predict` does, without weights."""

import json
import logging
from dataclasses import replace

import numpy as np
import pytest
from calls import calls_of
from scans import SMALL, refused, write_bin, write_sequence

from salsanext_cli import Scan, read_scan
from salsanext_cli.commands.stages.inspect import inspect
from salsanext_cli.commands.stages.project import project_scans
from salsanext_cli.commands.stages.train import train
from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.plain_data import plain
from salsanext_cli.runs.loop.run import RunOptions
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.scans.scan_selection import ScanSelection
from salsanext_cli.training.data.class_counts import count_classes
from salsanext_cli.training.recipe import Recipe

UPWARDS = replace(SMALL, name="upwards", fov_up=30.0, fov_down=-2.0)
TINY = Recipe(epochs=1, batch=2, crop_width=32)

pytestmark = pytest.mark.usefixtures("tiny_training")


@pytest.fixture
def dataset(tmp_path):
    """Three scans to train on and one to score on."""
    write_sequence(tmp_path / "data/sequences/00", ["0", "1", "2"], count=2000)
    write_sequence(tmp_path / "data/sequences/08", ["0"], count=2000)
    return tmp_path / "data"


def change(dataset, points=(0, 1, 2), scale=1.0, brighter=1.0, *, sequence="00", stem="1"):
    path = dataset / "sequences" / sequence / "velodyne" / f"{stem}.bin"
    scan = read_scan(path)
    changed = scan.points[:, points] * np.float32(scale)
    write_bin(path, Scan(changed, scan.intensity * np.float32(brighter)))


def trained(dataset, recipe=TINY, **options):
    folder = dataset.parent / "run"
    return train(dataset, folder, recipe=recipe, sensor=SMALL, device="cpu", **options).warnings


def by_code(warnings):
    return {warning.code: warning.scans for warning in warnings}


def test_correct_scans_give_no_warning(dataset, caplog):
    assert trained(dataset) == inspect(dataset, sensor=SMALL).warnings == []
    assert not [record for record in caplog.records if record.levelno >= logging.WARNING]


@pytest.mark.parametrize(
    ("changes", "codes"),
    [
        ({"points": (0, 2, 1)}, {"tilted", "out-of-view", "mixed-sensors"}),
        ({"brighter": 0.0}, {"no-intensity"}),
        ({"brighter": 255.0}, {"intensity-scale", "mixed-sensors"}),
    ],
)
def test_doubtful_scans_are_named_by_both(dataset, caplog, changes, codes):
    change(dataset, **changes)
    warnings = trained(dataset)
    assert {*by_code(warnings)} == codes
    assert all(scans == ["00/1"] for scans in by_code(warnings).values())
    inspected = inspect(dataset, sensor=SMALL)
    # `predict` matches the intensity; a training from the start takes it as it is.
    assert {*by_code(inspected.warnings)} == codes - {"intensity-scale"}
    assert all(scans == ["00/1"] for scans in by_code(inspected.warnings).values())
    assert inspected.to_dict()["warnings"] == plain(inspected.warnings)
    assert caplog.text.count("(mixed-sensors)") == 2 * ("mixed-sensors" in codes)
    assert "auto" not in "".join(warning.hint for warning in warnings)


def test_scans_in_millimetres_are_not_trained_on(dataset):
    change(dataset, scale=1000.0, sequence="08", stem="0")
    refused(FormatError, dataset / "sequences/08/velodyne/0.bin", trained, dataset)
    assert not (dataset.parent / "run/train.json").exists()
    (failure,) = inspect(dataset, sensor=SMALL).failures
    assert (failure.scan.name, failure.code) == ("08/0", "format")


def test_scans_are_checked_with_the_fitted_sensor(dataset):
    upwards = replace(SMALL, fov_up=30.0, fov_down=-2.0)
    assert {*by_code(inspect(dataset, sensor=upwards).warnings)} == {"out-of-view"}
    assert inspect(dataset, sensor=upwards, fit=True).warnings == []
    change(dataset, brighter=0.0)
    warnings = inspect(dataset, sensor=upwards, fit=True).warnings
    assert by_code(warnings) == {"no-intensity": ["00/1"]}


def test_sequences_of_two_sensors(dataset):
    write_sequence(dataset / "sequences/08", ["0"], count=8000)
    (inspected,), (warning,) = inspect(dataset, sensor=SMALL).warnings, trained(dataset)
    assert inspected.scans == warning.scans == ["08/0"]


def test_later_runs_repeat_the_warnings(dataset):
    """Scans with results are not read again."""
    out, scan = dataset.parent / "out", dataset / "sequences/00/velodyne/1.bin"
    whole = ScanSelection(sequences=("00",))

    def projected(selection=whole, **options):
        how = RunOptions(**options)
        outcome = project_scans(dataset, out, sensor=UPWARDS, selection=selection, options=how)
        return outcome.summary.warnings()

    first = projected()
    assert by_code(first) == {"out-of-view": ["00/0", "00/1", "00/2"]}
    assert projected() == first
    assert by_code(projected(ScanSelection(sequences=("08",)))) == {"out-of-view": ["08/0"]}
    assert by_code(projected(ScanSelection())) == {"out-of-view": ["00/0", "00/1", "00/2", "08/0"]}
    scan.write_bytes(b"")
    # Its results and warnings stay.
    assert projected(overwrite=True) == first


def test_fitted_sequences_are_checked_with_the_fit(dataset):
    """One of them hangs upside down and writes bytes."""
    for stem in "012":
        change(dataset, brighter=100.0, stem=stem)
        path = dataset / f"sequences/00/velodyne/{stem}.bin"
        scan = read_scan(path)
        write_bin(path, Scan(scan.points * np.float32([1, -1, -1]), scan.intensity))
    doubted = {scan for warning in trained(dataset) for scan in warning.scans}
    assert {"00/0", "00/1", "00/2"} <= doubted
    fitted = TINY.with_changes(sensors="fitted")
    assert trained(dataset, fitted, overwrite=True) == []


def test_a_resumed_training_repeats_the_warnings(dataset):
    change(dataset, brighter=0.0)
    warnings = trained(dataset)
    kept = dataset.parent / "run/class_counts.json"
    content = json.loads(kept.read_bytes())
    assert content["warnings"] == plain(warnings)
    with calls_of(count_classes) as counts:
        assert trained(dataset) == warnings
    assert not counts
    # A record of an older version has none.
    older = {key: value for key, value in content.items() if key != "warnings"}
    OwnedFolder(kept.parent).write(kept, json.dumps(older).encode())
    with calls_of(count_classes) as counts:
        assert trained(dataset) == warnings
    assert sum(len(call["source"].files) for call in counts) == 4
