# SPDX-License-Identifier: MIT
"""Values and errors by sequence."""

import pytest

from salsanext_cli.core.errors import FormatError
from salsanext_cli.runs.drives.by_sequence import by_sequence


def number_of(name):
    """Return the number of a sequence; fail for those that begin with x."""
    if name.startswith("x"):
        raise FormatError(name, "is damaged")
    return int(name)


def test_an_error_belongs_to_its_sequence():
    values = by_sequence(["08", "x1", "01"], number_of)
    assert (values["08"], values["01"]) == (8, 1)
    assert isinstance(values["x1"], FormatError)
    assert [*values] == ["08", "x1", "01"]


@pytest.mark.parametrize(("names", "stop"), [(["08", "x1", "x2"], True), (["x1", "x2"], False)])
def test_the_first_error_is_raised_if_it_stops_or_nothing_else_is_left(names, stop):
    with pytest.raises(FormatError) as caught:
        by_sequence(names, number_of, stop=stop)
    assert caught.value.subject == "x1"


def test_no_sequence_is_no_error():
    assert by_sequence([], number_of) == {}
