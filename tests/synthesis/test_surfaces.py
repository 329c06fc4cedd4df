# SPDX-License-Identifier: MIT
"""Classes, heights and edges of the ground: lawns, medians, junctions, shoulders, slopes."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import KDTree

from salsanext_cli.synthesis import presets
from salsanext_cli.synthesis.drive import _Track
from salsanext_cli.synthesis.lidar import hdl64_rig
from salsanext_cli.synthesis.presets import BRIGHTNESS, STYLES, Material, Numbers
from salsanext_cli.synthesis.street import edges, medians
from salsanext_cli.synthesis.street.brightness import contrast, draw_brightness
from salsanext_cli.synthesis.street.builder import Builder
from salsanext_cli.synthesis.street.ground import HIGH_GRASS_M, Cells, ground, high_grass
from salsanext_cli.synthesis.street.layout import LANE_AND_A_HALF_M, draw_plan
from salsanext_cli.synthesis.street.plan import LEFT, RIGHT, Crossing, Ditch, Median
from salsanext_cli.synthesis.street.traffic import draw_movers, lanes

STEP_M = 0.01  # Distance of two points on either side of an edge
FLAT = {"bank": 0.0, "embankment": 0.0, "ditch": 0.0, "median": 0.0, "traffic_islands": 0.0}


def plan_of(seed=0, length=120.0, style=0, **numbers):
    return draw_plan(np.random.default_rng(seed), Numbers(**vars(STYLES[style]) | numbers), length)


def with_crossing(plan, **fields):
    """Return the plan with one side street to both sides in the middle."""
    usual = {"half": 3.0, "pavement": 2.0, "sides": (LEFT, RIGHT), "zebra": False, "corner": 2.0}
    crossing = Crossing(s=60.0, **usual | fields)
    sides = tuple(replace(side, crossings=(crossing,)) for side in plan.sides)
    return replace(plan, crossings=(crossing,), sides=sides)


def paved_plan(kerb=0.1, **fields):
    """Return a level street with a pavement of 2 m at the kerb on its left, and no parking."""
    plan = plan_of(**FLAT)
    changed = {"parking": 0.0, "verge": 0.0, "sidewalk": 2.0, "kerb": kerb, "border": 0.0} | fields
    lots = tuple(replace(lot, drive=(lot.start, lot.start)) for lot in plan.sides[0].lots)
    left = replace(plan.sides[0], islands=(), lots=lots, **changed)
    return replace(plan, sides=(left, plan.sides[1]))


def at(plan, s, beyond):
    """Return labels and relief of the left side at distances from the kerb."""
    s, beyond = np.broadcast_arrays(np.asarray(s, float), np.asarray(beyond, float))
    t = plan.half + beyond
    return plan.label(s, t).tolist(), plan.relief(s, t)


@pytest.mark.parametrize("kerb", [0.0, 0.1])
def test_grass_is_flush_with_the_pavement_on_both_sides_of_it(kerb):
    grass = {"strip": presets.TERRAIN, "border_ground": presets.TERRAIN}
    plan = with_crossing(paved_plan(kerb=kerb, verge=3.0, border=2.0, **grass))
    for edge, labels in (
        (3.0, [presets.TERRAIN, presets.SIDEWALK]),
        (5.0, [presets.SIDEWALK, presets.TERRAIN]),
    ):
        found, height = at(plan, 20.0, [edge - STEP_M, edge + STEP_M])
        assert found == labels
        assert height[0] == pytest.approx(height[1], abs=1e-9)
    found, height = at(plan, 20.0, [-0.02, STEP_M])
    assert found == [presets.ROAD, presets.TERRAIN]
    assert height[1] - height[0] == pytest.approx(kerb, abs=1e-3)


@pytest.mark.parametrize("lowered", [False, True])
def test_kerbs_at_junctions_are_lowered_to_the_road_or_not(lowered):
    plan = with_crossing(paved_plan(), lowered=lowered)
    beside = 60.0 + 3.0 + 2.0 + 0.3
    found, height = at(plan, beside, [-0.02, STEP_M])
    assert found == [presets.ROAD, presets.SIDEWALK]
    assert height[1] - height[0] == pytest.approx(0.0 if lowered else 0.1, abs=1e-3)
    _, height = at(plan, beside + 5, [-0.02, STEP_M])
    assert height[1] - height[0] == pytest.approx(0.1, abs=1e-3)


@pytest.mark.parametrize("continued", [False, True])
def test_a_pavement_ends_at_a_side_street_or_continues_flush_across(continued):
    plan = with_crossing(paved_plan(), lowered=continued, continued=continued)
    found, height = at(plan, 60.0, [0.5, 1.5, 2.5])
    across = presets.SIDEWALK if continued else presets.ROAD
    assert found == [across, across, presets.ROAD]
    np.testing.assert_allclose(height, height[0], atol=1e-9)


@pytest.mark.parametrize("gap", [0.2, 2.5])
def test_lawns_fill_the_corners_of_a_junction(gap):
    plan = with_crossing(paved_plan(), lawn=4.0, lawn_gap=gap)
    inside = gap + 2.0
    places = [(60 + 3 + along, out) for along, out in ((inside, inside), (gap + 3.5, gap + 0.5))]
    for s, out in [*places, (60 - 3 - inside, inside)]:
        assert at(plan, [s], [out])[0] == [presets.TERRAIN]
    if gap > 1:
        assert at(plan, [60 + 3 + inside], [gap - 0.5])[0] == [presets.SIDEWALK]


def test_a_verge_lies_between_a_side_street_and_its_pavement():
    plan = with_crossing(paved_plan(), verge=1.0, pavement=2.5)
    s = 60 + 3 + np.array([-0.5, 0.5, 1.5])
    found, height = at(plan, s, 10.0)
    assert found == [presets.ROAD, presets.TERRAIN, presets.SIDEWALK]
    assert height[1] == pytest.approx(height[2], abs=1e-9)


@pytest.mark.parametrize("height", [0.0, 0.12])
@pytest.mark.parametrize("label", [presets.TERRAIN, presets.OTHER_GROUND])
def test_a_median_has_its_class_and_kerb_and_ends_at_junctions(label, height):
    median = Median(half=1.5, spans=((0.0, 50.0), (70.0, 120.0)), ground=label, height=height)
    plan = replace(paved_plan(), half=8.0, median=median)
    t = np.array([1.5 - STEP_M, 1.5 + STEP_M])
    assert plan.label(np.full(2, 20.0), t).tolist() == [label, presets.ROAD]
    inner, outer = plan.relief(np.full(2, 20.0), t)
    assert inner - outer == pytest.approx(height, abs=1e-3)
    assert plan.label(np.full(3, 60.0), np.array([-1.0, 1.0, 0.5])).tolist() == [presets.ROAD] * 3


@pytest.mark.parametrize("seed", range(6))
def test_vehicles_and_the_sensor_pass_beside_medians_and_shoulders(seed):
    rng = np.random.default_rng(seed)
    style = Numbers(**vars(STYLES[5]) | {"median": 1.0, "shoulder": 1.0, "traffic": 3.0})
    plan = draw_plan(rng, style, 170.0)
    movers = draw_movers(Builder(rng, plan), 8.0, 4.0)
    driving = [m for m in movers if abs(m.speed) > 3 and abs(m.t) < plan.half - 1]
    assert driving
    assert plan.median.half > 0
    for mover in driving:
        assert plan.median.half + 1.2 < abs(mover.t) < plan.half - plan.shoulder - 1.0
    track = _Track(rng, plan, 8.0, hdl64_rig(rng))
    offset = np.hypot(*(track.pose(60.0)[:2, 3] - plan.world(60.0, 0.0)[:2]))
    assert plan.median.half + 1.2 < offset < plan.half - plan.shoulder


def test_lanes_begin_at_the_median():
    for start in (0.0, 1.0, 4.0):
        for width in np.linspace(2.5, 12, 20):
            middles = np.array(lanes(start + width, start))
            lane = width / len(middles)
            np.testing.assert_allclose(middles, start + lane * (0.5 + np.arange(len(middles))))


def test_a_shoulder_is_road_outside_of_the_edge_line():
    plan = plan_of(seed=1, shoulder=1.0, shoulder_width=[2.0, 2.0], **FLAT)
    plan = replace(plan, crossings=())
    assert plan.shoulder == 2.0
    s = np.arange(5.0, 115.0)
    for sign in (LEFT, RIGHT):
        line = np.full_like(s, sign * (plan.half - 2.3))
        assert (plan.label(s, line) == presets.MARKING).all()
        for out in (1.9, 1.0, 0.1):
            on_shoulder = np.full_like(s, sign * (plan.half - out))
            assert (plan.label(s, on_shoulder) == presets.ROAD).all()


def test_bands_at_the_edges_of_the_road_are_road_of_another_look():
    differing = 0
    for seed in range(8):
        rng = np.random.default_rng(seed)
        plan = replace(plan_of(seed=seed, length=60.0, **FLAT), band=1.0)
        mesh = ground(rng, plan)
        middle = mesh.vertices[mesh.triangles].mean(axis=1)
        line = plan.world(np.arange(0, 60, 1.0), 0.0)
        away, _ = KDTree(line[:, :2]).query(middle[:, :2])
        road = mesh.labels == presets.ROAD
        # Side streets are road beyond the kerb: the band is where the plan says.
        band = road & (away < plan.half - 0.1) & (away > plan.half - 0.9)
        inner = road & (away < plan.half - 1.2)
        assert band.any()
        looks = [
            (np.bincount(mesh.materials[each]).argmax(), np.median(mesh.shades[each]))
            for each in (band, inner)
        ]
        differing += looks[0][0] != looks[1][0] or abs(looks[0][1] / looks[1][1] - 1) > 0.05
    assert differing >= 5


def test_a_ditch_is_as_deep_as_drawn_and_ends_level():
    ditch = Ditch(start=0.5, width=3.0, depth=0.7)
    plan = paved_plan(ditch=ditch)
    side = plan.sides[0]
    s = 20.0 if side.from_side_street(20.0) > 8 else 40.0
    assert side.from_side_street(s) > 8
    _, height = at(plan, s, side.depth + np.array([0.4, 0.5 + 1.5, 3.6]))
    assert height[1] - height[0] == pytest.approx(-0.7, abs=1e-9)
    assert height[2] == pytest.approx(height[0], abs=1e-9)


def cells_of(plan):
    s, t = np.meshgrid(np.arange(0.5, plan.length), np.arange(-30.25, 30.5, 0.5), indexing="ij")
    return Cells(s=s, t=t, labels=plan.label(s, t))


def test_high_grass_grows_on_terrain_beside_the_road_only():
    plan = plan_of(seed=2, style=2, high_grass=10.0)
    cells = cells_of(plan)
    height = high_grass(np.random.default_rng(0), plan, cells)
    grown = height > 0
    assert grown.any()
    assert (cells.labels[grown] == presets.TERRAIN).all()
    assert (np.abs(cells.t[grown]) > plan.half).all()
    assert height.max() < 1.0


def test_grass_is_vegetation_from_a_height_on_and_terrain_below():
    seen = set()
    for seed in range(4):
        plan = plan_of(seed=seed, length=60.0, style=2, high_grass=6.0, **FLAT)
        flat = replace(plan, waves=np.zeros_like(plan.waves))
        mesh = ground(np.random.default_rng(seed), flat)
        grass = mesh.materials == Material.HIGH_GRASS
        top = mesh.vertices[mesh.triangles][..., 2].max(axis=1)
        assert set(mesh.labels[grass]) <= {presets.TERRAIN, presets.VEGETATION}
        seen |= set(mesh.labels[grass].tolist())
        vegetation = mesh.labels == presets.VEGETATION
        assert grass[vegetation].all()
        low = mesh.labels[grass] == presets.TERRAIN
        assert np.median(top[grass][low]) < 2 * HIGH_GRASS_M
        if vegetation.any():
            assert np.median(top[vegetation]) > HIGH_GRASS_M
    assert seen == {presets.TERRAIN, presets.VEGETATION}


def test_medians_leave_room_for_a_lane_and_carry_barriers_or_plants():
    labels = set()
    for seed in range(12):
        plan = plan_of(seed=seed, style=5, median=1.0)
        assert plan.half - plan.shoulder - plan.median.half >= LANE_AND_A_HALF_M - 1e-9
        builder = Builder(np.random.default_rng(seed), plan)
        medians.furnish(builder)
        for part in builder.parts:
            labels |= set(part.labels.tolist())
        trunks = [part for part in builder.parts if part.labels[0] == presets.TRUNK]
        for trunk in trunks:
            assert trunk.vertices[trunk.triangles[trunk.labels == presets.TRUNK]].size
    assert {presets.TRUNK, presets.VEGETATION, presets.FENCE, presets.POLE} <= labels


@pytest.mark.parametrize("seed", range(4))
def test_crash_barriers_stand_at_the_edge_of_the_road_clear_of_side_streets(seed):
    plan = with_crossing(plan_of(seed=seed, style=7, **FLAT))
    plan = replace(plan, style=Numbers(**vars(plan.style) | {"crash_barrier": 1.0}))
    builder = Builder(np.random.default_rng(seed), plan)
    for side in plan.sides:
        edges.furnish(builder, side)
    assert builder.parts
    centre = plan.world(np.arange(0, plan.length, 0.25), 0.0)[:, :2]
    for part in builder.parts:
        assert set(part.labels.tolist()) == {presets.FENCE}
        away = np.hypot(*(part.vertices[:, None, :2] - centre).T)
        assert plan.half - 0.1 < away.min() < plan.half + 1.6
        nearest = away.argmin(axis=0) * 0.25
        assert (np.abs(nearest - 60.0) > 3.0 + 2.0 + 1.0).all()


def test_contrast_orders_the_ground_as_its_reflectance_does():
    usual = np.array([material.optics[0] for material in Material])
    at_none, at_full = usual * contrast(0.0), usual * contrast(1.0)
    np.testing.assert_allclose(at_none, usual)
    asphalt, paving, grass = at_full[[Material.ASPHALT, Material.PAVING, Material.GRASS]]
    assert 1.5 < paving / asphalt < 2.2
    assert 1.2 < grass / paving < 2.0
    assert at_full[Material.METAL] == usual[Material.METAL]


def test_brightness_differs_between_streets_and_within_its_bounds():
    draws = np.array([draw_brightness(np.random.default_rng(seed)) for seed in range(400)])
    assert (draws >= BRIGHTNESS.least).all()
    assert (draws <= BRIGHTNESS.most).all()
    ratio = np.log(draws[:, Material.GRASS] / draws[:, Material.ASPHALT])
    assert (np.abs(ratio) < 0.2).mean() > 0.15
    assert (ratio > 0.5).mean() > 0.2
    assert np.median(ratio) > 0.1
    spread = np.log(draws).std(axis=0)
    assert spread[Material.LEAF] < spread[Material.METAL]
