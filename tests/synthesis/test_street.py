# SPDX-License-Identifier: MIT
"""Plan of a street and its ground, and positions of static and moving objects."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import Delaunay

from salsanext_cli.synthesis import presets
from salsanext_cli.synthesis.presets import STYLES, Numbers
from salsanext_cli.synthesis.street import lots, roadside
from salsanext_cli.synthesis.street.builder import Builder
from salsanext_cli.synthesis.street.ground import ground
from salsanext_cli.synthesis.street.layout import draw_plan
from salsanext_cli.synthesis.street.plan import LEFT, REACH_M, Crossing, Lot
from salsanext_cli.synthesis.street.traffic import Mover, lanes
from salsanext_cli.synthesis.things import furniture

PLANS = [draw_plan(np.random.default_rng(seed), STYLES[seed], 160.0) for seed in range(len(STYLES))]


@pytest.fixture(params=PLANS)
def plan(request):
    return request.param


def away_from_crossings(plan, side, margin=6.0):
    s = np.arange(10.0, plan.length - 10, 0.5)
    ends = [margin, *(c.lawn_gap + c.lawn for c in side.crossings)]
    return s[side.from_side_street(s) > max(ends)]


def test_strips_lie_in_order_from_the_kerb_outwards(plan):
    for side in plan.sides:
        s = away_from_crossings(plan, side)
        for low, high in side.islands:
            s = s[(s < low) | (s >= high)]
        ends = np.cumsum([side.parking, side.verge, side.sidewalk])
        starts = ends - [side.parking, side.verge, side.sidewalk]
        for start, end, label in zip(
            starts, ends, (presets.PARKING, side.strip, presets.SIDEWALK), strict=True
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
                assert plan.label(s, t).item() == presets.ROAD
                camber = -0.015 * plan.half
                assert plan.relief(s, t).item() == pytest.approx(camber, abs=1e-9)


def test_a_kerb_is_a_step_of_its_height_and_lowered_at_driveways():
    sides = ((p, p.sides[0]) for p in PLANS)
    plan, left = next((p, s) for p, s in sides if s.sidewalk and s.kerb and not s.parking)
    s = away_from_crossings(plan, left)
    for start, end in (lot.drive for lot in left.lots):
        s = s[(s < start - 1) | (s > end + 1)]
    assert len(s) > 20
    low, high = (plan.relief(s, np.full_like(s, plan.half + offset)) for offset in (-0.01, 0.01))
    np.testing.assert_allclose(high - low, left.kerb, atol=1e-3)
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
        presets.ROAD, presets.MARKING, presets.PARKING, presets.SIDEWALK, presets.TERRAIN,
        presets.OTHER_GROUND, presets.VEGETATION,
    }  # fmt: skip


def test_an_embankment_is_steep_and_green():
    style = Numbers(**vars(STYLES[0]) | {"embankment": 1.0})
    for seed in range(5):
        plan = draw_plan(np.random.default_rng(seed), style, 160.0)
        for side in plan.sides:
            assert {lot.kind for lot in side.lots} <= {
                "thicket",
                "scrub",
                "field",
                "green",
                "meadow",
            }
            assert 0.35 <= abs(side.bank.slope) <= 0.9
            s = away_from_crossings(plan, side)
            foot = side.depth + side.bank.start
            ends = (foot, foot + side.bank.width)
            low, high = (plan.relief(s, np.full_like(s, side.sign * (plan.half + e))) for e in ends)
            np.testing.assert_allclose(high - low, side.bank.slope * side.bank.width)


VEHICLES = {*(presets.CAR, presets.TRUCK, presets.BUS, presets.OTHER_VEHICLE, presets.MOTORCYCLE)}
NARROW = Numbers(**vars(STYLES[4]) | {"crossing_gap": (300, 900)})
STREET = draw_plan(np.random.default_rng(0), NARROW, 120.0)
"""A narrow street without side streets; its houses may stand at the kerb."""


def parts_of(builder, labels):
    return [part for part in builder.parts if int(part.labels[0]) in labels]


def in_the_way(builder):
    """Return how many vehicles stand within a metre of the path of the sensor."""
    plan = builder.plan
    lane = min(0.0, 2.4 - plan.half)
    s, t = np.meshgrid(np.arange(0, plan.length, 0.4), lane + np.linspace(-1, 1, 6))
    path = plan.world(s, t)[..., :2].reshape(-1, 2)
    footprints = (Delaunay(part.vertices[:, :2]) for part in parts_of(builder, VEHICLES))
    return sum((footprint.find_simplex(path) >= 0).any() for footprint in footprints)


@pytest.mark.parametrize("seed", [0, 2, 4])
def test_no_car_parks_on_islands_between_parking_spaces(seed):
    busy = {"parking": 1.0, "parked": 1.0, "crossing_gap": (300, 900), "works": 0.0}
    rng = np.random.default_rng(seed)
    plan = draw_plan(rng, Numbers(**vars(STYLES[0]) | busy), 90.0)
    builder = Builder(rng, plan)
    places = []
    for side in plan.sides:
        t = side.sign * (plan.half + side.parking / 2)
        for low, high in side.islands:
            s = np.array([low - 0.01, (low + high) / 2, high + 0.01])
            strips = [presets.PARKING, side.strip, presets.PARKING]
            assert plan.label(s, np.full(3, t)).tolist() == strips
            if low > 3 and high < plan.length - 3:
                places.append(plan.world(s[1], t)[:2])
        roadside.furnish(builder, side)
    assert places
    for vehicle in parts_of(builder, VEHICLES):
        assert (Delaunay(vehicle.vertices[:, :2]).find_simplex(np.array(places)) < 0).all()


def test_parking_spaces_may_have_the_surface_of_the_road_or_another():
    style = Numbers(**vars(STYLES[0]) | {"parking": 1.0})
    alike = []
    for seed in range(24):
        rng = np.random.default_rng(seed)
        mesh = ground(rng, draw_plan(rng, style, 40.0))
        road, parking = (mesh.labels == label for label in (presets.ROAD, presets.PARKING))
        same = set(mesh.materials[road]) == set(mesh.materials[parking])
        brighter = np.median(mesh.shades[parking]) / np.median(mesh.shades[road])
        alike.append(same and abs(brighter - 1) < 0.03)
    assert 4 <= sum(alike) <= 20


@pytest.mark.parametrize("kind", ["house", "yard", "forecourt", "carpark"])
def test_no_vehicle_on_a_lot_at_the_kerb_stands_in_the_sensors_path(kind):
    side = replace(STREET.sides[0], parking=0.0, verge=0.0, sidewalk=0.0)
    parked = 0
    for seed in range(18):
        lot = Lot(
            kind=kind,
            start=50.0,
            end=65.0,
            setback=(0.5, 3.0, 7.0)[seed % 3],
            front=0,
            back=0,
            drive=(50.4, 53.4),
        )
        builder = Builder(np.random.default_rng(seed), STREET)
        lots.furnish(builder, side, lot)
        assert in_the_way(builder) == 0
        parked += len(parts_of(builder, VEHICLES))
    assert parked


@pytest.mark.parametrize("seed", range(6))
def test_no_vehicle_at_the_roadside_stands_in_the_sensors_path(seed):
    rng = np.random.default_rng(seed)
    crowded = Numbers(**vars(STYLES[seed]) | {"crowd": 30.0})
    builder = Builder(rng, draw_plan(rng, crowded, 60.0))
    for side in builder.plan.sides:
        roadside.furnish(builder, side)
    assert in_the_way(builder) == 0


def test_objects_are_placed_only_where_there_is_room():
    crossing = Crossing(60.0, 3.0, 0.0, (LEFT,), False, 1.0)
    left, right = STREET.sides
    left = replace(left, crossings=(crossing,))
    plan = replace(STREET, crossings=(crossing,), sides=(left, right))
    builder = Builder(np.random.default_rng(0), plan)
    post = furniture.post(builder.rng)

    def put(s, side=left):
        return builder.put_if_free(post, side, s, 2.0, radius=0.5)

    assert put(20.0)
    assert not put(20.9)
    assert put(21.1)
    assert put(20.9, right)
    for s in (60.0, 56.6, 63.4, 0.4, plan.length - 0.4):
        assert not put(s)
    assert put(60.0, right)
    assert put(56.4)
    assert put(0.6)
    assert len(builder.parts) == 6


def test_lanes_divide_half_the_carriageway():
    for half in np.linspace(2.5, 21, 75):
        middles = np.array(lanes(half))
        width = half / len(middles)
        assert 2.5 <= width <= 5.6
        np.testing.assert_allclose(middles, width / 2 + width * np.arange(len(middles)))


@pytest.mark.parametrize(("speed", "turn"), [(5.0, 0.0), (-5.0, np.pi)])
def test_movers_stay_in_their_lane_and_face_forward(speed, turn):
    mesh = furniture.bench(np.random.default_rng(0))
    mover = Mover(mesh=mesh, start=40.0, t=-1.5, speed=speed)
    for time in (0.0, 2.0):
        s = 40.0 + speed * time
        yaw = float(STREET.yaw(s)) + turn
        expected = mesh.moved(STREET.world(s, -1.5), yaw).vertices
        np.testing.assert_allclose(mover.at(STREET, time).vertices, expected, atol=1e-9)
    off_the_street = (STREET.length if speed > 0 else 0.0) - 40.0
    assert mover.at(STREET, off_the_street / speed) is None
