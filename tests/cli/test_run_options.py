# SPDX-License-Identifier: MIT
import json

import pytest
from command_line import every_command, only_json, parsed
from scans import labels_below

from salsanext_cli.cli import options, run_options
from salsanext_cli.errors import UsageError
from salsanext_cli.parallel.run import BACKENDS
from salsanext_cli.parallel.shards import Shard

SHARDED = {"project", "predict", "knn-refine", "uncertainty", "export-ply"}


def options_of(name):
    return {option for parameter in parsed(name).params for option in parameter.opts}


def test_who_works_can_be_said_of_every_stage_that_goes_through_scans():
    for name in SHARDED | {"eval", "inspect"}:
        assert {"--jobs", "--backend", "--scheduler"} <= options_of(name)
    assert {name for name in every_command() if "--shard" in options_of(name)} == SHARDED


def test_backends():
    assert tuple(backend.value for backend in run_options.Backend) == BACKENDS


def test_gathering():
    gathered = run_options.gather(
        4, run_options.Backend.dask, "tcp://here:8786", options.OnError.stop, True, Shard(2, 3)
    )
    assert (gathered.jobs, gathered.backend, gathered.scheduler) == (4, "dask", "tcp://here:8786")
    assert (gathered.on_error, gathered.overwrite, gathered.shard) == ("stop", True, Shard(2, 3))
    with pytest.raises(UsageError, match="--scheduler"):
        run_options.gather(None, run_options.Backend.loky, "tcp://here:8786", options.OnError.skip)


@pytest.mark.parametrize(
    ("arguments", "found"),
    [
        (["--shard", "3/2"], "--shard · 3/2"),
        (["--shard", "0"], "i/n"),
        (["--backend", "spark"], "spark"),
        (["--scheduler", "tcp://here:8786"], "--scheduler tcp://here:8786 · --backend loky"),
    ],
)
def test_a_command_line_that_is_wrong(run, data, tmp_path, weights, arguments, found):
    result = run("predict", data, tmp_path / "out", "--weights", weights, *arguments)
    assert result.exit_code == 2
    assert found in result.stderr
    assert not (tmp_path / "out").exists()


@pytest.fixture
def task(monkeypatch):
    """Return a function that makes this process a task of a Slurm array of two, from 4."""

    def become(number):
        for name, value in {"ID": number, "MIN": 4, "COUNT": 2}.items():
            monkeypatch.setenv(f"SLURM_ARRAY_TASK_{name}", str(value))

    return become


def test_tasks_of_an_array_share_the_scans(run, data, tmp_path, weights, task):
    call = ["predict", data, tmp_path / "out", "--weights", weights, "--device", "cpu"]
    for number in (5, 4):
        task(number)
        result = run(*call, "--json")
        assert result.exit_code == 0
        assert f"shard {number - 3}/2 of the scans" in result.stderr
        assert only_json(result)["done"] == 1
    assert len(labels_below(tmp_path / "out")) == 2
    asked = json.loads((tmp_path / "out/sequences/08/source.json").read_text())["asked_for"]
    assert asked == {"predict": ["000000", "000001"]}


def test_what_is_said_goes_before_the_array(run, data, tmp_path, weights, task):
    task(4)
    out = tmp_path / "out"
    result = run("project", data, out, "--weights", weights, "--shard", "1/1", "--json")
    assert "shard" not in result.stderr
    assert only_json(result)["done"] == 2


def test_shards_do_not_estimate_what_others_may_be_estimating(run, data, tmp_path, weights):
    out = tmp_path / "out"
    run("predict", data, out, "--weights", weights, "--device", "cpu")
    call = ["export-ply", "--out", out, "--colour", "uncertainty", "--shard", "1/2"]
    result = run(*call, "--weights", weights)
    assert result.exit_code == 2
    assert "run `salsanext uncertainty` first" in result.stderr
