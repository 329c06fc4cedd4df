# SPDX-License-Identifier: MIT
"""Street under construction: objects of varied brightness on a ground plan."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np

from salsanext_cli.synthesis.mesh import Array, Mesh, Rng
from salsanext_cli.synthesis.presets import BRIGHTNESS, Material
from salsanext_cli.synthesis.street.plan import Plan, Side

MODELS = 12  # Different objects of a maker in a street, besides their brightness
PIECE_M = 5.0  # Longest straight piece of objects along a bend
Maker = Callable[[float], Mesh]  # Returns a piece of a length in metres


def with_brightness(mesh: Mesh, brightness: Array) -> Mesh:
    """Return a mesh with its shades multiplied by the brightness of its materials, (materials,)."""
    shades = np.clip(mesh.shades * brightness[mesh.materials], 0, BRIGHTNESS.most)
    return replace(mesh, shades=shades.astype(np.float32))


def varied(mesh: Mesh, rng: Rng) -> Mesh:
    """Return an object with slightly brighter or darker materials."""
    return with_brightness(mesh, np.exp(rng.normal(0, BRIGHTNESS.object, len(Material))))


class Builder:
    """Street under construction; ``parts`` are its objects in world coordinates."""

    def __init__(self, rng: Rng, plan: Plan) -> None:
        self.rng = rng
        self.plan = plan
        self.parts: list[Mesh] = []
        self._models: dict[Callable[[Rng], Mesh], list[Mesh]] = {}
        self._taken: list[tuple[float, float, float]] = []

    def chance(self, probability: float) -> bool:
        """Draw yes or no."""
        return bool(self.rng.random() < probability)

    def between(self, low: float, high: float) -> float:
        """Draw a number between two; their middle if `high` is below `low`."""
        if high < low:
            low = high = (low + high) / 2
        return float(self.rng.uniform(low, high))

    def count(self, mean: float) -> range:
        """Draw a number of objects, as a range."""
        return range(int(self.rng.poisson(mean)))

    def along(self) -> float:
        """Draw a position along the street."""
        return self.between(0, self.plan.length)

    def model(self, make: Callable[[Rng], Mesh]) -> Mesh:
        """Return an object of a maker; after `MODELS` of them, an earlier one is used again."""
        models = self._models.setdefault(make, [])
        if len(models) == MODELS:
            return models[self.rng.integers(MODELS)]
        models.append(make(self.rng))
        return models[-1]

    def put(self, mesh: Mesh, side: Side, s: float, out: float, yaw: float = 0.0) -> None:
        """Place an object ``out`` metres beyond the kerb; its y points away from the road."""
        t = side.sign * (self.plan.half + out)
        turned = float(self.plan.yaw(s)) + (0.0 if side.sign > 0 else np.pi) + yaw
        self.parts.append(varied(mesh, self.rng).moved(self.plan.world(s, t), turned))

    def put_if_free(
        self, mesh: Mesh, side: Side, s: float, out: float, radius: float, yaw: float = 0.0
    ) -> bool:
        """Place an object unless others, a side street or the street's end are within `radius`."""
        t = side.sign * (self.plan.half + out)
        if (
            not radius <= s <= self.plan.length - radius
            or side.from_side_street(s) < radius
            or any(math.hypot(s - a, t - b) < radius + r for a, b, r in self._taken)
        ):
            return False
        self._taken.append((s, t, radius))
        self.put(mesh, side, s, out, yaw)
        return True

    def put_line(self, make: Maker, side: Side, start: float, end: float, out: float) -> None:
        """Place a long object along the street, made of pieces along x."""
        t = side.sign * (self.plan.half + out)
        for low, high in _pieces(max(start, 0.0), min(end, self.plan.length)):
            ends = self.plan.world([low, high], t)
            first, last = ends if side.sign > 0 else ends[::-1]
            step = last - first
            length = float(np.hypot(step[0], step[1]))
            mesh = make(length)
            # Shear the piece so that both ends stand on the sloping ground.
            mesh.vertices[:, 2] += mesh.vertices[:, 0] * step[2] / max(length, 1e-6)
            self.parts.append(mesh.moved(first, float(np.arctan2(step[1], step[0]))))

    def put_outward(self, make: Maker, side: Side, s: float, start: float, end: float) -> None:
        """Place a long object across the street, `start` to `end` metres beyond the kerb."""
        if 0 < s < self.plan.length:
            for low, high in _pieces(start, end):
                self.put(make(high - low), side, s, float(low), yaw=np.pi / 2)


def _pieces(start: float, end: float) -> Iterator[tuple[float, float]]:
    """Divide a stretch into pieces of equal length, none if it is too short."""
    if end - start >= 0.3:
        count = max(1, int(np.ceil((end - start) / PIECE_M)))
        yield from pairwise(np.linspace(start, end, count + 1))
