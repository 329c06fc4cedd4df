# SPDX-License-Identifier: MIT
"""Arguments of hints: with them, a command works on the scans that the runs were asked for."""

import os
import shutil
from pathlib import Path

import pytest
from calls import calls_of

from salsanext_cli import label_space
from salsanext_cli.runs.results.manifest import Manifest, ScanSource, StageRecord
from salsanext_cli.runs.results.scan_arguments import UNKNOWN, ScanArguments, scan_arguments
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_search import scans_at_top
from salsanext_cli.runs.scans.scan_selection import ScanSelection
from salsanext_cli.runs.scans.selection import choose, scans_of


def made(*folders: Path, count: int, suffix: str = ".bin") -> list[Path]:
    """Make files of scans, of which only the names count here."""
    paths = [folder / f"{number:06d}{suffix}" for folder in folders for number in range(count)]
    for path in paths:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    return paths


def asked(out: Path, *files: Path, stage: str = "predict") -> list[ScanFile]:
    """Record a run that was asked for files; return their scans."""
    scans = [scan for file in files for scan in scans_of(file)]
    sources: dict[str, ScanSource] = {}
    for scan in scans:
        suffixes = sources[scan.sequence].suffixes if scan.sequence in sources else {}
        suffix = scan.path.name.removeprefix(scan.stem)
        sources[scan.sequence] = ScanSource(str(scan.path.parent), {**suffixes, scan.stem: suffix})
    out.mkdir(exist_ok=True)
    Manifest(out).write(StageRecord(stage=stage, settings={}, scans=sources))
    return scans


def followed(arguments: ScanArguments) -> list[ScanFile]:
    """Return the scans that a command with the arguments works on."""
    selection = ScanSelection(sequences=arguments.sequences or None, limit=arguments.limit)
    scans = scans_of([Path(source) for source in arguments.sources])
    return choose(scans, selection, label_space(), "scans")


def parts(root: Path, *names: str) -> list[Path]:
    return [root / "sequences" / name / "velodyne" for name in names]


@pytest.fixture
def data(tmp_path) -> Path:
    """Return a data set of 5 sequences of 5 scans."""
    made(*parts(tmp_path / "data", "00", "01", "02", "03", "04"), count=5)
    return tmp_path / "data"


ALL = range(5)


@pytest.mark.parametrize(
    ("numbers_by_sequence", "sources", "options"),
    [
        ({"01": [3]}, ["01/velodyne/000003.bin"], {}),
        ({"00": [4], "03": [0]}, ["00/velodyne/000004.bin", "03/velodyne/000000.bin"], {}),
        ({"02": ALL}, ["02/velodyne"], {}),
        ({"02": range(4)}, ["02/velodyne"], {"limit": 4}),
        ({"01": ALL, "03": ALL}, [".."], {"sequences": ("01", "03")}),
        ({"01": ALL, "03": [0, 1]}, [".."], {"sequences": ("01", "03"), "limit": 7}),
        ({f"0{number}": ALL for number in ALL}, [".."], {}),
        ({f"0{number}": ALL for number in range(4)} | {"04": [0]}, [".."], {"limit": 21}),
    ],
)
def test_they_name_exactly_the_scans_of_the_runs(
    data, tmp_path, numbers_by_sequence, sources, options
):
    files = [
        data / "sequences" / sequence / "velodyne" / f"{number:06d}.bin"
        for sequence, numbers in numbers_by_sequence.items()
        for number in numbers
    ]
    scans = asked(tmp_path / "out", *files)
    arguments = scan_arguments(tmp_path / "out", scans[:1])
    assert followed(arguments) == sorted(scans)
    named = tuple(os.path.normpath(data / "sequences" / source) for source in sources)
    assert arguments == ScanArguments(sources=named, **options)


def test_scans_that_no_short_command_names_are_not_named(data, tmp_path):
    # Neither the first ones of the folder, nor few
    files = [path / f"{number:06d}.bin" for path in parts(data, "01", "03") for number in (1, 4)]
    assert scan_arguments(tmp_path / "out", asked(tmp_path / "out", *files)) == UNKNOWN
    assert scan_arguments(tmp_path / "out", []) == UNKNOWN


@pytest.mark.parametrize("left", [2, 5])
def test_scans_that_are_gone_are_not_named(tmp_path, left):
    files = made(tmp_path / "plain", count=6)
    scans = asked(tmp_path / "out", *files[:-1])
    for path in files[: 5 - left]:
        path.unlink()
    remaining = scans[5 - left :]
    arguments = scan_arguments(tmp_path / "out", remaining[:1])
    assert followed(arguments) == remaining
    assert arguments.limit == (5 if left == 5 else None)


def test_scans_of_several_runs_and_data_sets_are_all_named(data, tmp_path):
    other = tmp_path / "other"
    made(*parts(other, "07", "08"), count=2)
    first = asked(tmp_path / "out", *(part / "000002.bin" for part in parts(data, "00")))
    more = [part / "000001.bin" for part in (*parts(other, "08"), *parts(data, "04"))]
    second = asked(tmp_path / "out", *more, stage="uncertainty")
    for scan in (*first, *second):
        assert followed(scan_arguments(tmp_path / "out", [scan])) == sorted([*first, *second])


@pytest.mark.parametrize("sequences", [["02"], ["01", "04"]])
@pytest.mark.parametrize("is_copied", [False, True])
def test_scans_of_a_moved_data_set_are_named_where_they_are(data, tmp_path, sequences, is_copied):
    files = [part / "000003.bin" for part in parts(data, *sequences)]
    asked(tmp_path / "out", *files)
    moved = tmp_path / "elsewhere/moved"
    shutil.copytree(data, moved)
    if not is_copied:
        shutil.rmtree(data)
    scans = [scan for file in files for scan in scans_of(moved / file.relative_to(data))]
    assert followed(scan_arguments(tmp_path / "out", scans[:1])) == scans


def test_a_run_that_was_not_asked_for_a_scan_does_not_count(data, tmp_path):
    asked(tmp_path / "out", parts(data, "01")[0] / "000000.bin")
    (scan,) = scans_of(parts(data, "01")[0] / "000001.bin")
    whole = ScanArguments(sources=(str(data),))
    assert scan_arguments(tmp_path / "out", [scan]) == whole
    assert scan_arguments(tmp_path / "empty", [scan]) == whole
    # A run over a folder of another name has results of another name.
    renamed = ScanFile(sequence="05", stem=scan.stem, path=scan.path)
    assert scan_arguments(tmp_path / "out", [renamed]) == UNKNOWN


def test_drives_in_one_folder_are_chosen_by_their_names(tmp_path):
    folder = tmp_path / "samples/LIDAR_TOP"
    folder.mkdir(parents=True)
    for drive in ("n1", "n2", "n3"):
        for number in range(4):
            (folder / f"{drive}__LIDAR_TOP__{number}.pcd.bin").touch()
    scans = asked(tmp_path / "out", *sorted(folder.glob("n[13]*")))
    arguments = scan_arguments(tmp_path / "out", scans[:1])
    assert arguments == ScanArguments(sources=(str(folder),), sequences=("n1", "n3"))
    assert followed(arguments) == sorted(scans)


def test_tables_beside_clouds_are_named_as_files(tmp_path):
    made(tmp_path / "plain", count=4)
    (table,) = made(tmp_path / "plain", count=1, suffix=".csv")
    scans = asked(tmp_path / "out", table)
    assert scan_arguments(tmp_path / "out", scans).sources == (str(table),)


def test_older_records_have_no_suffixes(tmp_path):
    files = made(tmp_path / "plain", count=4)
    scans = asked(tmp_path / "out", files[2])
    source = ScanSource(str(tmp_path / "plain"), {"000002": ""})
    Manifest(tmp_path / "out").write(
        StageRecord(stage="predict", settings={}, scans={"plain": source})
    )
    assert followed(scan_arguments(tmp_path / "out", scans)) == scans


def test_a_folder_is_listed_once_however_many_scans_fail(tmp_path, caplog):
    made(tmp_path / "plain", count=9)
    made(tmp_path / "plain/elsewhere/deeper", count=1)
    scans = asked(tmp_path / "out", *sorted((tmp_path / "plain").glob("*.bin")))
    with calls_of(scans_at_top) as calls:
        sources = {scan_arguments(tmp_path / "out", [scan]).sources for scan in scans}
        assert sources == {(str(tmp_path / "plain"),)}
        assert len(calls) == 1
        # Until a file comes or goes
        scans[0].path.unlink()
        assert followed(scan_arguments(tmp_path / "out", scans[-1:])) == scans[1:]
        assert len(calls) == 2
    assert not caplog.records
