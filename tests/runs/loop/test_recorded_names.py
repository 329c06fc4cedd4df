# SPDX-License-Identifier: MIT
# ruff: noqa: F811
"""Results keep the names of their sequences, whatever a version or another source calls them."""

import shutil

from scans import write_sequence
from shallow_network import shallow, weights  # noqa: F401

from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.runs.loop.recorded_names import with_recorded_names
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.results.result_folder import ResultFolder
from salsanext_cli.runs.scans.scan_folders import FILE_LISTS
from salsanext_cli.runs.scans.scan_search import find_scans


def rename_sequence(out, before, after):
    """Rename a sequence in an output folder: its folder, and its name in all records."""
    (out / "sequences" / before).rename(out / "sequences" / after)
    for path in (*out.glob("*.json"), *(out / FILE_LISTS).iterdir()):
        text = path.read_text()
        for begin, end in (('"', '":'), ('"', "/"), ("sequences/", "/")):
            text = text.replace(f"{begin}{before}{end}", f"{begin}{after}{end}")
        path.write_text(text)


def test_sequences_of_older_versions_keep_their_names(weights, tmp_path):
    folder = tmp_path / "drive/velodyne_points/data"
    write_sequence(tmp_path, ["0"])
    folder.parent.mkdir(parents=True)
    (tmp_path / "velodyne").rename(folder)
    out = tmp_path / "out"
    network = NetworkSettings(weights, "cpu", engine="torch")
    predict_scans(folder, out, settings=network)
    rename_sequence(out, "drive", "data")  # As an older version named it.
    assert [scan.name for scan in find_scans(folder)] == ["drive/0"]
    assert [scan.name for scan in ResultFolder(out).scans()] == ["data/0"]
    before = (out / "sequences/data/predictions/0.label").stat()
    shutil.copy(folder / "0.bin", folder / "1.bin")
    predict_scans(tmp_path / "drive", out, settings=network)
    assert (out / "sequences/data/predictions/0.label").stat() == before
    assert [scan.name for scan in ResultFolder(out).scans()] == ["data/0", "data/1"]


def test_scans_of_other_drives_in_a_folder_do_not_get_recorded_names(weights, tmp_path):
    folder = tmp_path / "samples/LIDAR_TOP"
    write_sequence(tmp_path, ["a__LIDAR_TOP__1", "b__LIDAR_TOP__2"])
    folder.parent.mkdir()
    (tmp_path / "velodyne").rename(folder)
    first, second = find_scans(folder)
    out = tmp_path / "out"
    network = NetworkSettings(weights, "cpu", engine="torch")
    predict_scans(first.path, out, settings=network)
    assert with_recorded_names([first, second], out) == [first, second]
