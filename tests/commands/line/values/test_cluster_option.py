# SPDX-License-Identifier: MIT
"""Workers of a cluster or of this machine: what is typed counts, and then the variable."""

import pytest
from command_line import built, called, every_command, only_json

from salsanext_cli.commands.line.app import app


def chosen(*words):
    """Return the values of both options after `project`."""
    command = built(app).commands["project"]
    values = command.make_context("project", [*words, "a"]).params
    return values["jobs"], values["cluster"]


def test_jobs_win_over_the_variable_of_the_cluster(monkeypatch):
    assert chosen() == (1, None)
    assert chosen("--cluster", "auto") == (1, "auto")
    monkeypatch.setenv("SALSANEXT_CLUSTER", "head:6379")
    assert chosen() == (1, "head:6379")
    assert chosen("--cluster", "auto") == (1, "auto")
    for number in ("1", "2"):
        assert chosen("--jobs", number) == (int(number), None)


@pytest.mark.parametrize("number", [1, 2])
def test_both_cannot_be_typed(number):
    result = called("predict", "a", "--jobs", number, "--cluster", "auto", "--json", status=2)
    assert only_json(result)["code"] == "usage"


def test_every_command_with_jobs_has_a_cluster_but_train():
    """Processes of `train` prepare samples for the one that trains."""
    options = {name: command.__annotations__ for name, command in every_command().items()}
    with_jobs = {name for name, found in options.items() if "jobs" in found}
    assert with_jobs - {name for name, found in options.items() if "cluster" in found} == {"train"}
    assert len(with_jobs) > 12
