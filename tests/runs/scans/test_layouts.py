# SPDX-License-Identifier: MIT
"""Scans deeper in the tree: layouts of data sets, single folders, and ambiguous ones."""

import os
import shlex
import subprocess
from pathlib import Path

import pytest
from scans import make_empty, refused, write_sequence

from salsanext_cli import read_scan
from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.core.errors import NoInputError, OutputError
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.results.result_folder import ResultFolder
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.runs.scans.selection import data_set_of


def found(source: Path) -> list[str]:
    return [scan.name for scan in find_scans(source)]


KITTI = [
    f"2011_09_26/2011_09_26_drive_000{drive}_sync/{file}"
    for drive in (1, 2)
    for file in (
        "velodyne_points/data/0000000000.bin",
        "velodyne_points/data/0000000001.bin",
        "velodyne_points/timestamps.txt",
        "oxts/data/0000000000.txt",
        "image_02/data/0000000000.png",
    )
]
ARGOVERSE = [
    f"sensor/train/{log}/{file}"
    for log in ("0a-1", "0b-2")
    for file in (
        "sensors/lidar/315966070.feather",
        "annotations.feather",
        "city_SE3_egovehicle.feather",
        "calibration/intrinsics.feather",
    )
]
NUSCENES = [
    "samples/LIDAR_TOP/n008-a__LIDAR_TOP__15.pcd.bin",
    "samples/LIDAR_TOP/n008-b__LIDAR_TOP__17.pcd.bin",
    "samples/RADAR_FRONT/n008__RADAR_FRONT__15.pcd",
    "sweeps/LIDAR_TOP/n008__LIDAR_TOP__16.pcd.bin",
    "sweeps/RADAR_FRONT/n008__RADAR_FRONT__16.pcd",
    "lidarseg/v1.0-mini/0ab9_lidarseg.bin",
]
PANDASET = [
    *(f"{drive}/lidar/{name}" for drive in ("001", "002") for name in ("00.npy", "poses.json")),
    "001/meta/gps.json",
    "002/camera/front/00.jpg",
]
UNPACKED = ["velodyne/00/000000.bin", "velodyne/01/000000.bin", "labels/00/000000.label"]
GOOSE = ["lidar/train/2022_x/2022_x__7_vls128.bin", "lidar/val/2022_y/2022_y__7_vls128.bin"]


@pytest.mark.parametrize(
    ("files", "expected", "places"),
    [
        (
            KITTI,
            [f"2011_09_26_drive_000{d}_sync/000000000{n}" for d in (1, 2) for n in (0, 1)],
            [".", "2011_09_26"],
        ),
        (ARGOVERSE, ["0a-1/315966070", "0b-2/315966070"], [".", "sensor", "sensor/train"]),
        (
            NUSCENES,
            ["n008-a/n008-a__LIDAR_TOP__15", "n008-b/n008-b__LIDAR_TOP__17"],
            [".", "samples", "samples/LIDAR_TOP"],
        ),
        (PANDASET, ["001/00", "002/00"], ["."]),
        (UNPACKED, ["00/000000", "01/000000"], [".", "velodyne"]),
        (GOOSE, ["2022_x/2022_x__7_vls128", "2022_y/2022_y__7_vls128"], [".", "lidar"]),
    ],
)
def test_drives_of_known_layouts_are_sequences(tmp_path, files, expected, places):
    root = tmp_path / "data set"
    make_empty(root, *files)
    for place in places:
        assert found(root / place) == expected, place


@pytest.mark.parametrize(
    ("files", "place", "sequence"),
    [
        (KITTI, "2011_09_26/2011_09_26_drive_0002_sync", "2011_09_26_drive_0002_sync"),
        (ARGOVERSE, "sensor/train/0b-2", "0b-2"),
        (PANDASET, "002", "002"),
        (UNPACKED, "velodyne/01", "01"),
    ],
)
def test_a_drive_has_one_name_however_it_is_given(tmp_path, files, place, sequence):
    make_empty(tmp_path, *files)
    scans = find_scans(tmp_path / place)
    assert {scan.sequence for scan in scans} == {sequence}
    assert find_scans(scans[0].path.parent) == scans
    assert find_scans(scans[0].path) == scans[:1]
    assert [scan for scan in find_scans(tmp_path) if scan.sequence == sequence] == scans


@pytest.mark.parametrize(
    "folder", ["clouds", "pointclouds/front", "sensors/lidar", "lidar", "a/b/c/velodyne_points"]
)
def test_the_only_folder_with_scans_is_used_and_named(tmp_path, folder, caplog):
    make_empty(tmp_path, f"{folder}/1.pcd", "gps/track.csv", "README.md")
    with caplog.at_level(NOTICE):
        assert [scan.path for scan in find_scans(tmp_path)] == [tmp_path / folder / "1.pcd"]
    (record,) = caplog.records
    assert record.levelno == NOTICE
    assert f"{folder} (1 .pcd)" in record.getMessage()


def test_folders_that_are_not_used_are_named(tmp_path, caplog):
    make_empty(tmp_path, *NUSCENES)
    with caplog.at_level(NOTICE):
        find_scans(tmp_path)
    (message,) = caplog.messages
    assert "using samples/LIDAR_TOP (2 .pcd.bin) in the layout of nuScenes" in message
    assert "sweeps/LIDAR_TOP (1 .pcd.bin)" in message.partition("not used")[2]


def test_several_folders_are_listed_with_their_counts_and_commands(tmp_path):
    make_empty(tmp_path, "front/1.pcd", "front/2.pcd", "rear scans/1.pcd", "notes/a.txt")
    error = refused(NoInputError, tmp_path, find_scans, tmp_path).value
    assert "front (2 .pcd), rear scans (1 .pcd)" in error.problem
    assert "notes" not in error.problem
    for place in (f"{tmp_path}/front", f"'{tmp_path}/rear scans'"):
        assert f"salsanext predict {place} out" in error.hint


def test_two_layouts_are_ambiguous_and_texts_are_listed_but_never_used(tmp_path):
    make_empty(tmp_path / "both", *KITTI, *PANDASET)
    refused(NoInputError, tmp_path / "both", find_scans, tmp_path / "both")
    make_empty(tmp_path / "texts", "clouds/1.csv")
    error = refused(NoInputError, tmp_path / "texts", find_scans, tmp_path / "texts").value
    assert "clouds (1 .csv)" in error.problem


def test_tables_in_the_folder_are_the_scans_unless_a_known_layout_is_below(tmp_path):
    make_empty(tmp_path, "a.npy", "other/1.pcd")
    assert found(tmp_path) == [f"{tmp_path.name}/a"]
    make_empty(tmp_path, "drive/lidar/00.pcd", "drive/lidar/timestamps.json")
    assert found(tmp_path) == ["drive/00"]
    make_empty(tmp_path, "b.bin")
    assert found(tmp_path) == [f"{tmp_path.name}/b"]


@pytest.mark.parametrize(
    ("drives", "expected"),
    [
        (["day/run1/velodyne", "night/run1/velodyne"], ["day_run1/0", "night_run1/0"]),
        (["one/velodyne/00", "two/velodyne/00"], ["one_00/0", "two_00/0"]),
    ],
)
def test_names_of_drives_depend_on_their_own_path(tmp_path, drives, expected):
    """A drive that is added later does not rename the results of the others."""
    make_empty(tmp_path, f"{drives[0]}/0.bin")
    assert found(tmp_path) == expected[:1]
    make_empty(tmp_path, f"{drives[1]}/0.bin", f"third/{drives[1]}/1.bin")
    assert {*expected} < {*found(tmp_path)}


@pytest.mark.parametrize(
    "drives",
    [
        ["a/sequences/08/velodyne", "b/sequences/08/velodyne"],
        ["a/b_c/velodyne", "a_b/c/velodyne"],
        ["b_c/velodyne", "b/c/velodyne"],
        [f"{place}/drive_0001_sync/velodyne_points/data" for place in ("day", "copy of day")],
    ],
)
def test_folders_of_one_sequence_are_refused_with_the_command_for_each(tmp_path, drives):
    """Results could not tell their scans apart, also if the scans have other names."""
    make_empty(tmp_path, *(f"{drive}/{number}.bin" for number, drive in enumerate(drives)))
    error = refused(NoInputError, tmp_path, find_scans, tmp_path).value
    for drive in drives:
        assert f"salsanext predict {shlex.quote(f'{tmp_path}/{drive}')} out" in error.hint
        assert len(find_scans(tmp_path / drive)) == 1


@pytest.mark.parametrize(
    "files",
    [
        ["a/lidar/0.bin", "b/clouds/0.bin"],  # PandaSet has poses.json beside the scans.
        ["lidar/front/top/0.bin", "b/clouds/0.bin"],  # GOOSE has names of its own.
        ["a/sensors/lidar/0.pcd", "b/clouds/0.bin"],  # Argoverse 2 has Feather tables.
    ],
)
def test_folders_that_are_only_named_as_in_a_data_set_are_plain_folders(tmp_path, files):
    make_empty(tmp_path, *files)
    error = refused(NoInputError, tmp_path, find_scans, tmp_path).value
    for file in files:
        assert f"salsanext predict {(tmp_path / file).parent} out" in error.hint


def test_hidden_folders_results_and_loops_of_links_are_not_searched(tmp_path):
    make_empty(
        tmp_path, "run/clouds/1.pcd", ".cache/clouds/1.pcd", "run/.tmp/1.pcd", "labels/1.ply"
    )
    make_empty(tmp_path, "out/sequences/run/ply/1.ply", "out/.salsanext.files/host.tsv")
    (tmp_path / "run" / "up").symlink_to(tmp_path)
    (tmp_path / "again").symlink_to(tmp_path / "run")
    (tmp_path / "self").symlink_to(tmp_path / "self")
    assert len(found(tmp_path)) == 1


def test_results_in_the_root_of_the_scans_hide_no_scans(tmp_path):
    make_empty(tmp_path, *KITTI)
    before = found(tmp_path)
    results = ("sequences/d/predictions/0000000000.label", ".salsanext.files/machine.tsv")
    make_empty(tmp_path, *results, "sequences/d/velodyne_points/data/0000000009.bin")
    assert found(tmp_path) == before != []


def test_data_sets_that_stages_wrote_are_found(tmp_path):
    make_empty(tmp_path, "data/sequences/08/velodyne/0.bin", "data/sequences/08/ply/0.ply")
    make_empty(tmp_path, "data/.salsanext.files/host.tsv")
    assert found(tmp_path) == ["08/0"]


@pytest.mark.skipif(os.name == "nt" or not os.getuid(), reason="root may read everything")
def test_folders_that_may_not_be_read_are_skipped(tmp_path):
    make_empty(tmp_path, "clouds/1.pcd", "private/1.pcd")
    (tmp_path / "private").chmod(0)
    try:
        assert found(tmp_path) == ["clouds/1"]
    finally:
        (tmp_path / "private").chmod(0o700)


@pytest.mark.parametrize(
    ("files", "hint"),
    [
        (["lidar/00.pkl.gz", "meta/poses.json"], "pandas.read_pickle"),
        (["clouds/000000.bin.gz"], "gunzip"),
        (["day/drive.bag.active"], "rosbag reindex"),
        (["day/drive.pcapng"], "editcap -F pcap"),
        (["day/scans.tar.gz", "day/more.tar.gz", "day/1.bin.gz"], "unpack it"),
        (["day/drive.bag", "day/other.bag"], "day/drive.bag"),
        (["day/drive.bag", "README.md"], "day/drive.bag"),
        (["day/drive/metadata.yaml", "day/drive/drive_0.mcap"], "day/drive"),
    ],
)
def test_other_files_below_and_in_a_folder_get_the_hint_of_a_single_one(tmp_path, files, hint):
    make_empty(tmp_path, *files)
    place = (tmp_path / files[0]).parent
    for source in [tmp_path, *([place] if "mcap" not in files[-1] else [])]:
        assert hint in refused(NoInputError, source, find_scans, source).value.hint


def test_an_unfinished_bag_is_named(tmp_path):
    make_empty(tmp_path, "drive.bag.active")
    source = tmp_path / "drive.bag.active"
    error = refused(NoInputError, source, find_scans, source).value
    assert "never closed" in error.problem
    assert "rosbag reindex" in error.hint


def test_the_command_for_pickles_converts_all_of_a_folder(tmp_path):
    pandas = pytest.importorskip("pandas")
    folder = tmp_path / "it's lidar"
    folder.mkdir()
    for number in range(2):
        table = pandas.DataFrame({"x": [1.5], "y": [2.0], "z": [float(number)], "i": [7]})
        table.to_pickle(folder / f"0{number}.pkl.gz")
    error = refused(NoInputError, folder, find_scans, folder).value
    _, _, command = error.hint.partition("trust it: ")
    subprocess.run(shlex.split(command), check=True)
    scans = find_scans(folder)
    assert [read_scan(scan.path).points[0].tolist() for scan in scans] == [[1.5, 2, 0], [1.5, 2, 1]]


def test_labels_of_the_layouts_are_found(tmp_path):
    make_empty(tmp_path / "sk", *UNPACKED)
    make_empty(tmp_path / "goose", *GOOSE)
    first, _ = find_scans(tmp_path / "sk")
    assert first.label_path == tmp_path / "sk/labels/00/000000.label"
    assert data_set_of(first) == tmp_path / "sk"
    first, _ = find_scans(tmp_path / "goose")
    assert first.label_path == tmp_path / "goose/labels/train/2022_x/2022_x__7_goose.label"
    assert data_set_of(first) == tmp_path / "goose"


def test_labels_beside_the_scans_precede_those_that_a_layout_lacks(tmp_path):
    make_empty(tmp_path, "velodyne/00/a.bin", "velodyne/00/labels/a.label")
    (scan,) = find_scans(tmp_path)
    assert scan.label_path == tmp_path / "velodyne/00/labels/a.label"
    make_empty(tmp_path, "labels/00/a.label")
    assert scan.label_path == tmp_path / "labels/00/a.label"


@pytest.fixture
def kitti(tmp_path):
    root = tmp_path / "kitti"
    for drive in ("drive_1_sync", "drive_2_sync"):
        folder = root / "date" / drive / "velodyne_points" / "data"
        write_sequence(folder.parent, ["0", "1"], seed=len(drive))
        (folder.parent / "velodyne").rename(folder)
    return root


def test_drives_of_one_folder_are_found_by_later_stages(weights, tmp_path):
    network = NetworkSettings(weights, "cpu", engine="torch")
    folder = tmp_path / "samples/LIDAR_TOP"
    names = ["a__LIDAR_TOP__1", "a__LIDAR_TOP__2", "b__LIDAR_TOP__3"]
    write_sequence(tmp_path, names)
    folder.parent.mkdir()
    (tmp_path / "velodyne").rename(folder)
    out = tmp_path / "out"
    assert predict_scans(folder, out, settings=network).done == 3
    expected = find_scans(folder)
    assert [scan.name for scan in expected] == [f"{name[0]}/{name}" for name in names]
    assert find_scans(folder / f"{names[2]}.bin") == expected[2:]
    assert ResultFolder(out).scans() == expected
    assert ResultFolder(out, folder).scans() == expected
    single = tmp_path / "single"
    predict_scans(folder / f"{names[2]}.bin", single, settings=network)
    assert ResultFolder(single).scans() == expected[2:]
    assert ResultFolder(single, folder).scans() == expected[2:]


def test_later_stages_find_the_scans_and_never_those_of_another_drive(kitti, weights, tmp_path):
    network = NetworkSettings(weights, "cpu", engine="torch")
    out = tmp_path / "out"
    assert predict_scans(kitti, out, settings=network).done == 4
    expected = find_scans(kitti)
    assert ResultFolder(out).scans() == expected
    moved = kitti.rename(tmp_path / "moved")
    elsewhere = ResultFolder(out, moved).scans()
    assert [scan.name for scan in elsewhere] == [scan.name for scan in expected]
    single = tmp_path / "single"
    predict_scans(moved / "date/drive_2_sync", single, settings=network)
    kitti = moved.rename(kitti)
    assert {scan.path for scan in ResultFolder(single, kitti).scans()} == {
        scan.path for scan in expected if scan.sequence == "drive_2_sync"
    }
    other = tmp_path / "other/drive_2_sync"
    other.parent.mkdir()
    (kitti / "date/drive_1_sync").rename(other)
    with pytest.raises(OutputError):
        predict_scans(other, single, settings=network)


def test_scans_that_were_moved_are_named_with_the_argument_for_their_new_place(weights, tmp_path):
    write_sequence(tmp_path / "before", ["000000"])
    scans = tmp_path / "before/velodyne"
    out = tmp_path / "out"
    predict_scans(scans, out, settings=NetworkSettings(weights, "cpu", engine="torch"))
    for scan in scans.iterdir():
        scan.unlink()
    caught = refused(NoInputError, out / "sequences/before", ResultFolder(out).scans)
    assert "with dataset" in caught.value.hint
