# SPDX-License-Identifier: MIT
"""Records and links in an output folder: nothing outside of it is written or removed."""

import json

import numpy as np
import pytest
from claiming import claim
from scans import SMALL, files_below, write_sequence

from salsanext_cli.errors import NoInputError, OutputError
from salsanext_cli.stages.project import project_scans
from salsanext_cli.stages.synth import _claim as claim_synth
from salsanext_cli.storage.layout import ScanFile, find_scans, output_path
from salsanext_cli.storage.point_files import write_labels
from salsanext_cli.storage.sources import remembered_scans


@pytest.mark.parametrize("name", ["..", ".", "", "../../x", "/etc", "a/b", "a/../b", "x\0y"])
def test_names_that_lead_elsewhere(tmp_path, name):
    for sequence, stem in ((name, "a"), ("08", name)):
        with pytest.raises(OutputError, match="cannot name a file"):
            output_path(tmp_path, sequence, "predictions", stem)


@pytest.mark.parametrize("folder", ["../../victim", "/victim", "victim", ".."])
def test_manifests_that_claim_other_folders(tmp_path, folder):
    victim, out = tmp_path / "victim" / "000000.label", tmp_path / "out"
    victim.parent.mkdir()
    victim.touch()
    claim(out, "predict", {"weights": 1}, ["predictions"], overwrite=False)
    manifest = json.loads((out / "predict.json").read_text())
    (out / "predict.json").write_text(json.dumps(manifest | {"writes": [folder]}))
    with pytest.raises(OutputError, match=r"predict\.json"):
        claim(out, "predict", {"weights": 2}, ["predictions"], overwrite=True)
    assert victim.exists()


@pytest.mark.parametrize("stem", ["../../../victim", "/victim", "..", 3, None, ["a"]])
def test_records_of_scans_that_lead_elsewhere(tmp_path, stem):
    out, data = tmp_path / "out", write_sequence(tmp_path / "08", ["a"], count=5)
    scan = ScanFile("08", "a", data / "velodyne/a.bin")
    claim(out, "predict", {}, ["predictions"], [scan], overwrite=False)
    write_labels(output_path(out, "08", "predictions", "a"), np.zeros(5, np.uint32))
    path = out / "sequences/08/source.json"
    before = files_below(tmp_path)
    record = json.loads(path.read_text())
    path.write_text(json.dumps(record | {"asked_for": {"predict": [stem]}}))
    if isinstance(stem, str):
        assert remembered_scans(out) == [scan]
    else:
        with pytest.raises(OutputError, match=r"source\.json · damaged"):
            remembered_scans(out)
    assert files_below(tmp_path).keys() == before.keys()


@pytest.mark.parametrize("folder", [3, ["/"], "a\0b", {"a": 1}])
def test_records_of_folders_that_are_none(tmp_path, folder):
    write_labels(output_path(tmp_path, "08", "predictions", "a"), np.zeros(5, np.uint32))
    (tmp_path / "sequences/08/source.json").write_text(json.dumps({"scans": folder}))
    with pytest.raises(OutputError, match=r"source\.json · damaged"):
        remembered_scans(tmp_path)


@pytest.mark.parametrize("splits", [{"train": ["../../victim"]}, {"train": [3]}, 5, None])
def test_synthetic_data_sets_that_name_folders_elsewhere(tmp_path, splits):
    victim = tmp_path / "victim/velodyne/000000.bin"
    victim.parent.mkdir(parents=True)
    victim.touch()
    own = tmp_path / "out/sequences/00/velodyne/000000.bin"
    own.parent.mkdir(parents=True)
    own.touch()
    (tmp_path / "out/synth.json").write_text(json.dumps({"settings": {"splits": splits}}))
    claim_synth(tmp_path / "out", True)
    assert victim.exists()
    assert not own.exists()


def test_links_in_an_output_folder(tmp_path):
    """Those to folders are followed, which is how results get onto another disk.

    A link to a file is replaced or removed, and what it leads to stays as it is.
    """
    out, disk, victim = tmp_path / "out", tmp_path / "disk", tmp_path / "victim.label"
    disk.mkdir()
    victim.write_bytes(b"mine")
    claim(out, "predict", {"weights": 1}, ["predictions"], overwrite=False)
    (out / "sequences/08").mkdir(parents=True)
    (out / "sequences/08/predictions").symlink_to(disk)
    (disk / "notes.txt").touch()
    for stem in "ab":
        (disk / f"{stem}.label").symlink_to(victim)
    write_labels(output_path(out, "08", "predictions", "a"), np.zeros(5, np.uint32))
    assert (disk / "a.label").stat().st_size == 20
    claim(out, "predict", {"weights": 2}, ["predictions"], overwrite=True)
    assert [path.name for path in disk.iterdir()] == ["notes.txt"]
    assert victim.read_bytes() == b"mine"


def test_a_scan_that_is_a_link_to_itself_fails_alone(tmp_path):
    data = write_sequence(tmp_path / "08", ["a"], count=50)
    (data / "velodyne/b.bin").symlink_to("b.bin")
    for source in (data, data / ".." / "08" / "velodyne"):
        assert [scan.stem for scan in find_scans(source)] == ["a", "b"]
    outcome = project_scans(data, tmp_path / "out", sensor=SMALL)
    assert outcome.done == 1
    assert [failure.scan.stem for failure in outcome.failures] == ["b"]
    assert "too many levels of symbolic links" in outcome.failures[0].reason
    with pytest.raises(NoInputError, match="too many levels of symbolic links"):
        find_scans(data / "velodyne" / ".." / "velodyne" / "b.bin")
