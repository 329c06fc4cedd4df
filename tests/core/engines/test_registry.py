# SPDX-License-Identifier: MIT
# ruff: noqa: F811
"""Libraries that compute networks: a further one is a module and a row."""

import sys
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import ClassVar, get_args

import numpy as np
import pytest
from scans import SMALL, labels_below, make_scan, refused, write_bin
from shallow import shallow, weights  # noqa: F401

from salsanext_cli import load_network, project
from salsanext_cli.commands.line.option_groups import OPTIONS
from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.core.engines import registry
from salsanext_cli.core.engines.registry import LIBRARIES, Library, choose_engine, computes_int8
from salsanext_cli.core.engines.torch_backend import TorchBackend
from salsanext_cli.core.errors import MissingDependency, UsageError
from salsanext_cli.core.notices import warn_once
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.results.manifest import Manifest

MODULE = "third_backend"


@dataclass(frozen=True, eq=False)
class ThirdBackend(TorchBackend):
    """Counts the images that it predicts, and lets torch compute them."""

    library: ClassVar[str] = "third"
    predicted: ClassVar[list[int]] = []

    def predict(self, images, temperature, *, softmax=False):
        self.predicted.append(len(images))
        return super().predict(images, temperature, softmax=softmax)


@pytest.fixture
def third(monkeypatch):
    """Register a third library, slower than the others."""
    module = ModuleType(MODULE)
    module.ThirdBackend = ThirdBackend
    monkeypatch.setitem(sys.modules, MODULE, module)
    row = Library(
        name="third", title="Third", module=MODULE, backend="ThirdBackend", devices=("cpu",)
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


def test_predict_takes_a_third_library_and_records_it(third, weights, tmp_path):
    write_bin(tmp_path / "scans/0.bin", make_scan())
    for engine in ("third", "torch"):
        settings = NetworkSettings(weights, "cpu", engine=engine)
        outcome = predict_scans(tmp_path / "scans", tmp_path / engine, settings=settings)
        assert outcome.done == 1
        assert Manifest(tmp_path / engine).settings("predict").engine == engine
    assert ThirdBackend.predicted == [1]
    assert labels_below(tmp_path / "third") == labels_below(tmp_path / "torch")


def test_only_the_row_and_the_modules_of_a_library_name_it():
    """So a further library needs no change of the choice of device and precision."""
    engines = Path(registry.__file__).parent
    namers = {path.name for path in engines.glob("*.py") if '"openvino"' in path.read_text("utf-8")}
    assert namers == {"openvino_backend.py", "registry.py"}
    assert registry.int8_settings() == 'device="cpu" and engine="openvino"'


def test_the_option_takes_the_names_of_the_registry():
    assert get_args(OPTIONS[NetworkSettings]["engine"].metadata["typed"]) == ("auto", *LIBRARIES)


def test_the_fastest_library_that_starts_computes(third, monkeypatch, caplog):
    warn_once.cache_clear()
    broken = {
        name: Library(
            name=name,
            title=name,
            module=MODULE,
            backend="ThirdBackend",
            devices=("cpu",),
            failure=lambda: "does not start: no licence",
        )
        for name in ("first", "second")
    }
    for name in list(LIBRARIES):
        monkeypatch.delitem(LIBRARIES, name)
    for name, library in {**broken, "third": third}.items():
        monkeypatch.setitem(LIBRARIES, name, library)
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
