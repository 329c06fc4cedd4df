# SPDX-License-Identifier: MIT
"""Fences, walls, crash and noise barriers, and the lots that they close off or leave open."""

import numpy as np
import pytest

from salsanext_cli.synthesis import presets
from salsanext_cli.synthesis.presets import STYLES, Material, Numbers
from salsanext_cli.synthesis.street import boundaries, lots
from salsanext_cli.synthesis.street.builder import Builder
from salsanext_cli.synthesis.street.layout import draw_plan
from salsanext_cli.synthesis.street.plan import Lot
from salsanext_cli.synthesis.things import fences

LENGTH_M = 5.0
OPEN = ("pickets", "railing", "mesh", "site")
"""Kinds that some rays pass through."""


def covered(mesh, low, high):
    """Return the share of horizontal rays along y that meet a piece at heights low to high."""
    rng = np.random.default_rng(0)
    x, z = rng.uniform([0.2, low], [LENGTH_M - 0.2, high], (400, 2)).T
    corners = mesh.vertices[mesh.triangles][..., [0, 2]]
    met = np.zeros(len(x), bool)
    for a, b, c in corners:
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if abs(area) < 1e-9:
            continue
        first = ((x - a[0]) * (c[1] - a[1]) - (z - a[1]) * (c[0] - a[0])) / area
        second = ((b[0] - a[0]) * (z - a[1]) - (b[1] - a[1]) * (x - a[0])) / area
        met |= (first >= 0) & (second >= 0) & (first + second <= 1)
    return met.mean()


@pytest.mark.parametrize("kind", fences.KINDS)
def test_pieces_of_every_kind_are_fences_of_their_length_and_height(kind):
    height = 1.7
    mesh = fences.fence(np.random.default_rng(1), LENGTH_M, kind, height, 1.0)
    assert set(mesh.labels.tolist()) == {presets.FENCE}
    x, _, z = mesh.vertices.T
    assert x.min() > -0.2
    assert LENGTH_M - 0.2 < x.max() < LENGTH_M + 0.2
    top = 0.75 if kind == "barrier" else height
    assert top - 0.05 <= z.max() < top + 0.15
    assert z.min() <= 0.0


@pytest.mark.parametrize("kind", [*fences.SOLID, *OPEN])
def test_solid_kinds_let_no_ray_through_and_open_ones_do(kind):
    mesh = fences.fence(np.random.default_rng(0), LENGTH_M, kind, 1.6, 1.0)
    share = covered(mesh, 0.35, 1.3)
    if kind in fences.SOLID:
        assert share > 0.9
    else:
        assert 0.02 < share < 0.85


@pytest.mark.parametrize("kind", [*fences.WALLS, *fences.NOISE_BARRIERS])
def test_walls_are_of_the_material_of_their_kind(kind):
    mesh = fences.fence(np.random.default_rng(0), LENGTH_M, kind, 2.5, 1.0)
    material = (fences.WALLS | fences.NOISE_BARRIERS)[kind]
    assert np.bincount(mesh.materials).argmax() == material
    assert material in (Material.BRICK, Material.PLASTER, Material.PAVING, Material.WOOD,
                        Material.METAL)  # fmt: skip


def test_boundaries_are_fences_or_vegetation_of_low_and_high_kinds():
    plan = draw_plan(np.random.default_rng(0), STYLES[0], 40.0)
    builder = Builder(np.random.default_rng(0), plan)
    heights = {presets.FENCE: [], presets.VEGETATION: []}
    for _ in range(150):
        mesh = boundaries.boundary(builder)(3.0)
        (label,) = set(mesh.labels.tolist())
        heights[label].append(float(mesh.vertices[:, 2].max()))
    for found in heights.values():
        assert min(found) < 0.7
        assert 1.8 < max(found) < 3.6


LOT_GROUND = {
    "lawn": ({presets.TERRAIN}, {presets.TERRAIN}),
    "meadow": ({presets.TERRAIN}, {presets.TERRAIN}),
    "court": ({presets.OTHER_GROUND}, {presets.OTHER_GROUND}),
    "site": ({presets.OTHER_GROUND}, {presets.OTHER_GROUND}),
    "yard": ({presets.OTHER_GROUND, presets.TERRAIN}, {presets.TERRAIN}),
    "noise_barrier": ({presets.TERRAIN}, {presets.TERRAIN}),
}


@pytest.mark.parametrize("kind", LOT_GROUND)
def test_lots_have_the_ground_of_their_kind(kind):
    style = Numbers(**vars(STYLES[0]) | {"lots": {kind: 1.0}, "embankment": 0.0})
    fronts, backs = set(), set()
    for seed in range(4):
        plan = draw_plan(np.random.default_rng(seed), style, 120.0)
        for side in plan.sides:
            fronts |= {lot.front for lot in side.lots}
            backs |= {lot.back for lot in side.lots}
    assert (fronts, backs) == LOT_GROUND[kind]


def test_paths_cross_lawns_flush():
    style = Numbers(**vars(STYLES[0]) | {"lots": {"lawn": 1.0}, "embankment": 0.0, "bank": 0.0})
    paths = 0
    for seed in range(6):
        plan = draw_plan(np.random.default_rng(seed), style, 120.0)
        for side in plan.sides:
            for lot in side.lots:
                low, high = lot.drive
                s = np.array([low - 0.1, low + 0.1])
                clear = side.from_side_street(low) > 16
                if high > low and clear and low - lot.start > 0.2:
                    t = np.full(2, side.sign * (plan.half + side.depth + 2.0))
                    assert plan.label(s, t).tolist() == [presets.TERRAIN, presets.SIDEWALK]
                    before, after = plan.relief(s, t)
                    assert before == pytest.approx(after, abs=0.03)
                    paths += 1
    assert paths > 3


@pytest.mark.parametrize(
    ("kind", "heights"), [("noise_barrier", (2.0, 4.7)), ("high_wall", (1.2, 2.4))]
)
def test_walls_of_lots_are_fences_of_their_height(kind, heights):
    plan = draw_plan(np.random.default_rng(0), STYLES[0], 80.0)
    lot = Lot(
        kind=kind,
        start=20.0,
        end=40.0,
        setback=4.0,
        front=presets.TERRAIN,
        back=presets.TERRAIN,
        drive=(20.0, 20.0),
    )
    side = plan.sides[0]
    for seed in range(6):
        builder = Builder(np.random.default_rng(seed), plan)
        lots.furnish(builder, side, lot)
        walls = [part for part in builder.parts if set(part.labels.tolist()) == {presets.FENCE}]
        assert len(walls) == 4
        for wall in walls:
            top = wall.vertices[:, 2].max() - plan.world(30.0, plan.half + side.depth)[2]
            assert heights[0] - 0.8 < top < heights[1] + 0.8
