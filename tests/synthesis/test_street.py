# SPDX-License-Identifier: MIT
"""Street as built: what stands where, which way it faces, and where it moves."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import Delaunay

from salsanext_cli.synthesis import surfaces
from salsanext_cli.synthesis.presets import STYLES, Numbers
from salsanext_cli.synthesis.street import lots, roadside
from salsanext_cli.synthesis.street.builder import Builder
from salsanext_cli.synthesis.street.plan import LEFT, Crossing, Lot, draw_plan
from salsanext_cli.synthesis.street.traffic import Mover, lanes
from salsanext_cli.synthesis.things import furniture

VEHICLES = {
    *(surfaces.CAR, surfaces.TRUCK, surfaces.BUS, surfaces.OTHER_VEHICLE, surfaces.MOTORCYCLE)
}
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


@pytest.mark.parametrize("kind", ["house", "yard", "forecourt", "carpark"])
def test_no_vehicle_on_a_lot_at_the_kerb_stands_in_the_sensors_path(kind):
    side = replace(STREET.sides[0], parking=0.0, verge=0.0, sidewalk=0.0)
    parked = 0
    for seed in range(18):
        lot = Lot(kind, 50.0, 65.0, (0.5, 3.0, 7.0)[seed % 3], 0, 0, (50.4, 53.4))
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


def test_things_are_set_down_only_where_there_is_room():
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
def test_movers_keep_their_lane_and_face_where_they_go(speed, turn):
    mesh = furniture.bench(np.random.default_rng(0))
    mover = Mover(mesh, 40.0, -1.5, speed)
    for time in (0.0, 2.0):
        s = 40.0 + speed * time
        yaw = float(STREET.yaw(s)) + turn
        expected = mesh.moved(STREET.world(s, -1.5), yaw).vertices
        np.testing.assert_allclose(mover.at(STREET, time).vertices, expected, atol=1e-9)
    off_the_street = (STREET.length if speed > 0 else 0.0) - 40.0
    assert mover.at(STREET, off_the_street / speed) is None
