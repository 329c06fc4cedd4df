# SPDX-License-Identifier: MIT
"""Poses along a street, and what a sensor sees there."""

import numpy as np

CAMERA = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
"""From x forward, y left, z up to the camera's x right, y down, z forward."""


def along(*places):
    """Return poses of scans at places along x, turning a little."""
    poses = np.tile(np.eye(4), (len(places), 1, 1))
    for number, place in enumerate(places):
        turn = 0.05 * number
        poses[number, :2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
        poses[number, 0, 3] = place
    return poses


def street(poses):
    """Return a function from a scan's number to what is seen of a street's posts and kerbs."""
    random = np.random.default_rng(0)
    posts = random.uniform([-40, -15, 0], [80, 15, 0], (90, 3))
    points = np.repeat(posts, 120, axis=0) + random.uniform(-0.4, 0.4, (10800, 3)) * [1, 1, 0]
    points[:, 2] = random.uniform(-1.5, 2, 10800)
    ground = random.uniform([-40, -15, -1.75], [80, 15, -1.7], (9000, 3))
    world = np.concatenate([points, ground])
    return lambda number: (world - poses[number, :3, 3]) @ poses[number, :3, :3]
