# SPDX-License-Identifier: MIT
"""Data sets of `synthesise`: layout, labels, poses, splits, seeds, refusals."""

import json
import sys
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from quick_streets import record
from scans import files_below, refused

from salsanext_cli import __version__, label_space, read_labels
from salsanext_cli.commands.stages import synth
from salsanext_cli.commands.stages.synth import synthesise
from salsanext_cli.core.errors import MissingDependency, OutputError, UsageError
from salsanext_cli.io.files.atomic import write_bytes
from salsanext_cli.io.files.locks import locked
from salsanext_cli.io.formats.kitti import read_bin
from salsanext_cli.runs.results.manifest import Manifest
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.synthesis import drive
from salsanext_cli.synthesis.street import traffic

TINY = {"scans": 2, "spacing": 12.0, "seed": 3}


@contextmanager
def short_street():
    """Build a third of a street, and simulate a sixth of the pulses of the sensor."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("salsanext_cli.synthesis.lidar.AZIMUTH_STEP_DEG", 1.0)
        for module in (drive, traffic):
            patch.setattr(module, "RUN_OUT_M", 20.0)
        yield


@pytest.fixture(scope="module")
def streets(tmp_path_factory):
    """Return a folder with three small sequences, the result and the progress."""
    out = tmp_path_factory.mktemp("synth") / "streets"
    calls, counts = [], dict.fromkeys(("train", "valid", "test"), 1)
    with short_street():
        made = synthesise(out, **counts, **TINY, progress=lambda *done: calls.append(done))
    return out, made, calls


def test_every_file_of_the_layout_is_there(streets):
    out, made, calls = streets
    expected = {"labels.yaml", "synth.json"}
    for sequence in ("00", "01", "02"):
        files = ("poses.txt", "times.txt", "calib.txt")
        expected |= {f"sequences/{sequence}/{file}" for file in files}
        for stem in ("000000", "000001"):
            expected.add(f"sequences/{sequence}/velodyne/{stem}.bin")
            expected.add(f"sequences/{sequence}/labels/{stem}.label")
    assert files_below(out).keys() == expected
    assert made.scans == len(find_scans(out)) == 6
    assert made.splits == {"train": ("00",), "valid": ("01",), "test": ("02",)}
    assert calls == [(n, 3) for n in range(4)]
    splits = {"train": ["00"], "valid": ["01"], "test": ["02"]}
    settings = {"splits": splits, **TINY, "sensor": "hdl64"}
    expected = {"stage": "synth", "version": __version__, "settings": settings}
    assert json.loads((out / "synth.json").read_text()) == expected


def test_scans_and_labels_fit_together(streets):
    out, made, _ = streets
    totals = {}
    for file in find_scans(out):
        scan = read_bin(file.path)
        labels = read_labels(file.label_path, len(scan))
        assert np.isfinite(scan.points).all()
        assert scan.intensity.min() >= 0
        assert scan.intensity.max() <= 1
        assert not label_space().unknown_ids(labels)
        for raw, count in zip(*np.unique(labels, return_counts=True), strict=True):
            totals[int(raw)] = totals.get(int(raw), 0) + int(count)
    assert totals == made.points


def test_label_space_poses_times_and_calibration_have_the_layout_of_semantickitti(streets):
    out, made, _ = streets
    space, real = label_space(out / "labels.yaml"), label_space()
    assert (space.name, space.names) == (real.name, real.names)
    assert space.learning_map == real.learning_map
    np.testing.assert_array_equal(space.colours, real.colours)
    assert space.splits == made.splits
    folder = out / "sequences" / "02"
    poses = np.loadtxt(folder / "poses.txt")
    assert poses.shape == (2, 12)
    np.testing.assert_allclose(poses[0].reshape(3, 4), np.eye(4)[:3], atol=1e-9)
    assert np.linalg.norm(poses[1].reshape(3, 4)[:, 3]) == pytest.approx(12, rel=0.1)
    first, second = np.loadtxt(folder / "times.txt")
    assert first == 0 < second
    assert "Tr: 1 0 0 0 0 1 0 0 0 0 1 0\n" in (folder / "calib.txt").read_text()


def test_the_seed_determines_every_byte_whatever_other_sequences(streets, tmp_path):
    out, _, _ = streets
    with short_street():
        synthesise(tmp_path / "again", train=1, valid=0, **TINY)
    again = files_below(tmp_path / "again/sequences/00")
    assert again == files_below(out / "sequences/00")


@pytest.mark.slow
def test_workers_simulate_the_same_bytes(tmp_path):
    alone, many = (tmp_path / name for name in ("alone", "many"))
    synthesise(alone, train=1, valid=1, **TINY)
    synthesise(many, train=2, valid=0, **TINY, jobs=2)
    for sequence in ("00", "01"):
        again = files_below(many / "sequences" / sequence)
        assert again == files_below(alone / "sequences" / sequence)


@pytest.fixture
def quick(monkeypatch):
    """Record three points instead of a street."""
    monkeypatch.setattr(synth, "record", record)


def test_a_folder_with_other_files_is_refused(tmp_path):
    out = tmp_path / "full"
    scan = out / "sequences" / "00" / "velodyne" / "000000.bin"
    scan.parent.mkdir(parents=True)
    scan.write_bytes(b"precious")
    for overwrite in (False, True):
        for folder in (out, scan):
            with refused(OutputError, folder):
                synthesise(folder, train=1, valid=0, scans=1, overwrite=overwrite)
    assert list(files_below(out).values()) == [b"precious"]


@pytest.fixture
def again(tmp_path, quick):
    """Return a small data set, and a function that replaces it by a data set of one scan."""
    out = tmp_path / "streets"
    synthesise(out, train=1, valid=1, scans=2, spacing=1.0)
    return out, lambda: synthesise(out, train=1, valid=0, scans=1, seed=1, overwrite=True)


def test_overwrite_replaces_generated_files_only(again):
    out, replace = again
    notes = out / "sequences" / "00" / "notes.txt"
    notes.write_text("mine")
    with pytest.raises(OutputError):
        synthesise(out, train=1, valid=0, scans=1)
    replace()
    assert [read_bin(file.path).points[0, 0] for file in find_scans(out, ["00"])] == [1]
    labels = out / "sequences/00/labels/000000.label"
    assert set(out.rglob("*.label")) == {labels}
    names = {"poses.txt", "times.txt", "calib.txt", "notes.txt"}
    assert {path.name for path in out.rglob("*.txt")} == names
    assert notes.read_text() == "mine"
    replace()


def older_version(out, version="0.0"):
    manifest = Manifest(out)
    manifest.write(replace(manifest.record("synth"), version=version))


def test_an_interrupted_run_continues(quick, tmp_path, monkeypatch):
    """The result is that of an uninterrupted run, and existing files stay."""
    how = {"train": 1, "valid": 1, "scans": 2}
    made, expected = synthesise(tmp_path / "whole", **how), files_below(tmp_path / "whole")

    frames, record = [], synth.record

    def stopped(*args):
        for frame in record(*args):
            frames.append(frame)
            if len(frames) == stop_at:
                raise KeyboardInterrupt
            yield frame

    for stop_at in (2, 3):
        out = tmp_path / f"{stop_at}"
        frames.clear()
        with monkeypatch.context() as patched:
            patched.setattr(synth, "record", stopped)
            with pytest.raises(KeyboardInterrupt):
                synthesise(out, **how)
        (out / f".{'0' * 32}.part").write_bytes(b"of a killed process")
        before = {path: path.stat().st_mtime_ns for path in out.rglob("0*.*")}
        assert len(before) == 2 * (stop_at - 1)
        assert synthesise(out, **how) == made
        assert files_below(out) == expected | {f".{'0' * 32}.part": b"of a killed process"}
        assert before == {path: path.stat().st_mtime_ns for path in before}
    # A complete data set needs no open3d, and may be of another version.
    monkeypatch.setitem(sys.modules, "open3d", None)
    older_version(tmp_path / "whole")
    expected = files_below(tmp_path / "whole")
    assert synthesise(tmp_path / "whole", **how) == made
    assert files_below(tmp_path / "whole") == expected


def test_a_partial_data_set_is_completed_by_the_same_settings_only(quick, tmp_path):
    """Not with other settings or another version, nor during another run."""
    out, how = tmp_path / "out", {"train": 1, "valid": 0, "scans": 2}
    synthesise(out, **how)
    (out / "labels.yaml").unlink()
    before = files_below(out)
    refused(OutputError, out / "synth.json", synthesise, out, **how, seed=1)
    older_version(out)
    refused(OutputError, out / "synth.json", synthesise, out, **how)
    older_version(out, __version__)
    with locked(out / ".synth.lock"), pytest.raises(OutputError):
        synthesise(out, **how)
    assert files_below(out) == before


@pytest.mark.parametrize(
    ("name", "recorded"), [("00/velodyne/999999.bin", False), ("00/predictions/000000.label", True)]
)
def test_real_scans_and_results_of_other_stages_stay(again, name, recorded):
    out, replace = again
    path = out / "sequences" / name
    write_bytes(path, b"precious")
    if recorded:
        OwnedFolder(out).write(path, path.read_bytes())
    replace()
    assert path.read_bytes() == b"precious"


def test_a_linked_sequence_keeps_its_scans(again, tmp_path):
    out, replace = again
    folder, elsewhere = out / "sequences/00", tmp_path / "elsewhere"
    folder.rename(elsewhere)
    folder.symlink_to(elsewhere)
    before = files_below(elsewhere)
    refused(OutputError, folder, replace)
    assert files_below(elsewhere) == before


def test_an_edited_file_stays_and_is_named(again, caplog):
    out, replace = again
    label = out / "sequences/01/labels/000000.label"
    label.write_bytes(b"corrected")
    replace()
    assert str(label) in caplog.text
    assert label.read_bytes() == b"corrected"
    (out / "labels.yaml").write_bytes(b"corrected")
    before = files_below(out)
    refused(OutputError, out / "labels.yaml", replace)
    assert files_below(out) == before


def test_without_open3d_nothing_is_written(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(MissingDependency):
        synthesise(tmp_path / "out", train=1, valid=0, scans=1)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "wrong",
    [
        {"train": -1},
        {"train": 0, "valid": 0},
        {"scans": 0},
        {"seed": -1},
        {"spacing": float("nan")},
        {"spacing": 3.0, "scans": 5000},
        {"jobs": 0},
        {"sensor": "hdl32"},
    ],
    ids=str,
)
def test_invalid_settings_are_refused(tmp_path, wrong):
    with pytest.raises(UsageError) as caught:
        synthesise(tmp_path / "out", **wrong)
    assert caught.value.subject.partition(",")[0] in wrong
    assert not (tmp_path / "out").exists()
