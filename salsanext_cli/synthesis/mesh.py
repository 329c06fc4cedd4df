# SPDX-License-Identifier: MIT
"""Triangle meshes with a raw id, a material and a brightness per triangle."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from salsanext_cli.synthesis.materials import Material

Array = npt.NDArray[np.float64]


class Skin(NamedTuple):
    """Raw id, material and relative brightness of a surface."""

    label: int
    material: Material
    shade: float = 1.0

    @classmethod
    def drawn(
        cls, rng: np.random.Generator, label: int, material: Material, low: float, high: float
    ) -> Skin:
        """Draw the brightness between two bounds."""
        return cls(label, material, float(rng.uniform(low, high)))


@dataclass(frozen=True, slots=True)
class Mesh:
    """Triangles with a skin each.

    Attributes
    ----------
    vertices : (V, 3) float64
        Metres.
    triangles : (T, 3) int64
        Vertex indices.
    labels : (T,) uint32
        Raw SemanticKITTI ids.
    materials : (T,) uint8
        `Material` numbers.
    shades : (T,) float32
        Brightness relative to the material's usual one.
    """

    vertices: Array
    triangles: npt.NDArray[np.int64]
    labels: npt.NDArray[np.uint32]
    materials: npt.NDArray[np.uint8]
    shades: npt.NDArray[np.float32]

    @classmethod
    def of(cls, vertices: Array, triangles: npt.NDArray[np.int64], skin: Skin) -> Mesh:
        """Return a mesh that has one skin all over."""
        count = len(triangles)
        return cls(
            vertices,
            triangles,
            np.full(count, skin.label, np.uint32),
            np.full(count, skin.material, np.uint8),
            np.full(count, skin.shade, np.float32),
        )

    def __len__(self) -> int:
        return len(self.triangles)

    def moved(self, offset: npt.ArrayLike = (0.0, 0.0, 0.0), yaw: float = 0.0) -> Mesh:
        """Return the mesh turned about z by `yaw` radians, then shifted by `offset` metres."""
        return replace(self, vertices=self.vertices @ turn_z(yaw).T + np.asarray(offset, float))

    def scaled(self, factors: npt.ArrayLike) -> Mesh:
        """Return the mesh stretched along x, y and z."""
        return replace(self, vertices=self.vertices * np.asarray(factors, float))

    def leaned(self, angle: float) -> Mesh:
        """Return the mesh tilted about x by `angle` radians."""
        return replace(self, vertices=self.vertices @ turn_x(angle).T)

    def relabelled(self, label: int) -> Mesh:
        """Return the mesh with one raw id for all triangles."""
        return replace(self, labels=np.full(len(self), label, np.uint32))


def turn_x(angle: float) -> Array:
    """Return the (3, 3) rotation about x."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def turn_y(angle: float) -> Array:
    """Return the (3, 3) rotation about y."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def turn_z(angle: float) -> Array:
    """Return the (3, 3) rotation about z."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def merge(meshes: Iterable[Mesh]) -> Mesh:
    """Join meshes into one; nothing gives an empty mesh."""
    parts = list(meshes)
    if not parts:
        return Mesh.of(np.zeros((0, 3)), np.zeros((0, 3), np.int64), Skin(0, Material.ASPHALT))
    starts = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
    shifted = [part.triangles + start for part, start in zip(parts, starts, strict=True)]
    kept = ("labels", "materials", "shades")
    return Mesh(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate(shifted),
        *(np.concatenate([getattr(part, name) for part in parts]) for name in kept),
    )
