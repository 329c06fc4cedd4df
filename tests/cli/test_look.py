# SPDX-License-Identifier: MIT
"""Commands to look at results as they are typed; rerun-sdk is not needed."""

import sys

import pytest
from command_line import only_json
from evaluated import CAR, ROAD, World


@pytest.fixture
def world(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    world = World(tmp_path)
    world.add("000000", [CAR, ROAD], [CAR, CAR])
    world.add("000001", [CAR, ROAD], [CAR, ROAD])
    return world


def test_the_command_says_where_the_page_is(run, world):
    given = ("report", str(world.out), "--dataset", str(world.dataset))
    result = run(*given, "--json")
    assert result.exit_code == 0, result.output
    found = only_json(result)
    assert found["page"] == str(world.out / "report.html")
    assert found["accuracy"] == 3 / 4
    assert "report: 2 scans" in result.stderr
    assert run(*given, "--scans", "9").exit_code == 2
    assert run("report", "nowhere").exit_code == 1
    result = run(*given, "--scans", "08/000001", "--quiet")
    assert (result.exit_code, result.output) == (0, "")


def test_without_rerun_the_extra_is_named(run, world, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    result = run("export-rrd", world.out, "--dataset", world.dataset)
    assert result.exit_code == 1
    assert result.stderr == "error: rerun · not installed · pip install 'salsanext[rerun]'\n"
