# SPDX-License-Identifier: MIT
"""Elementary shapes have the size, the surface and the volume of geometry."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from salsanext_cli.synthesis.mesh import (
    Mesh,
    Skin,
    _circle,
    _fan,
    _quadrangles,
    _unit_sphere,
    box,
    disc,
    ellipsoid,
    extrusion,
    facets,
    merge,
    rotation,
    tube,
)
from salsanext_cli.synthesis.presets import Material

SKIN = Skin(40, Material.ASPHALT, 0.8)


def corners(mesh: Mesh) -> np.ndarray:
    """Return the corners (T, 3, 3) of the triangles."""
    return mesh.vertices[mesh.triangles]


def area(mesh: Mesh) -> float:
    a, b, c = corners(mesh).transpose(1, 0, 2)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def volume(mesh: Mesh) -> float:
    """Return the volume within a closed mesh, by the divergence theorem."""
    a, b, c = corners(mesh).transpose(1, 0, 2)
    return abs(float((a * np.cross(b, c)).sum() / 6))


def test_a_box_has_the_surface_and_the_extent_of_its_corners():
    mesh = box((1, 5, 2), (3, 2, 2.5), SKIN)
    assert area(mesh) == pytest.approx(2 * (2 * 3 + 3 * 0.5 + 2 * 0.5))
    np.testing.assert_allclose(mesh.vertices.min(0), (1, 2, 2))
    np.testing.assert_allclose(mesh.vertices.max(0), (3, 5, 2.5))
    assert (mesh.labels == 40).all()
    assert (mesh.shades == np.float32(0.8)).all()


@given(st.sampled_from("xyz"), st.floats(-7, 7))
def test_a_rotation_keeps_lengths_and_its_axis(axis, angle):
    matrix = rotation(axis, angle)
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(matrix) == pytest.approx(1)
    np.testing.assert_allclose(matrix @ np.eye(3)["xyz".index(axis)], np.eye(3)["xyz".index(axis)])
    assert np.trace(matrix) == pytest.approx(1 + 2 * np.cos(angle))


def test_moved_and_leaned_meshes_keep_their_surface_and_scaled_ones_their_proportions():
    mesh = box((0, 0, 0), (2, 1, 1), SKIN)
    for other in (mesh.moved((5, -2, 1), 0.7), mesh.leaned(0.3)):
        assert area(other) == pytest.approx(area(mesh))
    assert volume(mesh) == pytest.approx(2)
    assert volume(mesh.scaled((2, 3, 0.5))) == pytest.approx(2 * 2 * 3 * 0.5)
    quarter = mesh.moved((10, 0, 0), np.pi / 2).vertices
    np.testing.assert_allclose((quarter.min(0), quarter.max(0)), [(9, 0, 0), (10, 2, 1)], atol=1e-9)


def test_merged_meshes_keep_their_triangles_and_skins():
    parts = [box((0, 0, 0), (1, 1, 1), SKIN), disc((0, 0, 0), 2, Skin(50, Material.ASPHALT))]
    whole = merge(parts)
    np.testing.assert_array_equal(corners(whole), np.concatenate([corners(part) for part in parts]))
    np.testing.assert_array_equal(whole.labels, np.concatenate([part.labels for part in parts]))


@pytest.mark.parametrize(
    "shared",
    [box((0, 0, 0), (1, 1, 1), SKIN).triangles, _fan(5), *_circle(5), _unit_sphere()]
    + [_quadrangles(2, 4)],
)
def test_arrays_that_objects_share_cannot_be_changed(shared):
    with pytest.raises(ValueError, match="read-only"):
        shared[0] = 0


def test_a_tube_a_prism_and_a_disc_have_the_surfaces_of_their_polygons():
    sides = 9
    mesh = tube([(0, 0, 0), (0, 0, 3)], 0.5, SKIN, sides)
    edge = 2 * 0.5 * np.sin(np.pi / sides)
    assert area(mesh) == pytest.approx(3 * sides * edge)
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float)
    assert area(extrusion(np.array([0.0, 4.0]), np.stack([square] * 2), SKIN)) == pytest.approx(32)
    polygon = disc((1, 2, 3), 2, SKIN, sides)
    assert area(polygon) == pytest.approx(sides / 2 * 4 * np.sin(2 * np.pi / sides))
    assert np.ptp(polygon.vertices[:, 1]) == 0


def test_an_ellipsoid_is_within_its_radii():
    mesh = ellipsoid((1, 2, 3), (3, 2, 1), SKIN)
    scaled = (mesh.vertices - (1, 2, 3)) / (3, 2, 1)
    np.testing.assert_allclose(np.linalg.norm(scaled, axis=1), 1)
    assert 0.6 * 4 / 3 * np.pi * 6 < volume(mesh) < 4 / 3 * np.pi * 6


def test_leaves_are_around_their_centres():
    random = np.random.default_rng(0)
    centres = random.uniform(-5, 5, (30, 3))
    mesh = facets(centres, np.full(30, 0.1), SKIN, random)
    offsets = corners(mesh) - centres[:, None]
    assert np.abs(offsets).max() <= 0.1
    assert np.unique(mesh.shades).size == 30
