# SPDX-License-Identifier: MIT
"""Errors of a fusion beside an earlier one, and the command that replaces its results."""

import shlex

import pytest

from salsanext_cli.commands.line.options.option_names import CommandLine
from salsanext_cli.core.wording import spelled
from salsanext_cli.runs.drives.earlier_fusion import earlier_fusion, other_drive
from salsanext_cli.runs.results.output_run import OutputRun


@pytest.fixture
def single(tmp_path):
    """Return a run in a folder whose name has to be quoted."""
    return OutputRun(tmp_path / "my out", "fuse", folders=("votes", "probabilities"))


def words_in(hint):
    """Return the words of the command in a hint."""
    return shlex.split(hint.split("`")[1])


def test_other_poses_are_answered_by_the_command_that_fuses_again(single, tmp_path):
    target = tmp_path / "my fused"
    record = target / "sequences/08/drive.json"
    with spelled(CommandLine()):
        error = other_drive(record, single)
    assert error.subject == str(record)
    fuse = ["salsanext", "fuse", str(single.root), str(target)]
    assert words_in(error.hint) == [*fuse, "--sequences", "08", "--overwrite"]
    assert "--poses" in error.hint


def test_votes_of_a_fusion_into_another_folder_are_named(single, tmp_path):
    target = tmp_path / "other"
    with spelled(CommandLine()):
        error = earlier_fusion(single, target, "00")
    assert error.subject == str(single.root)
    assert "probabilities/ and votes/" in error.problem
    fuse = ["salsanext", "fuse", str(single.root), str(target)]
    assert words_in(error.hint) == [*fuse, "--sequences", "00", "--overwrite"]
