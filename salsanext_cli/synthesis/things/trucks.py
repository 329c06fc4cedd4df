# SPDX-License-Identifier: MIT
"""Trucks: a cab and what it carries or pulls."""

from typing import NamedTuple

import numpy as np

from salsanext_cli.synthesis import presets
from salsanext_cli.synthesis.mesh import Array, Mesh, Rng, Skin, box, faces, merge, tube
from salsanext_cli.synthesis.presets import TRUCK, Material, Numbers
from salsanext_cli.synthesis.things.bodywork import dark_paint, shell, wheels

STEEL = Skin(TRUCK, Material.METAL, 0.5)


class Bed(NamedTuple):
    """Half length, half width and height of the floor behind a cab, metres; skin of the load."""

    half_length: float
    half_width: float
    floor: float
    skin: Skin


def truck(rng: Rng) -> Mesh:
    """Return a truck of one of the kinds in the presets, perhaps with a trailer."""
    shares = {name: kind.share for name, kind in presets.TRUCKS.items()}
    kind = presets.TRUCKS[presets.weighted_choice(rng, shares)]
    return _articulated(rng, kind) if kind.articulated else _rigid(rng, kind)


def _rigid(rng: Rng, kind: Numbers) -> Mesh:
    """Return a truck whose cab and bed are on one frame; a trailer may follow."""
    cab = kind.cab
    stretch = _stretch(rng)
    bed = _draw_bed(rng, kind, cab.width * 0.49 * stretch[1])
    half_length = bed.half_length
    cab_length = cab.length * stretch[0]
    gap = rng.uniform(*kind.gap)
    parts = [_cab(rng, cab, stretch).moved((half_length + cab_length / 2 + gap, 0, 0))]
    parts.append(box((-half_length, -0.4, 0.5), (half_length + cab_length, 0.4, bed.floor), STEEL))
    parts += LOADS[kind.load](rng, bed)
    rear_axle = -half_length * 0.62
    axles = [half_length + gap + cab_length * 0.55, rear_axle]
    if half_length > 3:
        axles += [rear_axle + 1.15, rear_axle - 1.15]
    parts += wheels(TRUCK, axles, bed.half_width, cab.wheel, 0.35)
    parts += _rear(rng, bed)
    if rng.random() < kind.trailer:
        parts.append(_trailer(rng, kind, bed))
    whole = merge(parts)
    middle = (whole.vertices[:, 0].min() + whole.vertices[:, 0].max()) / 2
    return whole.moved((-middle, 0, 0))


def _articulated(rng: Rng, kind: Numbers) -> Mesh:
    """Return a tractor with a frame of its own and the front of a trailer on it."""
    cab = kind.cab
    stretch = _stretch(rng)
    bed = _draw_bed(rng, kind, cab.width * 0.52 * stretch[1])
    front = bed.half_length
    floor = bed.floor
    cab_length = cab.length * stretch[0]
    gap = rng.uniform(*kind.gap)
    drive = front - rng.uniform(1.0, 1.6)
    parts = [
        _cab(rng, cab, stretch).moved((front + gap + cab_length / 2, 0, 0)),
        box((drive - 0.7, -0.4, 0.6), (front + gap + cab_length * 0.8, 0.4, 0.9), STEEL),
        box((-front, -0.45, floor - 0.25), (front, 0.45, floor), STEEL),
        *LOADS[kind.load](rng, bed),
        *_rear(rng, bed),
    ]
    steering = front + gap + cab_length * 0.55
    bogie = -front * 0.62 + np.array([-1.3, 0.0, 1.3])
    parts += wheels(TRUCK, [steering, drive, *bogie.tolist()], bed.half_width, cab.wheel, 0.35)
    legs = front * 0.55
    for side in (-1, 1):
        outer = side * bed.half_width
        parts.append(tube([[legs, outer * 0.8, 0.3], [legs, outer * 0.8, floor]], 0.07, STEEL))
        tank = [[front + gap - 0.8, outer * 0.75, 0.65], [front + gap + 0.1, outer * 0.75, 0.65]]
        parts.append(tube(tank, 0.28, STEEL, 8))
        if rng.random() < 0.6:
            low = (bogie[2] + 0.8, outer - side * 0.04, 0.5)
            high = (legs - 0.3, outer, 0.95)
            parts.append(box(low, high, STEEL))
    return merge(parts).moved((-(cab_length + gap) / 2, 0, 0))


def _stretch(rng: Rng) -> Array:
    return rng.uniform([0.85, 0.88, 0.85], [1.1, 1.08, 1.15])


def _draw_bed(rng: Rng, kind: Numbers, half_width: float) -> Bed:
    material = (Material.PLASTER, Material.PAINT, Material.METAL)[rng.integers(3)]
    load = Skin.random(rng, TRUCK, material, 0.5, 1.8)
    return Bed(rng.uniform(*kind.bed) / 2, half_width, rng.uniform(*kind.floor), load)


def _cab(rng: Rng, cab: Numbers, stretch: Array) -> Mesh:
    """Return a cab around the origin with lamps and mirrors."""
    paint = dark_paint(rng, TRUCK)
    body = shell(cab, paint._replace(shade=paint.shade + 0.1), stretch)
    front = cab.length / 2 * stretch[0]
    half = cab.width / 2 * stretch[1]
    height = cab.profile[2, 1] * stretch[2]
    lamp = Skin(TRUCK, Material.LAMP)
    mirror = Skin(TRUCK, Material.PAINT, 0.4)
    parts = [body]
    for side in (-1, 1):
        inner = side * half * 0.6
        outer = side * half * 0.92
        parts.append(box((front - 0.1, inner, 0.6), (front + 0.01, outer, 0.78), lamp))
        low = (front - 0.45, side * half, height + 0.15)
        parts.append(box(low, (front - 0.3, side * (half + 0.22), height + 0.6), mirror))
    return merge(parts)


def _trailer(rng: Rng, kind: Numbers, towing: Bed) -> Mesh:
    """Return a trailer with two or three axles behind the bed that tows it."""
    half_length = rng.uniform(2.2, 4.0)
    bar = rng.uniform(0.9, 1.8)
    bed = Bed(half_length, towing.half_width, towing.floor, towing.skin)
    ends = [-half_length * 0.7, half_length * 0.7]
    parts = [
        box((-half_length, -0.4, 0.6), (half_length, 0.4, bed.floor), STEEL),
        tube([[half_length - 0.3, 0, 0.6], [half_length + bar, 0, 0.6]], 0.07, STEEL),
        *LOADS[kind.load](rng, bed),
        *wheels(TRUCK, ends, bed.half_width, 0.42, 0.3),
        *_rear(rng, bed),
    ]
    return merge(parts).moved((-towing.half_length - bar - half_length, 0, 0))


def _box(rng: Rng, bed: Bed) -> list[Mesh]:
    half_length, half_width, floor, skin = bed
    top = floor + rng.uniform(1.7, 2.6)
    parts = [box((-half_length, -half_width, floor), (half_length, half_width, top), skin)]
    for x in np.arange(-half_length, half_length, rng.uniform(0.6, 2.5)):
        low = (x, -half_width - 0.02, floor)
        high = (x + 0.05, half_width + 0.02, top)
        parts.append(box(low, high, STEEL))
    if rng.random() < 0.3:
        low = (half_length, -half_width * 0.8, top - 0.5)
        parts.append(box(low, (half_length + 0.6, half_width * 0.8, top), skin))
    return parts


def _flat(rng: Rng, bed: Bed) -> list[Mesh]:
    """Return a flatbed with low sides and a load."""
    half_length, half_width, floor, skin = bed
    top = floor + rng.uniform(0.3, 1.0)
    parts = [
        box((-half_length, -half_width, floor), (half_length, half_width, floor + 0.08), skin),
        box((-half_length, -half_width, floor), (half_length, -half_width + 0.05, top), skin),
        box((-half_length, half_width - 0.05, floor), (half_length, half_width, top), skin),
        box((-half_length, -half_width, floor), (-half_length + 0.05, half_width, top), skin),
        box((half_length - 0.05, -half_width, floor), (half_length, half_width, top + 0.5), skin),
    ]
    for _ in range(int(rng.integers(0, 7))):
        largest = np.minimum([1.6, 1.0], [1.8 * half_length, 1.8 * half_width])
        size = rng.uniform([0.5, 0.4, 0.3], [*largest, 1.4])
        x = rng.uniform(-half_length, half_length - size[0])
        y = rng.uniform(-half_width, half_width - size[1])
        piece = Skin.random(rng, TRUCK, Material.WOOD, 0.3, 1.2)
        parts.append(box((x, y, floor + 0.1), (x + size[0], y + size[1], floor + size[2]), piece))
    return parts


def _tub(rng: Rng, bed: Bed) -> list[Mesh]:
    """Return the tub of a tipper with sloping sides."""
    half_length, half_width, floor, skin = bed
    top = floor + rng.uniform(0.8, 1.6)
    foot = 0.8
    low = [[-half_length, -half_width * foot, floor], [half_length, -half_width * foot, floor]]
    low += [[half_length, half_width * foot, floor], [-half_length, half_width * foot, floor]]
    high = [[-half_length - 0.2, -half_width, top], [half_length + 0.2, -half_width, top + 0.2]]
    high += [[half_length + 0.2, half_width, top + 0.2], [-half_length - 0.2, half_width, top]]
    sides = [[low[i], low[i - 3], high[i - 3], high[i]] for i in range(4)]
    parts = [faces(np.array([low, *sides], float), skin)]
    for x in np.arange(-half_length, half_length, rng.uniform(0.5, 1.2)):
        parts.append(box((x, -half_width, floor + 0.1), (x + 0.08, half_width, top - 0.3), STEEL))
    return parts


def _tank(rng: Rng, bed: Bed) -> list[Mesh]:
    radius = float(min(bed.half_width, rng.uniform(0.8, 1.15)))
    x = bed.half_length
    z = bed.floor + radius
    path = [[-x, 0, z], [-x + 0.15, 0, z], [x - 0.15, 0, z], [x, 0, z]]
    parts = [tube(path, radius * np.array([0.4, 1, 1, 0.4]), bed.skin, 14)]
    parts.append(box((-x * 0.7, -0.3, z + radius), (x * 0.7, 0.3, z + radius + 0.15), STEEL))
    return parts


def _container(rng: Rng, bed: Bed) -> list[Mesh]:
    """Return a container with ribs, shorter than its bed or as long, on a bare frame."""
    half_width = bed.half_width
    floor = bed.floor
    skin = bed.skin
    half_length = bed.half_length * rng.uniform(0.55, 1.0)
    offset = rng.choice([-1.0, 0.0, 1.0]) * (bed.half_length - half_length)
    top = floor + rng.uniform(2.2, 2.7)
    inner = half_width - 0.05
    whole = box((-half_length, -inner, floor + 0.05), (half_length, inner, top), skin)
    parts = [whole]
    for x in np.arange(-half_length, half_length - 0.1, rng.uniform(0.25, 0.5)):
        rib = skin._replace(shade=skin.shade * 0.9)
        parts.append(box((x, -half_width, floor + 0.1), (x + 0.1, half_width, top - 0.1), rib))
    beams = box(
        (-bed.half_length, -half_width, floor - 0.15), (bed.half_length, half_width, floor), STEEL
    )
    return [merge(parts).moved((offset, 0, 0)), beams]


def _drum(rng: Rng, bed: Bed) -> list[Mesh]:
    """Return the tilted drum of a concrete mixer with its hopper and chute."""
    x = bed.half_length
    radius = min(1.15, bed.half_width)
    low = bed.floor + radius * 0.95
    high = bed.floor + radius * 1.35
    path = [[x * 0.95, 0, low], [x * 0.5, 0, low], [-x * 0.35, 0, high], [-x * 0.9, 0, high + 0.35]]
    drum = tube(path, radius * np.array([0.45, 1.0, 0.95, 0.4]), bed.skin, 14)
    hopper = box((-x, -0.45, high + 0.3), (-x * 0.75, 0.45, high + 0.9), STEEL)
    chute = tube([[-x, 0, high], [-x - 0.5, rng.uniform(-0.6, 0.6), 0.9]], 0.16, STEEL)
    post = box((-x * 0.95, -0.5, bed.floor), (-x * 0.8, 0.5, high), STEEL)
    return [drum, hopper, chute, post]


def _crane(rng: Rng, bed: Bed) -> list[Mesh]:
    """Return a flatbed with a folded crane behind the cab."""
    x = bed.half_length - 0.4
    floor = bed.floor
    elbow = [x - rng.uniform(0.3, 1.0), 0, floor + rng.uniform(2.0, 2.8)]
    tip = [x - rng.uniform(1.0, 2.2), 0, floor + rng.uniform(0.8, 1.6)]
    arm = [tube([[x, 0, floor], elbow], 0.16, bed.skin), tube([elbow, tip], 0.12, bed.skin)]
    return [*_flat(rng, bed), *arm]


def _rear(rng: Rng, bed: Bed) -> list[Mesh]:
    """Return bumper and reflectors, perhaps a ramp, up or down."""
    rear = -bed.half_length
    side = bed.half_width
    retro = Skin(TRUCK, Material.RETRO)
    parts = [box((rear - 0.02, -side, 0.42), (rear + 0.05, side, 0.52), STEEL)]
    for y in (-side + 0.1, side - 0.4):
        parts.append(box((rear - 0.03, y, 0.6), (rear + 0.01, y + 0.3, 0.75), retro))
    if rng.random() < 0.15:
        parts.append(box((rear - 0.12, -side, 0.5), (rear - 0.04, side, 2.1), STEEL))
    elif rng.random() < 0.08:
        low = [rear - 1.8, -side, 0.05]
        high = [rear, -side, bed.floor]
        ramp = np.array([[low, [low[0], side, 0.05], [rear, side, bed.floor], high]])
        parts.append(faces(ramp, STEEL))
    return parts


LOADS = {
    "box": _box, "flat": _flat, "tub": _tub, "tank": _tank,
    "container": _container, "drum": _drum, "crane": _crane,
}  # fmt: skip
"""What a bed carries."""
