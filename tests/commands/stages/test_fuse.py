# SPDX-License-Identifier: MIT
import json
import shlex
import shutil
import sys
from contextlib import ExitStack
from dataclasses import replace

import numpy as np
import pytest
from calls import calls_of
from command_line import called, invoked, only_json
from fused_arrays import fuse
from scans import files_below, refused, write_bin, write_weights
from shallow_network import shallow  # noqa: F401
from world import Stored

from salsanext_cli import KnnParameters, Scan, label_drive, label_space, read_labels, read_scan
from salsanext_cli.commands.line.app import app
from salsanext_cli.commands.line.options.option_names import CommandLine
from salsanext_cli.commands.stages.evaluate import evaluate_scans
from salsanext_cli.commands.stages.fuse import fuse_results, plan_fusion
from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.core.errors import (
    FormatError,
    NoInputError,
    OutputError,
    SalsanextError,
    UsageError,
)
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.wording import spelled
from salsanext_cli.io.poses import encode_poses, read_fused_poses
from salsanext_cli.runs.drives.drive_of_run import drive_of_run
from salsanext_cli.runs.drives.poses_of_sequence import checked_drive
from salsanext_cli.runs.loop.run import RunOptions
from salsanext_cli.runs.loop.run_options import Shard
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.results.making_commands import FUSE
from salsanext_cli.runs.results.output_paths import find_outputs
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.results.query import DATASET_VARIABLE, ResultQuery
from salsanext_cli.runs.results.result_folder import ResultFolder
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.runs.scans.scan_selection import ScanSelection

SPACE = label_space()
STEMS = ("000000", "000001", "000002")


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """Return shallow weights that are confident, with labels of several classes."""
    return write_weights(tmp_path_factory.mktemp("shallow") / "random.safetensors", seed=9)


@pytest.fixture
def world(world):
    """Return the world with the sensor of its scans: nothing here depends on a fit."""
    return world.unfitted()


def way(count):
    """Return the poses of a drive that turns."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    for number, pose in enumerate(poses):
        turn = 0.1 * number
        pose[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
        pose[:2, 3] = 0.2 * number, 0.1 * number
    return poses


def write_drive(world, count):
    """Write scans of one location, with different noise, and their poses; return the folder."""
    folder = world.data / "sequences/08"
    scan, poses = read_scan(world.scan()), way(count)
    for number in range(1, count):
        noise = np.random.default_rng(number).normal(0, 0.02, scan.points.shape)
        seen = (scan.points + noise - poses[number, :3, 3]) @ poses[number, :3, :3]
        moved = Scan(seen.astype(np.float32), scan.intensity)
        write_bin(folder / f"velodyne/{number:06}.bin", moved)
        shutil.copy(folder / "labels/000000.label", folder / f"labels/{number:06}.label")
    (folder / "poses.txt").write_bytes(encode_poses(poses))
    return folder


def typed(hint):
    """Run the command that a hint names."""
    name, *words = shlex.split(hint.split("`")[1])
    assert name == "salsanext"
    called(*words)


def predict_drive(world):
    """Predict a drive of three scans of one place."""
    network = world.unfitted().network
    predict_scans(write_drive(world, 3), world.out, settings=network, extras=("probabilities",))


@pytest.fixture(scope="module")
def once_driven(tmp_path_factory, weights):
    return Stored(tmp_path_factory.mktemp("driven"), weights, predict_drive)


@pytest.fixture
def drive(once_driven):
    """Return a world with predictions of such a drive."""
    return once_driven.restored().unfitted()


def fused_folder(world):
    return world.out / "fused/sequences/08"


def test_labels_equal_the_function(drive):
    single = {stem: drive.labels(stem=stem) for stem in STEMS}
    outcome = fuse_results(drive.out)
    assert (outcome.done, outcome.failures) == (3, ())
    scans = [read_scan(drive.scan(stem=stem)) for stem in STEMS]
    softmax = [np.load(drive.result("probabilities", stem=stem)) for stem in STEMS]
    tallies = fuse(scans, softmax, way(3))
    changed = 0
    for stem, tally in zip(STEMS, tallies, strict=True):
        of_fused = fused_folder(drive)
        labels = SPACE.to_train(single[stem])
        fused = tally.fused(labels)
        written = read_labels(of_fused / f"predictions/{stem}.label")
        np.testing.assert_array_equal(written, SPACE.to_raw(fused))
        np.testing.assert_array_equal(drive.labels(stem=stem), single[stem])
        for folder, of_folder in ((drive.out / "sequences/08", labels), (of_fused, fused)):
            against = np.load(folder / f"uncertainty/disagreement/{stem}.npy")
            np.testing.assert_array_equal(against, tally.disagreement(of_folder))
            np.testing.assert_array_equal(np.load(folder / f"views/{stem}.npy"), tally.scan_counts)
        changed += int((fused != labels).sum())
        assert (tally.scan_counts == 3).mean() > 0.7
    assert changed


def test_fused_labels_are_a_folder_of_results_and_rejected_ones_are_not_fused(drive):
    fuse_results(drive.out)
    results = ResultFolder(drive.out / "fused")
    assert results.manifest.owner("predictions") == "fuse"
    assert results.provenance.weights("predictions") == ResultFolder(drive.out).provenance.weights(
        "predictions"
    )
    assert results.provenance.sensor() == ResultFolder(drive.out).provenance.sensor()
    for folder, kinds in ((drive.out / "fused", set()), (drive.out, {"least_confidence"})):
        scans, space = ResultFolder(folder).predicted(ScanSelection())
        found = evaluate_scans(scans, folder, space).uncertainty
        assert {*found.kinds} >= {"disagreement", *kinds}
    path = drive.out / "predict.json"
    record = json.loads(path.read_text())
    record["settings"] |= {"reject": 0.9, "reject_by": "least_confidence"}
    path.write_text(json.dumps(record))
    refused(OutputError, drive.out, fuse_results, drive.out)


@pytest.mark.usefixtures("workers_in_process")
def test_a_run_goes_on_with_the_same_bytes(drive, tmp_path):
    fuse_results(drive.out)
    before = files_below(fused_folder(drive))
    for stem in STEMS[:2]:
        (fused_folder(drive) / f"predictions/{stem}.label").unlink()
    outcome = fuse_results(drive.out, options=RunOptions(jobs=2))
    assert (outcome.done, outcome.skipped) == (2, 1)
    assert files_below(fused_folder(drive)) == before


def test_new_labels_remove_the_disagreement_with_the_old_ones(drive):
    fuse_results(drive.out)
    predict_scans(
        drive.data / "sequences/08",
        drive.out,
        settings=drive.network,
        knn=KnnParameters(k=1),
        extras=("probabilities",),
        options=RunOptions(overwrite=True),
    )
    assert not any(drive.result("uncertainty/disagreement").parent.iterdir())
    assert not any(drive.result("views").parent.iterdir())


def test_fused_labels_of_refined_ones_are_fused_again(drive):
    fuse_results(drive.out, drive.out / "TARGET")
    record = json.loads((drive.out / "predict.json").read_text())
    record["settings"]["knn"] = None
    (drive.out / "predict.json").write_text(json.dumps(record))
    with spelled(CommandLine()), pytest.raises(OutputError) as caught:
        ResultFolder(drive.out / "TARGET").scans()
    typed(caught.value.hint)
    assert ResultFolder(drive.out / "TARGET").scans()


def test_a_second_folder_for_fused_labels_has_a_hint_that_works(drive):
    """The disagreement beside the labels of single scans is of the first fusion."""
    fuse_results(drive.out)
    first = files_below(fused_folder(drive))
    with spelled(CommandLine()):
        caught = refused(OutputError, drive.out, fuse_results, drive.out, drive.out / "other")
    assert "another folder" in caught.value.problem
    typed(caught.value.hint)
    assert files_below(drive.out / "other/sequences/08") == first
    assert files_below(fused_folder(drive)) == first


def test_results_of_a_moved_data_set_are_fused_by_the_command_of_the_hint(
    drive, tmp_path, monkeypatch, caplog
):
    recorded = drive.data
    other = shutil.copytree(drive.data, tmp_path / "other")
    for function in (fuse_results, plan_fusion):
        refused(OutputError, drive.out, function, drive.out, query=ResultQuery(dataset=other))
    assert not (drive.out / "fused").exists()
    moved = drive.data.rename(tmp_path / "moved")
    with spelled(CommandLine()):
        hint = f"`{FUSE.text(drive.out, find_scans(moved))}`"
    typed(hint)
    assert [*find_outputs(drive.out / "fused", "predictions")] == [("08", stem) for stem in STEMS]
    monkeypatch.setenv(DATASET_VARIABLE, str(moved))
    caplog.clear()
    with caplog.at_level(NOTICE):
        assert fuse_results(drive.out).skipped == len(STEMS)
    (line,) = [text for text in caplog.messages if str(recorded) in text]
    assert line.endswith(f"are taken from {moved}")
    monkeypatch.delenv(DATASET_VARIABLE)
    called("eval", drive.out / "fused")
    moved.rename(tmp_path / "moved again")
    typed(hint.replace(str(moved), f"'{tmp_path / 'moved again'}'"))


def test_votes_of_other_scans_are_not_mixed(drive):
    hidden = drive.result("probabilities", stem="000002")
    hidden.rename(hidden.with_suffix(".hidden"))
    assert [scan.stem for scan in fuse_results(drive.out).missing.scans] == ["000002"]
    hidden.with_suffix(".hidden").rename(hidden)
    record = fused_folder(drive) / "drive.json"
    with spelled(CommandLine()):
        caught = refused(OutputError, record, fuse_results, drive.out)
    typed(caught.value.hint)
    assert fuse_results(drive.out).skipped == 3
    record.unlink()
    refused(OutputError, record, fuse_results, drive.out)


def test_unpadded_numbers_are_in_order_for_labels_and_poses(world):
    folder = write_drive(world, 3)
    for name, number in zip(STEMS, ("9", "10", "11"), strict=True):
        for kind, suffix in (("velodyne", "bin"), ("labels", "label")):
            (folder / f"{kind}/{name}.{suffix}").rename(folder / f"{kind}/{number}.{suffix}")
    poses = way(3)
    poses[2, 0, 3] = 500
    (folder / "poses.txt").write_bytes(encode_poses(poses))
    predict_scans(folder, world.out, settings=world.network, extras=("votes",))
    fuse_results(world.out)
    views = {n: np.load(fused_folder(world) / f"views/{n}.npy").max() for n in ("9", "10", "11")}
    assert views == {"9": 2, "10": 2, "11": 1}
    record = json.loads((fused_folder(world) / "drive.json").read_bytes())
    assert record["scans"] == ["9", "10", "11"]
    assert np.loadtxt(fused_folder(world) / "poses.txt")[:, 3].argmax() == 2


def test_a_drive_in_parts_is_a_finding(drive):
    poses = way(3)
    poses[2, 0, 3] = 500
    (drive.data / "sequences/08/poses.txt").write_bytes(encode_poses(poses))
    for _ in range(2):
        result = called("fuse", drive.out, "--json")
        ((warning),) = [w for w in only_json(result)["warnings"] if w["code"] == "apart"]
        assert warning["scans"] == ["08"]
        assert "2 parts" in warning["message"]
        assert "000002" in warning["message"]
        assert result.stderr.count("apart") == 1


def test_a_sequence_with_bad_poses_fails_alone(world, caplog):
    write_drive(world, 2)
    bad = world.data / "sequences/00/poses.txt"
    bad.write_bytes(b"no poses")
    words = ["--weights", str(world.network.weights), "--engine", "torch", "--json"]
    words = ["predict", str(world.data), str(world.out), "--fuse", *words]
    called(*words, "--on-error", "stop", status=1)
    assert not world.out.exists()
    for command, done in ((words, 3), (["fuse", str(world.out), "--json"], 0)):
        found = only_json(called(*command, status=1))
        assert (found["done"], found["failed"]) == (done, 1)
        assert found["failures"][0]["code"] == "format"
        assert str(bad) in found["failures"][0]["reason"]
    assert len(list((fused_folder(world) / "predictions").iterdir())) == 2
    with pytest.raises(FormatError):
        fuse_results(world.out, options=RunOptions(on_error="stop"))
    caplog.clear()
    names = [each.name for each in label_drive(world.data, world.network.weights)]
    assert names == ["08/000000", "08/000001"]
    assert str(bad) in caplog.records[-1].message
    bad.write_bytes(encode_poses(way(1)))
    assert fuse_results(world.out).done == 1


def test_a_calibration_without_tr_has_a_hint_that_works(drive, tmp_path):
    folder = drive.data / "sequences/08"
    (folder / "calib.txt").write_text("P0: 1 0 0 0 0 1 0 0 0 0 1 0\n")
    caught = refused(FormatError, folder / "calib.txt", fuse_results, drive.out)
    assert 'poses="FILE"' in caught.value.hint
    # The poses of the drive are those of the scanner.
    path = shutil.move(folder / "poses.txt", tmp_path / "poses.txt")
    assert fuse_results(drive.out, poses=path).done == 3


def test_poses_may_be_named_for_one_sequence(world, tmp_path):
    (write_drive(world, 3) / "poses.txt").unlink()
    predict_scans(world.data, world.out, settings=world.network, extras=("votes",))
    half = [0.05 * number for number in range(3)]
    lines = [f"{n} {0.2 * n} {0.1 * n} 0 0 0 {np.sin(h)} {np.cos(h)}" for n, h in enumerate(half)]
    path = tmp_path / "tum.txt"
    path.write_text("\n".join(lines))
    words = ["fuse", str(world.out), "--poses", str(path)]
    called(*words, status=2)
    assert not (world.out / "fused").exists()
    called(*words, "--sequences", "08")
    used = read_fused_poses(fused_folder(world) / "poses.txt", STEMS)
    np.testing.assert_allclose(used, way(3), atol=1e-12)
    path.write_text("\n".join(lines[1:]))
    called(*words, "--sequences", "08", status=1)


def test_names_that_count_from_1_find_their_lines(world, caplog):
    folder = write_drive(world, 3)
    turned = way(3)[2] @ np.diag([-1.0, -1, 1, 1])
    (folder / "poses.txt").write_bytes(encode_poses([*way(3), turned]))
    stems = ["000001", "000002", "000003"]
    for old, new in reversed([*zip(STEMS, stems, strict=True)]):
        (folder / f"velodyne/{old}.bin").rename(folder / f"velodyne/{new}.bin")
    predict_scans(folder, world.out, settings=world.network, extras=("votes",))
    with caplog.at_level(NOTICE):
        assert fuse_results(world.out).done == 3
    used = read_fused_poses(fused_folder(world) / "poses.txt", stems)
    np.testing.assert_array_equal(used, way(3))
    assert "line numbers counted from 1" in caplog.text


def test_unfusible_results_are_refused(world, drive):
    refused(UsageError, "TARGET", fuse_results, drive.out, drive.out)
    with pytest.raises(NoInputError, match="77"):
        fuse_results(drive.out, query=ResultQuery(selection=ScanSelection(sequences=("77",))))
    poses = drive.data / "sequences/08/poses.txt"
    poses.write_bytes(encode_poses(way(2)))
    with pytest.raises(FormatError):
        fuse_results(drive.out)
    shutil.rmtree(drive.out / "sequences/08/probabilities")
    with pytest.raises(NoInputError, match='extras=\\("votes",\\)'):
        fuse_results(drive.out)
    with spelled(CommandLine()), pytest.raises(NoInputError) as caught:
        fuse_results(drive.out)
    command = shlex.split(caught.value.hint.partition("`")[2].partition("`")[0])
    folder = drive.data / "sequences/08/velodyne"
    assert command[:4] == ["salsanext", "predict", str(folder), str(drive.out)]
    assert command[command.index("--weights") + 1] == str(drive.network.weights)
    assert command[-1] == "--fuse"
    assert not fused_folder(drive).exists()


def test_damaged_votes_and_votes_for_unknown_classes_fail_alone(drive):
    drive.result("probabilities", stem="000001").write_bytes(b"no array")
    outcome = fuse_results(drive.out)
    assert [failure.scan.stem for failure in outcome.failures] == ["000001"]
    assert np.load(fused_folder(drive) / "views/000000.npy").max() == 2
    shutil.rmtree(drive.out / "sequences/08/probabilities")
    folder = drive.data / "sequences/08"
    again = RunOptions(overwrite=True)
    predict_scans(folder, drive.out, settings=drive.network, extras=("votes",), options=again)
    np.save(drive.result("votes"), np.full((1500, 3), 200 * 256, np.uint16))
    outcome = fuse_results(drive.out, options=again)
    assert [failure.code for failure in outcome.failures] == ["format"]
    assert np.load(fused_folder(drive) / "views/000001.npy").max() == 2


def test_computed_poses_are_written_and_used_again(drive):
    pytest.importorskip("small_gicp")
    (drive.data / "sequences/08/poses.txt").unlink()
    fuse_results(drive.out)
    before = files_below(fused_folder(drive))
    assert len((fused_folder(drive) / "poses.txt").read_text().splitlines()) == 3
    (fused_folder(drive) / "predictions/000001.label").unlink()
    assert fuse_results(drive.out).done == 1
    assert files_below(fused_folder(drive)) == before


def test_a_scan_that_is_gone_is_named_once(drive, caplog):
    drive.scan(stem="000002").unlink()
    fuse_results(drive.out)
    assert caplog.text.count("1 scan with results skipped") == 1


def test_edited_poses_are_neither_used_nor_replaced(drive):
    fuse_results(drive.out)
    path, moved = fused_folder(drive) / "poses.txt", way(3)
    moved[:, 1, 3] += 1
    path.write_bytes(encode_poses(moved))
    for overwrite in (False, True):
        refused(OutputError, path, fuse_results, drive.out, options=RunOptions(overwrite=overwrite))


@pytest.mark.parametrize(
    ("change", "subject"), [({"parts": ["x"]}, "drive.json"), ({"poses": "0"}, "poses.txt")]
)
def test_a_damaged_record_of_a_drive_is_refused(drive, change, subject):
    fuse_results(drive.out)
    path = fused_folder(drive) / "drive.json"
    path.write_text(json.dumps(json.loads(path.read_bytes()) | change))
    refused(SalsanextError, path.with_name(subject), fuse_results, drive.out)


def shifted(folder, metres):
    """Write poses by which a drive is elsewhere."""
    poses = way(3)
    poses[:, 0, 3] += metres
    (folder / "sequences/08/poses.txt").write_bytes(encode_poses(poses))


def test_a_killed_run_by_other_poses_leaves_no_labels_of_the_earlier_ones(drive):
    overwrite = RunOptions(overwrite=True)
    shifted(drive.data, 0.07)
    fuse_results(drive.out)
    labels = fused_folder(drive) / "predictions"
    expected = files_below(labels)
    shifted(drive.data, 0.2)
    fuse_results(drive.out, options=overwrite)
    shifted(drive.data, 0.07)

    def end_after_the_first(done, total):
        if done:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fuse_results(drive.out, options=replace(overwrite, progress=end_after_the_first))
    assert fuse_results(drive.out).done == 2
    assert files_below(labels) == expected


def test_predict_can_fuse_at_once(world):
    folder = write_drive(world, 2)
    words = ["predict", folder, world.out, "--weights", world.network.weights, "--fuse", "--json"]
    result = called(*words, "--engine", "torch")
    found = only_json(result)
    assert (found["done"], shlex.split(found["next"])[-1]) == (2, str(world.out / "fused"))
    assert len(list((fused_folder(world) / "predictions").iterdir())) == 2
    (folder / "poses.txt").write_bytes(b"nan " * 12 + b"\n" + b"1 " * 12)
    words[2] = world.out.with_name("never")
    called(*words, "--engine", "torch", status=1)
    assert not words[2].exists()
    words[2] = world.out
    called(*words, "--engine", "torch", "--shard", "1/2", status=2)
    votes = np.load(world.result("votes"))
    assert (votes.dtype, votes.shape) == (np.uint16, (1500, 3))
    assert not world.result("probabilities").exists()


def test_two_that_predict_and_fuse_one_folder_both_succeed(world, monkeypatch):
    """The other one still predicts when this one has ended, and then fuses too."""
    folder, looks = write_drive(world, 2), []
    with ExitStack() as other:

        def wait(_):
            assert not (world.out / "fused").exists()
            looks.append(len(looks))
            if len(looks) == 2:
                other.close()

        monkeypatch.setattr("salsanext_cli.commands.line.commands.predict.time.sleep", wait)
        other.enter_context(OwnedFolder(world.out, "predict").open(shared=True))
        words = ["predict", folder, world.out, "--weights", world.network.weights, "--fuse"]
        result = invoked(app, *words, "--engine", "torch")
    assert result.exit_code == 0, result.output
    assert len(looks) == 2
    assert len(list((fused_folder(world) / "predictions").iterdir())) == 2


def test_python_labels_a_drive_as_the_command_line_does(world, caplog, monkeypatch):
    folder, weights = write_drive(world, 3), world.network.weights
    (folder / "velodyne/000001.bin").write_bytes(b"damaged")
    settings = NetworkSettings(weights, precision="auto")
    predict_scans(folder, world.out, settings=settings, extras=("votes",))
    fuse_results(world.out)
    single = [world.labels(stem=stem) for stem in ("000000", "000002")]
    caplog.clear()
    found = [*label_drive(str(folder), str(weights))]
    assert [each.name for each in found] == ["08/000000", "08/000002"]
    assert "000001.bin" in caplog.text
    for each, raw in zip(found, single, strict=True):
        stem = each.name[3:]
        np.testing.assert_array_equal(each.scan.points, read_scan(world.scan(stem=stem)).points)
        written = read_labels(fused_folder(world) / f"predictions/{stem}.label")
        np.testing.assert_array_equal(SPACE.to_raw(each.labels), written)
        assert (written != raw).any()
        against = np.load(fused_folder(world) / f"uncertainty/disagreement/{stem}.npy")
        np.testing.assert_array_equal(each.disagreement, against)
    (folder / "poses.txt").unlink()
    monkeypatch.setitem(sys.modules, "small_gicp", None)
    with pytest.raises(SalsanextError, match=r"\[fuse\]"):
        next(label_drive(folder, weights))


def test_a_share_needs_the_drives_of_its_sequences_only(world):
    write_drive(world, 3)
    (world.data / "sequences/00/poses.txt").write_bytes(encode_poses(way(1)))
    predict_scans(world.data, world.out, settings=world.network, extras=("probabilities",))
    steps = (checked_drive, drive_of_run) * 2
    sequences = ("00", "08", "08", "08")
    for number, (step, sequence) in enumerate(zip(steps, sequences, strict=True), start=1):
        with calls_of(step) as calls:
            outcome = fuse_results(world.out, options=RunOptions(shard=Shard(number, 4)))
        assert outcome.done == 1
        assert [call["files"][0].sequence for call in calls] == [sequence]
    assert fuse_results(world.out).skipped == 4


def test_sequences_are_fused_one_after_the_other_whatever_was_found(world):
    write_drive(world, 2)
    (world.data / "sequences/00/poses.txt").write_bytes(encode_poses(way(1)))
    predict_scans(world.data, world.out, settings=world.network, extras=("probabilities",))
    for sequence, codes in (("00", {"apart"}), ("08", set())):
        query = ResultQuery(selection=ScanSelection(sequences=(sequence,)))
        outcome = fuse_results(world.out, query=query)
        assert outcome.summary.findings.by_code.keys() == codes
    assert {*OwnedFolder(world.out / "fused", "fuse").findings()} == {"00"}
