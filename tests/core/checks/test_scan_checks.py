# SPDX-License-Identifier: MIT
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scans import SMALL, make_scan, refused

from salsanext_cli import Scan, project
from salsanext_cli.core.checks.scan_checks import OTHER_SENSOR_HINT, check_scan
from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.fitting.field_of_view import fit_view
from salsanext_cli.core.geometry.intensity import NO_INTENSITY, intensity_quantiles
from salsanext_cli.core.sensors.sensor import INTENSITY_LEVELS
from salsanext_cli.io.formats import SCAN_SUFFIXES, read_scan
from salsanext_cli.io.sensors import sensor

QUANTILES = tuple(np.linspace(0, 1, INTENSITY_LEVELS))
TRAINED = replace(SMALL, intensity_quantiles=QUANTILES)
STREET = make_scan(4000)
LEVEL = np.abs(STREET.points[:, 2]) < 0.01 * np.linalg.norm(STREET.points, axis=1)
NARROW = STREET.points[:, 0] > 8 * np.abs(STREET.points[:, 1])
AHEAD = STREET.points[:, 0] > np.abs(STREET.points[:, 1])


def codes(scan, of=SMALL, trained=TRAINED):
    return [f.code for f in check_scan(Path("s.bin"), scan, of, trained).findings]


def moved(scale=1.0, turn=(1, 1, 1), shift=(0, 0, 0)):
    points = STREET.points * np.float32(scale) * np.float32(turn) + np.float32(shift)
    return Scan(points, STREET.intensity)


def leaning(degrees):
    cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turn = np.array([[cosine, 0, -sine], [0, 1, 0], [sine, 0, cosine]], np.float32)
    return Scan(STREET.points @ turn, STREET.intensity)


def mostly_missing():
    points = np.concatenate([STREET.points, np.zeros((3 * len(STREET), 3), np.float32)])
    return Scan(points, np.tile(STREET.intensity, 4))


def test_wrong_fields_of_view_are_findings_that_a_fit_corrects():
    assert codes(STREET) == []
    assert codes(STREET, trained=None) == []
    assert codes(STREET, replace(SMALL, fov_up=-8.0)) == ["out-of-view"]
    assert codes(STREET, replace(SMALL, fov_up=75.0, fov_down=-75.0)) == ["sparse"]
    named = replace(SMALL, name="mine", fov_up=-8.0)
    assert hints(STREET, named)["out-of-view"] == 'sensor="auto"'
    assert codes(STREET, fit_view([STREET], TRAINED)) == []
    plain = replace(SMALL, fov_up=-8.0)
    assert "inspect SCANS with fit=" in hints(STREET, plain, plain)["out-of-view"]
    assert codes(STREET, fit_view([STREET], plain)) == []


def unmeasured(value):
    return Scan(np.full((500, 3), value, np.float32), np.zeros(500, np.float32))


@pytest.mark.parametrize(
    "scan",
    [
        *(moved(scale) for scale in (1000, 100, 0.001)),
        moved(shift=(467_000, 5_890_000, 30)),
        *map(unmeasured, (np.nan, np.inf, 0.0)),
    ],
)
def test_other_units_and_scans_without_measurements_are_an_error(scan):
    refused(FormatError, "s.bin", codes, scan)


def test_doubtful_scans():
    for scan, code in (
        (moved(turn=(1, -1, -1)), "upside-down"),
        (Scan(STREET.points[:, [0, 2, 1]], STREET.intensity), "tilted"),
        (moved(shift=(0, 0, 1.2)), "height"),
        (leaning(12), "tilted"),
        (moved(scale=30), "units"),
        (Scan(STREET.points[LEVEL], STREET.intensity[LEVEL]), "sparse"),
        (mostly_missing(), "not-measured"),
        (moved(scale=0.4), "indoor"),
        (Scan(STREET.points[NARROW], STREET.intensity[NARROW]), "few-directions"),
        (Scan(STREET.points[AHEAD], STREET.intensity[AHEAD]), "part-of-circle"),
        (Scan(STREET.points, np.zeros_like(STREET.intensity)), "no-intensity"),
        (Scan(STREET.points, np.linalg.norm(STREET.points, axis=1)), "no-intensity"),
        (Scan(STREET.points, np.full_like(STREET.intensity, np.nan)), "no-intensity"),
        (Scan(STREET.points, STREET.intensity * 255), "intensity-scale"),
        (Scan(STREET.points, STREET.intensity / 80), "intensity-scale"),
    ):
        assert code in codes(scan)


FITTED = replace(SMALL, name="fitted")


def hints(scan, of, trained=TRAINED):
    return {f.code: f.hint for f in check_scan(Path("s.bin"), scan, of, trained).findings}


@pytest.mark.parametrize("of", [FITTED, replace(TRAINED, min_range=1.0)])
@pytest.mark.parametrize("degrees", [12, 25])
def test_an_odd_scan_of_a_run_needs_a_separate_run(of, degrees):
    """Nothing that `inspect --fit` writes would, since the others are as fitted."""
    odd = leaning(degrees)
    assert hints(odd, of)["tilted"] == OTHER_SENSOR_HINT
    assert codes(odd, fit_view([odd], TRAINED)) == []


def test_an_origin_in_a_sensor_file_corrects_the_height():
    odd = moved(shift=(0, 0, 1.2))
    found = fit_view([odd], TRAINED)
    assert "`origin = [" in hints(odd, found)["height"]
    assert "height" not in codes(odd, replace(found, origin=(0.0, 0.0, 1.2)))
    image, expected = project(odd, replace(SMALL, origin=(0.0, 0.0, 1.2))), project(STREET, SMALL)
    assert (image.pixel_of_point == expected.pixel_of_point).mean() > 0.99


def test_no_hint_names_an_option_that_weights_refuse():
    decibels = Scan(STREET.points, -40 * STREET.intensity - 1)
    assert 'intensity="auto"' not in hints(decibels, SMALL, SMALL)["intensity-scale"]
    assert 'intensity="auto"' in hints(decibels, SMALL)["intensity-scale"]
    matched = replace(SMALL, intensity_quantiles=tuple(255 * q for q in QUANTILES))
    assert "intensity_scale" not in hints(STREET, matched)["intensity-scale"]


def test_matched_intensities_are_compared_with_the_fitted_scans():
    bright = Scan(STREET.points, STREET.intensity * 255)
    matched = replace(SMALL, intensity_quantiles=tuple(255 * q for q in QUANTILES))
    assert codes(bright, matched) == []
    assert codes(STREET, matched) == ["intensity-scale"]
    assert codes(STREET, replace(SMALL, intensity_quantiles=NO_INTENSITY)) == []
    decibels = Scan(STREET.points, -40 * STREET.intensity - 1)
    negative = replace(SMALL, intensity_quantiles=tuple(-41 + 40 * q for q in QUANTILES))
    assert codes(decibels, negative) == []
    assert codes(decibels, trained=SMALL) == ["intensity-scale"]
    assert codes(bright, trained=None) == []
    # Matched with scans of another scale, as in a folder that holds their results.
    assert codes(bright, TRAINED) == codes(bright, trained=SMALL) == ["intensity-scale"]
    assert codes(STREET, trained=SMALL) == []


@pytest.mark.parametrize("rows", [32, 64, 128])
@pytest.mark.parametrize("by_column", [False, True])
def test_the_order_of_the_points_does_not_matter(rows, by_column):
    """Of a grid of beams and azimuths, every n-th point may be one beam."""
    beams, azimuths = np.radians(np.linspace(3, -25, rows)), np.linspace(-np.pi, np.pi, 1024)
    elevation, azimuth = np.meshgrid(beams, azimuths, indexing="xy" if by_column else "ij")
    distance = np.minimum(20, -1.7 / np.minimum(np.sin(elevation), -1e-3))
    flat = distance * np.cos(elevation)
    xyz = (flat * np.cos(azimuth), flat * np.sin(azimuth), distance * np.sin(elevation))
    points = np.stack(xyz, axis=-1).reshape(-1, 3).astype(np.float32)
    scan = Scan(points, np.random.default_rng(0).random(len(points), np.float32))
    assert codes(scan) == []
    assert codes(scan, replace(SMALL, fov_up=-4.0)) == ["out-of-view"]
    assert codes(scan, replace(SMALL, fov_up=-1.5)) == []


def test_few_measurements_among_many_points_are_checked():
    """A sample of all points would hold hardly one of them."""
    scan = moved(turn=(1, -1, -1))
    points = np.zeros((1_000_000, 3), np.float32)
    points[:: len(points) // len(scan)][: len(scan)] = scan.points
    intensity = np.random.default_rng(0).random(len(points), np.float32)
    assert codes(Scan(points, intensity)) == ["not-measured", *codes(scan)]
    points[:] = np.nan
    with pytest.raises(FormatError, match="1000000 points"):
        codes(Scan(points, intensity))


@pytest.mark.parametrize("count", [0, 1, 99])
def test_few_points_are_a_finding(count):
    assert codes(make_scan(count)) == ["few-points"]


KNOWN = {"livox_front": ["part-of-circle", "height"], "beams128_binary_compressed": ["accumulated"]}
"""Scans of the real ones that are doubted with reason: of a sensor that is no car's, and of one
that is 2.5 m behind the origin of its files."""


@pytest.mark.slow
@pytest.mark.real
def test_real_scans_have_no_finding_without_reason(real_data):
    folders = ("semantickitti", "pandaset", "sensors")
    names = [p for f in folders for p in sorted((real_data / "data" / f).rglob("*.*"))]
    scans = [p for p in names if p.name.endswith(SCAN_SUFFIXES) and "five_columns_h" not in p.name]
    trained = replace(sensor("hdl64-512"), intensity_quantiles=QUANTILES)
    found = {}
    for path in scans:
        scan = read_scan(path)
        if path.suffix == ".las":
            with pytest.raises(FormatError, match="as in a survey"):
                codes(scan)
            continue
        if path.suffix == ".pcd":
            assert 10 < np.nanmax(np.linalg.norm(scan.points, axis=1)) < 300
        fitted = fit_view([scan], trained)
        quantiles = intensity_quantiles([project(scan, fitted).channels])
        fitted = replace(fitted, intensity_quantiles=quantiles)
        if set(of_scan := codes(scan, fitted, trained)) - {"no-intensity"}:
            found[path.stem] = of_scan
    assert {name: codes_ for name, codes_ in found.items() if KNOWN.get(name) != codes_} == {}
    assert len(scans) > 50
