# SPDX-License-Identifier: MIT
"""Random numbers of a batch: of its scans and images on the host, of its points on the device.

The seed is that of the position in the training, so that a resumed training makes the same batches
on the same kind of device.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from salsanext_cli.core.engines.device_copies import device_numbers
from salsanext_cli.core.records import Mask


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class BatchRandom:
    """Generators of a batch.

    Attributes
    ----------
    host : Generator
        For a few numbers of each scan or image.
    points : torch.Generator
        For a number of each point or pixel, on the device.
    """

    host: np.random.Generator
    points: torch.Generator

    @classmethod
    def seeded(cls, seed: Sequence[int], device: torch.device) -> Self:
        """Return the generators of a batch, which depend on the seed and the kind of device."""
        host = np.random.default_rng(seed)
        points = torch.Generator(device)
        points.manual_seed(int(host.integers(2**63)))
        return cls(host=host, points=points)

    @property
    def device(self) -> torch.device:
        """Device of the points."""
        return self.points.device

    def happens(self, chance: float, count: int) -> Mask:
        """Decide by chance for each of a number of scans, (count,) bool."""
        return self.host.random(count) < chance

    def uniform(self, *shape: int) -> Tensor:
        """Return uniform numbers below 1 on the device, float32."""
        return torch.rand(shape, generator=self.points, device=self.device)

    def normal(self, *shape: int) -> Tensor:
        """Return standard normal numbers on the device, float32."""
        return torch.randn(shape, generator=self.points, device=self.device)

    def put(self, values: npt.ArrayLike, dtype: torch.dtype = torch.float32) -> Tensor:
        """Return numbers of the host on the device."""
        return device_numbers(values, self.device, dtype)
