# SPDX-License-Identifier: MIT
"""Random ground plans of a given style."""

from collections.abc import Iterable

import numpy as np

from salsanext_cli.synthesis import surfaces
from salsanext_cli.synthesis.mesh import Array, Rng
from salsanext_cli.synthesis.presets import Style
from salsanext_cli.synthesis.street.plan import LEFT, RIGHT, Crossing, Lot, Plan, Side


def draw_plan(rng: Rng, style: Style, length: float) -> Plan:
    """Draw a street of that style and length."""
    knots = np.arange(-1.0, length + 1.5, 0.5)
    heading = _heading(rng, knots)
    half = rng.uniform(*style.lane) * (rng.uniform(1.3, 1.9) if rng.random() < style.wide else 1)
    crossings = _crossings(rng, style, length)
    waves = np.stack(
        [
            rng.uniform(0.05, 1.0, 5) * np.array([1.2, 0.8, 0.3, 0.08, 0.03]),
            *(rng.choice([-1, 1], 5) * 2 * np.pi / np.array([260, 140, 60, 22, 9])
              * rng.uniform(0.3, 1, 5) for _ in range(2)),
            rng.uniform(0, 2 * np.pi, 5),
        ],
        -1,
    )  # fmt: skip
    bank = (rng.uniform(-0.6, 1) * style.bank, rng.uniform(-0.6, 1) * style.bank)
    x, y = np.cumsum(np.cos(heading)) * 0.5, np.cumsum(np.sin(heading)) * 0.5
    left, right = (_side(rng, style, sign, length, crossings) for sign in (LEFT, RIGHT))
    return Plan(style, length, half, knots, x, y, heading, waves, bank, crossings, (left, right))


def _heading(rng: Rng, knots: Array) -> Array:
    """Draw straights and bends no tighter than 85 m, so that the sides do not fold over."""
    curvature = np.zeros(len(knots))
    position = 0
    while position < len(knots):
        count = int(rng.uniform(40, 160))
        if rng.random() < 0.6:
            bend = rng.uniform(-1, 1) / 85
            curve = bend * np.hanning(count)[: len(knots) - position]
            curvature[position : position + count] = curve
        position += count
    return rng.uniform(-np.pi, np.pi) + np.cumsum(curvature) * 0.5


def _crossings(rng: Rng, style: Style, length: float) -> tuple[Crossing, ...]:
    found = []
    s = rng.uniform(0.3, 1.0) * style.crossing_gap[0]
    while s < length:
        sides = ((LEFT,), (RIGHT,), (LEFT, RIGHT))[rng.choice(3, p=(0.28, 0.28, 0.44))]
        paved = 0.0 if style.sidewalk < 0.4 else rng.uniform(1.2, 3)
        zebra = bool(rng.random() < 0.35) and style.sidewalk > 0.4
        found.append(Crossing(s, rng.uniform(2.2, 4.5), paved, sides, zebra, rng.uniform(0.8, 4.0)))
        s += rng.uniform(*style.crossing_gap)
    return tuple(found)


def _side(rng: Rng, style: Style, sign: int, length: float, crossings: Iterable[Crossing]) -> Side:
    parking = rng.uniform(1.7, 2.3) if rng.random() < style.parking else 0.0
    verge = rng.uniform(0.5, 2.6) if rng.random() < style.verge else 0.0
    sidewalk = rng.uniform(*style.sidewalk_width) if rng.random() < style.sidewalk else 0.0
    kerb = rng.uniform(0.02, 0.14) if sidewalk and rng.random() >= style.flush else 0.0
    strip = surfaces.OTHER_GROUND if rng.random() < style.gravel else surfaces.TERRAIN
    here = [c for c in crossings if sign in c.sides]
    stops = [(c.s - c.half - c.pavement, c.s + c.half + c.pavement) for c in here]
    lots: list[Lot] = []
    position = 0.0
    for low, high in [*stops, (length, length)]:
        lots += _lots(rng, style, position, low)
        position = high
    raised = bool(rng.random() < 0.5)
    return Side(sign, parking, verge, strip, sidewalk, kerb, raised, tuple(lots))


def _lots(rng: Rng, style: Style, start: float, end: float) -> list[Lot]:
    """Fill the stretch between two side streets with lots."""
    lots: list[Lot] = []
    kinds, weights = list(style.lots), np.array(list(style.lots.values()), float)
    setback = rng.uniform(*style.setback)
    while end - start > 1:
        width = rng.uniform(*style.lot_width)
        stop = end if end - start - width < style.lot_width[0] * 0.6 else start + width
        kind = str(rng.choice(kinds, p=weights / weights.sum()))
        lots.append(_lot(rng, kind, start, stop, setback + rng.uniform(-0.15, 0.15) * setback))
        start = stop
    return lots


def _lot(rng: Rng, kind: str, start: float, end: float, setback: float) -> Lot:
    paved = surfaces.SIDEWALK if rng.random() < 0.55 else surfaces.TERRAIN
    front, back = surfaces.TERRAIN, surfaces.TERRAIN
    drive = (start, start)
    if kind == "terrace":
        front, back = paved if setback > 2 else surfaces.SIDEWALK, surfaces.TERRAIN
    elif kind == "carpark":
        front, back, setback = surfaces.PARKING, paved, rng.uniform(5.5, 12)
    elif kind == "forecourt":
        front, setback = surfaces.OTHER_GROUND, rng.uniform(5, 12)
    elif kind == "house":
        if rng.random() < 0.6 and end - start > 8:
            drive = (start + 0.4, start + 0.4 + rng.uniform(2.6, 3.6))
        front = surfaces.SIDEWALK if rng.random() < 0.35 else surfaces.TERRAIN
    elif kind == "yard" and rng.random() < 0.3:
        front = surfaces.PARKING
    return Lot(kind, start, end, setback, front, back, drive)
