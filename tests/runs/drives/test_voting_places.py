# SPDX-License-Identifier: MIT
"""Places of votes: scans that were moved are fused, those of other data sets are not."""

import json
import shlex
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from command_line import called
from scans import files_below, refused, write_bin
from world import Stored, begin_and_end

from salsanext_cli import read_scan
from salsanext_cli.commands.line.options.option_names import CommandLine
from salsanext_cli.commands.stages.fuse import fuse_results, plan_fusion
from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.core.errors import NoInputError, OutputError
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.wording import spelled
from salsanext_cli.runs.drives.voting_places import MovedFolder, voting_places
from salsanext_cli.runs.loop.run_options import RunOptions, Shard
from salsanext_cli.runs.results.making_commands import FUSE, making_hint
from salsanext_cli.runs.results.output_paths import find_outputs
from salsanext_cli.runs.results.query import DATASET_VARIABLE, ResultQuery
from salsanext_cli.runs.results.scan_places import PlaceState, place_state
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.runs.scans.scan_selection import ScanSelection

POSE = b"1 0 0 0 0 1 0 0 0 0 1 0\n"

FIRST = ResultQuery(selection=ScanSelection(limit=1))


def vote(world):
    """Predict drives of one and of two scans, which do not move, with votes."""
    shutil.copy(world.scan(), world.scan(stem="000001"))
    for sequence, count in (("00", 1), ("08", 2)):
        (world.data / "sequences" / sequence / "poses.txt").write_bytes(POSE * count)
    predict_scans(world.data, world.out, settings=world.network, extras=("votes",))


@pytest.fixture(scope="module")
def once_voted(tmp_path_factory, weights):
    return Stored(tmp_path_factory.mktemp("voted"), weights, vote)


@pytest.fixture
def voted(once_voted):
    """Return the world with votes in the drives."""
    return once_voted.restored()


def other_data(world, folder: Path) -> Path:
    """Write other scans with the names and numbers of points of those of the world."""
    shutil.copytree(world.data, folder)
    for path in folder.glob("sequences/*/velodyne/*.bin"):
        scan = read_scan(path)
        write_bin(path, replace(scan, points=scan.points[:, [1, 0, 2]]))
    return folder


def ask(world, scans):
    """Write the record that `predict` writes before its first scan."""
    begin_and_end(world.out, "predict", {}, ["predictions"], scans)


def test_scans_of_the_current_folder_are_not_fused_while_the_recorded_ones_are_gone(
    voted, tmp_path, monkeypatch
):
    other = other_data(voted, tmp_path / "other")
    before = files_below(voted.out)
    voted.data.rename(tmp_path / "unmounted")
    monkeypatch.chdir(other)
    monkeypatch.delenv(DATASET_VARIABLE, raising=False)
    for function in (fuse_results, plan_fusion):
        refused(NoInputError, voted.out / "sequences/00", function, voted.out)
    result = called("fuse", voted.out, status=1)
    assert "--dataset" in result.stderr
    assert files_below(voted.out) == before


def test_the_place_of_moved_scans_is_recorded_beside_their_votes(voted, tmp_path, monkeypatch):
    other = other_data(voted, tmp_path / "other")
    hidden = voted.data.rename(tmp_path / "unmounted")
    monkeypatch.setenv(DATASET_VARIABLE, str(other))
    assert fuse_results(voted.out).done == 3
    record = json.loads((voted.out / "fuse.json").read_bytes())
    places = {name: str(other / "sequences" / name / "velodyne") for name in ("00", "08")}
    assert record["moved"] == places
    assert "scans" not in record, "further results are of those that `predict` recorded"
    # Labels by votes of the other scans are not taken for those of the recorded ones.
    hidden.rename(voted.data)
    before = files_below(voted.out / "sequences")
    caught = refused(OutputError, voted.out, fuse_results, voted.out)
    assert "overwrite" in caught.value.hint
    refused(OutputError, voted.out, fuse_results, voted.out, tmp_path / "second")
    again = RunOptions(overwrite=True)
    refused(OutputError, voted.out / "fused", fuse_results, voted.out, options=again)
    assert files_below(voted.out / "sequences") == before
    assert fuse_results(voted.out, tmp_path / "third", options=again).done == 3
    # The votes are of the recorded scans again.
    record = json.loads((voted.out / "fuse.json").read_bytes())
    assert record["moved"] == {
        name: str(voted.data / "sequences" / name / "velodyne") for name in ("00", "08")
    }
    assert fuse_results(voted.out, tmp_path / "third").skipped == 3


def test_the_place_at_which_votes_were_computed_stays_recorded(voted, tmp_path):
    """As of a run on the first scans, after which the drives are moved again."""
    first = voted.data.rename(tmp_path / "first")
    assert fuse_results(voted.out, query=replace(FIRST, dataset=first)).done == 1
    second = other_data(replace(voted, data=first), tmp_path / "second")
    before = files_below(voted.out)
    for overwrite in (False, True):
        # The scans of the first place are there.
        options = RunOptions(overwrite=overwrite)
        at_second = ResultQuery(dataset=second)
        subject = voted.out / "fused" if overwrite else voted.out
        refused(OutputError, subject, fuse_results, voted.out, query=at_second, options=options)
        refused(OutputError, subject, plan_fusion, voted.out, query=at_second, options=options)
    assert files_below(voted.out) == before
    first.rename(tmp_path / "unmounted")
    outcome = fuse_results(voted.out, query=at_second)
    assert (outcome.skipped, outcome.done) == (1, 2)
    moved = json.loads((voted.out / "fuse.json").read_bytes())["moved"]
    assert moved == {
        "00": str(first / "sequences/00/velodyne"),
        "08": str(second / "sequences/08/velodyne"),
    }


def test_a_run_that_goes_on_with_moved_scans_keeps_the_first_place(voted, tmp_path):
    """The first votes were computed where `predict` recorded the scans of the same drive."""
    only = ResultQuery(selection=ScanSelection(sequences=("08",), limit=1))
    assert fuse_results(voted.out, query=only).done == 1
    hidden = voted.data.rename(tmp_path / "unmounted")
    moved = shutil.copytree(hidden, tmp_path / "moved")
    assert fuse_results(voted.out, query=ResultQuery(dataset=moved)).done == 2
    record = json.loads((voted.out / "fuse.json").read_bytes())
    assert record["moved"] == {"00": str(moved / "sequences/00/velodyne")}
    hidden.rename(voted.data)
    refused(OutputError, voted.out, fuse_results, voted.out, query=ResultQuery(dataset=moved))
    assert fuse_results(voted.out, query=only).skipped == 1


def test_scans_beside_the_recorded_ones_have_a_hint_that_works(voted, tmp_path):
    """As copies on a faster disk."""
    copy = shutil.copytree(voted.data, tmp_path / "copy")
    with spelled(CommandLine()):
        query = ResultQuery(dataset=copy)
        caught = refused(OutputError, voted.out, fuse_results, voted.out, query=query)
    assert "omit --dataset" in caught.value.hint
    assert str(voted.scan("00")) in caught.value.problem
    assert fuse_results(voted.out).done == 3


def test_a_place_that_cannot_be_reached_counts_as_gone(voted, tmp_path, monkeypatch):
    """As a folder of a network disk, or one without permission; the system refuses a loop, too."""
    moved = voted.data.rename(tmp_path / "moved")
    voted.data.symlink_to(voted.data)
    monkeypatch.delenv(DATASET_VARIABLE, raising=False)
    scans = find_scans(moved)
    assert place_state(voted.out, scans) is PlaceState.MOVED
    assert dataset_of_hint(voted, scans) == str(moved)
    gone = ScanFile(sequence="08", stem="000000", path=voted.scan())
    assert making_hint("label", voted.out, [gone])
    refused(NoInputError, voted.out / "sequences/00", fuse_results, voted.out)
    monkeypatch.setenv(DATASET_VARIABLE, str(moved))
    assert len(plan_fusion(voted.out).todo) == 3
    assert len(plan_fusion(voted.out, query=ResultQuery(dataset=moved)).todo) == 3


def test_scans_that_vote_are_those_of_the_recorded_place_although_others_are_selected(
    voted, tmp_path
):
    other = other_data(voted, tmp_path / "other")
    shutil.rmtree(voted.data / "sequences/00")
    voted.scan().unlink()
    drive = replace(FIRST, dataset=other, selection=ScanSelection(sequences=("08",), limit=1))
    shard = RunOptions(shard=Shard(1, 2))
    before = files_below(voted.out)
    refused(OutputError, voted.out, fuse_results, voted.out, query=drive)
    refused(OutputError, voted.out, plan_fusion, voted.out, query=drive, options=shard)
    assert files_below(voted.out) == before


def test_a_link_to_the_recorded_scans_is_no_other_place(voted, tmp_path, caplog):
    link = tmp_path / "link"
    link.symlink_to(voted.data)
    with caplog.at_level(NOTICE):
        linked = ResultQuery(dataset=link)
        assert fuse_results(voted.out, query=linked).done == 3
    assert "no longer there" not in caplog.text
    assert "moved" not in json.loads((voted.out / "fuse.json").read_bytes())
    assert fuse_results(voted.out).skipped == 3
    assert place_state(voted.out, find_scans(link)) is PlaceState.LINKED


def test_each_moved_data_set_is_named_with_the_results_that_recorded_it(voted, tmp_path, caplog):
    target = voted.out / "fused"
    first = voted.data.rename(tmp_path / "first")
    fuse_results(voted.out, query=ResultQuery(dataset=first))
    second = first.rename(tmp_path / "second")
    with caplog.at_level(NOTICE):
        assert fuse_results(voted.out, query=ResultQuery(dataset=second)).skipped == 3
    lines = [text for text in caplog.messages if "no longer there" in text]
    words = "which are no longer there, are taken from"
    assert lines == [
        f"{voted.out}: scans of {voted.data}, {words} {second}",
        f"{target}: scans of {first}, {words} {second}",
    ]


def test_moved_folders_of_other_layouts_are_named_themselves(world, tmp_path):
    scan = ScanFile(sequence="drive", stem="1", path=tmp_path / "old/drive/1.pcd")
    ask(world, [scan])
    moved = replace(scan, path=tmp_path / "new/drive/1.pcd")
    places = voting_places(world.out, [moved], [moved], overwrite=False)
    assert places.moves == [MovedFolder(before=scan.path.parent, now=moved.path.parent)]
    assert places.moved == {"drive": str(moved.path.parent)}


def test_the_layout_of_a_place_that_cannot_be_reached_is_that_of_the_scan_now(world, tmp_path):
    """As of PandaSet on a network disk, whose files show that it is PandaSet."""
    old = tmp_path / "old"
    old.symlink_to(old)  # The system refuses it, as without permission.
    scan = ScanFile(sequence="drive", stem="1", path=old / "drive/lidar/1.pcd")
    ask(world, [scan])
    moved = replace(scan, path=tmp_path / "new/drive/lidar/1.pcd")
    places = voting_places(world.out, [moved], [moved], overwrite=False)
    assert places.moves == [MovedFolder(before=scan.path.parent, now=moved.path.parent)]


def test_a_moved_sequence_of_a_data_set_is_named_itself(world, tmp_path):
    scans = find_scans(world.data)
    ask(world, scans)
    moved = (world.data / "sequences/08").rename(tmp_path / "08")
    before = scans[-1].path.parent
    now = [scans[0], *find_scans(moved)]
    places = voting_places(world.out, now, now, overwrite=False)
    assert places.moves == [MovedFolder(before=before, now=moved / "velodyne")]
    assert [*places.moved] == ["08"]


def fused_at(world, dataset, *, target=None, limit=None, overwrite=False):
    """Fuse with the scans of a data set."""
    query = ResultQuery(dataset=dataset, selection=ScanSelection(limit=limit))
    options = RunOptions(overwrite=overwrite)
    return fuse_results(world.out, target, query=query, options=options)


def test_a_hint_after_votes_were_moved_back_names_the_recorded_scans(voted, tmp_path):
    moved = voted.data.rename(tmp_path / "moved")
    assert fused_at(voted, moved).done == 3
    moved.rename(voted.data)
    for path in voted.out.rglob("disagreement/*.npy"):
        path.unlink()
    options = ("--colour", "disagreement")
    missing = called("export-ply", voted.out, *options, status=1)
    assert f"run `salsanext fuse {shlex.quote(str(voted.out))}` first" in missing.stderr


def test_a_run_without_new_votes_records_no_place(voted, tmp_path):
    assert fuse_results(voted.out).done == 3
    mirror = shutil.copytree(voted.data, tmp_path / "mirror")
    hidden = voted.data.rename(tmp_path / "unmounted")
    assert fused_at(voted, mirror).skipped == 3
    assert "moved" not in json.loads((voted.out / "fuse.json").read_bytes())
    hidden.rename(voted.data)
    assert fuse_results(voted.out).skipped == 3


@pytest.fixture
def mirrored(voted, tmp_path):
    """Return the mirror of the data set with which votes were computed while it was away."""
    mirror = shutil.copytree(voted.data, tmp_path / "mirror")
    hidden = voted.data.rename(tmp_path / "unmounted")
    assert fused_at(voted, mirror).done == 3
    hidden.rename(voted.data)
    return mirror


def test_scans_at_the_place_of_their_votes_are_right(voted, mirrored, caplog):
    with caplog.at_level(NOTICE):
        assert fused_at(voted, mirrored).skipped == 3
    assert "no longer there" not in caplog.text
    next(voted.out.glob("sequences/08/uncertainty/disagreement/*.npy")).unlink()
    assert fused_at(voted, mirrored).done == 1
    assert "scans" not in json.loads((voted.out / "fuse.json").read_bytes())


def test_scans_that_are_gone_have_a_hint_that_names_those_of_their_votes(
    voted, mirrored, monkeypatch
):
    monkeypatch.delenv(DATASET_VARIABLE, raising=False)
    shutil.rmtree(voted.data)
    missing = called("eval", voted.out, status=1)
    assert f"took the scans from {mirrored / 'sequences/00/velodyne'}" in missing.stderr


def typed(hint, number=0):
    """Run a command that a hint names."""
    called(*shlex.split(hint.split("`")[2 * number + 1])[1:])


def test_the_commands_of_the_hint_take_the_scans_of_the_votes_or_vote_again(voted, mirrored):
    overwrite = RunOptions(overwrite=True)
    with spelled(CommandLine()):
        hint = refused(OutputError, voted.out, fuse_results, voted.out).value.hint
        caught = refused(
            OutputError, voted.out / "fused", fuse_results, voted.out, options=overwrite
        )
    before = files_below(voted.out / "sequences")
    typed(hint)
    assert files_below(voted.out / "sequences") == before, "the votes stay"
    typed(hint, 1)
    assert len(find_outputs(voted.out / "fused-2", "predictions")) == 3
    typed(caught.value.hint)
    assert fuse_results(voted.out, voted.out / "fused-2").skipped == 3


def test_votes_of_one_sequence_at_another_place_have_commands_that_work(voted, tmp_path):
    """The scans of the others are at the recorded place."""
    mirror = shutil.copytree(voted.data, tmp_path / "mirror")
    hidden = voted.data.rename(tmp_path / "unmounted")
    query = ResultQuery(dataset=mirror, selection=ScanSelection(sequences=("08",)))
    assert fuse_results(voted.out, query=query).done == 2
    hidden.rename(voted.data)
    with spelled(CommandLine()):
        hint = refused(OutputError, voted.out, fuse_results, voted.out).value.hint
    for number in (0, 1):
        typed(hint, number)
    assert len(find_outputs(voted.out / "fused-2", "predictions")) == 3


def test_votes_of_a_sequence_are_replaced_at_another_place_only_together(voted, mirrored, tmp_path):
    """The record has one place of each sequence."""
    first = ResultQuery(selection=ScanSelection(sequences=("08",), limit=1))
    overwrite = RunOptions(overwrite=True)
    before = files_below(voted.out)
    with spelled(CommandLine()):
        caught = refused(
            OutputError,
            voted.out,
            fuse_results,
            voted.out,
            tmp_path / "new",
            query=first,
            options=overwrite,
        )
    assert files_below(voted.out) == before
    typed(caught.value.hint, 1)
    moved = json.loads((voted.out / "fuse.json").read_bytes())["moved"]
    assert moved == {
        "00": str(mirrored / "sequences/00/velodyne"),
        "08": str(voted.data / "sequences/08/velodyne"),
    }


def dataset_of_hint(world, scans) -> str:
    """Return the data set that the command of a hint names."""
    with spelled(CommandLine()):
        return FUSE.text(world.out, scans).partition(" --dataset ")[2]
