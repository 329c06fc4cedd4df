# SPDX-License-Identifier: MIT
"""Records are plain data for JSON, and come back as they were."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scans import refused

from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.plain_data import (
    MALFORMED,
    are_numbers,
    as_json,
    decoded,
    plain,
    refuse_unknown,
)


@dataclass(frozen=True)
class Part:
    name: str
    share: float | None = None


@dataclass(frozen=True)
class Whole:
    count: int
    parts: tuple[Part, ...]
    pair: tuple[str, int] = ("a", 1)
    shares: Mapping[str, float] | None = None


PARTS = st.builds(Part, st.text(), st.none() | st.floats(allow_nan=False, allow_infinity=False))
WHOLES = st.builds(
    Whole,
    st.integers(-(2**60), 2**60),
    st.lists(PARTS, max_size=4).map(tuple),
    st.tuples(st.text(), st.integers(-9, 9)),
    st.none() | st.dictionaries(st.text(), st.floats(0, 1), max_size=3),
)


@given(WHOLES)
def test_a_record_comes_back_from_json(whole):
    assert decoded(Whole, json.loads(json.dumps(plain(whole)))) == whole


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (np.array([[1, 2]]), [[1, 2]]),
        (np.array([0.5, np.nan]), [0.5, None]),
        (math.nan, None),
        ({"b", "a"}, ["a", "b"]),
        (Path("a b"), "a b"),
        ({"x": (Part("p"),)}, {"x": [{"name": "p", "share": None}]}),
    ],
)
def test_values_of_python_and_numpy_are_plain(value, expected):
    assert plain(value) == expected


def test_json_has_texts_for_keys_and_for_infinity():
    assert as_json({1: math.inf}) == {"1": "Infinity"}
    assert decoded(float, "Infinity") == math.inf


@pytest.mark.parametrize(
    ("kind", "value"),
    [
        (Whole, {"count": "1", "parts": []}),
        (Whole, {"parts": []}),
        (Whole, []),
        (int, True),
        (str, 1),
        (tuple[int, int], [1]),
        (list[str], "ab"),
        (dict[str, int], [["a", 1]]),
    ],
)
def test_data_of_another_type_are_malformed(kind, value):
    with pytest.raises(MALFORMED):
        decoded(kind, value)


def test_an_unknown_key_is_refused_with_the_nearest_one():
    refuse_unknown({"name": 1}, Part, "file")
    caught = refused(UsageError, "file", refuse_unknown, {"names": 1, "share": 2}, Part, "file")
    assert "name" in caught.value.hint


def test_lists_of_numbers_are_known():
    assert are_numbers([1, 2.5])
    assert are_numbers(())
    assert not are_numbers([1, "2"])
    assert not are_numbers("12")
