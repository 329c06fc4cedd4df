# SPDX-License-Identifier: MIT
"""Houses: facades with recessed windows and doors, steps, balconies, roofs."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from salsanext_cli.synthesis.mesh import Array, Mesh, Rng, Skin, box, faces, merge
from salsanext_cli.synthesis.presets import BUILDING, Material

FOOT_M = -1.5  # Height of the foot of a wall: below the uneven ground
BLANK_SHARE = 0.2  # Largest share of openings in the ground floor of a blank front
Corners = list[list[float]]  # Four points of a quadrangle
Opening = tuple[float, float, float, float]  # Left, right, bottom and top


class House(NamedTuple):
    """Measures in metres, and skins of the walls."""

    width: float  # Of the front
    depth: float
    height: float  # Of the walls
    storey: float
    floors: int
    bay: float  # Between the middles of neighbouring windows
    wall: Skin
    base: Skin  # Of the ground floor
    open_share: float  # Share of openings in the bays of the ground floor of the front


def house(rng: Rng, width: float, depth: float, floors: int) -> Mesh:
    """Return a house whose front is `width` metres long and centred on x = 0."""
    material = Material.PLASTER if rng.random() < 0.7 else Material.BRICK
    wall = Skin.random(rng, BUILDING, material, 0.6, 1.35)
    storey = float(rng.uniform(2.6, 3.6))
    height = storey * floors + rng.uniform(0.2, 0.9)
    bay = float(rng.uniform(2.2, 4.2))
    base = wall if rng.random() < 0.6 else Skin.random(rng, BUILDING, Material.BRICK, 0.4, 1.5)
    bounds = ((0, BLANK_SHARE), (0.3, 0.6), (1, 1))[rng.choice(3, p=(0.45, 0.25, 0.3))]
    open_share = float(rng.uniform(*bounds))
    drawn = House(width, depth, height, storey, floors, bay, wall, base, open_share)
    corners = np.array([[-1, 0], [1, 0], [1, 1], [-1, 1], [-1, 0]]) * [width / 2, depth]
    parts = [_facade(rng, drawn, corners[i : i + 2], front=i == 0) for i in range(4)]
    parts.append(_roof(rng, drawn))
    if open_share > BLANK_SHARE or rng.random() < 0.5:
        parts += _details(rng, drawn)
    return merge(parts)


def _facade(rng: Rng, house: House, ends: Array, *, front: bool) -> Mesh:
    """Return the wall between two points: a grid of bays and storeys, mostly with windows."""
    along = ends[1] - ends[0]
    length = float(np.hypot(*along))
    columns = max(1, round(length / house.bay))
    rows = max(1, int(house.height / house.storey))
    lows = np.linspace(0, length, columns + 1)
    open_chance = [house.open_share, 0.85] if front else [0.65, 0.5]
    door = int(rng.integers(columns)) if front else -1
    bare = rng.uniform(0.1, 0.6)
    shop = front and bool(rng.random() < 0.25)
    size = rng.uniform([0.45, 1.1, 0.7], [0.75, 1.7, 1.0])
    shop_size = np.array([*size[:2], rng.uniform(0.7, 2.0)])
    base: list[Corners] = []
    upper: list[Corners] = []
    glass: list[Corners] = []
    closed: list[Corners] = []
    for row in range(rows):
        bottom = row * house.storey if row else FOOT_M
        top = (row + 1) * house.storey if row < rows - 1 else house.height
        walls = upper if row else base
        for column, (x0, x1) in enumerate(pairwise(lows)):
            kind = _kind_of_opening(row, is_door=column == door, is_shop=shop)
            hole = _hole(rng, x0, x1, row, house.storey, size if row else shop_size, kind)
            if hole is None or rng.random() > open_chance[min(row, 1)]:
                walls.append(_panel(x0, x1, bottom, top, 0))
                continue
            around, pane = _pierced(x0, x1, bottom, top, hole, rng.uniform(0.08, 0.3))
            walls.extend(around)
            panes = glass if rng.random() < bare else closed
            panes.append(pane)
    shutters = Skin.random(rng, BUILDING, Material.WOOD, 0.4, 1.1)
    panels = [
        (base, house.base),
        (upper, house.wall),
        (glass, Skin(BUILDING, Material.GLASS)),
        (closed, shutters),
    ]
    mesh = merge(faces(np.array(corners), skin) for corners, skin in panels if corners)
    return mesh.moved((*ends[0], 0), float(np.arctan2(*along[::-1])))


def _kind_of_opening(row: int, *, is_door: bool, is_shop: bool) -> str:
    """Return "door", "shop" or "window", the only kind above the ground floor, row 0."""
    if row == 0 and is_door:
        return "door"
    if row == 0 and is_shop:
        return "shop"
    return "window"


def _hole(
    rng: Rng, x0: float, x1: float, row: int, storey: float, size: Array, kind: str
) -> Opening | None:
    """Return the opening in a bay, None if the bay is too narrow."""
    middle = (x0 + x1) / 2
    width = (x1 - x0) * size[0]
    if kind == "door":
        return middle - 0.55, middle + 0.55, 0.15, 2.2
    if kind == "shop":
        return x0 + 0.25, x1 - 0.25, 0.4, 2.6
    if width < 0.4:
        return None
    bottom = row * storey + size[2] + rng.normal(0, 0.01)
    top = min(bottom + size[1], (row + 0.95) * storey)
    return middle - width / 2, middle + width / 2, bottom, top


def _panel(x0: float, x1: float, z0: float, z1: float, y: float) -> Corners:
    return [[x0, y, z0], [x1, y, z0], [x1, y, z1], [x0, y, z1]]


def _pierced(
    x0: float, x1: float, z0: float, z1: float, hole: Opening, depth: float
) -> tuple[list[Corners], Corners]:
    """Return the wall around an opening with reveals, and the pane behind it."""
    a, b, c, d = hole
    walls = [
        _panel(x0, a, z0, z1, 0),
        _panel(b, x1, z0, z1, 0),
        _panel(a, b, z0, c, 0),
        _panel(a, b, d, z1, 0),
        [[a, 0, c], [a, depth, c], [a, depth, d], [a, 0, d]],
        [[b, 0, c], [b, depth, c], [b, depth, d], [b, 0, d]],
        [[a, 0, c], [b, 0, c], [b, depth, c], [a, depth, c]],
        [[a, 0, d], [b, 0, d], [b, depth, d], [a, depth, d]],
    ]
    return walls, _panel(a, b, c, d, depth)


def _roof(rng: Rng, house: House) -> Mesh:
    """Return a flat or a gabled roof with eaves."""
    width = house.width
    depth = house.depth
    height = house.height
    skin = Skin.random(rng, BUILDING, Material.BRICK, 0.5, 0.9)
    eaves = rng.uniform(0.1, 0.6)
    x = width / 2 + 0.1
    low = -eaves
    high = depth + eaves
    if rng.random() < 0.3:
        return box((-x, low / 2, height), (x, high, height + 0.3), skin)
    ridge = height + rng.uniform(0.3, 0.6) * depth
    middle = depth / 2
    z = height - 0.1
    peak = ridge - 0.1
    slopes = [
        [[-x, eave, z], [x, eave, z], [x, middle, ridge], [-x, middle, ridge]]
        for eave in (low, high)
    ]
    gables = [
        [[end, 0, height], [end, depth, height], [end, middle, peak], [end, middle, peak]]
        for end in (-width / 2, width / 2)
    ]
    return merge([faces(np.array(slopes), skin), faces(np.array(gables), house.wall)])


def _details(rng: Rng, house: House) -> list[Mesh]:
    """Return steps, downpipes, plinths, balconies, canopies and bays of the front."""
    half = house.width / 2
    wall = house.wall
    top = house.storey * house.floors
    metal = Skin(BUILDING, Material.METAL, 1.1)
    parts = []
    if rng.random() < 0.5:
        parts.append(box((-half, -0.06, FOOT_M), (half, 0.02, rng.uniform(0.3, 0.9)), wall))
    for x in (-half + 0.1, half - 0.2):
        if rng.random() < 0.6:
            parts.append(box((x, -0.1, 0), (x + 0.1, -0.01, top), metal))
    if rng.random() < 0.5:
        x = rng.uniform(-half, half - 1.8)
        for n in range(1, 4):
            y = -0.35 * n
            z = 0.6 - 0.17 * n
            parts.append(box((x, y, FOOT_M), (x + 1.6, y + 0.4, z), wall))
    if rng.random() < 0.35 and house.width > 6:
        x = rng.uniform(-half + 1, half - 3.5)
        y = -rng.uniform(0.5, 1.3)
        parts.append(box((x, y, FOOT_M), (x + 2.5, 0.1, top * 0.9), wall))
    if house.floors > 1 and rng.random() < 0.5:
        for floor in range(1, house.floors):
            x = rng.uniform(-half + 0.3, half - 2.8)
            z = floor * house.storey
            parts.append(box((x, -1.2, z - 0.15), (x + 2.5, 0, z), wall))
            parts.append(box((x, -1.22, z), (x + 2.5, -1.17, z + 0.95), metal))
    if rng.random() < 0.4:
        x = rng.uniform(-half, half - 2)
        parts.append(box((x, -rng.uniform(0.6, 1.4), 2.3), (x + 2, 0, 2.45), metal))
    return parts


def garage(rng: Rng) -> Mesh:
    """Return a garage or shed, its door at y = 0."""
    wall = Skin.random(rng, BUILDING, Material.PLASTER, 0.6, 1.1)
    width, depth, height = rng.uniform([2.6, 4, 2.2], [6, 6.5, 2.9])
    walls = box((-width / 2, 0, FOOT_M), (width / 2, depth, height), wall)
    metal = Skin(BUILDING, Material.METAL, 1.3)
    return merge([walls, box((-width / 2 + 0.3, -0.03, 0), (width / 2 - 0.3, 0.02, 2), metal)])


def arch(rng: Rng, width: float, height: float) -> Mesh:
    """Return the storeys above a passage between two houses."""
    wall = Skin.random(rng, BUILDING, Material.PLASTER, 0.6, 1.3)
    low = float(rng.uniform(2.4, 3.4))
    return box((-width / 2, 0, low), (width / 2, 8, max(height, low + 1)), wall)
