# SPDX-License-Identifier: MIT
"""Objects of rare classes: shapes, labels, places, and how frequent they are in a street."""

from collections import Counter

import numpy as np
import pytest

from salsanext_cli.synthesis import presets
from salsanext_cli.synthesis.drive import build_street
from salsanext_cli.synthesis.lidar import Lasers, Scene, measure
from salsanext_cli.synthesis.presets import BALANCED_STYLES, HDL64, STYLES, style_of
from salsanext_cli.synthesis.street import crowd, traffic, yards
from salsanext_cli.synthesis.street.builder import MODELS, Builder
from salsanext_cli.synthesis.street.layout import draw_plan
from salsanext_cli.synthesis.things import (
    buses,
    figures,
    furniture,
    other_vehicles,
    pedestrians,
    riders,
    site_vehicles,
    trucks,
)

PERSON, BICYCLIST, MOTORCYCLIST = {30}, {31}, {32}
MAKERS = {
    "truck": (trucks.truck, {18}, (4.2, 1.6, 1.5), (24.0, 3.3, 4.5)),
    "bus": (buses.bus, {13}, (5.0, 2.0, 2.2), (18.5, 3.1, 3.7)),
    "tram": (buses.tram, {16}, (12.0, 2.2, 4.4), (37.0, 2.6, 5.2)),
    "other": (other_vehicles.other_vehicle, {20}, (2.0, 1.1, 0.5), (8.5, 3.4, 5.0)),
    "site": (site_vehicles.site_vehicle, {20}, (2.2, 1.0, 1.7), (7.5, 2.9, 4.9)),
    "posed": (figures.posed, PERSON, (0.2, 0.3, 0.5), (1.5, 1.8, 2.3)),
    "umbrella": (pedestrians.with_umbrella, PERSON, (0.8, 0.8, 1.1), (1.6, 1.4, 2.3)),
    "pram": (pedestrians.with_pram, PERSON, (1.3, 0.4, 1.0), (2.0, 1.0, 2.1)),
    "suitcase": (pedestrians.with_suitcase, PERSON, (0.6, 0.4, 1.0), (1.6, 1.8, 2.3)),
    "frame": (pedestrians.with_frame, PERSON, (0.9, 0.5, 1.0), (1.5, 1.0, 2.1)),
    "wheelchair": (pedestrians.in_wheelchair, PERSON, (0.6, 0.6, 0.8), (1.4, 0.9, 1.8)),
    "child": (pedestrians.with_child, PERSON, (0.2, 0.4, 1.0), (1.5, 1.8, 2.6)),
    "dog": (pedestrians.with_dog, {30, 99}, (0.5, 0.7, 1.0), (2.3, 2.1, 2.4)),
    "cyclist": (riders.riding_bicyclist, BICYCLIST, (1.5, 0.4, 1.5), (3.1, 0.9, 2.2)),
    "halting cyclist": (riders.halting_bicyclist, BICYCLIST, (1.5, 0.5, 1.4), (2.1, 1.1, 2.2)),
    "pushed bicycle": (riders.pushing_bicyclist, BICYCLIST, (1.5, 0.7, 1.0), (2.1, 1.6, 2.3)),
    "motorcyclist": (riders.riding_motorcyclist, MOTORCYCLIST, (1.5, 0.5, 1.5), (2.5, 1.0, 2.2)),
    "halting motorcyclist": (
        riders.halting_motorcyclist, MOTORCYCLIST, (1.5, 0.6, 1.4), (2.4, 1.2, 2.2),
    ),
    "hoop": (furniture.hoop, {99}, (0.6, 0.04, 0.9), (1.0, 0.06, 1.3)),
}  # fmt: skip


@pytest.mark.parametrize("name", MAKERS)
def test_an_object_has_its_class_and_size_and_stands_on_the_ground(name):
    make, labels, smallest, largest = MAKERS[name]
    for seed in range(25):
        mesh = make(np.random.default_rng(seed))
        assert set(mesh.labels.tolist()) == labels
        assert np.isfinite(mesh.vertices).all()
        size = np.ptp(mesh.vertices, axis=0)
        assert (size >= smallest).all(), size
        assert (size <= largest).all(), size
        foot = mesh.vertices[:, 2].min()
        assert (-0.06 <= foot <= 0.06) or (name == "hoop" and foot == pytest.approx(-0.3, abs=0.03))


@pytest.mark.parametrize("name", MAKERS)
def test_an_object_ahead_of_the_sensor_is_seen_with_its_label(name):
    make, labels, *_ = MAKERS[name]
    mesh = make(np.random.default_rng(3)).moved((9.0 + 19.0 * (name == "tram"), 0, 0), 0.5)
    azimuth, height = np.meshgrid(np.linspace(-0.1, 0.1, 90), np.linspace(-0.17, 0.1, 60))
    directions = np.stack([np.ones(azimuth.size), azimuth.ravel(), height.ravel()], -1)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    origins = np.tile([0.0, 0.0, 1.73], (len(directions), 1))
    ones = np.ones(len(directions))
    rays = np.concatenate([origins, directions], 1)
    seen = measure(
        np.random.default_rng(0), [Scene(mesh)], rays, Lasers(ones, 0 * ones, ones), HDL64
    )
    distance, _, found = seen
    returned = np.isfinite(distance)
    assert returned.sum() > 15
    assert set(found[returned].tolist()) <= labels


@pytest.mark.parametrize("name", trucks.LOADS)
def test_every_load_stays_on_its_bed(name):
    bed = trucks.Bed(3.0, 1.2, 1.0, trucks.STEEL)
    for seed in range(10):
        parts = trucks.LOADS[name](np.random.default_rng(seed), bed)
        corners = np.concatenate([part.vertices for part in parts])
        assert np.abs(corners[:, 1]).max() <= 1.35
        assert corners[:, 0].min() >= -3.9
        assert corners[:, 0].max() <= 3.8
        assert corners[:, 2].max() <= 4.5


def test_a_tractor_and_its_trailer_are_apart_above_the_chassis():
    """Between cab and container there is nothing at the height of the container."""
    kind = presets.TRUCKS["semi_container"]
    for seed in range(6):
        mesh = trucks._articulated(np.random.default_rng(seed), kind)
        corners = mesh.vertices[mesh.triangles]
        high = corners[corners[..., 2].min(axis=1) > 1.6]
        spans = sorted((c[:, 0].min(), c[:, 0].max()) for c in high)
        end, widest = spans[0][1], 0.0
        for low, far in spans:
            widest = max(widest, low - end)
            end = max(end, far)
        assert widest > 0.45


@pytest.mark.parametrize("name", figures.STANCE_SHARES)
def test_a_stance_has_its_height(name):
    """Of the hips, relative to the height of the person."""
    bounds = {"sitting": (0.28, 0.28), "crouching": (0.14, 0.26)}
    low, high = bounds.get(name, (0.52, 0.52))
    for seed in range(10):
        stance = figures.draw_stance(np.random.default_rng(seed), name)
        assert low <= stance.hips <= high
        assert (stance.feet[:, 2] < 0.05).all()
        assert (stance.knees[:, 2] > stance.feet[:, 2]).all()


def test_every_other_sequence_is_balanced_and_every_style_has_both_mixes():
    assert [presets.is_balanced(sequence) for sequence in range(10)] == [False, True] * 5
    both = range(2 * len(STYLES))
    for start in (0, 1, 6):
        assert sum(presets.is_balanced(start + sequence) for sequence in both) == len(STYLES)
    styles = {id(style_of(sequence)) for sequence in both}
    assert styles == {id(style) for style in (*STYLES, *BALANCED_STYLES)}


def objects_of(styles):
    """Count the parked and the moving objects of a street of each style, by raw id."""
    counts = Counter()
    for seed, style in enumerate(styles):
        rng = np.random.default_rng(seed)
        builder = Builder(rng, draw_plan(rng, style, 180.0))
        for side in builder.plan.sides:
            crowd.furnish(builder, side)
            yards.furnish(builder, side)
        movers = traffic.draw_movers(builder, 8.0, 5.0)
        meshes = [*builder.parts, *(mover.mesh for mover in movers)]
        counts.update(int(mesh.labels[0]) for mesh in meshes)
    back = {moving: standing for standing, moving in presets.MOVING.items()}
    total = Counter()
    for label, count in counts.items():
        total[back.get(label, label)] += count
    return total


@pytest.mark.parametrize("streets", [1, pytest.param(4, marks=pytest.mark.slow)])
def test_rare_objects_are_far_more_frequent_in_balanced_streets(streets):
    """By number: people five times or more, riders, trucks and other vehicles more.

    In one street of each style, fewer than 20 ordinary objects of a class are a matter of chance.
    """
    ordinary = objects_of(STYLES[:6] * streets)
    balanced = objects_of(BALANCED_STYLES[:6] * streets)
    least = {30: 5, 31: 6, 32: 6, 11: 5, 15: 5, 18: 5, 20: 8}
    judged = [label for label in least if streets > 1 or ordinary[label] >= 20]
    assert {30, 11, 15} <= {*judged}
    for label in judged:
        assert balanced[label] >= least[label] * max(ordinary[label], 1), label
    assert balanced[presets.CAR] < 3 * ordinary[presets.CAR]


def test_people_who_cross_do_not_walk_into_the_sensor():
    speed, duration = 8.0, 6.0
    style = BALANCED_STYLES[1]
    rng = np.random.default_rng(1)
    builder = Builder(rng, draw_plan(rng, style, 200.0))
    plan = builder.plan
    lane = min(0.0, 2.4 + plan.shoulder - plan.half)
    crossers = [m for m in traffic.draw_movers(builder, speed, duration) if m.across]
    assert crossers
    for time in np.arange(0, duration, 0.2):
        ahead = np.array([m.start - 70.0 - speed * time for m in crossers])
        t = np.array([m.t + m.across * time for m in crossers])
        assert not ((np.abs(ahead) < 4) & (np.abs(t - lane) < 1.5)).any()


def test_a_mover_that_crosses_faces_where_it_walks():
    rng = np.random.default_rng(0)
    plan = draw_plan(rng, STYLES[0], 100.0)
    mesh = furniture.bench(rng)
    mover = traffic.Mover(mesh=mesh, start=50.0, t=-3.0, speed=0.0, across=1.0)
    expected = mesh.moved(plan.world(50.0, -1.0), float(plan.yaw(50.0)) + np.pi / 2)
    np.testing.assert_allclose(mover.at(plan, 2.0).vertices, expected.vertices, atol=1e-9)


def test_a_walking_person_moves_and_the_dog_does_not_become_a_person():
    mesh = pedestrians.with_dog(np.random.default_rng(0))
    moving = traffic._in_motion(mesh)
    np.testing.assert_array_equal(moving.labels == 254, mesh.labels == 30)
    np.testing.assert_array_equal(moving.labels == 99, mesh.labels == 99)


def test_a_street_reuses_its_models_after_some():
    rng = np.random.default_rng(0)
    builder = Builder(rng, draw_plan(rng, STYLES[0], 60.0))
    drawn = [builder.model(furniture.hoop) for _ in range(400)]
    assert len({id(mesh) for mesh in drawn[:MODELS]}) == MODELS
    assert {id(mesh) for mesh in drawn[MODELS:]} == {id(mesh) for mesh in drawn[:MODELS]}
    assert id(builder.model(furniture.bench)) not in {id(mesh) for mesh in drawn}


def test_equal_seeds_build_equal_streets():
    first, second = (
        build_street(np.random.default_rng(4), BALANCED_STYLES[4], 10.0, 6.0) for _ in range(2)
    )
    np.testing.assert_array_equal(first.standing.vertices, second.standing.vertices)
    np.testing.assert_array_equal(first.standing.labels, second.standing.labels)
    assert len(first.movers) == len(second.movers)
