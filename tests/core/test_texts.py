# SPDX-License-Identifier: MIT
"""Texts of messages: numbers, names, likely words and escapes."""

import pytest

from salsanext_cli.core.texts import (
    counted,
    error_text,
    escaped,
    first_few,
    nearest,
    printable,
    quoted,
    shortened,
    with_hint,
)


def test_numbers_have_a_noun_and_separators():
    assert [counted(n, "scan") for n in (0, 1, 2000)] == ["0 scans", "1 scan", "2,000 scans"]


def test_names_beyond_the_third_are_counted():
    assert first_few(["a", "b", "c"]) == "a, b, c"
    assert first_few([*"abcde"]) == "a, b, c and 2 more"


@pytest.mark.parametrize(
    ("word", "likely"),
    [("Cra", "car"), ("ov", "other-vehicle"), ("moto", "motorcycle"), ("x", ""), ("train", "")],
)
def test_a_word_is_recognised_by_likeness_start_or_initials(word, likely):
    assert nearest(word, ["car", "other-vehicle", "motorcycle"]) == likely


def test_values_are_shortened_to_a_length():
    assert shortened("a" * 100) == "a" * 100
    assert shortened("a" * 101) == "a" * 99 + "…"
    assert shortened(10**5000) == "a number of 16610 bits"
    assert quoted("a") == "'a'"
    assert error_text(ValueError("two\nlines")) == "two lines"
    assert error_text(RecursionError()) == "nested too deeply"


def test_characters_that_disguise_a_name_are_escaped():
    assert printable("a\n\u202eb\udcff") == "a\\x0a\\u202eb\\xff"
    assert escaped({"a\udcff": ["\n", 1]}) == {"a\\xff": ["\n", 1]}


def test_a_hint_has_its_own_line():
    assert with_hint("problem", "") == "problem"
    assert with_hint("problem", "remedy") == "problem\nhint: remedy"
