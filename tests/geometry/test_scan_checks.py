# SPDX-License-Identifier: MIT
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scans import SMALL, make_scan

from salsanext_cli import Scan, project
from salsanext_cli.errors import FormatError
from salsanext_cli.formats import SCAN_SUFFIXES, read_scan
from salsanext_cli.geometry.coverage import field_of_view_coverage
from salsanext_cli.geometry.intensity import NO_INTENSITY, intensity_quantiles
from salsanext_cli.geometry.scan_checks import check_scan
from salsanext_cli.geometry.view_fit import fit_view
from salsanext_cli.sensors import INTENSITY_LEVELS, sensor

QUANTILES = tuple(np.linspace(0, 1, INTENSITY_LEVELS))
TRAINED = replace(SMALL, intensity_quantiles=QUANTILES)
STREET = make_scan(4000)
AHEAD = STREET.points[:, 0] > np.abs(STREET.points[:, 1])


def codes(scan, of=SMALL, trained=TRAINED):
    image, coverage = project(scan, of), field_of_view_coverage(scan, of)
    return [f.code for f in check_scan(Path("s.bin"), scan, image, of, coverage, trained)]


def moved(scale=1.0, turn=(1, 1, 1), shift=(0, 0, 0)):
    points = STREET.points * np.float32(scale) * np.float32(turn) + np.float32(shift)
    return Scan(points, STREET.intensity)


def test_a_right_scan_is_not_doubted():
    assert codes(STREET) == []
    assert codes(STREET, trained=None) == []


@pytest.mark.parametrize("scale", [1000, 100, 0.001])
def test_other_units_are_an_error(scale):
    with pytest.raises(FormatError, match=r"s\.bin · a median range of .* in metres"):
        codes(moved(scale))


def test_map_coordinates_are_an_error():
    with pytest.raises(FormatError, match="take the sensor's place off map coordinates"):
        codes(moved(shift=(467_000, 5_890_000, 30)))


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0])
def test_a_scan_without_a_measurement_is_an_error(value):
    points = np.full((500, 3), value, np.float32)
    with pytest.raises(FormatError, match="none of its 500 points is a measurement"):
        codes(Scan(points, np.zeros(500, np.float32)))


@pytest.mark.parametrize(
    ("scan", "code"),
    [
        (moved(turn=(1, -1, -1)), "upside-down"),
        (Scan(STREET.points[:, [0, 2, 1]], STREET.intensity), "tilted"),
        (moved(shift=(0, 0, 1.2)), "height"),
        (Scan(STREET.points[AHEAD], STREET.intensity[AHEAD]), "part-of-circle"),
        (Scan(STREET.points, np.zeros_like(STREET.intensity)), "no-intensity"),
        (Scan(STREET.points, np.linalg.norm(STREET.points, axis=1)), "no-intensity"),
        (Scan(STREET.points, np.full_like(STREET.intensity, np.nan)), "no-intensity"),
        (Scan(STREET.points, STREET.intensity * 255), "intensity-scale"),
        (Scan(STREET.points, STREET.intensity / 80), "intensity-scale"),
    ],
)
def test_what_is_doubtful(scan, code):
    assert code in codes(scan)


def test_points_out_of_view_are_doubtful():
    assert codes(STREET, replace(SMALL, fov_up=-8.0)) == ["out-of-view"]


def test_what_was_matched_is_of_no_doubt():
    bright = Scan(STREET.points, STREET.intensity * 255)
    own = replace(SMALL, intensity_quantiles=tuple(255 * value for value in QUANTILES))
    assert codes(bright, own) == []
    assert codes(bright, trained=None) == []
    # Matched with scans of another scale, as in a folder that holds their results.
    assert codes(bright, TRAINED) == codes(STREET, own) == ["intensity-scale"]
    assert codes(bright, replace(SMALL, intensity_quantiles=NO_INTENSITY)) == []
    assert codes(bright, trained=SMALL) == ["intensity-scale"]
    assert codes(STREET, trained=SMALL) == []


@pytest.mark.parametrize("count", [0, 1, 99])
def test_few_points_are_not_judged(count):
    assert codes(make_scan(count)) == []


KNOWN = {"livox_front": ["part-of-circle", "height"], "beams128_binary_compressed": ["height"]}
"""Scans of the real ones that are doubted with reason: of sensors that are no car's."""


@pytest.mark.real
def test_no_real_scan_is_doubted_without_reason(real_data):
    folders = ("semantickitti", "pandaset", "sensors")
    names = [p for f in folders for p in sorted((real_data / "data" / f).rglob("*.*"))]
    scans = [p for p in names if p.name.endswith(SCAN_SUFFIXES) and "five_columns_h" not in p.name]
    trained = replace(sensor("hdl64-512"), intensity_quantiles=QUANTILES)
    found = {}
    for path in scans[::3]:
        scan = read_scan(path)
        view = fit_view([scan], trained)
        quantiles = intensity_quantiles([project(scan, view).channels])
        own = replace(view, intensity_quantiles=quantiles)
        if set(told := codes(scan, own, trained)) - {"no-intensity"}:
            found[path.stem] = told
    assert found.items() <= KNOWN.items()
    assert len(scans) > 50
