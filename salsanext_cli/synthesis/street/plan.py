# SPDX-License-Identifier: MIT
"""Ground plan of a street: road, pavements, lots and side streets.

Positions are ``s``, metres along the centre line, and ``t``, metres to its left; methods take
arrays of both.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.records import Mask
from salsanext_cli.synthesis import presets
from salsanext_cli.synthesis.mesh import Array
from salsanext_cli.synthesis.presets import Numbers

REACH_M = 62.0  # Extent of the world to either side of the centre line
LEFT = 1
RIGHT = -1
KERB_M = 0.02  # Half the depth of the face of a kerb, which belongs to the pavement
DROP_M = 0.6  # Length of the slope of a kerb at a driveway
RUN_OUT_M = 70.0  # Length of the street behind the first scan and beyond the last one
MULTILANE_HALF_WIDTH_M = 5.5
"""Half the width from which a carriageway has several lanes per direction."""
ACROSS_M = 4.0  # Width of a parking strip from which cars stand across it
CORNER_LINES_M = np.concatenate([np.arange(0.15, 4.1, 0.15), np.arange(4.5, 10.1, 0.5)])
"""Distances from the kerb of grid lines for rounded corners."""
LOWERED_M = 1.0  # Distance from a rounded corner at which a lowered kerb begins to rise


@dataclass(frozen=True, slots=True, kw_only=True)
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
    lowered: bool = False  # Whether the kerbs of the street are lowered here
    continued: bool = False  # Whether the pavement of the street continues across
    verge: float = 0.0  # Width of the grass between either pavement and the carriageway
    lawn: float = 0.0  # Length of the mown grass at its corners along either street
    lawn_gap: float = 0.0  # Distance of this grass from either kerb


@dataclass(frozen=True, slots=True, kw_only=True)
class Bank:
    """Slope of the ground beside the street, up or down, between two levels."""

    slope: float  # Rise per metre away from the street
    start: float  # Distance from the lots' edge to its foot
    width: float  # From foot to top


@dataclass(frozen=True, slots=True, kw_only=True)
class Ditch:
    """Channel along the street that drains it."""

    start: float  # Distance from the edge of the lots, negative towards the road
    width: float
    depth: float

    def height(self, beyond_lots: Array) -> Array:
        """Return the height of the ground at distances from the edge of the lots."""
        share = np.clip((beyond_lots - self.start) / max(self.width, 1e-6), 0, 1)
        return -self.depth * (1 - np.cos(2 * np.pi * share)) / 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Median:
    """Raised or flush ground between the directions of traffic: a strip, or islands."""

    half: float  # Half its width, 0 for none
    spans: tuple[tuple[float, float], ...]  # Intervals along s
    ground: int  # Raw id
    height: float  # Of its kerb

    def covers(self, s: Array, t: Array) -> Mask:
        """Return which positions are on the median."""
        inside = np.zeros(np.broadcast_shapes(np.shape(s), np.shape(t)), bool)
        for low, high in self.spans:
            inside |= (s >= low) & (s < high)
        covered: Mask = inside & (np.abs(t) < self.half)
        return covered


@dataclass(frozen=True, slots=True)
class Side:
    """One side of the street: widths of its strips from the kerb outwards, then the lots."""

    sign: int  # LEFT or RIGHT
    parking: float
    islands: tuple[tuple[float, float], ...]  # Intervals along s that interrupt the parking spaces
    verge: float
    strip: int  # Raw id of the verge
    sidewalk: float
    border: float  # Strip between the pavement and the lots
    border_ground: int  # Its raw id
    kerb: float  # Height, 0 at driveways
    raised_parking: bool
    lots: tuple[Lot, ...]
    crossings: tuple[Crossing, ...]  # Those to this side
    bank: Bank
    ditch: Ditch

    @property
    def depth(self) -> float:
        """Distance from the kerb to the lots, in metres."""
        return self.paved + self.border

    @property
    def paved(self) -> float:
        """Distance from the kerb to the far edge of the pavement, in metres."""
        return self.parking + self.verge + self.sidewalk

    def kerb_height(self, s: Array) -> Array:
        """Height of the kerb, which is lowered at driveways and at some junctions."""
        height = np.full(np.shape(s), self.kerb)
        for low, high in (lot.drive for lot in self.lots if lot.drive[1] > lot.drive[0]):
            away = np.maximum(low - s, s - high)
            height = np.minimum(height, self.kerb * np.clip(away / DROP_M, 0, 1))
        for crossing in self.crossings:
            if crossing.lowered:
                away = np.abs(s - crossing.s) - crossing.half - crossing.corner - LOWERED_M
                height = np.minimum(height, self.kerb * np.clip(away / DROP_M, 0, 1))
        return height

    def on_side_street(self, s: Array, beyond: Array) -> Mask:
        """Return which positions `beyond` the kerb are on a side street or its rounded corners."""
        on_street = np.zeros(np.broadcast_shapes(np.shape(s), np.shape(beyond)), bool)
        for crossing in self.crossings:
            away = np.abs(s - crossing.s) - crossing.half
            radius = crossing.corner
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
        label = np.where(beyond < self.depth, self.border_ground, label)
        label = np.where(beyond < self.paved, presets.SIDEWALK, label)
        label = np.where(beyond < self.parking + self.verge, self.strip, label)
        on_island = np.zeros(np.shape(s), bool)
        for low, high in self.islands:
            on_island |= (s >= low) & (s < high)
        label = np.where((beyond < self.parking) & ~on_island, presets.PARKING, label)
        for crossing in self.crossings:
            self._label_corners(label, s, beyond, crossing)
        on_street = self.on_side_street(s, beyond)
        label[on_street] = presets.ROAD
        strip = (beyond >= max(self.parking + self.verge, KERB_M)) & (beyond < self.paved)
        for crossing in self.crossings:
            if crossing.continued:
                near = np.abs(s - crossing.s) < crossing.half + crossing.corner
                label[on_street & strip & near] = presets.SIDEWALK
        return label.astype(np.uint32)

    def _label_corners(
        self, label: npt.NDArray[np.uint32], s: Array, beyond: Array, crossing: Crossing
    ) -> None:
        """Set the labels of the pavements, the verges and the mown corners of a side street."""
        away = np.abs(s - crossing.s) - crossing.half
        outside = beyond > self.parking
        label[(away < crossing.pavement) & outside] = presets.SIDEWALK
        label[(away < crossing.verge) & (beyond > self.depth)] = presets.TERRAIN
        from_kerb = beyond - self.parking
        nearest = np.minimum(away, from_kerb)
        farthest = np.maximum(away, from_kerb)
        corner = (nearest > 0) & (farthest < crossing.lawn_gap + crossing.lawn)
        if self.sidewalk and crossing.lawn:
            label[corner] = presets.SIDEWALK
        label[corner & (nearest > crossing.lawn_gap)] = presets.TERRAIN


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
    median: Median
    shoulder: float  # Width of the carriageway outside of its edge lines
    band: float  # Width of a strip of another look along the edges of the carriageway

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
            rise = rise + side.ditch.height(beyond - side.depth)
            level = np.clip(side.from_side_street(s) / 6, 0, 1)
            height = height + rise * level * (beyond > 0)
        return height + self.median.height * self.median.covers(s, t)

    def label(self, s: Array, t: Array) -> npt.NDArray[np.uint32]:
        """Raw id of the ground at (s, t)."""
        label = np.where(self._painted(s, t), presets.MARKING, presets.ROAD).astype(np.uint32)
        for side in self.sides:
            beyond = side.sign * t - self.half
            label = np.where(beyond > -KERB_M / 2, side.label(s, beyond), label)
        label[self.median.covers(s, t)] = self.median.ground
        return label

    def on_band(self, t: Array) -> Mask:
        """Return which distances from the centre line are on the bands of the carriageway."""
        away = self.half - np.abs(t)
        on_band: Mask = (away > 0) & (away < self.band)
        return on_band

    def _painted(self, s: Array, t: Array) -> Mask:
        """Return where the carriageway is painted: dashes, edge lines, zebra and stop lines."""
        dashed = (np.abs(t) < 0.08) & (np.mod(s, 9.0) < 3.0)
        lined = self.shoulder > 0 or self.style.lane[1] > 4
        edge = (np.abs(np.abs(t) - (self.half - 0.3 - self.shoulder)) < 0.06) & lined
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
            corner = CORNER_LINES_M[crossing.corner + 0.5 > CORNER_LINES_M]
            gap = crossing.lawn_gap
            lines = [0.0, crossing.pavement, crossing.verge, gap, gap + crossing.lawn, *corner]
            for reach in lines:
                s += [crossing.s - crossing.half - reach, crossing.s + crossing.half + reach]
        s += [end for span in self.median.spans for end in span]
        t = [-0.08, 0.08, -self.median.half, self.median.half]
        widest = max((crossing.corner for crossing in self.crossings), default=0.0)
        for side in self.sides:
            s += [edge for lot in side.lots for edge in (lot.start, *lot.drive)]
            s += [edge for island in side.islands for edge in island]
            strips = [0, side.parking, side.parking + side.verge, side.paved, side.depth]
            for crossing in side.crossings:
                gap = side.parking + crossing.lawn_gap
                strips += [gap, gap + crossing.lawn]
            strips += [side.depth + lot.setback for lot in side.lots]
            foot = side.depth + side.bank.start
            strips += [foot, foot + side.bank.width]
            if side.ditch.depth:
                start = side.depth + side.ditch.start
                strips += list(start + side.ditch.width * np.linspace(0, 1, 7))
            line = self.shoulder + 0.3
            strips += [-line - 0.06, -line + 0.06, -self.band]
            strips += list(CORNER_LINES_M[widest + 0.5 > CORNER_LINES_M])
            t += [side.sign * (self.half + strip) for strip in strips]
        return np.unique(np.round(s, 3)), np.unique(np.round(t, 3))
