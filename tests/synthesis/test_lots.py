# SPDX-License-Identifier: MIT
"""Lots of any width are built up, however narrow."""

import numpy as np
import pytest

from salsanext_cli.synthesis.builder import Builder
from salsanext_cli.synthesis.draw import draw_plan
from salsanext_cli.synthesis.lots import furnish
from salsanext_cli.synthesis.plan import Lot
from salsanext_cli.synthesis.style import STYLES

PLAN = draw_plan(np.random.default_rng(0), STYLES[0], 80.0)
KINDS = ("terrace", "house", "yard", "green", "field", "thicket", "carpark")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("width", [0.2, 1.2, 2.5, 3.5])
def test_a_narrow_lot_can_be_furnished(kind, width):
    lot = Lot(kind, 30.0, 30.0 + width, 4.0, 0, 0, (30.0, 30.0))
    for seed in range(8):
        builder = Builder(np.random.default_rng(seed), PLAN)
        furnish(builder, PLAN.left, lot)
        ends = [part.vertices[:, 0] for part in builder.parts]
        assert all(np.isfinite(end).all() for end in ends)


def test_between_takes_the_middle_where_there_is_no_room():
    builder = Builder(np.random.default_rng(0), PLAN)
    assert builder.between(3.0, 2.0) == 2.5
    assert 2.0 <= builder.between(2.0, 3.0) < 3.0
