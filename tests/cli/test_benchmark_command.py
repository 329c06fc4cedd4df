# SPDX-License-Identifier: MIT
"""The command benchmark, with both sides in their processes, on a small scan."""

import json
import sys

import pytest
from command_line import only_json

from salsanext_cli.benchmarking.benchmark import PARTS
from salsanext_cli.cli.benchmark import LISTED

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="benchmark needs POSIX")


def test_a_few_parts(run, data, weights, tmp_path):
    file = tmp_path / "speed.json"
    options = ("--weights", weights, "--device", "cpu", "--rounds", 1, "--threads", 1)
    parts = ("--parts", "knn, help", "--write", file)
    result = run("benchmark", data, *options, *parts, "--json", "--quiet")
    assert (result.exit_code, result.stderr) == (0, "")
    found = only_json(result)
    assert json.loads(file.read_text()).items() <= found.items()
    assert found["machine"]["threads"] == 1
    knn, help_ = found["parts"]
    assert knn["ratio"]["median"] == knn["baseline"]["median"] / knn["product"]["median"]
    assert 0 < knn["share_of_ceiling"] < 1
    assert help_["baseline"] is None
    again = run("benchmark", data, *options, *parts)
    assert again.exit_code == 1
    assert "exists" in again.stderr


def test_help_lists_the_parts():
    assert ", ".join(PARTS) == LISTED


@pytest.mark.parametrize(
    "option", [("--rounds", 0), ("--threads", 0), ("--parts", ""), ("--parts", "knn,nets")]
)
def test_a_wrong_option(run, data, option):
    result = run("benchmark", data, *option)
    assert result.exit_code == 2
    assert f"error: {option[0]} · " in result.stderr
