# SPDX-License-Identifier: MIT
"""Triangle meshes with a class, a material and a brightness per triangle; elementary shapes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from salsanext_cli.synthesis.presets import Material

Array = npt.NDArray[np.float64]
Rng = np.random.Generator
Number = TypeVar("Number", bound=np.generic)
BOX_FACES = np.array(
    [[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4]]
    + [[2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5]]
)
BOX_FACES.flags.writeable = False  # Shared by all boxes
TO_X = np.array([1.0, 0.0, 0.0])
TO_Z = np.array([0.0, 0.0, 1.0])


class Skin(NamedTuple):
    """Raw id, material and relative brightness of a surface."""

    label: int
    material: Material
    shade: float = 1.0

    @classmethod
    def random(cls, rng: Rng, label: int, material: Material, low: float, high: float) -> Skin:
        """Draw the brightness between two bounds."""
        return cls(label, material, float(rng.uniform(low, high)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Mesh:
    """Triangles with a label, a material and a brightness each."""

    vertices: Array  # (V, 3) float64: metres
    triangles: npt.NDArray[np.int64]  # (T, 3) int64: vertex indices
    labels: npt.NDArray[np.uint32]  # (T,) uint32: raw SemanticKITTI ids
    materials: npt.NDArray[np.uint8]  # (T,) uint8: `Material` numbers
    shades: npt.NDArray[np.float32]  # (T,) float32: relative brightness

    @classmethod
    def uniform(cls, vertices: Array, triangles: npt.NDArray[np.int64], skin: Skin) -> Mesh:
        """Return a mesh with the same skin everywhere."""
        count = len(triangles)
        labels = np.full(count, skin.label, np.uint32)
        materials = np.full(count, skin.material, np.uint8)
        return cls(
            vertices=vertices,
            triangles=triangles,
            labels=labels,
            materials=materials,
            shades=np.full(count, skin.shade, np.float32),
        )

    def moved(self, offset: npt.ArrayLike = (0.0, 0.0, 0.0), yaw: float = 0.0) -> Mesh:
        """Return the mesh turned about z by `yaw` radians, then shifted by `offset` metres."""
        return replace(self, vertices=self.vertices @ rotation("z", yaw).T + np.asarray(offset))

    def scaled(self, factors: npt.ArrayLike) -> Mesh:
        """Return the mesh stretched along x, y and z."""
        return replace(self, vertices=self.vertices * np.asarray(factors))

    def leaned(self, angle: float) -> Mesh:
        """Return the mesh tilted about x by `angle` radians."""
        return replace(self, vertices=self.vertices @ rotation("x", angle).T)


def rotation(axis: str, angle: float) -> Array:
    """Return the (3, 3) rotation about ``"x"``, ``"y"`` or ``"z"`` by `angle` radians."""
    first = "xyz".index(axis)
    second = (first + 1) % 3
    third = (first + 2) % 3
    matrix = np.eye(3)
    matrix[second, second] = matrix[third, third] = np.cos(angle)
    matrix[third, second], matrix[second, third] = np.sin(angle), -np.sin(angle)
    return matrix


def merge(meshes: Iterable[Mesh]) -> Mesh:
    """Join meshes into one."""
    parts = list(meshes)
    starts = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
    triangles = [part.triangles + start for part, start in zip(parts, starts, strict=True)]
    return Mesh(
        vertices=np.concatenate([part.vertices for part in parts]),
        triangles=np.concatenate(triangles),
        labels=np.concatenate([part.labels for part in parts]),
        materials=np.concatenate([part.materials for part in parts]),
        shades=np.concatenate([part.shades for part in parts]),
    )


def box(corner: npt.ArrayLike, opposite: npt.ArrayLike, skin: Skin) -> Mesh:
    """Return an axis-parallel box between two opposite corners."""
    (x0, y0, z0), (x1, y1, z1) = np.sort(np.array([corner, opposite], float), 0)
    corners = np.array([[x, y, z] for z in (z0, z1) for y in (y0, y1) for x in (x0, x1)])
    return Mesh.uniform(corners, BOX_FACES, skin)


def faces(corners: Array, skin: Skin) -> Mesh:
    """Return flat polygons with corners (Q, P, 3) in cyclic order, as fans around the first."""
    count, sides = corners.shape[:2]
    triangles = np.arange(count)[:, None, None] * sides + _fan(sides)
    return Mesh.uniform(corners.reshape(-1, 3), triangles.reshape(-1, 3), skin)


def _read_only(shared: npt.NDArray[Number]) -> npt.NDArray[Number]:
    """Return an array that many objects share, which none of them can change now."""
    shared.flags.writeable = False
    return shared


@cache
def _fan(sides: int) -> npt.NDArray[np.int64]:
    """Return the triangles (T, 3) of a polygon around its first corner."""
    return _read_only(np.array([[0, k, k + 1] for k in range(1, sides - 1)]))


def loft(sections: Array, skin: Skin) -> Mesh:
    """Join consecutive closed rings, sections (S, P, 3), by quadrangles."""
    rings, sides = sections.shape[:2]
    return Mesh.uniform(sections.reshape(-1, 3), _quadrangles(rings, sides), skin)


@cache
def _quadrangles(rings: int, sides: int) -> npt.NDArray[np.int64]:
    """Return the triangles (T, 3) between consecutive closed rings, which many objects share."""
    index = np.arange(rings * sides).reshape(rings, sides)
    following = np.roll(index, -1, 1)
    a = index[:-1]
    b = following[:-1]
    c = following[1:]
    d = index[1:]
    triangles = [np.stack(f, -1).reshape(-1, 3) for f in ((a, b, c), (a, c, d))]
    joined: npt.NDArray[np.int64] = np.concatenate(triangles)
    return _read_only(joined)


def extrusion(stations: Array, sections: Array, skin: Skin) -> Mesh:
    """Join sections (S, P, 2), across and up, at stations (S,) along x."""
    x = np.broadcast_to(stations[:, None, None], (*sections.shape[:2], 1))
    return loft(np.concatenate([x, sections], -1), skin)


def tube(path: npt.ArrayLike, radii: npt.ArrayLike, skin: Skin, sides: int = 7) -> Mesh:
    """Return a tube along a path (K, 3) with one radius or one per point."""
    points = np.asarray(path, float)
    radius = np.broadcast_to(radii, len(points))
    along = _normalised(_gradient(points))
    steepest = np.where(np.abs(along[:, 2:]) > 0.9, TO_X, TO_Z)
    across = _normalised(_cross(along, steepest))
    upward = _cross(along, across)
    cosines, sines = _circle(sides)
    spread = cosines * across[:, None] + sines * upward[:, None]
    return loft(points[:, None] + radius[:, None, None] * spread, skin)


@cache
def _circle(sides: int) -> tuple[Array, Array]:
    """Return the cosines and sines (P, 1) of evenly spaced angles, from 0."""
    angle = np.linspace(0, 2 * np.pi, sides, endpoint=False)[:, None]
    return _read_only(np.cos(angle)), _read_only(np.sin(angle))


# `numpy` has these functions for arrays of any shape: for a few points they take far longer.
def _gradient(points: Array) -> Array:
    """Return the steps along a path (K, 3) at each of its points, as `numpy.gradient` does."""
    steps = np.empty_like(points)
    steps[0] = points[1] - points[0]
    steps[-1] = points[-1] - points[-2]
    steps[1:-1] = (points[2:] - points[:-2]) / 2
    return steps


def _normalised(vectors: Array) -> Array:
    """Return vectors (K, 3) with their length divided out."""
    lengths: Array = np.sqrt(np.add.reduce(vectors * vectors, axis=1, keepdims=True))
    return vectors / lengths


def _cross(a: Array, b: Array) -> Array:
    """Return the cross products of vectors (K, 3)."""
    ax, ay, az = a.T
    bx, by, bz = b.T
    product = np.empty_like(a)
    product[:, 0] = ay * bz - az * by
    product[:, 1] = az * bx - ax * bz
    product[:, 2] = ax * by - ay * bx
    return product


def ellipsoid(
    centre: npt.ArrayLike, radii: npt.ArrayLike, skin: Skin, unevenness: Array | float = 0.0
) -> Mesh:
    """Return an ellipsoid of 6 rings of 8 points; `unevenness` (6, 8, 1) is relative."""
    lumps = _unit_sphere() * (1 + unevenness)
    return loft(lumps * np.asarray(radii) + np.asarray(centre), skin)


@cache
def _unit_sphere() -> Array:
    """Return a sphere of radius 1 as rings of points, (6, 8, 3)."""
    latitude = np.linspace(-np.pi / 2, np.pi / 2, 6)[:, None]
    longitude = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    x = np.cos(latitude) * np.cos(longitude)
    y = np.cos(latitude) * np.sin(longitude)
    return _read_only(np.stack([x, y, np.broadcast_to(np.sin(latitude), x.shape)], -1))


def disc(centre: npt.ArrayLike, radius: float, skin: Skin, sides: int = 12) -> Mesh:
    """Return a flat disc across the y axis."""
    angle = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    rim = np.stack([radius * np.cos(angle), np.zeros(sides), radius * np.sin(angle)], -1)
    corners = np.concatenate([np.zeros((1, 3)), rim, rim[:1]]) + np.asarray(centre, float)
    return faces(corners[None], skin)


def facets(centres: Array, sizes: Array, skin: Skin, rng: Rng) -> Mesh:
    """Return randomly turned triangles of sizes (F,) around centres (F, 3), as leaves."""
    count = len(centres)
    corners = centres[:, None] + sizes[:, None, None] * rng.uniform(-1, 1, (count, 3, 3))
    mesh = faces(corners, skin)
    mesh.shades[:] *= np.exp(0.2 * rng.standard_normal(count)).astype(np.float32)
    return mesh
