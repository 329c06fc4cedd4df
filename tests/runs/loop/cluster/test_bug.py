# SPDX-License-Identifier: MIT
"""Exceptions that can be pickled, and others."""

import pickle

from salsanext_cli.runs.loop.cluster.bug import Bug


class PairError(Exception):
    """Exception that is pickled, and cannot be made from its pickle."""

    def __init__(self, first, second):
        super().__init__(f"{first} and {second}")


def test_a_bug_that_cannot_be_pickled_keeps_its_text():
    for error, kind in (
        (KeyError("a"), KeyError),
        (PairError("one", "two"), RuntimeError),
        (ValueError(lambda: None), RuntimeError),
    ):
        bug = pickle.loads(Bug.packed(error, "the trace"))
        assert type(bug.error) is kind
        assert str(bug.error) == str(error)
        assert bug.noted().__notes__ == ["the trace"]
