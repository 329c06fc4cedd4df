# SPDX-License-Identifier: MIT
"""Shapes of a requested size and place; meshes that are joined and moved."""

import numpy as np
import pytest

from salsanext_cli.synthesis.mesh import Mesh, Skin, box, merge, tube
from salsanext_cli.synthesis.surfaces import CAR, POLE, Material

STEEL = Skin(POLE, Material.METAL, 0.5)


def signed_volume(mesh: Mesh) -> float:
    """Sum the tetrahedra between the origin and every triangle."""
    a, b, c = (mesh.vertices[mesh.triangles[:, i]] for i in range(3))
    return float(np.linalg.det(np.stack([a, b, c], 1)).sum() / 6)


def test_a_box_has_its_volume():
    mesh = box((1, 2, 3), (2, 4, 6), STEEL)
    assert signed_volume(mesh) == pytest.approx(6)


@pytest.mark.parametrize("direction", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, -2, 0.5)])
def test_a_tube_may_point_anywhere(direction):
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


def test_moving_turns_first_and_shifts_then():
    mesh = box((0, 0, 0), (2, 1, 1), STEEL).moved((10, 0, 0), np.pi / 2)
    np.testing.assert_allclose(mesh.vertices.min(0), [9, 0, 0], atol=1e-12)
    np.testing.assert_allclose(mesh.vertices.max(0), [10, 2, 1], atol=1e-12)
