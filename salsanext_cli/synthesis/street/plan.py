# SPDX-License-Identifier: MIT
"""Ground plan of a street: road, pavements, lots and side streets.

Positions are ``s``, metres along the centre line, and ``t``, metres to its left; methods take
arrays of both.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from salsanext_cli.records import Mask
from salsanext_cli.synthesis import presets
from salsanext_cli.synthesis.mesh import Array, Rng
from salsanext_cli.synthesis.presets import Numbers, weighted_choice

REACH_M = 62.0  # Extent of the world to either side of the centre line
LEFT, RIGHT = 1, -1
KERB_M = 0.02  # Half the depth of the face of a kerb, which belongs to the pavement
DROP_M = 0.6  # Length of the slope of a kerb at a driveway
RUN_OUT_M = 70.0  # Length of the street behind the first scan and beyond the last one
MULTILANE_HALF_WIDTH_M = 5.5
"""Half the width from which a carriageway has several lanes per direction."""
GREEN = ("thicket", "scrub", "field", "green")  # Kinds of lot on an embankment
ACROSS_M = 4.0  # Width of a parking strip from which cars stand across it
MAX_KERB_M = 0.14
CORNER_LINES_M = np.arange(0.15, 4.1, 0.15)
"""Distances from the kerb of grid lines for rounded corners."""


@dataclass(frozen=True, slots=True)
class Lot:
    """A plot beside the street, from ``start`` to ``end`` along s."""

    kind: str
    start: float
    end: float
    setback: float  # From the street to the house
    front: int  # Raw ids of the ground before and behind the front of the house
    back: int
    drive: tuple[float, float]  # Interval along s of a driveway, empty where both are equal


@dataclass(frozen=True, slots=True)
class Crossing:
    """A side street."""

    s: float  # Of its middle
    half: float  # Half the width of its carriageway
    pavement: float  # Width of either pavement
    sides: tuple[int, ...]  # LEFT, RIGHT or both
    zebra: bool
    corner: float  # Radius of the kerb where it meets the street


@dataclass(frozen=True, slots=True)
class Bank:
    """Slope of the ground beside the street, up or down, between two levels."""

    slope: float  # Rise per metre away from the street
    start: float  # Distance from the lots' edge to its foot
    width: float  # From foot to top


@dataclass(frozen=True, slots=True)
class Side:
    """One side of the street: widths of its strips from the kerb outwards, then the lots."""

    sign: int  # LEFT or RIGHT
    parking: float
    islands: tuple[tuple[float, float], ...]  # Intervals along s that interrupt the parking spaces
    verge: float
    strip: int  # Raw id of the verge
    sidewalk: float
    kerb: float  # Height, 0 at driveways
    raised_parking: bool
    lots: tuple[Lot, ...]
    crossings: tuple[Crossing, ...]  # Those to this side
    bank: Bank

    @property
    def depth(self) -> float:
        """Distance from the kerb to the lots, in metres."""
        return self.parking + self.verge + self.sidewalk

    def kerb_height(self, s: Array) -> Array:
        """Height of the kerb, which is lowered at driveways."""
        height = np.full(np.shape(s), self.kerb)
        for low, high in (lot.drive for lot in self.lots if lot.drive[1] > lot.drive[0]):
            away = np.maximum(low - s, s - high)
            height = np.minimum(height, self.kerb * np.clip(away / DROP_M, 0, 1))
        return height

    def on_side_street(self, s: Array, beyond: Array) -> Mask:
        """Return which positions `beyond` the kerb are on a side street or its rounded corners."""
        on_street = np.zeros(np.broadcast_shapes(np.shape(s), np.shape(beyond)), bool)
        for crossing in self.crossings:
            away, radius = np.abs(s - crossing.s) - crossing.half, crossing.corner
            cut = np.hypot(radius - away, radius - beyond) > radius
            on_street |= (away <= 0) | ((away < radius) & (beyond < radius) & cut)
        return on_street

    def from_side_street(self, s: Array | float) -> Array:
        """Distance along s to the nearest side street's carriageway; negative inside."""
        distance = np.full(np.shape(s), 1e3)
        for crossing in self.crossings:
            distance = np.minimum(distance, np.abs(s - crossing.s) - crossing.half)
        return distance

    def label(self, s: Array, beyond: Array) -> npt.NDArray[np.uint32]:
        """Raw id of the ground `beyond` the kerb."""
        label = np.full(np.shape(s), presets.TERRAIN, np.uint32)
        for lot in self.lots:
            inside = (s >= lot.start) & (s < lot.end)
            front = beyond < self.depth + lot.setback
            drive = (s > lot.drive[0]) & (s < lot.drive[1]) & front
            ground = np.where(drive, presets.SIDEWALK, np.where(front, lot.front, lot.back))
            label = np.where(inside, ground, label)
        label = np.where(beyond < self.depth, presets.SIDEWALK, label)
        label = np.where(beyond < self.parking + self.verge, self.strip, label)
        on_island = np.zeros(np.shape(s), bool)
        for low, high in self.islands:
            on_island |= (s >= low) & (s < high)
        label = np.where((beyond < self.parking) & ~on_island, presets.PARKING, label)
        for crossing in self.crossings:
            paved = np.abs(s - crossing.s) - crossing.half < crossing.pavement
            label = np.where(paved & (beyond > self.parking), presets.SIDEWALK, label)
        label[self.on_side_street(s, beyond)] = presets.ROAD
        return label.astype(np.uint32)


@dataclass(frozen=True, slots=True)
class Plan:
    """A whole street."""

    style: Numbers
    length: float  # Of the centre line, metres
    half: float  # Half the width of the carriageway
    knots: Array  # (K,): the centre line at every half metre of s
    x: Array
    y: Array
    heading: Array
    waves: Array  # (4, M): amplitude, x and y wave number and phase of the rolling ground
    crossings: tuple[Crossing, ...]
    sides: tuple[Side, Side]  # Left and right

    def yaw(self, s: npt.ArrayLike) -> Array:
        """Heading of the street at s, radians."""
        return np.interp(np.asarray(s, float), self.knots, self.heading)

    def world(self, s: npt.ArrayLike, t: npt.ArrayLike) -> Array:
        """World coordinates (..., 3) of the ground at (s, t)."""
        s, t = np.broadcast_arrays(np.asarray(s, float), np.asarray(t, float))
        yaw = self.yaw(s)
        x = np.interp(s, self.knots, self.x) - t * np.sin(yaw)
        y = np.interp(s, self.knots, self.y) + t * np.cos(yaw)
        return np.stack([x, y, self.rolling(x, y) + self.relief(s, t)], -1)

    def rolling(self, x: Array, y: Array) -> Array:
        """Height of the landscape under everything."""
        amplitude, kx, ky, phase = self.waves[(...,) + (None,) * np.ndim(x)]
        return (amplitude * np.sin(kx * x + ky * y + phase)).sum(0)

    def relief(self, s: Array, t: Array) -> Array:
        """Height of kerbs, camber and banks above the landscape."""
        height = -0.015 * np.minimum(np.abs(t), self.half)
        for side in self.sides:
            beyond = side.sign * t - self.half
            inside = (beyond > 0) & ~side.on_side_street(s, beyond)
            flat = side.parking if not side.raised_parking else 0.0
            height = height + side.kerb_height(s) * (inside & (beyond > flat))
            bank = side.bank
            rise = bank.slope * np.clip(beyond - side.depth - bank.start, 0, bank.width)
            level = np.clip(side.from_side_street(s) / 6, 0, 1)
            height = height + rise * level * (beyond > 0)
        return height

    def label(self, s: Array, t: Array) -> npt.NDArray[np.uint32]:
        """Raw id of the ground at (s, t)."""
        label = np.where(self._painted(s, t), presets.MARKING, presets.ROAD).astype(np.uint32)
        for side in self.sides:
            beyond = side.sign * t - self.half
            label = np.where(beyond > -KERB_M / 2, side.label(s, beyond), label)
        return label

    def _painted(self, s: Array, t: Array) -> Mask:
        """Return where the carriageway is painted: dashes, edge lines, zebra and stop lines."""
        dashed = (np.abs(t) < 0.08) & (np.mod(s, 9.0) < 3.0)
        edge = (np.abs(np.abs(t) - (self.half - 0.3)) < 0.06) & (self.style.lane[1] > 4)
        painted: Mask = dashed | edge
        for crossing in self.crossings:
            away = np.abs(s - crossing.s) - crossing.half
            painted &= away > 1
            if crossing.zebra:
                painted |= (away > 1.5) & (away < 4.5) & (np.mod(t, 1.0) < 0.5)
        return painted

    def edges(self) -> tuple[Array, Array]:
        """Return all s and all t at which the ground changes."""
        s: list[float] = []
        for crossing in self.crossings:
            corner = crossing.half + CORNER_LINES_M
            for reach in (crossing.half, crossing.half + crossing.pavement, *corner):
                s += [crossing.s - reach, crossing.s + reach]
        t = [-0.08, 0.08]
        for side in self.sides:
            s += [edge for lot in side.lots for edge in (lot.start, *lot.drive)]
            s += [edge for island in side.islands for edge in island]
            strips = [0, side.parking, side.parking + side.verge, side.depth]
            strips += [side.depth + lot.setback for lot in side.lots]
            foot = side.depth + side.bank.start
            strips += [foot, foot + side.bank.width]
            t += [side.sign * (self.half + strip) for strip in strips]
            t += [side.sign * (self.half - 0.36), side.sign * (self.half - 0.24)]
            t += list(side.sign * (self.half + CORNER_LINES_M))
        return np.unique(np.round(s, 3)), np.unique(np.round(t, 3))


def draw_plan(rng: Rng, style: Numbers, length: float) -> Plan:
    """Draw a street of a style and length."""
    knots = np.arange(-1.0, length + 1.5, 0.5)
    heading = _heading(rng, knots)
    half = rng.uniform(*style.lane) * (rng.uniform(1.3, 1.9) if rng.random() < style.wide else 1)
    crossings = _crossings(rng, style, length)
    amplitude = rng.uniform(0.05, 1.0, 5) * [1.2, 0.8, 0.3, 0.08, 0.03]
    longest = np.array([260, 140, 60, 22, 9])
    kx, ky = (
        rng.choice([-1, 1], 5) * 2 * np.pi / longest * rng.uniform(0.3, 1, 5) for _ in range(2)
    )
    waves = np.array([amplitude, kx, ky, rng.uniform(0, 2 * np.pi, 5)])
    x, y = np.cumsum(np.cos(heading)) * 0.5, np.cumsum(np.sin(heading)) * 0.5
    left, right = (_side(rng, style, sign, length, crossings) for sign in (LEFT, RIGHT))
    return Plan(style, length, half, knots, x, y, heading, waves, crossings, (left, right))


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
        sides = ((LEFT,), (RIGHT,), (LEFT, RIGHT))[rng.choice(3, p=(0.28, 0.28, 0.44))]
        paved = 0.0 if style.sidewalk < 0.4 else rng.uniform(1.2, 3)
        zebra = bool(rng.random() < 0.35) and style.sidewalk > 0.4
        half, corner = rng.uniform([2.2, 0.8], [4.5, 4.0])
        crossings.append(Crossing(s, half, paved, sides, zebra, corner))
        s += rng.uniform(*style.crossing_gap)
    return tuple(crossings)


def _side(
    rng: Rng, style: Numbers, sign: int, length: float, crossings: tuple[Crossing, ...]
) -> Side:
    width = (4.6, 5.6) if rng.random() < style.across else (1.7, 2.3)
    parking = rng.uniform(*width) if rng.random() < style.parking else 0.0
    islands = tuple(_islands(rng, length)) if parking and rng.random() < 0.5 else ()
    verge = rng.uniform(0.5, 2.6) if rng.random() < style.verge else 0.0
    sidewalk = rng.uniform(*style.sidewalk_width) if rng.random() < style.sidewalk else 0.0
    low = MAX_KERB_M * rng.random() ** 1.3  # Most are lower than half of it
    kerb = low if sidewalk and rng.random() >= style.flush else 0.0
    strip = presets.OTHER_GROUND if rng.random() < style.gravel else presets.TERRAIN
    bank = Bank(rng.uniform(-0.6, 1) * style.bank, 0.5, 14.0)
    kinds = style.lots
    if rng.random() < style.embankment:
        steep = rng.uniform(0.35, 0.9) * rng.choice([1, 1, 1, -1])
        bank = Bank(steep, rng.uniform(0.2, 8), rng.uniform(2.5, 10))
        kinds = {kind: share for kind, share in kinds.items() if kind in GREEN} or {"scrub": 1}
    lots: list[Lot] = []
    position = 0.0
    here = tuple(crossing for crossing in crossings if sign in crossing.sides)
    for crossing in here:
        lots += _lots(rng, style, kinds, position, crossing.s - crossing.half - crossing.pavement)
        position = crossing.s + crossing.half + crossing.pavement
    lots += _lots(rng, style, kinds, position, length)
    raised = bool(rng.random() < 0.5)
    return Side(
        sign, parking, islands, verge, strip, sidewalk, kerb, raised, tuple(lots), here, bank
    )


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
        front, back, setback = presets.PARKING, paved, rng.uniform(5.5, 12)
    elif kind == "forecourt":
        front, setback = presets.OTHER_GROUND, rng.uniform(5, 12)
    elif kind == "house":
        if rng.random() < 0.6 and end - start > 8:
            drive = (start + 0.4, start + 0.4 + rng.uniform(2.6, 3.6))
        front = presets.SIDEWALK if rng.random() < 0.35 else presets.TERRAIN
    elif kind == "yard" and rng.random() < 0.3:
        front = presets.PARKING
    return Lot(kind, start, end, setback, front, back, drive)
