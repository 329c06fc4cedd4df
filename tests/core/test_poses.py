# SPDX-License-Identifier: MIT
"""Rotations by quaternions."""

import numpy as np
import pytest

from salsanext_cli.core.poses import rotation


def product(first, second):
    """Return the Hamilton product of two quaternions (x, y, z, w)."""
    vector = first[3] * second[:3] + second[3] * first[:3] + np.cross(first[:3], second[:3])
    return np.array([*vector, first[3] * second[3] - first[:3] @ second[:3]])


@pytest.mark.parametrize("seed", range(5))
def test_the_matrix_turns_a_vector_as_its_quaternion_does(seed):
    random = np.random.default_rng(seed)
    quaternion = random.normal(size=4)
    quaternion /= np.linalg.norm(quaternion)
    inverse = quaternion * [-1, -1, -1, 1]
    vector = random.normal(size=3)
    turned = product(product(quaternion, np.array([*vector, 0])), inverse)
    np.testing.assert_allclose(rotation(*quaternion) @ vector, turned[:3], atol=1e-12)


def test_a_quarter_turn_about_z_takes_x_to_y():
    half = np.pi / 4
    turned = np.array(rotation(0, 0, np.sin(half), np.cos(half))) @ [1, 0, 0]
    np.testing.assert_allclose(turned, [0, 1, 0], atol=1e-15)
