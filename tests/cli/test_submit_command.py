# SPDX-License-Identifier: MIT
"""`salsanext submit` as it is typed."""

import numpy as np
import pytest
from command_line import only_json

from salsanext_cli import write_labels
from salsanext_cli.results.layout import output_path
from salsanext_cli.stages import submit as stage


@pytest.fixture
def out(tmp_path, monkeypatch):
    monkeypatch.setattr(stage, "SCANS_OF_TEST", dict.fromkeys(stage.SCANS_OF_TEST, 1))
    monkeypatch.chdir(tmp_path)
    for sequence in stage.SCANS_OF_TEST:
        path = output_path(tmp_path / "out", sequence, "predictions", "000000")
        write_labels(path, np.full(5, 40))
    return tmp_path / "out"


def test_a_submission(run, out, tmp_path):
    result = run("submit", "out", "a.zip")
    assert (result.exit_code, result.stdout) == (0, "")
    assert result.stderr.splitlines()[-1] == "submit: 11 scans → a.zip"
    assert run("submit", "out", "a.zip").exit_code == 1
    found = only_json(run("submit", "out", "b.zip", "--json", "-q"))
    assert (found["stage"], found["scans"], found["problems"]) == ("submit", 11, [])
    assert (tmp_path / "a.zip").read_bytes() == (tmp_path / "b.zip").read_bytes()


def test_problems_are_one_list_and_status_one(run, out, tmp_path):
    for sequence in ("12", "20"):
        output_path(out, sequence, "predictions", "000000").unlink()
    result = run("submit", "out", "a.zip", "-q")
    assert result.exit_code == 1
    assert result.stderr.splitlines() == [
        *(
            f"error: sequence {s} · 1 of 1 predictions are missing: 000000 · predict them"
            for s in ("12", "20")
        ),
        "submit: 2 problems, a.zip is not written",
    ]
    result = run("submit", "out", "a.zip", "--json")
    assert [p["sequence"] for p in only_json(result)["problems"]] == ["12", "20"]
    assert result.exit_code == 1
    assert not (tmp_path / "a.zip").exists()
