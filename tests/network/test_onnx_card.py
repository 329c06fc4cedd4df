# SPDX-License-Identifier: MIT
"""Cards of ONNX files, which the package onnx wrote."""

import pytest
from command_line import python
from onnx_models import write_onnx
from scans import SMALL

from salsanext_cli import label_space
from salsanext_cli.errors import MissingDependency, WeightsError
from salsanext_cli.network.card import KEY, WeightsCard, read_card

CARD = WeightsCard({"name": "salsanext"}, label_space(), SMALL, description="größer\n")


@pytest.mark.parametrize("opset", [9, 17])
def test_the_card_is_what_was_written(tmp_path, opset):
    path = write_onnx(tmp_path / "m.onnx", {"other": "…", **CARD.to_metadata()}, opset)
    assert read_card(path).to_metadata() == CARD.to_metadata()


def test_a_cut_file_is_an_error_wherever_it_is_cut(tmp_path):
    path = write_onnx(tmp_path / "m.onnx", CARD.to_metadata())
    content = path.read_bytes()
    for length in range(0, len(content), 7):
        path.write_bytes(content[:length])
        with pytest.raises(WeightsError):
            read_card(path)


@pytest.mark.parametrize(
    ("make", "found"),
    [
        (lambda path: None, "no such file"),
        (lambda path: path.mkdir(), r"a folder: .*\nhint: name the file in it"),
        (lambda path: path.write_bytes(b"PK\x03\x04"), "damaged or cut off"),
        (lambda path: path.write_bytes(b""), "lacks"),
        (lambda path: write_onnx(path, {}), "lacks"),
        (lambda path: write_onnx(path, {KEY: "[1"}), "damaged metadata"),
    ],
)
def test_files_that_are_none_of_ours(tmp_path, make, found):
    path = tmp_path / "m.onnx"
    make(path)
    with pytest.raises(WeightsError, match=found) as caught:
        read_card(path)
    assert caught.value.subject == str(path)


def test_no_telemetry_is_imported(tmp_path):
    path = write_onnx(tmp_path / "m.onnx", CARD.to_metadata())
    ended = python(
        "import sys\n"
        "from pathlib import Path\n"
        "from salsanext_cli.network.card import read_card\n"
        f"read_card(Path({str(path)!r}))\n"
        "print([m for m in sys.modules if 'telemetry' in m or m.startswith('openvino.tools.ovc')])"
    )
    assert (ended.stdout, ended.stderr) == ("[]\n", "")


def test_where_openvino_cannot_be_imported(tmp_path, monkeypatch):
    path = write_onnx(tmp_path / "m.onnx", CARD.to_metadata())
    monkeypatch.setitem(__import__("sys").modules, "openvino", None)
    with pytest.raises(MissingDependency) as caught:
        read_card(path)
    assert caught.value.subject == "openvino"
