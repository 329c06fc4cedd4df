# SPDX-License-Identifier: MIT
"""``--intensity-field`` on the command line, and in the folder of results."""

import json

import numpy as np
import pytest
from command_line import only_json, subject
from scans import make_scan

from salsanext_cli import write_ply
from salsanext_cli.runs.results.result_folder import ResultFolder


@pytest.fixture
def drive(tmp_path):
    """Write scans with an intensity under another name."""
    (tmp_path / "drive").mkdir()
    for number in range(2):
        scan = make_scan(seed=number)
        fields = dict(zip("xyz", scan.points.T, strict=True)) | {"scalar_Echo": scan.intensity}
        write_ply(tmp_path / f"drive/{number}.ply", fields)
    return tmp_path / "drive"


def test_the_folder_of_results_records_it(run, drive, weights, tmp_path):
    out = tmp_path / "out"
    call = ["predict", drive, out, "--weights", weights, "--device", "cpu", "--json"]
    warned = only_json(run(*call, status=0))["warnings"]
    assert "no-intensity" in json.dumps(warned)
    named = [*call, "--intensity-field", "echo"]
    assert "intensity_field" in run(*named, status=1).stderr
    assert "no-intensity" not in json.dumps(only_json(run(*named, "--overwrite", status=0)))
    assert ResultFolder(out).provenance.sensor().intensity_field == "echo"
    # Later commands need the option no more.
    run("export-ply", out, "--colour", "intensity", status=0)
    cloud = (out / "sequences/drive/ply/0.ply").read_bytes()
    assert make_scan(seed=0).intensity.max().tobytes() in cloud


def test_inspect_takes_it_and_a_mistake_is_named(run, drive):
    found = only_json(run("inspect", drive, "--intensity-field", "echo", "--json", status=0))
    assert "no-intensity" not in json.dumps(found)
    assert "no-intensity" in json.dumps(only_json(run("inspect", drive, "--json", status=0)))
    for name in ("x", "", " "):
        result = run("inspect", drive, "--intensity-field", name, status=2)
        assert subject(result) == "--intensity-field"
    assert "scalar_Echo" in run("inspect", drive, "--intensity-field", "ring", status=1).stderr


def test_it_changes_the_intensity_only(run, drive, weights, tmp_path):
    for name in ((), ("--intensity-field", "echo")):
        out = tmp_path / f"out{len(name)}"
        run("project", drive, out, "--weights", weights, *name, status=0)
    images = [np.load(tmp_path / f"out{n}/sequences/drive/range/0.npy") for n in (0, 2)]
    np.testing.assert_array_equal(images[0][:4], images[1][:4])
    assert not images[0][4].any()
    assert images[1][4].any()
