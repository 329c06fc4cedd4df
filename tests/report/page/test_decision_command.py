# SPDX-License-Identifier: MIT
# ruff: noqa: F811
"""The command that follows from a decision names the scans and weights of the run, and works."""

import html
import re
import shlex
import shutil
from types import SimpleNamespace

import pytest
from command_line import called
from narrow_network import narrow, weights  # noqa: F401
from scans import write_sequence

from salsanext_cli.commands.line.options.option_names import CommandLine
from salsanext_cli.commands.stages.report import report
from salsanext_cli.core.checks.finding import Finding
from salsanext_cli.core.measures.decision import Decision, Verdict
from salsanext_cli.core.wording import spelled
from salsanext_cli.report.page.decision_command import decision_command
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.results.provenance import Provenance
from salsanext_cli.runs.scans.scan_search import find_scans

pytestmark = pytest.mark.usefixtures("undrawn")


def words_of_command(out) -> list[str]:
    """Return the command of the decision on the page of a run, in words."""
    with spelled(CommandLine()):
        page = report(out).page.read_text("utf-8")
    (command,) = re.findall(r'class="decision">.*?<code>(.*?)</code>', page)
    return shlex.split(html.unescape(command))


def record(out) -> None:
    """Record a warning about each scan that leads to a decision with a command."""
    scans = {f"{path.parts[-3]}/{path.stem}" for path in out.rglob("*.label")}
    findings = {name: [Finding("sparse", "few rows", "look")] for name in scans}
    OwnedFolder(out, "predict").record_findings(findings, scans)


@pytest.fixture
def drive(world, tmp_path, monkeypatch):
    """Return a world whose scans have no labels, in the current folder."""
    monkeypatch.chdir(tmp_path)
    shutil.rmtree(world.data / "sequences")
    write_sequence(world.data / "sequences/08", ["000000", "000001"], labels=False)
    return world


def test_the_command_of_the_decision_names_the_scans_and_the_weights_and_works(drive, tmp_path):
    scans = drive.data / "sequences/08/velodyne"
    weights = drive.network.weights
    called("predict", scans, tmp_path / "out", "--weights", weights, "--engine", "torch")
    record(tmp_path / "out")
    words = words_of_command(tmp_path / "out")
    assert words[0] == "salsanext"
    assert (tmp_path / words[2]).resolve() == scans.resolve()
    assert (tmp_path / words[words.index("--weights") + 1]).resolve() == weights.resolve()
    called(*words[1:])
    (made,) = {tmp_path / name for name in ("coarse", "to-label") if (tmp_path / name).is_dir()}
    assert any(made.rglob("*.label"))


def test_several_sequences_are_chosen_in_their_data_set(drive, tmp_path):
    write_sequence(drive.data / "sequences/09", ["000000"], labels=False)
    write_sequence(drive.data / "sequences/10", ["000000"], labels=False)
    weights = drive.network.weights
    options = ("--sequences", "08,09", "--weights", weights, "--engine", "torch")
    called("predict", drive.data, tmp_path / "out", *options)
    record(tmp_path / "out")
    words = words_of_command(tmp_path / "out")
    assert (tmp_path / words[2]).resolve() == drive.data.resolve()
    assert words[words.index("--sequences") + 1] == "08,09"


def test_weights_that_changed_since_are_not_named(drive, tmp_path):
    weights = tmp_path / "mine.safetensors"
    shutil.copy(drive.network.weights, weights)
    scans = drive.data / "sequences/08/velodyne"
    called("predict", scans, tmp_path / "out", "--weights", weights, "--engine", "torch")
    record(tmp_path / "out")
    weights.write_bytes(b"others")
    words = words_of_command(tmp_path / "out")
    assert words[words.index("--weights") + 1] == "WEIGHTS"


def test_scans_are_labelled_again_from_the_same_origin(drive, tmp_path):
    scans = drive.data / "sequences/08/velodyne"
    options = ("--weights", drive.network.weights, "--engine", "torch", "--origin", "0.5,0,-0.25")
    called("predict", scans, tmp_path / "out", *options)
    rows = [SimpleNamespace(file=file) for file in find_scans(scans)]
    run = SimpleNamespace(rows=rows, reader=SimpleNamespace(out=tmp_path / "out"))
    words = {}
    for decision in (Decision.COARSE, Decision.LABEL_TEN):
        with spelled(CommandLine()):
            command = decision_command(run, Verdict(decision=decision, reason=""))
        words[decision] = shlex.split(command)
    called(*words[Decision.COARSE][1:])
    origins = [Provenance(tmp_path / name).sensor().origin for name in ("out", "coarse")]
    assert origins == [(0.5, 0, -0.25)] * 2
    # `pick` has no such option.
    called(*words[Decision.LABEL_TEN][1:])
