# SPDX-License-Identifier: MIT
"""Buses and trams."""

import numpy as np

from salsanext_cli.synthesis import presets
from salsanext_cli.synthesis.mesh import Mesh, Rng, Skin, box, merge, tube
from salsanext_cli.synthesis.presets import BUS, ON_RAILS, Material
from salsanext_cli.synthesis.things.bodywork import dark_paint, fittings, shell, wheels


def bus(rng: Rng) -> Mesh:
    """Return a bus: a coach or a city bus, an articulated one, or a minibus with a bonnet."""
    makers = (_coach, _coach, _coach, _articulated, _minibus, _minibus)
    return makers[rng.integers(len(makers))](rng)


def _paint(rng: Rng) -> Skin:
    dark = rng.random() < 0.4
    return dark_paint(rng, BUS) if dark else Skin.random(rng, BUS, Material.PAINT, 0.3, 1.6)


def _coach(rng: Rng) -> Mesh:
    """Return a bus, from a minibus to one of 12 m and more."""
    shape = presets.BUS_BODY
    stretch = rng.uniform([0.55, 0.88, 0.85], [1.1, 1.02, 1.08])
    length = shape.length * stretch[0]
    width = shape.width * stretch[1]
    paint = _paint(rng)
    parts = [shell(shape, paint, stretch), *fittings(shape, BUS, stretch)]
    parts += wheels(BUS, [0.28 * length, -0.26 * length], width / 2, shape.wheel, 0.3)
    top = shape.profile[:, 2].max() * stretch[2]
    if rng.random() < 0.6:
        parts.append(box((-length / 4, -0.7, top), (length / 5, 0.7, top + 0.3), paint))
    for x in np.arange(-0.4, 0.4, rng.uniform(0.1, 0.16)) * length:
        low = (x, -width / 2, 1.2 * stretch[2])
        high = (x + 0.12, width / 2, top - 0.1)
        parts.append(box(low, high, paint))
    return merge(parts)


def _minibus(rng: Rng) -> Mesh:
    """Return a minibus: a van's bonnet, a row of windows and a rack or a second door."""
    shape = presets.MINIBUS_BODY
    stretch = rng.uniform([0.85, 0.92, 0.92], [1.2, 1.08, 1.08])
    half = shape.width / 2 * stretch[1]
    length = shape.length * stretch[0]
    paint = _paint(rng)
    parts = [shell(shape, paint, stretch), *fittings(shape, BUS, stretch)]
    parts += wheels(BUS, [0.33 * length, -0.27 * length], half, shape.wheel, 0.25)
    belt = 1.35 * stretch[2]
    roof = 2.35 * stretch[2]
    for x in np.arange(-0.42, 0.2, rng.uniform(0.13, 0.2)) * length:
        parts.append(box((x, -half * 0.97, belt), (x + 0.1, half * 0.97, roof), paint))
    return merge(parts)


def _articulated(rng: Rng) -> Mesh:
    """Return a bus of two sections with bellows between them."""
    shape = presets.BUS_BODY
    paint = _paint(rng)
    height = rng.uniform(0.92, 1.05)
    turn = rng.uniform(-0.08, 0.08)
    parts = []
    for centre, share in ((4.6, 0.72), (-5.4, 0.6)):
        stretch = np.array([share, 1.0, height])
        axle = 0.2 * shape.length * share
        section = [shell(shape, paint, stretch)]
        section += wheels(BUS, [axle, -axle], shape.width / 2, shape.wheel, 0.3)
        parts.append(merge(section).moved((centre, 0, 0), turn if centre < 0 else 0.0))
    bellows = Skin(BUS, Material.RUBBER)
    for x in np.arange(-1.95, 0.5, 0.3):
        parts.append(box((x, -1.15, 0.6), (x + 0.2, 1.15, 2.9 * height), bellows))
    return merge(parts)


def tram(rng: Rng) -> Mesh:
    """Return a tram of two to four sections, with a pantograph."""
    shape = presets.BUS_BODY
    paint = Skin.random(rng, ON_RAILS, Material.PAINT, 0.2, 1.2)
    dark = Skin(ON_RAILS, Material.RUBBER)
    count = int(rng.integers(2, 5))
    share = rng.uniform(0.55, 0.75)
    length = share * shape.length
    height = rng.uniform(1.05, 1.15)
    low = 0.15
    parts = []
    for index in range(count):
        section = shell(shape, paint, np.array([share, 0.98, height]))
        x = index * (length + 0.5)
        parts.append(section.moved((x, 0, low - 0.2)))
        parts.append(box((x - 1.6, -0.9, 0.0), (x + 1.6, 0.9, 0.6), dark))
        if index:
            parts.append(box((x - length / 2 - 0.5, -1.0, 0.4), (x - length / 2, 1.0, 2.9), dark))
    roof = 3.0 * height - 0.05
    elbow = [0.9, 0, roof + 0.8]
    rail = [0.0, 0, roof + 1.5]
    parts.append(tube([[0, 0, roof], elbow, rail], 0.05, dark, 5))
    parts.append(tube([[0, -0.8, roof + 1.5], [0, 0.8, roof + 1.5]], 0.04, dark, 5))
    return merge(parts).moved((-(count - 1) * (length + 0.5) / 2, 0, 0))
