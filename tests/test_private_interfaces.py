# SPDX-License-Identifier: MIT
"""Interfaces of other packages that these do not document, each used in one module.

A weekly job runs the tests that are marked `private` with the newest versions, also those above the
bounds of `pyproject.toml`. A failure names the module to change before the bound is raised.
"""

import re
import socket
import sys
import tomllib
from datetime import timedelta
from pathlib import Path

import numba
import numpy as np
import pytest
import torch
import torch.distributed
import typer
from torch import nn
from torch.optim import SGD, AdamW

from salsanext_cli.commands.line.app import app
from salsanext_cli.commands.line.options.typer_interface import (
    USAGE_ERROR,
    TyperCommand,
    TyperGroup,
)
from salsanext_cli.core.engines.conversion import converted
from salsanext_cli.core.engines.openvino_runtime import openvino_core
from salsanext_cli.io import kernel_cache
from salsanext_cli.runs.loop.cluster import node_code
from salsanext_cli.training.fused_step import is_fused, skip_step
from salsanext_cli.training.running_average import RunningAverage

pytestmark = pytest.mark.private
BOUNDED = ("numba", "openvino", "ray", "rosbags", "torch", "typer")
USERS = {
    "io/bag_index.py": r"message_index_offsets|\.dbconn\b|messages_scan|decompressors",
    "io/kernel_cache.py": r"numba\.core|\._cache\b",
    "core/engines/conversion.py": r"torch\.jit|openvino\.frontend",
    "training/fused_step.py": r"found_inf",
    "training/running_average.py": r"torch\._foreach",
    "commands/line/options/typer_interface.py": (
        r"typer\.core|BadParameter\.__base__|get_parameter_source"
    ),
    "training/distributed.py": r"dist\.rendezvous",
    "runs/loop/cluster/ray_cluster.py": r"ray\.cloudpickle",
}
"""The only module that uses an interface, and what names it."""


@pytest.mark.parametrize("user", USERS)
def test_one_module_uses_an_interface(user):
    package = Path(kernel_cache.__file__).parents[1]
    found = {
        module.relative_to(package).as_posix()
        for module in package.rglob("*.py")
        if re.search(USERS[user], module.read_text("utf-8"))
    }
    assert found == {user}


def test_the_versions_of_packages_with_such_interfaces_have_a_bound():
    project = Path(__file__).parents[1] / "pyproject.toml"
    described = tomllib.loads(project.read_text("utf-8"))["project"]
    extras = described["optional-dependencies"]
    required = [*described["dependencies"], *extras["ros"], *extras["ray"]]
    bounded = {re.split(r"[\[<>=]", text)[0] for text in required if "<" in text}
    assert bounded == {*BOUNDED}


def twice(value):
    return 2 * value


def test_a_kernel_of_numba_takes_another_cache(tmp_path, monkeypatch, caplog):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setitem(vars(numba.config), "CACHE_DIR", "")
    hits = []
    for _ in range(2):
        kernel = numba.njit(twice)
        kernel_cache.cache_kernel(kernel)
        assert kernel(1.5) == 3.0
        hits.append(sum(kernel.stats.cache_hits.values()))
    assert hits == [0, 1]
    assert not caplog.records


@pytest.mark.parametrize("kind", [SGD, AdamW])
def test_a_fused_optimiser_of_torch_skips_a_step(kind):
    parameter = nn.Parameter(torch.ones(3))
    optimiser = kind([parameter], lr=0.1, fused=True)
    assert is_fused(optimiser)
    assert not is_fused(kind([parameter], lr=0.1))
    parameter.grad = torch.ones(3)
    skip_step(optimiser, torch.tensor(True))
    optimiser.step()
    assert torch.equal(parameter, torch.ones(3))
    skip_step(optimiser, torch.tensor(False))
    optimiser.step()
    assert (parameter < 1).all()


def test_torch_copies_the_counts_of_several_batch_norms_together():
    average, new = (nn.Sequential(nn.BatchNorm2d(1), nn.BatchNorm2d(1)) for _ in range(2))
    for number, layer in enumerate(new, start=7):
        layer.num_batches_tracked.fill_(number)
    RunningAverage(average, new, 0.9).update(0)
    assert [int(layer.num_batches_tracked) for layer in average] == [7, 8]


def test_a_module_of_torch_becomes_a_graph_of_openvino():
    """Erfc is an operation that the front end learns from us, of numbers ≥ 0."""
    image = torch.rand(1, 2, 4, 4, generator=torch.Generator().manual_seed(0))
    module = nn.Conv2d(2, 3, 1).eval()

    def function(layer, values):
        return torch.special.erfc(layer(values).abs())

    model = converted(module, function, [image])
    graph = openvino_core().compile_model(model, "CPU", {"INFERENCE_PRECISION_HINT": "f32"})
    with torch.inference_mode():
        expected = function(module, image).numpy()
    np.testing.assert_allclose(graph(image.numpy())[0], expected, rtol=1e-4, atol=1e-6)


def test_torch_returns_the_store_the_rank_and_the_size_of_a_group(monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = str(free.getsockname()[1])
    group = {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port, "RANK": "0", "WORLD_SIZE": "1"}
    for name, value in group.items():
        monkeypatch.setenv(name, value)
    store, rank, size = next(torch.distributed.rendezvous("env://", timeout=timedelta(seconds=20)))
    assert (rank, size) == (0, 1)
    assert not store.check(["failed"])
    # The first value stays.
    assert store.compare_set("failed", "", "a") == b"a"
    assert store.compare_set("failed", "", "b") == b"a"
    assert store.add("calls", 2) == 2


def test_ray_sends_the_code_of_a_module_instead_of_its_name(monkeypatch):
    cloudpickle = pytest.importorskip("ray.cloudpickle")
    assert cloudpickle.loads(cloudpickle.dumps(node_code.node_problem)) is node_code.node_problem
    cloudpickle.register_pickle_by_value(node_code)
    try:
        content = cloudpickle.dumps((node_code.node_problem, node_code.NodeWorker))
    finally:
        cloudpickle.unregister_pickle_by_value(node_code)
    # As on a node without the package.
    monkeypatch.setitem(sys.modules, node_code.__name__, None)
    function, kind = cloudpickle.loads(content)
    lacking = node_code.NodeRequirements(versions={"salsanext": "none"})
    # The result is sent back in the same way.
    problem = cloudpickle.loads(cloudpickle.dumps(function(lacking)))
    assert "salsanext" in problem.text
    assert problem.hint == node_code.VERSIONS_HINT
    assert kind(b"", 1).packed == b""


def test_typer_tells_what_was_typed(monkeypatch):
    monkeypatch.setenv("SALSANEXT_CLUSTER", "auto")
    command = typer.main.get_command(app).commands["predict"]
    context = command.make_context("predict", ["--jobs", "2", "a"])
    names = {name: context.get_parameter_source(name).name for name in ("jobs", "shard")}
    assert names == {"jobs": "COMMANDLINE", "shard": "DEFAULT"}
    assert context.params["cluster"] is None
    context = command.make_context("predict", ["a"])
    assert context.get_parameter_source("cluster").name == "ENVIRONMENT"


COMMAND_NAMES = ("params", "format_help", "format_help_text", "get_short_help_str", "parse_args")
GROUP_NAMES = (*COMMAND_NAMES, "commands", "invoke", "resolve_command")
PARAMETER_NAMES = ("opts", "param_type_name", "metavar", "envvar", "default", "required", "help")
OPTION_NAMES = (*PARAMETER_NAMES, "secondary_opts", "is_flag", "show_default", "rich_help_panel")
CONTEXT_NAMES = (
    *("parent", "info_name", "command_path", "args", "params", "resilient_parsing", "exit"),
    "get_parameter_source",
)
FORMATTER_NAMES = ("write_usage", "write_paragraph", "write_text", "write_dl", "getvalue")


def test_commands_of_typer_have_the_attributes_that_the_help_reads():
    group = typer.main.get_command(app)
    assert isinstance(group, TyperGroup)
    assert lacks(group, GROUP_NAMES) == []
    commands = [command for command in group.commands.values() if isinstance(command, TyperCommand)]
    assert len(commands) > 15
    for command in commands:
        assert lacks(command, COMMAND_NAMES) == []
        for parameter in command.params:
            is_option = parameter.param_type_name == "option"
            assert lacks(parameter, OPTION_NAMES if is_option else PARAMETER_NAMES) == []
    context = group.make_context("salsanext", ["models"])
    assert lacks(context, CONTEXT_NAMES) == []
    assert lacks(context.make_formatter(), (*FORMATTER_NAMES, "indentation", "section")) == []


@pytest.mark.parametrize("words", [["--nope"], ["predict", "--limit", "x", "a"]])
def test_errors_of_typer_have_one_class_and_the_attributes_that_messages_need(words):
    program = typer.Typer()

    @program.command()
    def predict(scans: str, limit: int = 0) -> None:
        """Do nothing."""

    @program.command()
    def other() -> None:
        """Do nothing."""

    with pytest.raises(USAGE_ERROR) as caught:
        typer.main.get_command(program).main(words, standalone_mode=False)
    error = caught.value
    assert lacks(error, ("ctx", "format_message")) == []
    assert getattr(error, "option_name", None) or error.param.opts == ["--limit"]


def lacks(value, names):
    return [name for name in names if not hasattr(value, name)]
