# SPDX-License-Identifier: MIT
"""Metadata of ONNX files, against the package onnx."""

from contextlib import suppress

import pytest

from salsanext_cli.errors import WeightsError
from salsanext_cli.network.card import read_card
from salsanext_cli.network.onnx_metadata import MAX_FIELDS, OPSET, onnx_metadata

onnx = pytest.importorskip("onnx")


def write(path, metadata, opset=OPSET):
    """Write a model of one layer."""
    ports = [
        onnx.helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, [1, 2]) for name in "xy"
    ]
    graph = onnx.helper.make_graph(
        [onnx.helper.make_node("Relu", ["x"], ["y"])], "g", ports[:1], ports[1:]
    )
    opsets = [onnx.helper.make_opsetid(*pair) for pair in (("other", 2), ("", opset))]
    model = onnx.helper.make_model(graph, doc_string="d" * 300, opset_imports=opsets)
    onnx.helper.set_model_props(model, metadata)
    onnx.save(model, path)
    return path


@pytest.mark.parametrize(
    "metadata", [{}, {"a": ""}, {"": "b"}, {"salsanext": "{}" * 1000, "ümlaut": "größer\n"}]
)
def test_as_the_package_onnx_reads_them(tmp_path, metadata):
    path = write(tmp_path / "m.onnx", metadata)
    assert onnx_metadata(path) == metadata
    assert onnx_metadata(path) == {p.key: p.value for p in onnx.load(path).metadata_props}


def test_a_cut_file_is_an_error_wherever_it_is_cut(tmp_path):
    path = write(tmp_path / "m.onnx", {"salsanext": "{}"})
    content = path.read_bytes()
    whole, whole_fields = onnx_metadata(path), 0
    for length in range(len(content)):
        path.write_bytes(content[:length])
        # Between two fields nobody can tell.
        with suppress(WeightsError):
            assert onnx_metadata(path) in ({}, whole)
            whole_fields += 1
    assert whole_fields < 5


def test_hostile_files(tmp_path):
    for content, found in (
        (b"", "no graph"),
        (b"PK\x03\x04", "kind"),
        (b"\x3a\xff\xff\xff\xff\xff\xff\xff\xff\x7f", "beyond the end"),
        (b"\x3a" + b"\xff" * 12, "ten bytes"),
        (b"\x08\x01" * (MAX_FIELDS + 1), "more than 1000 fields"),
        (b"\x3a\x00\x72\x04\x0a\x02\xff\xfe", "decode"),
    ):
        path = tmp_path / "m.onnx"
        path.write_bytes(content)
        with pytest.raises(WeightsError, match=found):
            read_card(path)


@pytest.mark.parametrize(
    ("make", "found"),
    [
        (lambda path: None, "no such file"),
        (lambda path: path.mkdir(), "directory"),
        (lambda path: write(path, {}), "lacks"),
        (lambda path: write(path, {"salsanext": "[1"}), "damaged metadata"),
        (lambda path: write(path, {}, 1), "opset 1 · expected 17"),
    ],
)
def test_files_that_are_none_of_ours(tmp_path, make, found):
    make(tmp_path / "m.onnx")
    with pytest.raises(WeightsError, match=found):
        read_card(tmp_path / "m.onnx")
