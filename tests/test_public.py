# SPDX-License-Identifier: MIT
"""The names that other programs use."""

import ast
import importlib
from pathlib import Path

import numpy as np
import pytest
from command_line import python
from scans import SMALL, make_scan

import salsanext_cli as sn
from salsanext_cli.storage.point_files import write_bin

NAMES = [name for name in sn.__all__ if not name.startswith("__")]
HEAVY = ("torch", "numpy", "numba", "open3d", "matplotlib", "typer", "rich", "yaml", "plyfile")


def typed_names():
    """Return the names that type checkers see, with the modules they come from."""
    tree = ast.parse(Path(sn.__file__).read_text("utf-8"))
    (block,) = [n for n in tree.body if isinstance(n, ast.If)]
    assert ast.unparse(block.test) == "TYPE_CHECKING"
    return {alias.name: node.module for node in block.body for alias in node.names}


def test_all_is_what_type_checkers_see():
    assert set(NAMES) == set(typed_names())
    assert list(sn.__all__) == sorted(set(sn.__all__))
    assert set(NAMES) <= set(dir(sn))


@pytest.mark.parametrize("name", NAMES)
def test_each_is_what_its_home_holds(name):
    home = importlib.import_module(typed_names()[name])
    assert getattr(sn, name) is getattr(home, name)
    assert getattr(sn, name).__doc__


def test_other_names_are_attribute_errors():
    with pytest.raises(AttributeError, match="no attribute 'predikt'"):
        _ = sn.predikt
    names: dict[str, object] = {}
    exec("from salsanext_cli import *", names)
    assert set(NAMES) <= set(names)


def test_importing_imports_nothing_heavy():
    code = f"import sys, salsanext_cli; print([n for n in {HEAVY!r} if n in sys.modules])"
    assert python(code).stdout == "[]\n"


def test_the_sample_of_the_design_runs(tmp_path, monkeypatch, weights):
    """Five lines from a file to labels, the network's view being the preset's."""
    monkeypatch.chdir(tmp_path)
    write_bin(Path("000000.bin"), make_scan())
    Path("weights.safetensors").symlink_to(weights)
    monkeypatch.setattr("salsanext_cli.sensors.presets", lambda: {"hdl64": SMALL})

    scan = sn.read_scan("000000.bin")
    image = sn.project(scan, sn.sensor("hdl64"))
    network = sn.load_network("weights.safetensors", device="cpu")
    probs = network.probabilities(image)
    labels = sn.knn_refine(image, probs.argmax(0))

    assert scan.points.shape == (1500, 3)
    assert scan.points.dtype == scan.intensity.dtype == np.float32
    assert image.channels.shape == (5, 16, 128)
    assert image.pixel_of_point.shape == (1500,)
    assert image.point_of_pixel.shape == (16, 128)
    assert probs.shape == (20, 16, 128)
    np.testing.assert_allclose(probs.sum(axis=0), 1, atol=1e-5)
    assert labels.shape == (1500,)
    assert labels.dtype == np.uint8
    raw = sn.label_space().to_raw(labels)
    np.testing.assert_array_equal(sn.label_space().to_train(raw), labels)
