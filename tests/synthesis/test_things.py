# SPDX-License-Identifier: MIT
"""Elementary shapes, and objects of the right classes and sizes."""

import numpy as np
import pytest

from salsanext_cli.synthesis import presets
from salsanext_cli.synthesis.mesh import Skin, box, merge, tube
from salsanext_cli.synthesis.presets import CAR, POLE, STYLES, Material
from salsanext_cli.synthesis.street import lots
from salsanext_cli.synthesis.street.builder import Builder
from salsanext_cli.synthesis.street.layout import draw_plan
from salsanext_cli.synthesis.street.plan import Lot
from salsanext_cli.synthesis.things import furniture, people, vegetation, vehicles

STEEL = Skin(POLE, Material.METAL, 0.5)


@pytest.mark.parametrize("direction", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, -2, 0.5)])
def test_a_tube_may_have_any_direction(direction):
    end = np.array(direction, float)
    mesh = tube([[0, 0, 0], end], 0.2, STEEL)
    along = mesh.vertices @ end / np.linalg.norm(end)
    across = np.sqrt((mesh.vertices**2).sum(1) - along**2)
    np.testing.assert_allclose(across, 0.2, atol=1e-9)


def test_merging_keeps_every_triangle_and_its_skin():
    first = box((0, 0, 0), (1, 1, 1), STEEL)
    second = box((5, 0, 0), (6, 1, 1), Skin(CAR, Material.PAINT, 2.0))
    both = merge([first, second])
    corners = np.concatenate([m.vertices[m.triangles] for m in (first, second)])
    np.testing.assert_array_equal(both.vertices[both.triangles], corners)
    assert both.labels.tolist() == [POLE] * 12 + [CAR] * 12
    assert both.materials.tolist() == [Material.METAL] * 12 + [Material.PAINT] * 12
    assert both.shades.tolist() == [0.5] * 12 + [2.0] * 12


THINGS = {
    "car": (vehicles.car, {presets.CAR}, (3.4, 1.6, 1.3), (6.0, 2.4, 2.7)),
    "truck": (vehicles.truck, {presets.TRUCK}, (4.2, 1.6, 1.5), (17.5, 3.3, 4.2)),
    "person": (people.person, {presets.PERSON}, (0.2, 0.2, 1.0), (1.4, 1.1, 2.0)),
    "bicycle": (people.bicycle, {presets.BICYCLE}, (1.5, 0.4, 0.8), (2.0, 0.8, 1.3)),
    "bicyclist": (people.bicyclist, {presets.BICYCLIST}, (1.5, 0.4, 1.6), (2.1, 0.9, 2.1)),
    "motorcycle": (people.motorcycle, {presets.MOTORCYCLE}, (1.5, 0.5, 0.9), (2.3, 1.0, 1.7)),
    "motorcyclist": (
        people.motorcyclist, {presets.MOTORCYCLIST}, (1.5, 0.5, 1.5), (2.4, 1.0, 2.2),
    ),
    "sitter": (
        lambda rng: people.person(rng, sitting=True), {presets.PERSON},
        (0.4, 0.2, 0.7), (1.2, 1.1, 1.6),
    ),
    "bus": (vehicles.bus, {presets.BUS}, (5.0, 2.1, 2.2), (18.5, 3.1, 3.7)),
    "other": (vehicles.other_vehicle, {presets.OTHER_VEHICLE}, (2.0, 1.1, 0.5), (8.5, 3.4, 5.0)),
    "lamp": (furniture.lamp, {presets.POLE}, (0.1, 0.1, 3.5), (0.6, 3.5, 9.8)),
    "post": (furniture.post, {presets.POLE}, (0.07, 0.07, 0.9), (0.25, 0.25, 8.5)),
    "sign": (furniture.sign, {presets.POLE, presets.SIGN}, (0.05, 0.05, 1.3), (1.6, 0.3, 4.2)),
    "board": (furniture.board, {presets.POLE, presets.SIGN}, (0.7, 0.1, 1.3), (3.0, 0.3, 3.5)),
    "light": (
        furniture.traffic_light, {presets.POLE, presets.CLUTTER},
        (0.1, 0.1, 3.2), (0.5, 0.6, 4.0),
    ),
    "bench": (furniture.bench, {presets.CLUTTER}, (1.4, 0.4, 1.1), (2.2, 0.5, 1.2)),
    "clutter": (furniture.clutter, {presets.CLUTTER}, (0.3, 0.2, 0.15), (4.0, 4.0, 3.6)),
    "ground cover": (
        lambda rng: vegetation.ground_cover(rng, 1.5), {presets.VEGETATION},
        (2.0, 2.0, 0.05), (3.6, 3.6, 1.0),
    ),
    "shelter": (furniture.shelter, {presets.STRUCTURE}, (2.4, 1.3, 2.4), (4.8, 1.8, 2.9)),
}  # fmt: skip


@pytest.mark.parametrize("name", THINGS)
def test_objects_have_the_right_classes_and_sizes(name):
    make, labels, smallest, largest = THINGS[name]
    for seed in range(15):
        mesh = make(np.random.default_rng(seed))
        assert set(np.unique(mesh.labels).tolist()) <= labels
        assert np.isfinite(mesh.vertices).all()
        assert mesh.triangles.min() >= 0
        assert mesh.triangles.max() < len(mesh.vertices)
        size = np.ptp(mesh.vertices, axis=0)
        assert (size >= np.array(smallest) - 1e-9).all(), size
        assert (size <= largest).all(), size


@pytest.mark.parametrize("seed", range(8))
def test_a_clipped_hedge_is_nearly_even(seed):
    height, depth = 0.8, 0.6
    mesh = vegetation.hedge(np.random.default_rng(seed), 5.0, height, depth, vegetation.CLIPPED_M)
    assert set(mesh.labels.tolist()) == {presets.VEGETATION}
    across, up = np.abs(mesh.vertices[:, 1]), mesh.vertices[:, 2]
    assert np.quantile(across, 0.99) < depth / 2 + 0.08
    assert np.quantile(up, 0.99) < height + 0.08


@pytest.mark.parametrize("kind", lots.KINDS)
@pytest.mark.parametrize("width", [0.2, 1.2, 3.5])
def test_a_narrow_lot_can_be_furnished(kind, width):
    plan = draw_plan(np.random.default_rng(0), STYLES[0], 80.0)
    lot = Lot(
        kind=kind, start=30.0, end=30.0 + width, setback=4.0, front=0, back=0, drive=(30.0, 30.0)
    )
    for seed in range(4):
        builder = Builder(np.random.default_rng(seed), plan)
        lots.furnish(builder, plan.sides[0], lot)
        ends = [part.vertices[:, 0] for part in builder.parts]
        assert all(np.isfinite(end).all() for end in ends)
