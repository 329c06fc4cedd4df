# SPDX-License-Identifier: MIT
"""Results in the folder of the scans themselves, or above or below it, hide no scans."""

from pathlib import Path

import numpy as np
import pytest
from command_line import called, only_json
from scans import make_scan, refused, write_bin, write_sequence

from salsanext_cli.core.errors import OutputError
from salsanext_cli.runs.scans.scan_search import find_scans, require_no_hidden_scans


@pytest.fixture
def drive(tmp_path, monkeypatch):
    """Make scans in every layout, and go there."""
    write_sequence(tmp_path / "data/sequences/00", ["a", "b"], count=300)
    write_sequence(tmp_path / "streets/east", ["a", "b"], count=300)
    for number, stem in enumerate("ab"):
        scan = make_scan(300, number)
        write_bin(tmp_path / f"plain/{stem}.bin", scan)
        (tmp_path / "tables").mkdir(exist_ok=True)
        np.savetxt(tmp_path / f"tables/{stem}.txt", np.c_[scan.points, scan.intensity])
    monkeypatch.chdir(tmp_path)


def call(command):
    result = called(*command.split())
    return only_json(result)


@pytest.mark.parametrize(
    ("source", "out"),
    [
        ("tables", "tables"),
        *(
            pytest.param(*places, marks=pytest.mark.slow)
            for places in (("plain", "plain/out"), ("data", "data"), ("streets", "streets"))
        ),
        ("data/sequences/00/velodyne", "data/sequences/00/velodyne"),
    ],
)
def test_later_commands_find_the_scans(drive: None, weights, source: str, out: str) -> None:
    places = ["plain", "tables", "data", "data/sequences", "data/sequences/00", "streets"]
    before = {place: find_scans(Path(place)) for place in [*places, source]}
    network = f"--weights {weights} --device cpu --engine torch --json --columns x,y,z,intensity"
    first = call(f"predict {source} {out} {network}")
    assert (first["done"], first["failures"]) == (2, [])
    # `eval` writes a table that is not a scan, beside tables that are.
    (Path(out) / "scores.txt").write_text("accuracy_mean: 0.5\n")
    assert {place: find_scans(Path(place)) for place in before} == before
    again = call(f"predict {source} {out} {network}")
    assert (again["done"], again["skipped"]) == (0, 2)
    assert call(f"export-ply {out} --json")["done"] == 2
    call(f"predict {source} elsewhere {network}")
    for labels in Path("elsewhere").rglob("*.label"):
        assert labels.read_bytes() == (out / labels.relative_to("elsewhere")).read_bytes()


@pytest.mark.usefixtures("drive")
def test_sequences_with_scans_would_hide_others() -> None:
    for place in ("plain", "data/sequences/00", "streets"):
        refused(OutputError, place, require_no_hidden_scans, Path(place))
    for place in ("data", "tables", "new"):
        require_no_hidden_scans(Path(place))
