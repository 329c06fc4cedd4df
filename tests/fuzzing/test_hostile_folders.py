# SPDX-License-Identifier: MIT
"""Records and links in an output folder: nothing outside of it is written or removed."""

import json

import numpy as np
import pytest
from scans import SMALL, files_below, write_sequence
from world import begin_and_end

from salsanext_cli.commands.stages.project import project_scans
from salsanext_cli.commands.stages.synth import synthesise
from salsanext_cli.core.errors import OutputError
from salsanext_cli.runs.results.result_folder import ResultFolder
from salsanext_cli.runs.scans.scan_search import find_scans

LABELS = np.zeros(5, np.uint32)


@pytest.mark.parametrize("stem", ["../../../victim", "/victim", "..", 3, None, ["a"]])
def test_records_of_scans_that_lead_elsewhere(tmp_path, stem):
    """Names that were asked for only determine missing results."""
    out, scans = tmp_path / "out", find_scans(write_sequence(tmp_path / "08", ["a"], count=5))
    output = begin_and_end(out, "predict", {}, ["predictions"], scans)
    output.write_labels(scans[0], LABELS)
    before = files_below(tmp_path)
    record = json.loads((out / "predict.json").read_text())
    record["scans"]["08"]["asked_for"] = [stem]
    (out / "predict.json").write_text(json.dumps(record))
    if isinstance(stem, str):
        assert ResultFolder(out).scans() == scans
    else:
        with pytest.raises(OutputError, match=r"predict\.json: "):
            ResultFolder(out).scans()
    assert files_below(tmp_path).keys() == before.keys()


@pytest.mark.parametrize("splits", [{"train": ["../../victim"]}, {"train": [3]}, 5, None])
def test_synthetic_data_sets_that_name_folders_elsewhere(tmp_path, splits):
    victim = tmp_path / "victim/velodyne/000000.bin"
    victim.parent.mkdir(parents=True)
    victim.touch()
    (tmp_path / "out").mkdir()
    (tmp_path / "out/synth.json").write_text(json.dumps({"settings": {"splits": splits}}))
    with pytest.raises(OutputError, match=r"synth\.json: "):
        synthesise(tmp_path / "out", train=1, valid=0, scans=1, overwrite=True)
    assert victim.exists()


def test_links_in_an_output_folder(tmp_path):
    """New results go through links to folders; nothing is removed there."""
    out, disk, victim = tmp_path / "out", tmp_path / "disk", tmp_path / "victim.label"
    disk.mkdir()
    victim.write_bytes(b"mine")
    (out / "sequences/08").mkdir(parents=True)
    (out / "sequences/08/predictions").symlink_to(disk)
    (disk / "b.label").symlink_to(victim)
    scans = find_scans(write_sequence(tmp_path / "08", ["a", "b"], count=5))
    output = begin_and_end(out, "predict", {}, ["predictions"], scans, overwrite=True)
    assert {path.name for path in output.foreign} == {"b.label"}
    output.write_labels(scans[0], LABELS)
    assert (disk / "a.label").stat().st_size == 20
    output = begin_and_end(out, "predict", {"seed": 2}, ["predictions"], scans, overwrite=True)
    assert {path.name for path in output.foreign} == {"a.label", "b.label"}
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
