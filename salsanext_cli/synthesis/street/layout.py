# SPDX-License-Identifier: MIT
"""Random ground plans of streets of a style."""

from collections.abc import Iterator, Mapping

import numpy as np

from salsanext_cli.synthesis import presets
from salsanext_cli.synthesis.mesh import Array, Rng
from salsanext_cli.synthesis.presets import Numbers, weighted_choice
from salsanext_cli.synthesis.street.plan import (
    LEFT,
    RIGHT,
    Bank,
    Crossing,
    Ditch,
    Lot,
    Median,
    Plan,
    Side,
)

GREEN = ("thicket", "scrub", "field", "green", "meadow")  # Kinds of lot on an embankment
MAX_KERB_M = 0.14
LANE_AND_A_HALF_M = 4.3
"""Smallest distance from a median to the edge of the road, so that it is clear of the sensor."""
WIDE_ENOUGH_M = 5.0  # Half the width of a carriageway that has room for islands or cycle lanes


def draw_plan(rng: Rng, style: Numbers, length: float) -> Plan:
    """Draw a street of a style and length."""
    knots = np.arange(-1.0, length + 1.5, 0.5)
    heading = _heading(rng, knots)
    half = rng.uniform(*style.lane) * (rng.uniform(1.3, 1.9) if rng.random() < style.wide else 1)
    shoulder = rng.uniform(*style.shoulder_width) if rng.random() < style.shoulder else 0.0
    crossings = _crossings(rng, style, length)
    median = _median(rng, style, half, crossings, length)
    half = max(half, median.half + LANE_AND_A_HALF_M if median.half else 0.0) + shoulder
    amplitude = rng.uniform(0.05, 1.0, 5) * [1.2, 0.8, 0.3, 0.08, 0.03]
    longest = np.array([260, 140, 60, 22, 9])
    kx, ky = (
        rng.choice([-1, 1], 5) * 2 * np.pi / longest * rng.uniform(0.3, 1, 5) for _ in range(2)
    )
    waves = np.array([amplitude, kx, ky, rng.uniform(0, 2 * np.pi, 5)])
    x = np.cumsum(np.cos(heading)) * 0.5
    y = np.cumsum(np.sin(heading)) * 0.5
    left, right = (_side(rng, style, sign, length, crossings) for sign in (LEFT, RIGHT))
    band = _band(rng, style, half, shoulder)
    return Plan(
        style=style,
        length=length,
        half=half,
        knots=knots,
        x=x,
        y=y,
        heading=heading,
        waves=waves,
        crossings=crossings,
        sides=(left, right),
        median=median,
        shoulder=shoulder,
        band=band,
    )


def _band(rng: Rng, style: Numbers, half: float, shoulder: float) -> float:
    """Draw the width of a gutter, a lane for bicycles or a shoulder with another surface."""
    if rng.random() >= style.band:
        return 0.0
    if shoulder and rng.random() < 0.6:
        return shoulder
    widest = 1.8 if half > WIDE_ENOUGH_M else 0.6
    return float(rng.uniform(0.25, widest))


def _median(
    rng: Rng, style: Numbers, half: float, crossings: tuple[Crossing, ...], length: float
) -> Median:
    """Draw a strip between the directions of traffic, traffic islands, or neither."""
    kind = rng.random()
    wide = rng.random() < 0.25
    grass = wide or rng.random() < 0.45
    ground = presets.TERRAIN if grass else presets.OTHER_GROUND
    height = 0.0 if rng.random() < 0.3 else rng.uniform(0.04, 0.16)
    if kind < style.median:
        half_width = rng.uniform(3.0, 8.0) if wide else rng.uniform(0.4, 3.0)
        spans = tuple(_between_crossings(rng, crossings, length))
        return Median(half=half_width, spans=spans, ground=ground, height=height)
    if kind < style.median + style.traffic_islands and half > WIDE_ENOUGH_M:
        half_width = rng.uniform(0.6, max(0.7, min(1.6, half - LANE_AND_A_HALF_M)))
        spans = tuple(_short_spans(rng, crossings, length))
        return Median(half=half_width, spans=spans, ground=ground, height=max(height, 0.05))
    return Median(half=0.0, spans=(), ground=ground, height=0.0)


def _between_crossings(
    rng: Rng, crossings: tuple[Crossing, ...], length: float
) -> Iterator[tuple[float, float]]:
    """Yield the stretches between junctions; a median goes on past some side streets."""
    start = 0.0
    for crossing in crossings:
        if len(crossing.sides) == 1 and rng.random() < 0.35:
            continue
        gap = crossing.half + rng.uniform(0.5, 5)
        if crossing.s - gap > start + 2:
            yield start, crossing.s - gap
        start = crossing.s + gap
    if length > start + 2:
        yield start, length


def _short_spans(
    rng: Rng, crossings: tuple[Crossing, ...], length: float
) -> Iterator[tuple[float, float]]:
    """Yield traffic islands at least 3 m away from junctions."""
    s = rng.uniform(0, 30)
    while s < length:
        end = s + rng.uniform(2, 14)
        if all(end < c.s - c.half - 3 or s > c.s + c.half + 3 for c in crossings):
            yield s, end
        s = end + rng.uniform(10, 45)


def _heading(rng: Rng, knots: Array) -> Array:
    """Draw straights and bends of at least 85 m radius: the sides must not fold over."""
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


def _crossings(rng: Rng, style: Numbers, length: float) -> tuple[Crossing, ...]:
    crossings = []
    s = rng.uniform(0.3, 1.0) * style.crossing_gap[0]
    while s < length:
        crossings.append(_crossing(rng, style, s))
        s += rng.uniform(*style.crossing_gap)
    return tuple(crossings)


def _crossing(rng: Rng, style: Numbers, s: float) -> Crossing:
    sides = ((LEFT,), (RIGHT,), (LEFT, RIGHT))[rng.choice(3, p=(0.28, 0.28, 0.44))]
    paved = 0.0 if style.sidewalk < 0.4 else rng.uniform(1.2, 3)
    zebra = bool(rng.random() < 0.35) and style.sidewalk > 0.4
    half, corner = rng.uniform([2.2, 0.8], [4.5, 4.0])
    if rng.random() < style.round_corner:
        corner = rng.uniform(4.0, 9.5)
    continued = bool(rng.random() < style.continued)
    lowered = continued or bool(rng.random() < style.lowered)
    verge = 0.0
    if paved and rng.random() < style.verge:
        verge = rng.uniform(0.4, 2.5)
        paved += verge
    lawn, lawn_gap = _corner_lawn(rng, style, corner)
    return Crossing(
        s=s,
        half=half,
        pavement=paved,
        sides=sides,
        zebra=zebra,
        corner=corner,
        lowered=lowered,
        continued=continued,
        verge=verge,
        lawn=lawn,
        lawn_gap=lawn_gap,
    )


def _corner_lawn(rng: Rng, style: Numbers, corner: float) -> tuple[float, float]:
    """Draw the size of the lawns at a junction and their distance from the kerbs, in metres."""
    if rng.random() >= style.corner_lawn:
        return 0.0, 0.0
    if rng.random() < 0.5:  # A pavement runs around it
        return float(rng.uniform(3, 12)), float(rng.uniform(1.2, 3) + 0.25 * corner)
    return float(rng.uniform(2, 5)), float(rng.uniform(0.1, 0.3) + 0.25 * corner)


def _side(
    rng: Rng, style: Numbers, sign: int, length: float, crossings: tuple[Crossing, ...]
) -> Side:
    width = (4.6, 5.6) if rng.random() < style.across else (1.7, 2.3)
    parking = rng.uniform(*width) if rng.random() < style.parking else 0.0
    islands = tuple(_islands(rng, length)) if parking and rng.random() < 0.5 else ()
    verge_width = (2.6, 7.0) if rng.random() < style.wide_verge else (0.5, 2.6)
    verge = rng.uniform(*verge_width) if rng.random() < style.verge else 0.0
    sidewalk = rng.uniform(*style.sidewalk_width) if rng.random() < style.sidewalk else 0.0
    low = MAX_KERB_M * rng.random() ** 1.3  # Most are lower than half of it
    kerb = low if sidewalk and rng.random() >= style.flush else 0.0
    strip = presets.OTHER_GROUND if rng.random() < style.gravel else presets.TERRAIN
    border = rng.uniform(0.4, 6.0) if rng.random() < style.border else 0.0
    border_ground = presets.OTHER_GROUND if rng.random() < style.gravel else presets.TERRAIN
    bank = Bank(slope=rng.uniform(-0.6, 1) * style.bank, start=0.5, width=14.0)
    ditch = _ditch(rng, style)
    kinds = style.lots
    if rng.random() < style.embankment:
        steep = rng.uniform(0.35, 0.9) * rng.choice([1, 1, 1, -1])
        bank = Bank(slope=steep, start=rng.uniform(0.2, 8), width=rng.uniform(2.5, 10))
        ditch = Ditch(start=0.0, width=0.0, depth=0.0)
        kinds = {kind: share for kind, share in kinds.items() if kind in GREEN} or {"scrub": 1}
    lots: list[Lot] = []
    position = 0.0
    here = tuple(crossing for crossing in crossings if sign in crossing.sides)
    for crossing in here:
        lots += _lots(rng, style, kinds, position, crossing.s - crossing.half - crossing.pavement)
        position = crossing.s + crossing.half + crossing.pavement
    lots += _lots(rng, style, kinds, position, length)
    return Side(
        sign=sign,
        parking=parking,
        islands=islands,
        verge=verge,
        strip=strip,
        sidewalk=sidewalk,
        border=border,
        border_ground=border_ground,
        kerb=kerb,
        raised_parking=bool(rng.random() < 0.5),
        lots=tuple(lots),
        crossings=here,
        bank=bank,
        ditch=ditch,
    )


def _ditch(rng: Rng, style: Numbers) -> Ditch:
    if rng.random() >= style.ditch:
        return Ditch(start=0.0, width=0.0, depth=0.0)
    width = rng.uniform(1.5, 4.0)
    return Ditch(start=rng.uniform(0.1, 1.5), width=width, depth=rng.uniform(0.15, 0.3) * width)


def _islands(rng: Rng, length: float) -> Iterator[tuple[float, float]]:
    """Yield intervals along s of planted ground between groups of parking spaces."""
    gap = rng.uniform(8, 40)
    s = rng.uniform(0, gap)
    while s < length:
        end = s + rng.uniform(0.8, 4)
        yield s, end
        s = end + gap * rng.uniform(0.7, 1.3)


def _lots(
    rng: Rng, style: Numbers, kinds: Mapping[str, float], start: float, end: float
) -> list[Lot]:
    """Fill the stretch between two side streets with lots."""
    lots: list[Lot] = []
    setback = rng.uniform(*style.setback)
    while end - start > 1:
        width = rng.uniform(*style.lot_width)
        stop = end if end - start - width < style.lot_width[0] * 0.6 else start + width
        kind = weighted_choice(rng, kinds)
        lots.append(_lot(rng, kind, start, stop, setback + rng.uniform(-0.15, 0.15) * setback))
        start = stop
    return lots


def _lot(rng: Rng, kind: str, start: float, end: float, setback: float) -> Lot:
    paved = presets.SIDEWALK if rng.random() < 0.55 else presets.TERRAIN
    front = back = presets.TERRAIN
    drive = (start, start)
    if kind == "terrace":
        front = paved if setback > 2 else presets.SIDEWALK
    elif kind == "carpark":
        front = presets.PARKING
        back = paved
        setback = rng.uniform(5.5, 12)
    elif kind == "forecourt":
        front = presets.OTHER_GROUND
        setback = rng.uniform(5, 12)
    elif kind == "house":
        if rng.random() < 0.6 and end - start > 8:
            widths = (4.5, 6.0) if rng.random() < 0.25 else (2.6, 3.6)
            drive = (start + 0.4, start + 0.4 + rng.uniform(*widths))
        front = presets.SIDEWALK if rng.random() < 0.35 else presets.TERRAIN
    elif kind == "yard" and rng.random() < 0.5:
        front = presets.OTHER_GROUND
    elif kind == "court":
        front = back = presets.OTHER_GROUND
        setback = rng.uniform(8, 20)
    elif kind == "site":
        front = back = presets.OTHER_GROUND
        setback = rng.uniform(6, 20)
    elif kind == "lawn":
        setback = rng.uniform(5, 22)
        if rng.random() < 0.4:  # A path across it
            path = rng.uniform(start, max(start, end - 3))
            drive = (path, path + rng.uniform(1.2, 3))
    return Lot(
        kind=kind, start=start, end=end, setback=setback, front=front, back=back, drive=drive
    )
