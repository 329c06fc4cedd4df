# SPDX-License-Identifier: MIT
"""Fixtures of output folders, whose tests ask nothing of the network."""

import pytest
from narrow import narrow, weights  # noqa: F401

from salsanext_cli import Scan
from salsanext_cli.core.geometry import sensor_place


@pytest.fixture
def places_found_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Find the place of the sensor of a scan once, for which each step of a run asks again."""
    find = sensor_place.find_place
    places: dict[tuple[bytes, bool], sensor_place.SensorPlace | None] = {}

    def find_once(scan: Scan, *, verified: bool = True) -> sensor_place.SensorPlace | None:
        key = scan.points.tobytes(), verified
        if key not in places:
            places[key] = find(scan, verified=verified)
        return places[key]

    monkeypatch.setattr(sensor_place, "find_place", find_once)
