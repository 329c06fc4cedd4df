# SPDX-License-Identifier: MIT
"""Ground of a street as a mesh: its surfaces, their brightness, and high grass on it."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.records import Mask
from salsanext_cli.synthesis import presets
from salsanext_cli.synthesis.mesh import Array, Mesh, Rng
from salsanext_cli.synthesis.presets import BRIGHTNESS, Material
from salsanext_cli.synthesis.street.plan import KERB_M, REACH_M, Plan, Side

PAVED = (Material.PAVING, Material.PAVING, Material.PAVING, Material.ASPHALT)
"""Materials of paved ground, as likely as they are frequent here."""
OTHER = (Material.PAVING, Material.ASPHALT, Material.GRAVEL, Material.GRAVEL, Material.GRAVEL)
"""Materials of yards, islands and building sites."""
SAME_SURFACE = (
    (presets.PARKING, presets.ROAD), (presets.SIDEWALK, presets.PARKING),
    (presets.OTHER_GROUND, presets.SIDEWALK),
)  # fmt: skip
"""Ground that may have the surface of another, so that only its location differs."""
UNEVEN_M = (0.008, 0.02, 0.03, 0.05)
"""Standard deviations of the height of grass, each as likely: from a mown lawn to a pasture."""
PAVED_UNEVEN_M = 0.004
HIGH_GRASS_M = 0.3  # Height from which grass is vegetation and not terrain
LUMPY = 0.25  # Standard deviation of the height of high grass, relative to its mean
GRASS_HEIGHTS_M = (0.1, 0.9)
SOIL_SHARE = 0.35  # Share of the streets with patches of bare soil


@dataclass(frozen=True, slots=True, kw_only=True)
class Cells:
    """Middles of the cells of the ground, (S, T) each."""

    s: Array  # Along the street, metres
    t: Array  # To the left of the centre line, metres
    labels: npt.NDArray[np.uint32]  # Raw ids


def ground(rng: Rng, plan: Plan) -> Mesh:
    """Return the ground of a street; a cell has the label of its middle, or is high grass."""
    s, t = _grid_lines(plan)
    grid_s, grid_t = np.meshgrid(s, t, indexing="ij")
    vertices = plan.world(grid_s, grid_t)
    is_terrain = plan.label(grid_s, grid_t) == presets.TERRAIN
    unevenness = np.where(is_terrain, rng.choice(UNEVEN_M), PAVED_UNEVEN_M)
    vertices[..., 2] += unevenness * rng.standard_normal(grid_s.shape)
    middle_s, middle_t = np.meshgrid((s[:-1] + s[1:]) / 2, (t[:-1] + t[1:]) / 2, indexing="ij")
    cells = Cells(s=middle_s, t=middle_t, labels=plan.label(middle_s, middle_t))
    grass = high_grass(rng, plan, cells)
    lift = _at_vertices(grass)
    vertices[..., 2] += lift * np.exp(rng.normal(0, LUMPY, lift.shape))
    labels = np.where(grass >= HIGH_GRASS_M, presets.VEGETATION, cells.labels).astype(np.uint32)
    materials, shades = _look(rng, plan, cells)
    materials[grass > 0] = Material.HIGH_GRASS
    shades *= _patches(rng, middle_s[:, 0], middle_t[0], plan.length)
    shades *= rng.normal(1, 0.03, shades.shape)
    index = np.arange(grid_s.size).reshape(grid_s.shape)
    a = index[:-1, :-1]
    b = index[1:, :-1]
    c = index[1:, 1:]
    d = index[:-1, 1:]
    faces = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], 2)
    return Mesh(
        vertices=vertices.reshape(-1, 3),
        triangles=faces.reshape(-1, 3),
        labels=np.repeat(labels.ravel(), 2),
        materials=np.repeat(materials.ravel(), 2),
        shades=np.repeat(shades.ravel(), 2).astype(np.float32),
    )


def _grid_lines(plan: Plan) -> tuple[Array, Array]:
    """Return the s (S + 1,) and the t (T + 1,) of the lines between cells."""
    s_edges, t_edges = plan.edges()
    s = _lines(np.arange(0.0, plan.length + 1, 1.0), s_edges, 0.0, plan.length)
    across = np.concatenate([np.arange(-10, 10.1, 0.5), np.linspace(10, REACH_M, 26)])
    t = _lines(np.concatenate([across, -across]), t_edges, -REACH_M, REACH_M)
    return s, t


def _lines(regular: Array, edges: Array, low: float, high: float) -> Array:
    lines: Array = np.unique(np.concatenate([regular, edges - KERB_M, edges + KERB_M]))
    lines = lines[(lines >= low) & (lines <= high)]
    return lines[np.concatenate([[True], np.diff(lines) > 0.01])]


def high_grass(rng: Rng, plan: Plan, cells: Cells) -> Array:
    """Draw the height of the grass on cells, (S, T) in metres: 0 where it is mown."""
    height = np.zeros(cells.s.shape)
    for side in plan.sides:
        beyond = side.sign * cells.t - plan.half
        for _ in range(int(rng.poisson(plan.style.high_grass * plan.length / 40))):
            inside = _patch_of_grass(rng, plan, side, cells.s, beyond)
            height[inside] = rng.uniform(*GRASS_HEIGHTS_M)
        for lot in side.lots:
            if lot.kind == "meadow":
                inside = (cells.s >= lot.start) & (cells.s < lot.end)
                inside &= beyond > side.depth + rng.uniform(0.1, 2.5)
                height[inside] = rng.uniform(*GRASS_HEIGHTS_M)
    height[(cells.labels != presets.TERRAIN) | (np.abs(cells.t) < plan.half)] = 0.0
    return height


def _patch_of_grass(rng: Rng, plan: Plan, side: Side, s: Array, beyond: Array) -> Mask:
    """Draw which cells are in a patch of high grass: on the verge, a slope or behind."""
    middle = rng.uniform(0, plan.length)
    half = rng.uniform(2, 30)
    if side.bank.width < 12:  # A steep bank
        start = side.depth + side.bank.start
        width = side.bank.width * rng.uniform(0.4, 1.2)
    else:
        start = side.paved + rng.uniform(-side.verge, 10)
        width = rng.uniform(0.5, 8)
    wave = 0.15 * width * np.sin(s * rng.uniform(0.2, 1.0) + rng.uniform(0, 6.28))
    inside: Mask = (np.abs(s - middle) < half) & (beyond > start + wave)
    inside &= beyond < start + width - wave
    return inside


def _at_vertices(height: Array) -> Array:
    """Return the least height of the cells around each vertex, (S + 1, T + 1)."""
    padded = np.pad(height, 1, mode="edge")
    return np.minimum.reduce([padded[:-1, :-1], padded[1:, :-1], padded[:-1, 1:], padded[1:, 1:]])


def _look(rng: Rng, plan: Plan, cells: Cells) -> tuple[npt.NDArray[np.uint8], Array]:
    """Draw the materials and shades of the cells, (S, T) each."""
    materials_of = {
        presets.ROAD: Material.PAVING if rng.random() < 0.12 else Material.ASPHALT,
        presets.MARKING: Material.MARKING,
        presets.PARKING: PAVED[rng.integers(len(PAVED))],
        presets.SIDEWALK: PAVED[rng.integers(len(PAVED))],
        presets.OTHER_GROUND: OTHER[rng.integers(len(OTHER))],
        presets.TERRAIN: Material.GRASS,
    }
    spread = rng.choice(BRIGHTNESS.ground)
    looks = {a: (m, rng.uniform(1 - spread, 1 + spread)) for a, m in materials_of.items()}
    for label, other in SAME_SURFACE:
        if rng.random() < BRIGHTNESS.same_surface:
            looks[label] = looks[other]
    materials = np.zeros(cells.s.shape, np.uint8)
    shades = np.ones(cells.s.shape)
    for label, (material, shade) in looks.items():
        materials[cells.labels == label] = material
        shades[cells.labels == label] = shade
    on_band = plan.on_band(cells.t) & (cells.labels == presets.ROAD)
    material = (Material.PAVING, Material.ASPHALT)[rng.integers(2)]
    materials[on_band] = material
    shades[on_band] *= np.exp(rng.normal(0, BRIGHTNESS.patch))
    if rng.random() < SOIL_SHARE:
        bare = _soil(rng, cells, plan.length) & (cells.labels == presets.TERRAIN)
        materials[bare] = Material.SOIL
    return materials, shades


def _soil(rng: Rng, cells: Cells, length: float) -> Mask:
    """Draw which cells are in patches without grass."""
    inside = np.zeros(cells.s.shape, bool)
    for _ in range(int(length / 12)):
        s, t = rng.uniform([0, -25], [length, 25])
        half_s, half_t = rng.uniform([0.5, 0.5], [8, 5])
        inside |= ((cells.s - s) / half_s) ** 2 + ((cells.t - t) / half_t) ** 2 < 1
    return inside


def _patches(rng: Rng, s: Array, t: Array, length: float) -> Array:
    """Return the brightness of cells (S, T): repaired, worn and wet patches, tracks."""
    shade = np.ones((len(s), len(t)))
    for _ in range(int(length / 6)):
        centre = rng.uniform([0, -12], [length, 12])
        half = rng.uniform([0.4, 0.2], [9, 1.6]) * rng.choice([1, 1, 1, 3])
        inside = (np.abs(s - centre[0]) < half[0])[:, None] & (np.abs(t - centre[1]) < half[1])
        if rng.random() < BRIGHTNESS.wet_patch:
            shade[inside] *= rng.uniform(*BRIGHTNESS.wet_brightness)
        else:
            shade[inside] *= np.exp(rng.normal(0, BRIGHTNESS.patch))
    return np.clip(shade, BRIGHTNESS.least, BRIGHTNESS.most)
