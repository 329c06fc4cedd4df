# SPDX-License-Identifier: MIT
"""`predict --reject` and reports state the share of rejected points of those with a label."""

import base64
import re
import shlex
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import called, only_json
from scans import HOUSING

from salsanext_cli import read_labels
from salsanext_cli.commands.picked_labels import doubtful_share
from salsanext_cli.core.network.error_model import ErrorModel
from salsanext_cli.core.uncertainty.error_features import FEATURES
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.io.weights.weights import save_with_card


@pytest.fixture
def ranged_weights(housed, tmp_path) -> Path:
    """Return weights of which the error of a label grows with the range of its point."""
    slopes = np.array([[4.0 if name == "log range" else 0.0] for name in FEATURES], np.float32)
    model = ErrorModel(features=FEATURES, layers=[(slopes, np.array([-12.0], np.float32))])
    target = tmp_path / "ranged.safetensors"
    source = housed.network.weights
    save_with_card(source, target, replace(read_card(source), error=model))
    return target


def counted_slowly(out: Path, threshold: float) -> tuple[int, int]:
    """Return the number of points with a label, and of those above a threshold."""
    labelled = above = 0
    for path in out.rglob("*.label"):
        errors = np.load(path.parents[1] / f"uncertainty/error/{path.stem}.npy")
        for label, error in zip(read_labels(path), errors, strict=True):
            labelled += label != 0
            above += bool(label != 0 and error > np.float32(threshold))
    return labelled, above


def sentence_share(result) -> str:
    """Return the share of doubtful points in the sentence of a decision."""
    (share,) = re.findall(r"([\d.]+) % of the points with a label have", result.stderr)
    return share


@pytest.mark.parametrize(
    "command", ["filter OUT TARGET --max-error 0.5", "picture OUT --colour error"]
)
def test_the_hint_about_the_error_of_merged_classes_works(
    housed, ranged_weights, tmp_path, monkeypatch, command
):
    """An error of merged classes cannot be computed: it is that of another run."""
    given = ("--weights", ranged_weights, "--engine", "torch")
    out = tmp_path / "merged"
    called("predict", housed.data, out, *given, "--classes", "coarse")
    places = {"OUT": out, "TARGET": tmp_path / "target"}
    failed = called(*(places.get(word, word) for word in command.split()), status=1)
    (line,) = (line for line in failed.stderr.splitlines() if line.startswith("hint: "))
    (run,) = re.findall(r"`salsanext (.*?)`", line)
    places["OUT"] = shlex.split(line.rpartition("give ")[2])[0]
    monkeypatch.chdir(tmp_path)
    called(*shlex.split(run), *given)
    called(*(places.get(word, word) for word in command.split()))


def test_a_run_that_rejects_and_the_report_state_one_share(housed, ranged_weights, tmp_path):
    data, out, rejecting = housed.data, tmp_path / "out", tmp_path / "rejecting"
    for folder in [*data.rglob("labels")]:
        shutil.rmtree(folder)
    given = ("--weights", ranged_weights, "--engine", "torch")
    called("predict", data, out, *given, "--error")
    labelled, above = counted_slowly(out, 0.1)
    assert 0 < above < labelled
    assert labelled == 3 * 1500, "points on the housing have no label"
    share = above / labelled
    assert f"{100 * share:.1f}" != f"{100 * above / (labelled + 3 * HOUSING):.1f}"
    result = called("predict", data, rejecting, *given, "--reject", "0.1")
    (printed,) = re.findall(r"\(([\d.]+) % of the points with a label\) rejected", result.stderr)
    numbers = only_json(
        called("predict", data, rejecting, *given, "--reject", "0.1", "--overwrite", "--json")
    )
    assert printed == f"{100 * share:.1f}"
    assert (numbers["rejected_points"], numbers["rejected_share"]) == (above, round(share, 4))
    for folder in (out, rejecting):
        result = called("report", folder)
        assert doubtful_share(folder) == share
        if folder == out:
            assert sentence_share(result) == printed
    page = (rejecting / "report.html").read_text("utf-8")
    assert f"<b>{printed} %</b>of the points with a label rejected" in page
    assert f"{printed} % of them above 10 %" in page
    columns = {}
    for name in ("doubtful", "rejected"):
        (text,) = re.findall(f'"{name}": ?"([^"]*)"', page)
        columns[name] = np.frombuffer(base64.b64decode(text), "<f4")
    np.testing.assert_array_equal(columns["rejected"], columns["doubtful"])
    assert columns["rejected"].mean() == pytest.approx(share)
