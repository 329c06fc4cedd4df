# SPDX-License-Identifier: MIT
"""Difference of two colours as people see it: CIEDE2000.

Sharma, Wu and Dalal, The CIEDE2000 color-difference formula, Color Research & Application 30
(2005), 21.
"""

from typing import Any

import numpy as np
import numpy.typing as npt

Values = npt.NDArray[np.float64]

XYZ = np.array(
    [
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.0721750],
        [0.0193339, 0.1191920, 0.9503041],
    ]
)
"""From linear sRGB to CIE XYZ."""


def linear_rgb(colours: npt.NDArray[Any]) -> Values:
    """Return the light of sRGB values of 0 to 255, from 0 to 1."""
    share = colours / 255
    light: Values = np.where(share > 0.04045, ((share + 0.055) / 1.055) ** 2.4, share / 12.92)
    return light


def colour_difference(first: npt.NDArray[np.uint8], second: npt.NDArray[np.uint8]) -> Values:
    """Return the difference of sRGB colours, (…, 3) each, which are broadcast."""
    return lab_difference(lab_of(first), lab_of(second))


def lab_of(colours: npt.NDArray[np.uint8]) -> Values:
    """Return CIELAB coordinates of sRGB colours, under the white of sRGB."""
    xyz = linear_rgb(colours) @ XYZ.T / XYZ.sum(axis=1)
    root = np.where(xyz > (6 / 29) ** 3, np.cbrt(xyz), xyz * (29 / 6) ** 2 / 3 + 4 / 29)
    x, y, z = np.moveaxis(root, -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)


def lab_difference(first: Values, second: Values) -> Values:
    """Return the difference of CIELAB colours, (…, 3) each."""
    (l1, a1, b1), (l2, a2, b2) = np.moveaxis(first, -1, 0), np.moveaxis(second, -1, 0)
    stretch = 1.5 - _saturation((np.hypot(a1, b1) + np.hypot(a2, b2)) / 2) / 2
    c1, c2 = np.hypot(stretch * a1, b1), np.hypot(stretch * a2, b2)
    h1, h2 = np.arctan2(b1, stretch * a1), np.arctan2(b2, stretch * a2)
    coloured = c1 * c2 > 0
    turn = np.where(coloured, (h2 - h1 + np.pi) % (2 * np.pi) - np.pi, 0)
    hue = np.where(coloured, h1 + turn / 2, h1 + h2)
    lightness, chroma = (l1 + l2) / 2, (c1 + c2) / 2
    weight = (
        1
        - 0.17 * np.cos(hue - np.radians(30))
        + 0.24 * np.cos(2 * hue)
        + 0.32 * np.cos(3 * hue + np.radians(6))
        - 0.20 * np.cos(4 * hue - np.radians(63))
    )
    middle = (lightness - 50) ** 2
    lighter = (l2 - l1) / (1 + 0.015 * middle / np.sqrt(20 + middle))
    stronger = (c2 - c1) / (1 + 0.045 * chroma)
    turned = 2 * np.sqrt(c1 * c2) * np.sin(turn / 2) / (1 + 0.015 * chroma * weight)
    blue = np.exp(-(((np.degrees(hue) % 360 - 275) / 25) ** 2))
    rotation = -2 * _saturation(chroma) * np.sin(np.radians(60) * blue)
    squares = lighter**2 + stronger**2 + turned**2 + rotation * stronger * turned
    difference: Values = np.sqrt(squares)
    return difference


def _saturation(chroma: Values) -> Values:
    root: Values = np.sqrt(chroma**7 / (chroma**7 + 25.0**7))
    return root
