# SPDX-License-Identifier: MIT
"""Vehicles: cars, buses, trucks, caravans, trailers, tractors, excavators."""

from typing import NamedTuple

import numpy as np

from salsanext_cli.synthesis import presets
from salsanext_cli.synthesis.mesh import Array, Mesh, Rng, Skin, box, disc, faces, loft, merge, tube
from salsanext_cli.synthesis.presets import BUS, CAR, OTHER_VEHICLE, TRUCK, Material, Numbers

STEEL = Skin(TRUCK, Material.METAL, 0.5)
IRON = Skin(OTHER_VEHICLE, Material.METAL, 0.6)


def vehicle(rng: Rng) -> Mesh:
    """Return a car, truck, bus or other vehicle with the frequencies of the presets."""
    makers = {"car": car, "truck": truck, "bus": bus, "other": other_vehicle}
    return makers[presets.weighted_choice(rng, presets.TRAFFIC)](rng)


def length_of(mesh: Mesh) -> float:
    """Return the length of a vehicle in its own frame, metres."""
    return float(np.ptp(mesh.vertices[:, 0]))


def dark_paint(rng: Rng, label: int) -> Skin:
    """Draw the paint of a vehicle, mostly dark in the infrared."""
    bounds = ((0.0, 0.09), (0.1, 0.5), (0.5, 1.0), (1.0, 1.6))
    return Skin.random(rng, label, Material.PAINT, *bounds[rng.choice(4, p=(0.6, 0.14, 0.16, 0.1))])


def _body(body: Numbers, paint: Skin, stretch: Array) -> Mesh:
    """Return a body without wheels: cross-sections from front to rear, and windows."""
    profile = body.profile
    x = (0.5 - profile[:, 0]) * body.length
    half = body.width / 2 * np.where(profile[:, 0] % 1.0 == 0, 0.86, 1.0)
    belt, roof, top = profile[:, 1], profile[:, 2], half * profile[:, 3]
    sill = np.full(len(x), body.bottom)
    middle = (sill + belt) / 2
    y = np.stack([-half * 0.94, -half, -half * 0.96, -top, top, half * 0.96, half, half * 0.94], -1)
    z = np.stack([sill, middle, belt, roof, roof, belt, middle, sill], -1)
    sections = np.stack([np.broadcast_to(x[:, None], y.shape), y, z], -1)
    shell = loft(sections, paint)
    windows = np.zeros((len(x) - 1, y.shape[1]), bool)
    windows[np.ix_(body.cabin, (2, 4))] = windows[np.ix_(body.screens, (2, 3, 4))] = True
    glass = np.tile(windows.ravel(), 2)
    shell.materials[glass], shell.shades[glass] = Material.GLASS, 0.8
    return merge([shell, faces(sections[[0, -1]], paint)]).scaled(stretch)


def _wheels(label: int, axles: list[float], track: float, radius: float, wide: float) -> list[Mesh]:
    """Return wheels at both ends of axles: a tyre with a rim on its outside."""
    tyre, rim = Skin(label, Material.RUBBER), Skin(label, Material.METAL, 0.9)
    parts = []
    for x in axles:
        for side in (-1, 1):
            inner, outer = side * (track - wide), side * track
            parts.append(tube([[x, inner, radius], [x, outer, radius]], radius, tyre, 14))
            parts.append(disc((x, outer - side * 0.02, radius), radius * 0.97, tyre))
            parts.append(disc((x, outer + side * 0.01, radius), radius * 0.66, rim))
    return parts


def _fittings(body: Numbers, label: int, stretch: Array) -> list[Mesh]:
    lamp, retro = Skin(label, Material.LAMP), Skin(label, Material.RETRO)
    mirror = Skin(label, Material.PAINT, 0.4)
    front, rear = body.length / 2 * stretch[0], -body.length / 2 * stretch[0]
    half, height = body.width / 2 * stretch[1], body.profile[1, 1] * stretch[2]
    parts = [
        box((front - 0.02, -0.26, 0.38), (front + 0.015, 0.26, 0.49), retro),
        box((rear - 0.015, -0.26, 0.62), (rear + 0.02, 0.26, 0.73), retro),
    ]
    for side in (-1, 1):
        x, a, b, c = body.length * 0.16, side * (half - 0.36), side * (half - 0.1), side * half
        parts += [
            box((front - 0.3, a, height - 0.16), (front - 0.02, b, height), lamp),
            box((rear - 0.01, a, height + 0.05), (rear + 0.2, b, height + 0.2), lamp),
            box((rear - 0.02, a, 0.45), (rear + 0.02, b, 0.5), retro),
            box((x, c, height + 0.2), (x + 0.12, side * (half + 0.16), height + 0.36), mirror),
        ]
    return parts


def car(rng: Rng) -> Mesh:
    """Return a car of one of several shapes, sizes and paints."""
    body = presets.CARS[rng.integers(len(presets.CARS))]
    stretch = rng.uniform([0.93, 0.96, 0.96], [1.07, 1.03, 1.05])
    track = (body.width / 2 + 0.005) * stretch[1]
    axles = [0.31 * body.length * stretch[0], -0.30 * body.length * stretch[0]]
    parts = [
        _body(body, dark_paint(rng, CAR), stretch),
        *_wheels(CAR, axles, track, body.wheel, 0.2),
        *_fittings(body, CAR, stretch),
    ]
    floor = Skin(CAR, Material.RUBBER)
    reach = body.length * 0.45
    parts.append(box((-reach, -0.7, body.bottom - 0.04), (reach, 0.7, body.bottom + 0.1), floor))
    if rng.random() < 0.15:
        top = body.profile[:, 2].max() * stretch[2]
        parts.append(box((-0.9, -0.5, top + 0.05), (0.8, 0.5, top + 0.3), floor))
    return merge(parts)


def bus(rng: Rng) -> Mesh:
    """Return a bus, from a minibus to one of 12 m and more."""
    shape = presets.BUS_BODY
    stretch = rng.uniform([0.55, 0.88, 0.85], [1.1, 1.02, 1.08])
    length, width = shape.length * stretch[0], shape.width * stretch[1]
    dark = rng.random() < 0.5
    paint = dark_paint(rng, BUS) if dark else Skin.random(rng, BUS, Material.PAINT, 0.3, 1.6)
    parts = [_body(shape, paint, stretch), *_fittings(shape, BUS, stretch)]
    parts += _wheels(BUS, [0.28 * length, -0.26 * length], width / 2, shape.wheel, 0.3)
    top = shape.profile[:, 2].max() * stretch[2]
    if rng.random() < 0.6:
        parts.append(box((-length / 4, -0.7, top), (length / 5, 0.7, top + 0.3), paint))
    for x in np.arange(-0.4, 0.4, rng.uniform(0.1, 0.16)) * length:
        low, high = (x, -width / 2, 1.2 * stretch[2]), (x + 0.12, width / 2, top - 0.1)
        parts.append(box(low, high, paint))
    return merge(parts)


class Bed(NamedTuple):
    """Half length, half width and height of the floor behind a cab, metres; skin of the load."""

    half_length: float
    half_width: float
    floor: float
    skin: Skin


def truck(rng: Rng) -> Mesh:
    """Return a truck of one of the kinds in the presets."""
    shares = {name: kind.share for name, kind in presets.TRUCKS.items()}
    kind = presets.TRUCKS[presets.weighted_choice(rng, shares)]
    cab = kind.cab
    stretch = rng.uniform([0.85, 0.88, 0.85], [1.1, 1.08, 1.15])
    material = (Material.PLASTER, Material.PAINT, Material.METAL)[rng.integers(3)]
    load = Skin.random(rng, TRUCK, material, 0.5, 1.8)
    half_length, half_width = rng.uniform(*kind.bed) / 2, cab.width * 0.49 * stretch[1]
    bed = Bed(half_length, half_width, rng.uniform(*kind.floor), load)
    cab_length, gap = cab.length * stretch[0], rng.uniform(*kind.gap)
    paint = dark_paint(rng, TRUCK)
    body = _body(cab, paint._replace(shade=paint.shade + 0.1), stretch)
    parts = [body.moved((half_length + cab_length / 2 + gap, 0, 0))]
    parts.append(box((-half_length, -0.4, 0.5), (half_length + cab_length, 0.4, bed.floor), STEEL))
    loads = {"box": _box, "flat": _flat, "tub": _tub, "tank": _tank}
    parts += loads[kind.load](rng, bed)
    rear_axle = -half_length * 0.62
    axles = [half_length + gap + cab_length * 0.55, rear_axle]
    if half_length > 3:
        axles += [rear_axle + 1.15, rear_axle - 1.15]
    parts += _wheels(TRUCK, axles, half_width, cab.wheel, 0.35)
    parts += _rear(rng, bed)
    return merge(parts).moved((-(cab_length + gap) / 2, 0, 0))


def _box(rng: Rng, bed: Bed) -> list[Mesh]:
    half_length, half_width, floor, skin = bed
    top = floor + rng.uniform(1.7, 2.6)
    parts = [box((-half_length, -half_width, floor), (half_length, half_width, top), skin)]
    for x in np.arange(-half_length, half_length, rng.uniform(0.6, 2.5)):
        low, high = (x, -half_width - 0.02, floor), (x + 0.05, half_width + 0.02, top)
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
    top, foot = floor + rng.uniform(0.8, 1.6), 0.8
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
    x, z = bed.half_length, bed.floor + radius
    path = [[-x, 0, z], [-x + 0.15, 0, z], [x - 0.15, 0, z], [x, 0, z]]
    parts = [tube(path, radius * np.array([0.4, 1, 1, 0.4]), bed.skin, 14)]
    parts.append(box((-x * 0.7, -0.3, z + radius), (x * 0.7, 0.3, z + radius + 0.15), STEEL))
    return parts


def _rear(rng: Rng, bed: Bed) -> list[Mesh]:
    """Return bumper and reflectors, perhaps a ramp, up or down."""
    rear, side = -bed.half_length, bed.half_width
    retro = Skin(TRUCK, Material.RETRO)
    parts = [box((rear - 0.02, -side, 0.42), (rear + 0.05, side, 0.52), STEEL)]
    for y in (-side + 0.1, side - 0.4):
        parts.append(box((rear - 0.03, y, 0.6), (rear + 0.01, y + 0.3, 0.75), retro))
    if rng.random() < 0.15:
        parts.append(box((rear - 0.12, -side, 0.5), (rear - 0.04, side, 2.1), STEEL))
    elif rng.random() < 0.08:
        low, high = [rear - 1.8, -side, 0.05], [rear, -side, bed.floor]
        ramp = np.array([[low, [low[0], side, 0.05], [rear, side, bed.floor], high]])
        parts.append(faces(ramp, STEEL))
    return parts


def _caravan(rng: Rng) -> Mesh:
    shape = presets.CARAVAN_BODY
    stretch = rng.uniform([0.7, 0.85, 0.8], [1.25, 1.08, 1.06])
    half = shape.width / 2 * stretch[1]
    front = shape.length / 2 * stretch[0]
    parts = [_body(shape, Skin.random(rng, OTHER_VEHICLE, Material.PAINT, 0.1, 1.6), stretch)]
    parts += _wheels(OTHER_VEHICLE, [rng.uniform(-0.5, 0.2)], half, shape.wheel, 0.2)
    return merge([*parts, *_drawbar(front)])


def _drawbar(front: float) -> list[Mesh]:
    bar = tube([[front - 0.3, 0, 0.45], [front + 1.2, 0, 0.42]], 0.05, IRON)
    return [bar, tube([[front + 1.0, 0, 0.0], [front + 1.0, 0, 0.5]], 0.04, IRON)]


def _trailer(rng: Rng) -> Mesh:
    """Return a small trailer: open, with a tarpaulin, or a closed box."""
    x, y, floor = rng.uniform([0.9, 0.6, 0.45], [2.6, 1.05, 0.65])
    height = rng.choice([rng.uniform(0.3, 0.5), rng.uniform(0.8, 1.9)])
    material = Material.CLOTH if height > 0.6 else Material.METAL
    skin = Skin.random(rng, OTHER_VEHICLE, material, 0.2, 1.4)
    parts = [box((-x, -y, floor), (x, y, floor + height), skin)]
    parts += _wheels(OTHER_VEHICLE, [0.0, -0.7] if x > 2 else [0.0], y + 0.2, 0.3, 0.18)
    return merge([*parts, *_drawbar(float(x))])


def _tractor(rng: Rng) -> Mesh:
    paint = Skin.random(rng, OTHER_VEHICLE, Material.PAINT, 0.1, 1.4)
    glass = Skin(OTHER_VEHICLE, Material.GLASS)
    parts = [
        box((0.2, -0.4, 0.8), (2.0, 0.4, 1.55), paint),
        box((-1.0, -0.75, 0.9), (0.2, 0.75, 1.4), paint),
        box((-1.0, -0.7, 1.4), (0.2, 0.7, 2.5), glass),
        box((-1.1, -0.8, 2.5), (0.3, 0.8, 2.7), paint),
        *_wheels(OTHER_VEHICLE, [-0.7], 1.05, 0.8, 0.45),
        *_wheels(OTHER_VEHICLE, [1.5], 0.95, 0.55, 0.35),
        tube([[0.5, -0.45, 1.5], [0.5, -0.45, 2.7]], 0.05, IRON),
    ]
    for x, y in ((-1.0, -0.72), (-1.0, 0.66), (0.15, -0.72), (0.15, 0.66)):
        parts.append(box((x, y, 1.4), (x + 0.08, y + 0.08, 2.5), paint))
    return merge(parts).scaled(rng.uniform(0.8, 1.15))


def _excavator(rng: Rng) -> Mesh:
    paint = Skin.random(rng, OTHER_VEHICLE, Material.PAINT, 0.4, 1.5)
    tracks = Skin(OTHER_VEHICLE, Material.RUBBER)
    parts = [box((-1.6, y - 0.25, 0), (1.6, y + 0.25, 0.8), tracks) for y in (-0.95, 0.95)]
    upper = [
        box((-1.7, -1.2, 1.0), (0.9, 1.2, 1.9), paint),
        box((-0.3, 0.2, 1.9), (0.9, 1.15, 2.8), Skin(OTHER_VEHICLE, Material.GLASS)),
        box((-0.4, 0.15, 2.8), (1.0, 1.2, 2.9), paint),
    ]
    reach, lift = rng.uniform([2.2, 2.5], [3.6, 4.2])
    joint, tip = [reach, -0.3, lift], [reach + rng.uniform(0.6, 1.6), -0.3, rng.uniform(0.4, 1.5)]
    upper += [tube([[0.5, -0.3, 1.6], joint], 0.22, paint), tube([joint, tip], 0.17, paint)]
    upper.append(box(np.array(tip) - [0.5, 0.5, 0.4], np.array(tip) + [0.3, 0.5, 0.4], IRON))
    parts.append(merge(upper).moved(yaw=rng.uniform(-0.2, 0.2)))
    return merge(parts).scaled(rng.uniform(0.6, 1.1))


def other_vehicle(rng: Rng) -> Mesh:
    """Return a caravan, a trailer, a tractor or an excavator."""
    makers = (_caravan, _caravan, _trailer, _trailer, _tractor, _excavator)
    return makers[rng.integers(len(makers))](rng)
