# SPDX-License-Identifier: MIT
"""Projection and kNN as slow loops without any optimisation."""

import math

import numpy as np

F = np.float32


def slow_project(scan, sensor):
    """Project one point after the other; return the four arrays of a `RangeImage`."""
    height, width = sensor.height, sensor.width
    down = F(math.radians(sensor.fov_down))
    extent = F(math.radians(sensor.fov_up) - math.radians(sensor.fov_down))
    channels = np.zeros((5, height, width), np.float32)
    pixel_of_point = np.full(len(scan), -1, np.int32)
    point_of_pixel = np.full((height, width), -1, np.int32)
    point_range = np.zeros(len(scan), np.float32)
    for i in range(len(scan)):
        x, y, z = (float(coordinate) for coordinate in scan.points[i])
        if not all(map(math.isfinite, (x, y, z))):
            continue
        r = F(math.sqrt(x * x + y * y + z * z)) if max(abs(x), abs(y), abs(z)) < 1e7 else F(1e7)
        if r == 0 or r > 1e6:
            continue
        yaw = F(math.atan2(y, x))
        pitch = F(math.asin(float(F(z) / r)))
        u = F(0.5) * (F(1) - yaw / F(math.pi)) * F(width)
        v = (F(1) - (pitch - down) / extent) * F(height)
        if sensor.out_of_view == "drop" and not 0 <= v <= height:
            continue
        column = min(max(math.floor(u), 0), width - 1)
        row = min(max(math.floor(v), 0), height - 1)
        pixel_of_point[i], point_range[i] = row * width + column, r
        holder = point_of_pixel[row, column]
        if holder < 0 or r < point_range[holder]:
            point_of_pixel[row, column] = i
            intensity = scan.intensity[i] if abs(scan.intensity[i]) <= 1e6 else 0
            channels[:, row, column] = r, x, y, z, intensity
    return channels, pixel_of_point, point_of_pixel, point_range


def slow_weights(window, sigma):
    """Return 1 − a Gaussian whose sum over the window is 1."""
    half = window // 2
    gaussian = {
        (dy, dx): math.exp(-(dx * dx + dy * dy) / (2 * sigma * sigma))
        for dy in range(-half, half + 1)
        for dx in range(-half, half + 1)
    }
    total = sum(gaussian.values())
    return {offset: F(1 - value / total) for offset, value in gaussian.items()}


def slow_refine(image, labels, k, window, sigma, cutoff):
    """Compare every point with every pixel of its window, once."""
    height, width = image.height, image.width
    ranges = image.channels[0]
    weights = slow_weights(window, sigma)
    refined = np.zeros(len(image.pixel_of_point), np.uint8)
    for i, pixel in enumerate(image.pixel_of_point):
        if pixel < 0:
            continue
        row, column = divmod(int(pixel), width)
        neighbours = {(row, column): (F(0), -1)}
        for place, ((dy, dx), weight) in enumerate(weights.items()):
            v, u = row + dy, (column + dx) % width
            comes_round = not -((width - 1) // 2) <= dx <= width // 2
            if comes_round or not 0 <= v < height or (v, u) in neighbours or ranges[v, u] == 0:
                continue
            distance = abs(ranges[v, u] - image.point_range[i]) * weight
            neighbours[v, u] = (distance, place)
        nearest = sorted(neighbours, key=neighbours.__getitem__)[:k]
        voters = [int(labels[vu]) for vu in nearest if neighbours[vu][0] <= cutoff]
        votes = [voter for voter in voters if voter > 0]
        own = int(labels[row, column])
        refined[i] = min(votes, key=lambda label: (-votes.count(label), label), default=own)
    return refined


def published_refine(ranges, labels, pixel_x, pixel_y, point_range, class_count=20):
    """Refine by the published edge rules: padding of range 0 and label 0, no vote is class 1.

    `ranges` is -1 where empty, which the published code turns to infinity.
    """
    framed_ranges, framed_labels = np.pad(ranges, 2), np.pad(labels, 2)
    distances, candidates = [], []
    for (dy, dx), weight in slow_weights(5, 1.0).items():
        there = (pixel_y + 2 + dy, pixel_x + 2 + dx)
        neighbour = framed_ranges[there]
        neighbour = np.where(neighbour < 0, F(np.inf), neighbour)
        neighbour = point_range if dy == dx == 0 else neighbour
        distances.append(np.abs(neighbour - point_range) * weight)
        candidates.append(framed_labels[there])
    distances, candidates = np.array(distances), np.array(candidates)
    nearest = np.argsort(distances, axis=0, kind="stable")[:5]
    too_far = np.take_along_axis(distances, nearest, 0) > 1
    voters = np.take_along_axis(candidates, nearest, 0)
    votes = [((voters == label) & ~too_far).sum(axis=0) for label in range(1, class_count)]
    return np.argmax(votes, axis=0) + 1
