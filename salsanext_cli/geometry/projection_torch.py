# SPDX-License-Identifier: MIT
"""Projection on a torch device by the steps of the compiled one, so that every bit is the same.

Divisors are tensors, because CUDA multiplies by the reciprocal of a number; and a product and the
sum it goes into are two operations, which no device fuses.
"""

import math

import numpy as np
import torch

from salsanext_cli.records import LARGEST, Int, RangeImage, Scan

PI = float(np.float32(math.pi))
NO_POINT = 2**63 - 1


def project(
    scan: Scan,
    fov_down: np.float32,
    fov: np.float32,
    height: int,
    width: int,
    drop: bool,
    rows: Int | None,
    device: str,
) -> RangeImage:
    """Project a scan on a device and copy the result back; see `projection.project`."""
    points = torch.tensor(scan.points, device=device)
    intensity = torch.tensor(scan.intensity, device=device)
    pixel_of_point, point_range = find_pixels(points, fov_down, fov, height, width, drop)
    if rows is not None:
        in_rows = torch.tensor(rows, device=device) * width + pixel_of_point % width
        pixel_of_point = torch.where(pixel_of_point < 0, -1, in_rows)
    point_of_pixel = find_nearest(pixel_of_point, point_range, height * width)
    usable = torch.where(intensity.abs() <= float(LARGEST), intensity, 0.0)
    columns = torch.cat([point_range[:, None], points, usable[:, None]], dim=1)
    nothing = columns.new_zeros(1, columns.shape[1])
    # Index -1, an empty pixel, finds the row of zeros at the end.
    channels = torch.cat([columns, nothing])[point_of_pixel].T.contiguous()
    return RangeImage(
        channels.reshape(-1, height, width).cpu().numpy(),
        pixel_of_point.cpu().numpy(),
        point_of_pixel.to(torch.int32).reshape(height, width).cpu().numpy(),
        point_range.cpu().numpy(),
    )


def arctan2(y: torch.Tensor, x: torch.Tensor) -> torch.Tensor:
    """Return atan2(y, x) of float64 tensors; see `projection.arctan2`."""
    steep = y.abs() > x.abs()
    small = torch.where(steep, x.abs(), y.abs())
    large = torch.where(steep, y.abs(), x.abs())
    turned = small > (math.sqrt(2) - 1) * large
    numerator = torch.where(turned, small - large, small)
    denominator = torch.where(turned, small + large, large)
    t = numerator / torch.where(denominator > 0, denominator, 1.0)
    q = t * t
    series = torch.full_like(q, 1 / 25)
    for n in range(23, 1, -2):
        series = q * series + (1 / n if n % 4 == 1 else -1 / n)
    # Of two plain numbers `where` would make float32.
    angle = t * (q * series + 1) + turned.double() * (math.pi / 4)
    angle = torch.where(steep, math.pi / 2 - angle, angle)
    angle = torch.where(torch.signbit(x), math.pi - angle, angle)
    return torch.copysign(angle, y)


def find_pixels(
    points: torch.Tensor,
    fov_down: np.float32,
    fov: np.float32,
    height: int,
    width: int,
    drop: bool,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return flat pixel index (N,) int32 and range (N,) float32 of each point (paper eq. 1)."""
    a, b, c = points.double().unbind(1)
    distance = (a * a + b * b + c * c).sqrt().float()
    slope = (points[:, 2] / distance).double()
    yaw = arctan2(b, a).float()
    pitch = arctan2(slope, ((1 - slope) * (1 + slope)).sqrt()).float()
    u = 0.5 * (1 - yaw / yaw.new_tensor(PI)) * width
    v = (1 - (pitch - float(fov_down)) / yaw.new_tensor(float(fov))) * height
    seen = (distance > 0) & (distance <= float(LARGEST))
    if drop:
        seen &= (v >= 0) & (v <= height)
    u = torch.where(seen & (u > 0), u, 0.0).clamp(max=width - 1).int()
    v = torch.where(seen & (v > 0), v, 0.0).clamp(max=height - 1).int()
    return torch.where(seen, v * width + u, -1), torch.where(seen, distance, 0.0)


def find_nearest(
    pixel_of_point: torch.Tensor, point_range: torch.Tensor, pixels: int
) -> torch.Tensor:
    """Return the nearest point of each pixel, the first of equally near ones; (pixels,) int64."""
    # One integer of range and index, whose minimum does not depend on the order of threads.
    index = torch.arange(len(point_range), device=point_range.device)
    key = (point_range.view(torch.int32).long() << 32) | index
    target = torch.where(pixel_of_point < 0, pixels, pixel_of_point).long()
    nearest = torch.full((pixels + 1,), NO_POINT, dtype=torch.int64, device=key.device)
    nearest = nearest.scatter_reduce(0, target, key, "amin")[:pixels]
    return torch.where(nearest == NO_POINT, -1, nearest & 0xFFFFFFFF)
