# SPDX-License-Identifier: MIT
"""Nodes of coordinate systems as text."""

import pytest

from salsanext_cli.io.formats.survey.wkt import MAX_DEPTH, read_wkt


def test_nodes_have_values_and_nodes():
    (system,) = read_wkt('projcs ("a, b[", GEOGCS["c", 1e-3], UNIT["m",1], AXIS["x", EAST])').nodes
    assert (system.keyword, system.values) == ("PROJCS", ["a, b["])
    assert [node.keyword for node in system.nodes] == ["GEOGCS", "UNIT", "AXIS"]
    (geographic,) = system.children(["GEOGCS"])
    assert geographic.values == ["c", "1e-3"]
    assert system.children(["AXIS"])[0].values == ["x", "EAST"]


def test_outer_nodes_come_before_inner_ones():
    root = read_wkt('A[B["1",C["2"]],C["3"]],B["4"]')
    assert root.first(["B", "C"]).values == ["1"]
    assert root.first(["C"]).values == ["2"]
    assert root.first(["D"]) is None


@pytest.mark.parametrize("text", ["", "]]", '"a', "A[B[1", "A]B[", "[[,,", "\0\x7f"])
def test_any_text_has_nodes(text):
    assert read_wkt(text).keyword == ""


def test_deep_texts_are_refused():
    assert read_wkt("A[" * (MAX_DEPTH - 1)).first(["B"]) is None
    with pytest.raises(ValueError, match="nested"):
        read_wkt("A[" * MAX_DEPTH)
