# SPDX-License-Identifier: MIT
import pytest

from salsanext_cli.measures.calibration import Calibration
from salsanext_cli.measures.ranking import Ranking
from salsanext_cli.measures.tally import Tally


def test_a_tally_of_nothing_in_particular_cannot_be_made():
    class Unfinished(Tally):
        """Does not say what it adds up."""

    for kind in (Tally, Unfinished):
        with pytest.raises(TypeError, match="abstract"):
            kind(1, 1, {})


@pytest.mark.parametrize("kind", [Calibration, Ranking])
def test_the_counts_of_nothing_are_none(kind):
    nothing = kind.none(3)
    assert nothing.points.tolist() == [0, 0, 0]
    assert (nothing.scans, nothing.left_out) == (0, 0)
