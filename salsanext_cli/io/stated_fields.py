# SPDX-License-Identifier: MIT
"""What a sensor file states; a fit to scans estimates the rest."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from salsanext_cli.core.sensors.sensor import FIELD_OF_VIEW, presets
from salsanext_cli.io.files.yaml_toml import read_toml

MOUNTING = ("up", "origin", "registered")


@dataclass(frozen=True, slots=True)
class StatedFields:
    """Whether a sensor file states what a fit could estimate instead."""

    view: bool  # Field of view
    mounting: bool  # Direction up, or position of the sensor


def stated_fields(name_or_file: str | Path) -> StatedFields:
    """Return what a sensor states by its name, which is nothing, or by its file.

    Parameters
    ----------
    name_or_file : str or Path
        Name of a preset or "auto", or TOML file with keys of a sensor.

    Returns
    -------
    StatedFields

    Raises
    ------
    UsageError
        If there is no such preset or file, or the file is no TOML.
    """
    names = ("auto", *presets())
    if str(name_or_file) in names:
        return StatedFields(view=False, mounting=False)
    keys = read_toml(Path(name_or_file), "sensor", names).keys()
    return StatedFields(
        view=not keys.isdisjoint(FIELD_OF_VIEW), mounting=not keys.isdisjoint(MOUNTING)
    )
