# SPDX-License-Identifier: MIT
"""Records as JSON files, read back with their types."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from salsanext_cli.core.errors import OutputError
from salsanext_cli.core.plain_data import MALFORMED, as_json, decoded, plain
from salsanext_cli.io.files.json_files import read_record, write_json


@dataclass(frozen=True)
class Inner:
    name: str
    share: float = 1.0


@dataclass(frozen=True)
class Outer:
    count: int
    ends: tuple[float, float]
    names: tuple[str, ...] = ()
    inner: Inner | None = None
    parts: Mapping[str, list[Inner]] | None = None
    is_done: bool = False


WHOLE = Outer(3, (0.5, float("inf")), ("a", "b"), Inner("x", 2.5), {"y": [Inner("z")]}, True)


@pytest.mark.parametrize("record", [WHOLE, Outer(0, (1.0, 2.0))])
def test_records_come_back_as_they_were(record: Outer, tmp_path: Path) -> None:
    assert decoded(Outer, as_json(record)) == record
    write_json(tmp_path / "a.json", as_json(record))
    assert read_record(Outer, tmp_path / "a.json") == record
    assert read_record(Outer, tmp_path / "none.json") is None


def test_whole_numbers_are_floats_unknown_keys_skipped_arrays_lists_and_nan_null():
    assert decoded(Outer, {"count": 1, "ends": [1, 2], "later": 5}) == Outer(1, (1.0, 2.0))
    data = {"a": np.array([1.0, np.nan]), "b": (np.float64(2), {3}), "c": Path("x")}
    assert plain(data) == {"a": [1.0, None], "b": [2.0, [3]], "c": "x"}


UNIONS = [
    (str | int, 3),
    (int | float, 2.5),
    (float | int, 3),
    (Inner | str, "x"),
    (tuple[int, ...] | str, "x"),
    (int | tuple[str, ...] | None, ("a", "b")),
    (int | Inner | None, Inner("x")),
    (int | str | None, None),
]


@pytest.mark.parametrize(("union", "value"), UNIONS)
def test_any_member_of_a_union_comes_back_as_it_was(union: object, value: object) -> None:
    back = decoded(union, as_json(value))
    assert back == value
    assert type(back) is type(value)


@pytest.mark.parametrize("value", [[], 1.5, {"name": 1}, None])
def test_what_no_member_of_a_union_takes_is_refused(value: object) -> None:
    with pytest.raises(MALFORMED):
        decoded(int | Inner, value)


@pytest.mark.parametrize(
    "change",
    [
        *({"count": value} for value in (None, "3", 1.0, True, [])),
        *({"ends": value} for value in ([1.0], [1.0, 2.0, 3.0], "ab", 5, [1.0, True])),
        *({"names": value} for value in ("ab", ["a", 1], {"a": "b"})),
        *({"inner": value} for value in ({}, {"name": 1}, "name", ["name"], 3)),
        *({"parts": value} for value in ([], {"y": [{}]}, {"y": "z"})),
    ],
)
def test_errors_name_the_file(change: dict[str, object], tmp_path: Path) -> None:
    write_json(tmp_path / "a.json", as_json(WHOLE) | change)
    with pytest.raises(OutputError) as caught:
        read_record(Outer, tmp_path / "a.json")
    assert (caught.value.subject, caught.value.code) == (str(tmp_path / "a.json"), "output")
