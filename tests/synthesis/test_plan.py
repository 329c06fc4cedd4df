# SPDX-License-Identifier: MIT
"""Plan of a street and its ground: strips in order, kerbs, corners, one surface."""

import numpy as np
import pytest

from salsanext_cli.synthesis import surfaces
from salsanext_cli.synthesis.presets import STYLES, Numbers
from salsanext_cli.synthesis.street.plan import REACH_M, draw_plan, ground

PLANS = [draw_plan(np.random.default_rng(seed), STYLES[seed], 160.0) for seed in range(len(STYLES))]


@pytest.fixture(params=PLANS)
def plan(request):
    return request.param


def away_from_crossings(plan, side, margin=6.0):
    s = np.arange(10.0, plan.length - 10, 0.5)
    return s[side.from_side_street(s) > margin]


def test_strips_lie_in_order_from_the_kerb_outwards(plan):
    for side in plan.sides:
        s = away_from_crossings(plan, side)
        ends = np.cumsum([side.parking, side.verge, side.sidewalk])
        starts = ends - [side.parking, side.verge, side.sidewalk]
        for start, end, label in zip(
            starts, ends, (surfaces.PARKING, side.strip, surfaces.SIDEWALK), strict=True
        ):
            if end > start:
                t = side.sign * (plan.half + (start + end) / 2)
                assert (plan.label(s, np.full_like(s, t)) == label).all()


def test_side_streets_are_road_and_level_with_it(plan):
    for side in plan.sides:
        for crossing in side.crossings:
            s = np.array([crossing.s])
            for out in (0.5, 5.0, 30.0):
                t = np.array([side.sign * (plan.half + out)])
                assert plan.label(s, t).item() == surfaces.ROAD
                camber = -0.015 * plan.half
                assert plan.relief(s, t).item() == pytest.approx(camber, abs=1e-9)


def test_a_kerb_is_a_step_of_its_height():
    sides = ((p, p.sides[0]) for p in PLANS)
    plan, left = next((p, s) for p, s in sides if s.sidewalk and s.kerb and not s.parking)
    s = away_from_crossings(plan, left)
    for start, end in (lot.drive for lot in left.lots):
        s = s[(s < start - 1) | (s > end + 1)]
    assert len(s) > 20
    low, high = (plan.relief(s, np.full_like(s, plan.half + offset)) for offset in (-0.01, 0.01))
    np.testing.assert_allclose(high - low, left.kerb, atol=1e-3)


def test_a_kerb_is_lowered_at_driveways():
    drives = [
        (plan, side, sum(lot.drive) / 2)
        for plan in PLANS
        for side in plan.sides
        for lot in side.lots
        if side.kerb and not side.parking and lot.drive[1] > lot.drive[0]
    ]
    assert drives
    for plan, side, s in drives:
        t = side.sign * (plan.half + np.array([-0.01, 0.01]))
        low, high = plan.relief(np.full(2, s), t)
        assert high == pytest.approx(low, abs=1e-3)


def test_the_ground_has_no_holes_and_the_plans_labels():
    plan = PLANS[0]
    mesh = ground(np.random.default_rng(0), plan)
    corners = mesh.vertices[mesh.triangles]
    flat = corners[..., :2]
    first, second = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    twice = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    assert (twice > 0).all()
    # On a bend the outside gains what the inside loses: the area is that of the straight street.
    assert twice.sum() / 2 == pytest.approx(2 * REACH_M * plan.length, rel=0.01)
    assert set(np.unique(mesh.labels)) <= {
        surfaces.ROAD, surfaces.MARKING, surfaces.PARKING, surfaces.SIDEWALK, surfaces.TERRAIN,
        surfaces.OTHER_GROUND,
    }  # fmt: skip


def test_an_embankment_is_steep_and_green():
    style = Numbers(**vars(STYLES[0]) | {"embankment": 1.0})
    for seed in range(5):
        plan = draw_plan(np.random.default_rng(seed), style, 160.0)
        for side in plan.sides:
            assert {lot.kind for lot in side.lots} <= {"thicket", "scrub", "field", "green"}
            assert 0.35 <= abs(side.bank.slope) <= 0.9
            s = away_from_crossings(plan, side)
            foot = side.depth + side.bank.start
            ends = (foot, foot + side.bank.width)
            low, high = (plan.relief(s, np.full_like(s, side.sign * (plan.half + e))) for e in ends)
            np.testing.assert_allclose(high - low, side.bank.slope * side.bank.width)
