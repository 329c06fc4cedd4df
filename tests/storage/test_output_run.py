# SPDX-License-Identifier: MIT
"""Runs that want the same output folder at the same time, in processes of their own."""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from claiming import claim
from scans import files_below

from salsanext_cli.errors import OutputError
from salsanext_cli.storage import output_run as claims
from salsanext_cli.storage.atomic import STALE
from salsanext_cli.storage.layout import ScanFile
from salsanext_cli.storage.output_run import alone, claimed, recording
from salsanext_cli.storage.sources import asked_for
from salsanext_cli.storage.stage_records import owner
from salsanext_cli.training.run_folder import trained_alone

SETTINGS = {"weights": "a"}
Start = Callable[..., subprocess.Popen[str]]


@pytest.fixture
def start() -> Iterator[Start]:
    """Return what starts claimants; those left are killed."""
    started: list[subprocess.Popen[str]] = []
    script = Path(__file__).with_name("claimant.py")

    def begin(out: Path, weights: str, overwrite: str = "") -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, str(script), str(out), weights, overwrite],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=Path(claims.__file__).parents[2],
            env={**os.environ, "PYTHONPATH": str(Path(claims.__file__).parents[2])},
        )
        started.append(process)
        return process

    yield begin
    for process in started:
        process.kill()
        process.communicate()


def tell(process: subprocess.Popen[str]) -> None:
    assert process.stdin
    process.stdin.write("\n")
    process.stdin.flush()


def heard(process: subprocess.Popen[str]) -> str:
    assert process.stdout
    return process.stdout.readline().strip()


def result(out: Path, name: str = "000000") -> Path:
    return out / f"sequences/08/predictions/{name}.label"


def leave_result(out: Path, content: bytes = b"whole") -> Path:
    path = result(out)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    return path


def recorded(out: Path) -> str:
    weights = json.loads((out / "predict.json").read_text())["settings"]["weights"]
    assert isinstance(weights, str)
    return weights


@pytest.mark.parametrize("overwrite", ["", "overwrite"])
def test_of_two_with_other_settings_one_has_the_folder(
    tmp_path: Path, start: Start, overwrite: str
) -> None:
    claimants = {name: start(tmp_path, name, overwrite) for name in "ab"}
    for process in claimants.values():
        assert heard(process) == "ready"
    for process in claimants.values():
        tell(process)
    said = {name: heard(process) for name, process in claimants.items()}
    (winner,) = (name for name, words in said.items() if words == "claimed")
    (loser,) = {"a", "b"} - {winner}
    assert "weights was" in said[loser] or "another run of `predict` is at work" in said[loser]
    assert recorded(tmp_path) == winner
    tell(claimants[winner])
    claimants[winner].wait()
    assert list(files_below(tmp_path)) == ["predict.json"]


def test_results_that_are_being_made_are_not_removed(tmp_path: Path, start: Start) -> None:
    """Until who makes them has died, however that was."""
    process = start(tmp_path, "b")
    heard(process)
    tell(process)
    assert heard(process) == "claimed"
    path = leave_result(tmp_path)
    with pytest.raises(OutputError, match="another run of `predict` is at work in it · wait"):
        claim(tmp_path, "predict", SETTINGS, ["predictions"], overwrite=True)
    with pytest.raises(OutputError, match="another run of `predict` is at work"):
        claim(tmp_path, "knn-refine", {}, ["predictions"], overwrite=True)
    assert path.exists()
    assert recorded(tmp_path) == "b"
    assert owner(tmp_path, "predictions") == "predict"
    process.kill()
    process.wait()
    claim(tmp_path, "predict", SETTINGS, ["predictions"], overwrite=True)
    assert not path.exists()
    assert recorded(tmp_path) == "a"


def test_runs_with_the_same_settings_work_side_by_side(tmp_path: Path) -> None:
    claim(tmp_path, "predict", SETTINGS, ["predictions"], overwrite=False)
    path = leave_result(tmp_path)
    for overwrite in (True, False):
        with (
            claimed(tmp_path, "predict", SETTINGS, ["predictions"], overwrite=True),
            claimed(tmp_path, "predict", SETTINGS, ["predictions"], overwrite=overwrite),
        ):
            assert path.exists()
    assert path.exists()


def test_stages_that_fill_other_folders_do_not_wait(tmp_path: Path) -> None:
    with (
        claimed(tmp_path, "predict", SETTINGS, ["predictions"], overwrite=False),
        claimed(tmp_path, "export-ply", {"colour": "label"}, ["ply"], overwrite=False),
    ):
        claim(tmp_path, "export-ply", {"colour": "label"}, ["ply"], overwrite=True)
        with pytest.raises(OutputError, match="another run of `export-ply`"):
            claim(tmp_path, "export-ply", {"colour": "range"}, ["ply"], overwrite=True)


def test_no_claimant_forgets_what_others_were_asked_for(tmp_path: Path) -> None:
    def ask(number: int) -> None:
        scan = ScanFile("08", f"{number:03d}", tmp_path / "data" / f"{number:03d}.bin")
        claim(tmp_path / "out", "predict", SETTINGS, ["predictions"], [scan], overwrite=False)

    with ThreadPoolExecutor(8) as threads:
        list(threads.map(ask, range(40)))
    assert asked_for(tmp_path / "out", "08")["predict"] == {f"{n:03d}" for n in range(40)}


def test_whoever_never_ends_recording_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(claims, "PATIENCE", 0.1)
    with (
        recording(tmp_path),
        pytest.raises(OutputError, match=r"records\.lock · held by another process · wait"),
    ):
        claim(tmp_path, "predict", SETTINGS, ["predictions"], overwrite=False)


def test_one_training_at_a_time(tmp_path: Path) -> None:
    with (
        trained_alone(tmp_path),
        pytest.raises(OutputError, match="another run of `train` is at work in it"),
        trained_alone(tmp_path),
    ):
        pass
    with trained_alone(tmp_path):
        pass
    assert files_below(tmp_path) == {}


def test_a_refused_claim_leaves_the_folder_to_others(tmp_path: Path) -> None:
    claim(tmp_path, "predict", SETTINGS, ["predictions"], overwrite=False)
    with pytest.raises(OutputError, match="weights was"):
        claim(tmp_path, "predict", {"weights": "b"}, ["predictions"], overwrite=False)
    with alone(tmp_path, "predict"):
        pass
    assert list(files_below(tmp_path)) == ["predict.json"]


def age(path: Path, seconds: float) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"half")
    then = path.stat().st_mtime - seconds
    os.utime(path, (then, then))
    return path


def test_what_was_left_half_written_long_ago_is_removed(tmp_path: Path) -> None:
    """Nothing else is: others may be writing, and not all hidden files are ours."""
    out, hexadecimal = tmp_path / "out", "0123456789abcdef" * 2
    scan = ScanFile("08", "000000", tmp_path / "08/velodyne/000000.bin")
    claim(out, "predict", SETTINGS, ["predictions"], [scan], overwrite=False)
    folder, old = result(out).parent, STALE + 60
    gone = [
        age(folder / f".{hexadecimal}.part", old),
        age(folder / f".{hexadecimal}{hexadecimal}.part", old),
        age(out / f".{hexadecimal}.part", old),
        age(folder.parent / f".{hexadecimal}.part", old),
    ]
    kept = [
        age(folder / f".{hexadecimal[::-1]}.part", STALE - 60),
        age(folder / f".{'f' * 32}.part", -old),
        age(folder / ".mine.part", old),
        age(folder / f"{hexadecimal}.part", old),
        age(folder / f".{hexadecimal}.label", old),
        age(result(out, "000001"), old),
        age(out / "sequences/09/predictions" / f".{hexadecimal}.part", old),
    ]
    claim(out, "predict", SETTINGS, ["predictions"], [scan], overwrite=True)
    assert [path for path in gone if path.exists()] == []
    assert [path for path in kept if not path.exists()] == []
    assert len(files_below(out)) == len(kept) + 2


def test_what_nobody_recorded_is_removed_by_overwriting(tmp_path: Path) -> None:
    """Else the next run would take it for its own."""
    path = tmp_path / "sequences/08/predictions/a.label"
    path.parent.mkdir(parents=True)
    path.write_bytes(b"mine")
    with pytest.raises(OutputError, match="nobody knows how"):
        claim(tmp_path, "predict", {}, ["predictions"], overwrite=False)
    assert path.exists()
    claim(tmp_path, "predict", {}, ["predictions"], overwrite=True)
    assert not path.exists()


def test_a_later_shard_does_not_wait_for_those_that_record(tmp_path: Path) -> None:
    scans = [ScanFile("08", "a", tmp_path / "a.bin")]
    with claimed(tmp_path, "predict", {"k": 1}, ["predictions"], scans, overwrite=False):
        pass
    with (
        recording(tmp_path),
        claimed(tmp_path, "predict", {"k": 1}, ["predictions"], scans, overwrite=False),
    ):
        assert owner(tmp_path, "predictions") == "predict"
