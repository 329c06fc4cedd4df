# SPDX-License-Identifier: MIT
"""Colours of the points of a cloud, by class or by value."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes import LabelSpace
from salsanext_cli.report.colours import COLOUR_MAP, error_colours, value_colours
from salsanext_cli.storage.scan_results import UNCERTAINTY, ScanResults

CLASS_COLOURS = ("label", "truth", "error")
COLOURS = (*CLASS_COLOURS, "intensity", "range", "uncertainty", *UNCERTAINTY)
"""Colourings of points; "uncertainty" is the total, else the epistemic."""


@dataclass(frozen=True, slots=True)
class PointColours:
    """Colouring of points, the same for all scans of a run.

    Attributes
    ----------
    colour : str
        One of `COLOURS`, "uncertainty" aside.
    scale : pair of float
        Values at the ends of the colour map, for colours that are values.
    space : LabelSpace
        Colours of the classes.
    """

    colour: str
    scale: tuple[float, float]
    space: LabelSpace

    @property
    def is_class(self) -> bool:
        """True if points are coloured by class, without a scale."""
        return self.colour in CLASS_COLOURS

    @property
    def legend(self) -> str:
        """One line with the meaning of the colours."""
        low, high = self.scale
        return self.colour if self.is_class else f"{self.colour} {COLOUR_MAP} {low:.6g} {high:.6g}"

    def of_points(
        self, results: ScanResults, columns: Mapping[str, npt.NDArray[Any]]
    ) -> npt.NDArray[np.uint8]:
        """Return red, green and blue of every point, (N, 3), from its `scalar_columns`."""
        if not self.is_class:
            return value_colours(columns[self.colour], *self.scale)
        ids = {
            name: self.space.to_train(raw, strict=False)
            for name, raw in (("label", results.label), ("truth", results.truth))
            if raw is not None
        }
        if self.colour == "error":
            return error_colours(ids["truth"], ids["label"], self.space)
        colours: npt.NDArray[np.uint8] = self.space.colours[ids[self.colour]]
        return colours
