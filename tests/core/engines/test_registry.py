# SPDX-License-Identifier: MIT
# ruff: noqa: F811
"""Libraries that compute networks: a further one is a module and a row."""

import ast
import sys
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import ClassVar, get_args

import numpy as np
import pytest
from scans import SMALL, labels_below, make_scan, refused, write_bin
from shallow_network import shallow, weights  # noqa: F401

import salsanext_cli
from salsanext_cli import load_network, project
from salsanext_cli.commands.line.options.option_groups import OPTIONS
from salsanext_cli.commands.line.output.version_report import version_lines
from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.core.engines import device, machine, registry
from salsanext_cli.core.engines.batches import BatchSize
from salsanext_cli.core.engines.device import choose_precision
from salsanext_cli.core.engines.memory import out_of_gpu_memory, out_of_memory
from salsanext_cli.core.engines.registry import LIBRARIES, Library, choose_engine, computes_int8
from salsanext_cli.core.engines.torch_backend import TorchBackend
from salsanext_cli.core.errors import MissingDependency, UsageError
from salsanext_cli.core.notices import warn_once
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.results.manifest import Manifest

MODULE = "third_backend"


@dataclass(frozen=True, eq=False)
class ThirdBackend(TorchBackend):
    """Has memory for one image, counts those that it predicts, and lets torch compute them."""

    library: ClassVar[str] = "third"
    predicted: ClassVar[list[int]] = []

    def predict(self, images, temperature, *, softmax=False):
        if len(images) > 1:
            raise RuntimeError("Third: ARENA EXHAUSTED")
        self.predicted.append(len(images))
        return super().predict(images, temperature, softmax=softmax)


@pytest.fixture
def third(monkeypatch):
    """Register a third library, slower than the others."""
    module = ModuleType(MODULE)
    module.ThirdBackend = ThirdBackend
    monkeypatch.setitem(sys.modules, MODULE, module)
    row = Library(
        name="third",
        title="Third",
        module=MODULE,
        backend="ThirdBackend",
        devices=("cpu",),
        precisions=("float32",),
        packages=("third-library",),
        memory_errors=("arena exhausted",),
        gpu_memory_errors=("no room on the board",),
    )
    monkeypatch.setitem(LIBRARIES, row.name, row)
    ThirdBackend.predicted.clear()
    return row


def test_every_row_names_its_backend():
    for name, library in LIBRARIES.items():
        assert library.name == name == library.backend_class().library


def test_a_third_library_predicts(third, weights):
    image = project(make_scan(), SMALL)
    network = load_network(weights, "cpu", SMALL, engine="third")
    expected = load_network(weights, "cpu", SMALL, engine="torch").probabilities(image)
    np.testing.assert_array_equal(network.probabilities(image), expected)
    assert network.backend.library == "third"
    assert ThirdBackend.predicted == [1]
    assert not computes_int8("third")
    assert refused(UsageError, "engine", choose_engine, "third", "cuda:0")


@pytest.mark.usefixtures("third")
def test_its_words_tell_the_memory_of_a_gpu_from_that_of_the_host():
    host = RuntimeError("Arena exhausted")
    board = RuntimeError("There is no room on the board")
    other = RuntimeError("another fault")
    assert [out_of_memory(error) for error in (host, board, other)] == [True, True, False]
    assert [out_of_gpu_memory(error) for error in (host, board, other)] == [False, True, False]


def test_predict_takes_a_third_library_and_records_it(third, weights, tmp_path):
    for number in range(3):
        write_bin(tmp_path / f"scans/{number}.bin", make_scan(seed=number))
    for engine in ("third", "torch"):
        settings = NetworkSettings(weights, "cpu", engine=engine)
        outcome = predict_scans(tmp_path / "scans", tmp_path / engine, settings=settings)
        assert outcome.done == 3
        assert Manifest(tmp_path / engine).settings("predict").engine == engine
    assert ThirdBackend.predicted == [1, 1, 1]
    assert labels_below(tmp_path / "third") == labels_below(tmp_path / "torch")


def test_images_of_a_third_library_that_lack_memory_are_computed_in_smaller_batches(
    third, weights, caplog
):
    """As it is for the other libraries: the row has the words of its error."""
    network = load_network(weights, "cpu", SMALL, engine="third")
    images = [network.input(project(make_scan(seed=seed), SMALL).channels) for seed in range(3)]
    sizes = BatchSize(3, "scans")
    predictions = [p for batch in sizes.in_batches(network.predict, images) for p in batch]
    assert len(predictions) == 3
    assert ThirdBackend.predicted == [1, 1, 1]
    assert len(caplog.records) == 1


def test_the_words_of_a_library_that_is_not_there_mean_nothing():
    with pytest.raises(RuntimeError, match="EXHAUSTED"):
        list(BatchSize(2, "scans").in_batches(_exhausted, [1, 2]))


def _exhausted(_):
    raise RuntimeError("Third: ARENA EXHAUSTED")


def test_a_third_library_computes_in_its_number_types_only(third, monkeypatch):
    monkeypatch.setattr(device, "bfloat16_instructions", lambda: ["bf16"])
    assert choose_precision("auto", "cpu", "openvino") == "bfloat16"
    assert choose_precision("auto", "cpu", "third") == "float32"
    for precision in ("bfloat16", "int8"):
        refused(UsageError, "precision", choose_precision, precision, "cpu", "third")


def test_a_third_library_is_among_the_versions_of_reports_and_records(third):
    assert "third-library is not installed" in version_lines()
    versions = machine.versions(machine.computing_packages())
    assert versions["third-library"] is None
    assert versions.keys() > {"python", "torch", "openvino", "numpy", "numba"}


def texts(path):
    """Return the texts in the code of a module, without its docstrings."""
    tree = ast.parse(path.read_text("utf-8"))
    constants = (node.value for node in ast.walk(tree) if isinstance(node, ast.Constant))
    docstrings = {
        ast.get_docstring(node, clean=False)
        for node in ast.walk(tree)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
    }
    return [text for text in constants if isinstance(text, str) and text not in docstrings]


def test_only_the_row_and_the_modules_of_a_library_name_it():
    """So a further library needs no change of any other module."""
    package = Path(salsanext_cli.__file__).parent
    namers = {
        path.relative_to(package).as_posix()
        for path in package.rglob("*.py")
        # To parse a file takes longer than to read it.
        if "openvino" in path.read_text("utf-8").lower()
        if any("openvino" in text.lower() for text in texts(path))
    }
    engines = "core/engines"
    assert namers == {
        f"{engines}/openvino_backend.py",
        f"{engines}/openvino_runtime.py",
        f"{engines}/registry.py",
    }
    assert registry.int8_settings() == 'device="cpu" and engine="openvino"'


def test_the_option_takes_the_names_of_the_registry():
    assert get_args(OPTIONS[NetworkSettings]["engine"].typed) == ("auto", *LIBRARIES)


def test_the_fastest_library_that_starts_computes(third, monkeypatch, caplog):
    warn_once.cache_clear()
    broken = {
        name: Library(
            name=name,
            title=name,
            module=MODULE,
            backend="ThirdBackend",
            devices=("cpu",),
            precisions=("float32",),
            packages=(),
            failure=lambda: "does not start: no licence",
        )
        for name in ("first", "second")
    }
    monkeypatch.setattr(registry, "LIBRARIES", {**broken, "third": third})
    assert choose_engine("auto", "cpu") == "third"
    assert [record.getMessage().partition(":")[0] for record in caplog.records] == [*broken]
    assert all("third" in record.getMessage() for record in caplog.records)
    caught = refused(MissingDependency, "second", choose_engine, "second", "cpu")
    assert "third" in caught.value.hint
    monkeypatch.setattr(registry, "LIBRARIES", broken)
    caught = refused(MissingDependency, "second", choose_engine, "second", "cpu")
    assert caught.value.hint == "install it again"
    refused(UsageError, "engine", choose_engine, "torch", "cpu")
    warn_once.cache_clear()
