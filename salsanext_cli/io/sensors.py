# SPDX-License-Identifier: MIT
"""Sensors by name: presets and TOML files."""

from __future__ import annotations

from pathlib import Path

from salsanext_cli.core.sensors.sensor import FIELD_OF_VIEW, NOISE, OF_IMAGES, Sensor, presets
from salsanext_cli.io.files.yaml_toml import read_toml


def sensor(name_or_file: str | Path, base: Sensor | None = None) -> Sensor:
    """Return a sensor by name or file.

    Parameters
    ----------
    name_or_file : str or Path
        Name of a preset, or TOML file with the keys of a sensor.
    base : Sensor, optional
        Sensor whose size and normalisation are the defaults of a file, and also its field of view
        and noise if the file states no edge; None for the size and normalisation of the HDL-64.

    Returns
    -------
    Sensor

    Raises
    ------
    UsageError
        If there is no such preset or file, or the file does not describe a sensor.
    """
    if str(name_or_file) in presets():
        return presets()[str(name_or_file)]
    path = Path(name_or_file)
    data = read_toml(path, "sensor", presets() if base is None else ("auto", *presets()))
    base_values = (base or presets()["hdl64"]).to_dict()
    defaults = {key: base_values[key] for key in OF_IMAGES}
    if base is not None and data.keys().isdisjoint(FIELD_OF_VIEW):
        optional = FIELD_OF_VIEW + NOISE
        defaults |= {key: base_values[key] for key in optional if key in base_values}
    return Sensor.from_dict({"name": path.stem, **defaults, **data}, path, is_file=True)
