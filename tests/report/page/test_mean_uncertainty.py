# SPDX-License-Identifier: MIT
"""Means of uncertainties have one title, and shares are in %."""

import pytest

from salsanext_cli.core.uncertainty.kinds import UNCERTAINTY
from salsanext_cli.report.page.mean_uncertainty import is_share, mean_in_words, title_of


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("error", "mean probability of error 25.0 %"),
        ("least_confidence", "mean 1 − confidence 25.0 %"),
        ("entropy", "mean entropy 0.25"),
        ("mutual_information", "mean mutual information 0.25"),
    ],
)
def test_a_mean_in_words(kind, words):
    assert mean_in_words(kind, 0.25) == words


def test_only_known_kinds_of_at_most_one_are_shares():
    shares = {kind for kind in UNCERTAINTY if is_share(kind)}
    assert {"error", "least_confidence"} <= shares
    assert "entropy" not in shares
    assert not is_share("of a plug-in")
    assert title_of("of_a_plug_in") == "of a plug in"
