# SPDX-License-Identifier: MIT
# ruff: noqa: F811
"""The script about bad conditions corrupts, predicts and scores each cell once."""

import re
import runpy
import subprocess
from pathlib import Path

import numpy as np
import pytest
from scans import write_sequence
from shallow import shallow, weights  # noqa: F401
from typer.testing import CliRunner

from salsanext_cli import read_labels, read_scan
from salsanext_cli.cli.app import app

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
SHARES = r"nan|\d+\.\d"


@pytest.fixture
def commands(monkeypatch):
    """Run commands in this process; return the names of those that were run."""
    names = []

    def command(words, **_):
        names.append(words[1])
        result = CliRunner().invoke(app, words[1:])
        assert result.exit_code == 0, result.stderr
        return subprocess.CompletedProcess(words, 0, result.stdout.encode())

    monkeypatch.setattr(subprocess, "run", command)
    monkeypatch.setenv("SALSANEXT_ENGINE", "torch")
    monkeypatch.syspath_prepend(BENCHMARKS)
    return names


@pytest.fixture
def data(tmp_path):
    """Return a data set of two sequences."""
    write_sequence(tmp_path / "data/sequences/00", ["0"])
    write_sequence(tmp_path / "data/sequences/01", ["0"], seed=3)
    return tmp_path / "data"


def run(*words: object) -> None:
    runpy.run_path(str(BENCHMARKS / "corruptions.py"))["main"](*map(str, words))


def lines(capsys) -> dict[str, list[list[str]]]:
    """Return the shares of each printed line by its name, and check the headings."""
    heading, *rows = capsys.readouterr().out.splitlines()
    columns = heading.split()
    found = {}
    for row in rows:
        name, *cells = re.split(r" {2,}", row)
        found[name] = [re.findall(SHARES, cell) for cell in cells]
        assert len(cells) == len(columns)
    return found


@pytest.mark.usefixtures("undrawn")
def test_cells_are_written_scored_and_not_repeated(data, tmp_path, weights, commands, capsys):
    folder = tmp_path / "folder"
    some = ("--weights", weights, "--corruptions", "other sensor", "--severities", 1, 3)
    run(data, folder, *some)
    found = lines(capsys)
    names = ["other sensor 1", "other sensor 3", "other sensor mean"]
    assert [*found] == ["clean", *names]
    assert [len(cell) for cell in found["clean"]] == [1, 1, 1, 2, 2, 2]
    accuracy = [float(found[name][1][0]) for name in names]
    assert accuracy[2] == pytest.approx(sum(accuracy[:2]) / 2, abs=0.11)
    assert commands == ["predict", "eval"] * 3
    # The cells hold what was scored: a data set like the first.
    for sequence in ("00", "01"):
        clean, milder = (
            read_scan(folder / cell / "data/sequences" / sequence / "velodyne/0.bin")
            for cell in ("clean", "other-sensor-1")
        )
        own = read_scan(data / "sequences" / sequence / "velodyne/0.bin")
        np.testing.assert_array_equal(clean.points, own.points)
        assert 0.3 * len(own) < len(milder) < 0.7 * len(own)
        label = folder / "other-sensor-1/data/sequences" / sequence / "labels/0.label"
        assert len(read_labels(label)) == len(milder)
    run(data, folder, *some)
    assert lines(capsys) == found
    assert len(commands) == 6


@pytest.mark.slow
def test_error_and_other_kinds_have_columns(data, tmp_path, weights, commands, capsys):
    tuned = tmp_path / "tuned.safetensors"
    words = ["tune", "error", data, tuned, "--weights", weights, "--sequences", "00,01"]
    assert CliRunner().invoke(app, [str(word) for word in words]).exit_code == 0
    some = ("--corruptions", "crosstalk", "--severities", 2, "--uncertainty")
    run(data, tmp_path / "folder", "--weights", tuned, *some, "--sequences", "00")
    found = lines(capsys)
    assert commands == ["predict", "uncertainty", "eval"] * 2
    assert [len(cell) for cell in found["crosstalk 2"]] == [1, 1, 1, 2, 2, 2, 2, 2, 2, 2, 2, 4]
    assert not (tmp_path / "folder/clean/data/sequences/01").exists()
