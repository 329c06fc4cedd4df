# SPDX-License-Identifier: MIT
"""Values that a sensor may have."""

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

from salsanext_cli.errors import shortened
from salsanext_cli.files.yaml_toml import are_numbers

MAX_PIXELS = 1 << 21
"""Largest range image, in pixels: 64×32768, eight times that of the finest sensor."""
BYTES_PER_PIXEL = 1000
"""Approximate memory of a network per pixel."""
MAX_NUMBER = 1e6
"""Bound of means, deviations and scales, in metres and units of intensity, and of their inverse."""
SCALES = f"numbers from {1 / MAX_NUMBER:g} to {MAX_NUMBER:g}"
NOISE = ("range_noise", "intensity_noise")
MIN_LENGTH = 1e-3
"""Least length of a vector that tells a direction."""
INTENSITY_LEVELS = 65
"""Quantiles of intensity, evenly spaced from the smallest to the largest value."""
POSSIBLE = "a possible sensor"
BOX_EXPECTED = "six numbers in metres, the least x, y, z and then the largest, or none"
MAX_BEAMS = 256
BEAMS_EXPECTED = f"2 to {MAX_BEAMS} elevations in degrees that fall from 90 to -90"
MAX_COLUMNS = 64
COLUMNS_EXPECTED = (
    f"up to {MAX_COLUMNS} different names in lower case, with x, y and z, "
    "such as x,y,z,intensity,ring"
)
UNUSED_COLUMN = "_"
"""Name of a column that means nothing; the only one that may occur more than once."""


def are_beams(elevations: tuple[float, ...]) -> bool:
    """Say whether numbers can be the elevations of beams in degrees, top first; none can."""
    if not isinstance(elevations, tuple) or not are_numbers(elevations):
        return False
    fall = all(upper > lower for upper, lower in pairwise((90.1, *elevations, -90.1)))
    return not elevations or (fall and 2 <= len(elevations) <= MAX_BEAMS)


def are_columns(names: tuple[str, ...]) -> bool:
    """Say whether names can be those of the columns of a table of points."""
    if not isinstance(names, tuple) or not all(isinstance(name, str) for name in names):
        return False
    used = [name for name in names if name != UNUSED_COLUMN]
    complete = not names or {"x", "y", "z"} <= set(used)
    plain = all(name == name.lower().strip() and name for name in names)
    return complete and plain and len(set(used)) == len(used) and len(names) <= MAX_COLUMNS


def is_box(values: Sequence[float]) -> bool:
    """Return whether these are the least and the largest coordinates of a box, or nothing."""
    lowest, highest = values[:3], values[3:]
    pairs = zip(lowest, highest, strict=False)
    return len(values) in (0, 6) and all(-MAX_NUMBER <= a < b <= MAX_NUMBER for a, b in pairs)


def faults(sensor: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield what was found and what was expected of each impossible field of a `Sensor`.

    Only the first is meaningful: later ones take earlier values to be right.
    """
    shown = {key: shortened(value) for key, value in sensor.items()}
    if not isinstance(sensor["name"], str):
        yield "a name that is no text", POSSIBLE
    up, down, height, width = (sensor[key] for key in ("fov_up", "fov_down", "height", "width"))
    if not (math.isfinite(up) and math.isfinite(down)):
        yield "fov not finite", POSSIBLE
    if not up > down:
        yield f"fov_up {shown['fov_up']} ≤ fov_down {shown['fov_down']}", POSSIBLE
    size = f"size {shown['height']}×{shown['width']}"
    if not all(type(length) is int and length >= 1 for length in (height, width)):
        yield size, POSSIBLE
    if height * width > MAX_PIXELS:
        memory = f"{shortened(height * width * BYTES_PER_PIXEL // 10**9, 12)} GB"
        found = f"{size}, of which an image takes {memory} in a network"
        yield found, f"at most {MAX_PIXELS} pixels, such as 64×{MAX_PIXELS // 64}"
    if not len(sensor["means"]) == len(sensor["stds"]) == 5:
        yield "means and stds are not 5 numbers each", POSSIBLE
    if not all(abs(mean) <= MAX_NUMBER for mean in sensor["means"]):
        yield f"means {shown['means']}", f"numbers up to {MAX_NUMBER:g}"
    if not all(1 / MAX_NUMBER <= std <= MAX_NUMBER for std in sensor["stds"]):
        yield f"stds {shown['stds']}", SCALES
    if sensor["out_of_view"] not in ("clamp", "drop"):
        yield f"out_of_view {shown['out_of_view']}", POSSIBLE
    if not 1 / MAX_NUMBER <= sensor["intensity_scale"] <= MAX_NUMBER:
        yield f"intensity_scale {shown['intensity_scale']}", SCALES
    if not (len(sensor["up"]) == 3 and MIN_LENGTH < math.hypot(*sensor["up"]) < math.inf):
        yield f"up {shown['up']}", "a direction, three numbers"
    if not (len(sensor["origin"]) == 3 and math.hypot(*sensor["origin"]) < MAX_NUMBER):
        yield f"origin {shown['origin']}", "a place, three numbers in metres"
    quantiles = sensor["intensity_quantiles"]
    rise = list(quantiles) == sorted(quantiles)
    bounded = all(abs(value) <= MAX_NUMBER for value in quantiles)
    if not (len(quantiles) in (0, INTENSITY_LEVELS) and rise and bounded):
        expected = f"{INTENSITY_LEVELS} numbers that rise, up to {MAX_NUMBER:g}"
        yield f"intensity_quantiles {shown['intensity_quantiles']}", expected
    for name in NOISE:
        if not (sensor[name] is None or 0 <= sensor[name] < math.inf):
            yield f"{name} {shown[name]}", POSSIBLE
    if not are_columns(sensor["columns"]):
        yield f"columns {shown['columns']}", COLUMNS_EXPECTED
    if not are_beams(sensor["beams"]):
        yield f"beams {shown['beams']}", BEAMS_EXPECTED
    if not 0 <= (sensor["row_gaps"] or 0) <= 1:
        yield f"row_gaps {shown['row_gaps']}", "a share"
    if not 0 <= (sensor["min_range"] or 0) <= MAX_NUMBER:
        yield f"min_range {shown['min_range']}", "a range in metres"
    if not is_box(sensor["ego_box"] or ()):
        yield f"ego_box {shown['ego_box']}", BOX_EXPECTED
