# SPDX-License-Identifier: MIT
"""Runs of stages in an output folder: records, refusals, foreign files, disturbances."""

import json
import os
import shutil
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from recorded_runs import KNN, SETTINGS, TYPED, predict, scans_of
from scans import files_below, labels_below, refused, write_sequence, write_weights
from world import begin_and_end

from salsanext_cli import __version__, label_space, sensor
from salsanext_cli.commands.stages.predict import PredictJob, predict_scans
from salsanext_cli.core.checks.finding import Finding
from salsanext_cli.core.checks.warning_codes import WarningCode
from salsanext_cli.core.errors import OutputError, WeightsError
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.io.files.atomic import STALE_AFTER_S
from salsanext_cli.io.files.reading import fingerprint
from salsanext_cli.runs.loop.network_task import NetworkTask
from salsanext_cli.runs.loop.run import RunOptions, run_over_scans
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.records.stage_settings import (
    ExportSettings,
    PredictSettings,
    UncertaintySettings,
)
from salsanext_cli.runs.results.manifest import Manifest
from salsanext_cli.runs.results.output_run import OutputRun, output_run
from salsanext_cli.runs.results.provenance import Provenance
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_search import find_scans

LABELS = np.full(5, 10, np.uint32)


def predicted(out: Path, scans: list[ScanFile], settings=SETTINGS) -> list[Path]:
    """Write labels of scans as a run does; return their paths."""
    output = predict(out, settings, scans=scans)
    for scan in scans:
        output.write_labels(scan, LABELS)
    return [output.path(scan, "predictions") for scan in scans]


def test_the_record_of_a_run(tmp_path: Path) -> None:
    scans = scans_of(tmp_path, "a", "b")
    predict(tmp_path / "out", scans=scans)
    assert json.loads((tmp_path / "out/predict.json").read_text()) == {
        "stage": "predict",
        "version": __version__,
        "settings": SETTINGS,
        "writes": ["predictions"],
        "scans": {"08": {"folder": str(scans[0].path.parent), "asked_for": ["a.bin", "b.bin"]}},
    }
    records = Manifest(tmp_path / "out")
    assert records.settings("predict") == PredictSettings(weights="abc", knn=KnnParameters())
    assert records.settings("project") is None
    assert (records.owner("predictions"), records.owner("range")) == ("predict", None)


def test_runs_of_the_same_settings_may_write_more(tmp_path: Path) -> None:
    scans = scans_of(tmp_path, "a", "b")
    predict(tmp_path, scans=scans)
    predict(tmp_path, folders=("predictions", "pixel_labels"), scans=scans[:1])
    before = files_below(tmp_path)
    predict(tmp_path, scans=scans[1:])
    assert files_below(tmp_path) == before
    record = Manifest(tmp_path).record("predict")
    assert record.writes == ("pixel_labels", "predictions")
    assert {*record.scans["08"].suffixes} == {"a", "b"}


@pytest.mark.parametrize(
    ("other", "named"),
    [
        ({"weights": "abc", "knn": KNN | {"k": 7}}, ["knn.k was 5 and is 7"]),
        (SETTINGS | {"reject": 0.5}, ["reject was not set and is 0.5"]),
        ({"weights": "abc"}, ["knn.k was 5 and is not set", "knn.sigma was 1.0 and is not set"]),
    ],
)
def test_other_settings_are_refused_and_named(tmp_path: Path, other, named: list[str]) -> None:
    predict(tmp_path)
    before = files_below(tmp_path)
    caught = refused(OutputError, tmp_path / "predict.json", predict, tmp_path, other)
    assert all(difference in caught.value.problem for difference in named)
    assert "overwrite=True" in caught.value.hint
    assert files_below(tmp_path) == before
    first = Provenance(tmp_path).origins(["predict", "uncertainty"])
    predict(tmp_path, other, overwrite=True)
    assert first.keys() == {"predict"}
    assert Provenance(tmp_path).origins(["predict"]) != first
    assert list(files_below(tmp_path)) == ["predict.json"]


def test_overwriting_removes_what_was_written_with_other_settings(tmp_path: Path) -> None:
    """The recorded scans go too; with the same settings nothing is removed."""
    scans = scans_of(tmp_path, "a", "b")
    paths = predicted(tmp_path / "out", scans)
    predict(tmp_path / "out", scans=scans, overwrite=True)
    assert all(path.exists() for path in paths)
    predict(tmp_path / "out", {"weights": "new"}, scans=scans[:1], overwrite=True)
    assert not any(path.exists() for path in paths)
    assert {*Manifest(tmp_path / "out").record("predict").scans["08"].suffixes} == {"a"}


def test_overwriting_does_not_remove_foreign_files(tmp_path, caplog):
    """They are a corrected label, results of others, notes, and a sequence behind a link."""
    out = tmp_path / "out"
    scans = scans_of(tmp_path, "a", "b")
    ours, corrected = predicted(out, scans)
    corrected.write_bytes(b"corrected by hand...")
    foreign = out / "sequences/99/predictions/a.label"
    foreign.parent.mkdir(parents=True)
    foreign.write_bytes(b"mine")
    notes = ours.with_name("notes.txt")
    notes.write_text("mine")
    (linked,) = predicted(out, scans_of(tmp_path, "c", sequence="05"))
    sequence = linked.parents[1].rename(tmp_path / "elsewhere")
    (out / "sequences/05").symlink_to(sequence)

    with output_run(
        out, "predict", PredictSettings(weights="new"), ("predictions",), scans, overwrite=True
    ) as output:
        assert output.foreign == {corrected}
        output.require_replaceable(scans[0])
        refused(OutputError, corrected, output.require_replaceable, scans[1])
    assert json.loads((out / "predict.json").read_text())["foreign"] == [
        str(path.relative_to(out)) for path in (linked, corrected, foreign)
    ]
    # It is no result of the new settings in the next run either, until it is moved.
    again = predict(out, {"weights": "new"}, scans=scans)
    assert (again.is_done(scans[1]), again.foreign) == (False, {corrected})
    corrected.unlink()
    again.write_labels(scans[1], np.uint32([40]))
    assert predict(out, {"weights": "new"}, scans=scans).is_done(scans[1])
    corrected.write_bytes(b"corrected by hand...")
    assert not ours.exists()
    assert corrected.read_bytes() == b"corrected by hand..."
    assert (sequence / "predictions/c.label").exists()
    assert foreign.exists()
    assert notes.exists()
    for path in (corrected, foreign, linked):
        assert str(path) in caplog.text


def test_results_of_another_stage_are_refused(tmp_path: Path) -> None:
    (path,) = predicted(tmp_path, scans_of(tmp_path, "a"))
    refine = (tmp_path, "knn-refine", {}, ["predictions"])
    refused(OutputError, tmp_path / "predict.json", begin_and_end, *refine)
    assert path.exists()
    begin_and_end(*refine, overwrite=True)
    assert Manifest(tmp_path).owner("predictions") == "knn-refine"
    assert not path.exists()


def test_results_that_no_stage_recorded(tmp_path: Path) -> None:
    """They are refused in further folders of the same stage too."""
    out, scans = tmp_path / "out", scans_of(tmp_path, "a", "b")
    for folder, name in (("predictions", "a.label"), ("probabilities", "a.npy")):
        path = out / "sequences/08" / folder / name
        path.parent.mkdir(parents=True)
        path.write_bytes(b"mine")
        refused(OutputError, path, predict, out, folders=("predictions", folder), scans=scans)
        output = predict(out, folders=("predictions", folder), scans=scans, overwrite=True)
        assert path in output.foreign
        assert path.read_bytes() == b"mine"


def test_label_space_and_sensor_are_those_of_the_stage_that_wrote(tmp_path: Path) -> None:
    records, space, hdl32 = Provenance(tmp_path), label_space(), sensor("hdl32")
    assert (records.label_space(), records.sensor()) == (None, sensor("hdl64"))
    predict(tmp_path, {"label_space": space.to_dict(), "sensor": hdl32.to_dict()})
    recorded = records.label_space()
    assert (recorded.to_dict(), records.sensor()) == (space.to_dict(), hdl32)


def test_another_source_of_the_same_name_is_refused_before_anything_is_removed(tmp_path) -> None:
    predicted(tmp_path / "out", scans_of(tmp_path, "a"))
    before = files_below(tmp_path / "out")
    other = find_scans(write_sequence(tmp_path / "other/08", ["a"]))
    with refused(OutputError, tmp_path / "out"):
        predict(tmp_path / "out", {"weights": "new"}, scans=other, overwrite=True)
    assert files_below(tmp_path / "out") == before
    with refused(OutputError, tmp_path / "new"):
        predict(tmp_path / "new", scans=[*scans_of(tmp_path, "a"), *other])
    assert not (tmp_path / "new").exists()


def test_results_of_running_stages_are_not_removed(tmp_path: Path) -> None:
    """A refused run removes nothing else either; the lock of a killed run has no effect."""
    out, scans = tmp_path / "out", scans_of(tmp_path, "a")
    (path,) = predicted(out, scans)
    begin_and_end(out, "knn-refine", {}, ["pixel_labels"], scans)
    before = files_below(out)
    with output_run(out, "predict", TYPED, ("predictions",), scans, overwrite=False):
        for stage in ("predict", "knn-refine"):
            with refused(OutputError, out):
                begin_and_end(out, stage, {"seed": 3}, ["predictions"], scans, overwrite=True)
    assert files_below(out) == before
    (out / f".predict.{'0' * 32}.lock").touch()
    predict(out, {"weights": "new"}, overwrite=True)
    assert not path.exists()
    assert sorted(files_below(out)) == ["knn-refine.json", "predict.json"]


@pytest.mark.parametrize("settings", [SETTINGS, {"weights": "new"}])
def test_the_lock_of_a_killed_run_is_removed_by_the_next(tmp_path: Path, settings) -> None:
    predicted(tmp_path, scans_of(tmp_path, "a"))
    left = tmp_path / f".predict.{'0' * 32}.lock"
    left.touch()
    predict(tmp_path, settings, overwrite=True)
    assert not left.exists()


def test_runs_side_by_side(tmp_path: Path) -> None:
    """They have the same settings, or are of stages that fill other folders."""
    (path,) = predicted(tmp_path, scans_of(tmp_path, "a"))
    first = (tmp_path, "predict", TYPED, ["predictions"], ())
    export = (tmp_path, "export-ply", ExportSettings(colour="label"), ["ply"])
    with (
        output_run(*first, overwrite=True),
        output_run(*first, overwrite=False),
        output_run(*export, (), overwrite=False),
    ):
        assert path.exists()
        begin_and_end(*export[:2], {"colour": "label"}, ["ply"], overwrite=True)
        with refused(OutputError, tmp_path):
            begin_and_end(*export[:2], {"colour": "range"}, ["ply"], overwrite=True)
    assert path.exists()


def test_records_contain_the_scans_of_all_runs(tmp_path: Path) -> None:
    stems = [f"{number:03d}" for number in range(40)]
    predicted(tmp_path, scans_of(tmp_path, "first"))
    with ThreadPoolExecutor(8) as threads:
        list(threads.map(lambda s: predict(tmp_path, scans=scans_of(tmp_path, s)), stems))
    assert {*Manifest(tmp_path).record("predict").scans["08"].suffixes} == {*stems, "first"}


def test_the_first_run_without_results_is_withdrawn_and_others_are_not(tmp_path: Path) -> None:
    out = tmp_path / "a/b"
    scans = scans_of(tmp_path, "a")
    run = (out, "predict", TYPED, ("predictions",), scans)

    def fail() -> None:
        with output_run(*run, overwrite=False):
            assert (out / "predict.json").exists()
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert not (tmp_path / "a").exists()
    with output_run(*run, overwrite=False) as output:
        output.write_labels(scans[0], np.uint32([40]))
    with output_run(*run, overwrite=True):
        output.path(scans[0], "predictions").unlink()
    assert (out / "predict.json").exists()


def test_the_warnings_of_a_run_without_results_are_withdrawn_too(tmp_path: Path) -> None:
    """As of a scan that was checked, and could not be labelled."""
    out = tmp_path / "out"
    scans = scans_of(tmp_path, "a")
    findings = {"08/a": [Finding(WarningCode.SPARSE, "few rows", "look")]}
    run = (out, "predict", TYPED, ("predictions",), scans)
    with output_run(*run, overwrite=False) as output:
        output.record_findings(findings, {"08/a"})
        assert (out / "predict.warnings.json").exists()
    assert not out.exists()
    with output_run(*run, overwrite=False) as output:
        output.record_findings(findings, {"08/a"})
        output.write_labels(scans[0], np.uint32([40]))
    assert output.findings() == findings


def test_a_file_of_digests_stays_while_a_record_names_it(tmp_path: Path) -> None:
    digests = PredictSettings(weights="abc", trained_on="0" * 24)
    scans = scans_of(tmp_path, "a")
    with output_run(
        tmp_path, "predict", digests, ("predictions",), scans, overwrite=False
    ) as output:
        output.write_labels(scans[0], np.uint32([40]))
    (named,) = tmp_path.glob("digests-*")
    other = UncertaintySettings(weights="abc", trained_on="0" * 24)
    with output_run(
        tmp_path, "uncertainty", other, ("uncertainty/epistemic",), scans, overwrite=False
    ):
        assert (tmp_path / "uncertainty.json").exists()
    assert not (tmp_path / "uncertainty.json").exists()
    assert named.exists()
    assert (tmp_path / "predict.json").exists()


def test_a_folder_of_the_user_stays_if_a_run_has_no_results(tmp_path: Path) -> None:
    with output_run(tmp_path, "predict", TYPED, ("predictions",), (), overwrite=False):
        (tmp_path / "notes.txt").write_text("mine")
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_old_temporary_files_are_removed(tmp_path: Path) -> None:
    """Other runs may be writing, and other hidden files stay."""
    out, mark, old = tmp_path / "out", "0123456789abcdef" * 2, STALE_AFTER_S + 60
    folder = out / "sequences/08/predictions"
    gone = [place / f".{mark}.part" for place in (folder, folder.parent, out)]
    gone.append(folder / f".{mark}{mark}.part")
    others = {
        folder / f".{mark[::-1]}.part": STALE_AFTER_S - 60,
        folder / f".{'f' * 32}.part": -old,
        folder / ".mine.part": old,
        folder / f"{mark}.part": old,
    }
    for path, age in (dict.fromkeys(gone, old) | others).items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"half")
        then = path.stat().st_mtime - age
        os.utime(path, (then, then))
    predict(out, scans=scans_of(tmp_path, "a"))
    assert [path for path in gone if path.exists()] == []
    assert [path for path in others if not path.exists()] == []


def run(world, meddle: Callable[[], object] = lambda: None, **options):
    """Predict, and call `meddle` after the first scan."""

    def progress(done: int, _: int) -> None:
        if done == 1:
            meddle()

    options = RunOptions(progress=progress, **options)
    return predict_scans(world.data, world.out, settings=world.network, options=options)


def test_a_scan_that_is_deleted(world, tmp_path):
    """It is the fourth, because the third may be read before the first is done."""
    write_sequence(world.data / "sequences/08", ["000000", "000001", "000002"])
    predict_scans(world.data, tmp_path / "whole", settings=world.network)
    path = world.scan("08", "000002")
    content = path.read_bytes()
    outcome = run(world, path.unlink)
    assert (outcome.done, len(outcome.failures)) == (3, 1)
    assert outcome.failures[0].reason.startswith(f"{path}: ")
    path.write_bytes(content)
    assert run(world).done == 1
    assert labels_below(world.out) == labels_below(tmp_path / "whole")


@pytest.mark.slow
def test_workers_refuse_replaced_weights(world, tmp_path):
    """A training that goes on may replace them before a worker loads them."""
    weights = tmp_path / "w.safetensors"
    shutil.copy(world.network.weights, weights)
    network = NetworkSettings(weights, "cpu").load()
    settings = NetworkSettings(weights, "cpu").resolved(network)
    write_weights(weights, seed=1)
    output = OutputRun(world.out, folders=("predictions",))
    job = partial(PredictJob, knn=KnnParameters(), output=output)
    task = NetworkTask(job=job, settings=settings, network=network)
    refused(WeightsError, weights, run_over_scans, task, find_scans(world.data), RunOptions(jobs=2))
    assert labels_below(world.out) == {}


def test_an_output_folder_that_is_deleted(world, tmp_path):
    """The deleted results do not count as done."""
    predict_scans(world.data, tmp_path / "whole", settings=world.network)
    refused(OutputError, world.out, run, world, lambda: shutil.rmtree(world.out))
    with pytest.raises(OutputError):
        run(world)
    assert run(world, overwrite=True).done == 3
    assert labels_below(world.out) == labels_below(tmp_path / "whole")


def test_a_file_replaced_by_one_of_the_same_size_and_time(tmp_path):
    """A clock that was set back, or a copy with the same times, can have this effect."""
    digests = []
    for content in (b"one", b"two"):
        (tmp_path / "new").write_bytes(content)
        os.utime(tmp_path / "new", (1, 1))
        (tmp_path / "new").replace(tmp_path / "file")
        digests.append(fingerprint(tmp_path / "file"))
    assert digests[0] != digests[1]
