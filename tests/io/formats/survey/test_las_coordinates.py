# SPDX-License-Identifier: MIT
"""Coordinate systems in records of LAS files."""

import logging
import re
import struct

import numpy as np
import pytest
from las_files import keys_record, size_records, text_record, write_las
from scans import make_scan, refused

from salsanext_cli import read_scan
from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.notices import log_once

pytest.importorskip("laspy")
SCAN = make_scan(100)
GEOGRAPHIC = (
    'GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.25]],UNIT["degree",0.0174]]'
)
GEOCENTRIC = 'GEOCCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.25]],UNIT["metre",1]]'
METRES = f'PROJCS["UTM 32N",{GEOGRAPHIC},UNIT["metre",1]]'
FEET = f'PROJCS["New York",{GEOGRAPHIC},UNIT["US survey foot",0.3048006096012192]]'
FEET_AND_METRES = f'COMPD_CS["a",{FEET},VERT_CS["b",VERT_DATUM["c",2005],UNIT["metre",1]]]'
LOCAL = 'LOCAL_CS["site",LOCAL_DATUM["site",32767],UNIT["foot",0.3048],AXIS["X",EAST]]'
PRETTY = """PROJCRS["NAD83 / Ohio North (ftUS)",
    BASEGEOGCRS["NAD83",ANGLEUNIT["degree",0.0174532925199433]],
    CONVERSION["x",PARAMETER["False easting",600000, LENGTHUNIT["metre",1]]],
    CS[Cartesian,2],
        AXIS["easting (X)",east, ORDER[1], LENGTHUNIT["US survey foot", 0.304800609601219]],
        AXIS["northing (Y)",north, ORDER[2], LENGTHUNIT["US survey foot", 0.304800609601219]],
    USAGE[AREA["Ohio"], BBOX[40.1,-84.81,42.33,-80.51]]]"""
LEVELLED = """ENGCRS["site",EDATUM["site"],CS[Cartesian,3],AXIS["x",east,LENGTHUNIT["foot",0.3048]],
    AXIS["y",north,LENGTHUNIT["foot",0.3048]],AXIS["z",up,LENGTHUNIT["metre",1]]]"""
GEOCENTRIC_2 = 'GEODCRS["WGS 84",CS[Cartesian,3],AXIS["X",geocentricX],LENGTHUNIT["metre",1]]'
US_FOOT = 1200 / 3937
MAX_X, MIN_X, MAX_Y = 179, 187, 195  # Positions of bounds in the header


@pytest.mark.parametrize(
    ("record", "problem"),
    [
        (lambda: keys_record((1024, 2), (2048, 4326)), "degrees"),
        (lambda: text_record(GEOGRAPHIC), "degrees"),
        (lambda: keys_record((1024, 3)), "centre of the earth"),
        (lambda: text_record(GEOCENTRIC), "centre of the earth"),
        (lambda: text_record(GEOCENTRIC_2), "centre of the earth"),
    ],
)
def test_degrees_and_geocentric_coordinates_are_refused(tmp_path, record, problem):
    path = write_las(tmp_path / "s.las", SCAN.points, records=[record()])
    assert problem in refused(FormatError, path, read_scan, path).value.problem


@pytest.mark.parametrize(
    ("record", "factors"),
    [
        (lambda: keys_record((1024, 1), (3076, 9001)), (1, 1, 1)),
        (lambda: text_record(METRES), (1, 1, 1)),
        (lambda: keys_record((1024, 1), (3076, 9002)), (0.3048, 0.3048, 0.3048)),
        (lambda: keys_record((1024, 1), (3076, 9003), (4099, 9001)), (US_FOOT, US_FOOT, 1)),
        (lambda: text_record(FEET), (US_FOOT, US_FOOT, US_FOOT)),
        (lambda: text_record(FEET_AND_METRES), (US_FOOT, US_FOOT, 1)),
        (lambda: text_record(PRETTY), (US_FOOT, US_FOOT, US_FOOT)),
        (lambda: text_record(LOCAL), (0.3048, 0.3048, 0.3048)),
        (lambda: text_record(LEVELLED), (0.3048, 0.3048, 1)),
        (lambda: keys_record((3076, 9005)), (0.3047972654, 0.3047972654, 0.3047972654)),
        (lambda: keys_record((3076, 0), (4099, 0)), (1, 1, 1)),
    ],
)
def test_feet_become_metres(tmp_path, record, factors):
    path = write_las(tmp_path / "s.las", SCAN.points, records=[record()])
    assert np.abs(read_scan(path).points - SCAN.points * factors).max() < 0.6e-3


def test_a_unit_without_a_code_has_its_size(tmp_path):
    path = write_las(tmp_path / "s.las", SCAN.points, records=size_records(0.25))
    assert np.abs(read_scan(path).points - SCAN.points / 4).max() < 0.6e-3


@pytest.mark.parametrize("compressed", [False, True])
def test_a_record_behind_the_points_states_the_unit(tmp_path, compressed):
    path = tmp_path / ("s.laz" if compressed else "s.las")
    write_las(path, SCAN.points, extended_records=[text_record(LOCAL)])
    assert np.abs(read_scan(path).points - SCAN.points * 0.3048).max() < 0.6e-3
    path.write_bytes(path.read_bytes()[:-1])
    assert "damaged or cut off" in refused(FormatError, path, read_scan, path).value.problem


@pytest.mark.parametrize(
    ("records", "unit"),
    [
        (lambda: [keys_record((3076, 9042))], "EPSG:9042"),
        (lambda: [keys_record((3076, 9001), (4099, 9042))], "EPSG:9042"),
        (lambda: [keys_record((3076, 32767))], "without a size"),
        (lambda: size_records(0.0), "0.0"),
        (lambda: size_records(float("nan")), "nan"),
        (lambda: [text_record('LOCAL_CS["site",UNIT["pace","long"]]')], "pace"),
        (lambda: [text_record('LOCAL_CS["site",UNIT["pace",-1]]')], "pace"),
        (lambda: [text_record('LOCAL_CS["site",UNIT["pace"]]')], "pace"),
    ],
)
def test_unknown_units_are_refused(tmp_path, records, unit):
    path = write_las(tmp_path / "s.las", SCAN.points, records=records())
    assert unit in refused(FormatError, path, read_scan, path).value.problem


@pytest.mark.parametrize(
    ("unit", "factors"),
    [((3076, 9036), ["1000", "1000"]), ((3076, 9003), ["0.3048006096", "0.3048006096"])],
)
def test_the_notice_has_the_factors(tmp_path, caplog, unit, factors):
    log_once.cache_clear()
    caplog.set_level(logging.INFO)
    read_scan(write_las(tmp_path / "s.las", SCAN.points / 1000, records=[keys_record(unit)]))
    (line,) = [line for line in caplog.messages if "converted to metres" in line]
    assert re.findall(r"by ([\d.]+)", line) == factors


@pytest.mark.parametrize("text", ['PROJCS["site A"]', 'LOCAL_CS["site A"]', 'VERT_CS["site A"]'])
def test_a_text_without_a_unit_is_read_as_metres_and_a_line_says_it(tmp_path, caplog, text):
    log_once.cache_clear()
    caplog.set_level(logging.INFO)
    path = write_las(tmp_path / "s.las", SCAN.points, records=[text_record(text)])
    assert np.abs(read_scan(path).points - SCAN.points).max() < 0.6e-3
    (line,) = [line for line in caplog.messages if "without a unit" in line]
    assert ("site A" in line) == ("VERT" not in text)


@pytest.mark.parametrize(
    ("keys", "factor"),
    [
        (((1024, 1), (3072, 2263), (3076, 9003)), US_FOOT),  # New York
        (((1024, 1), (3072, 25832)), 1),  # UTM
        (((1024, 1), (3072, 28992)), 1),  # Netherlands
        (((1024, 1), (3072, 32767)), 1),
    ],
)
def test_a_system_by_its_code_has_the_stated_unit_or_is_known_to_be_in_metres(
    tmp_path, keys, factor
):
    path = write_las(tmp_path / "s.las", SCAN.points, records=[keys_record(*keys)])
    assert np.abs(read_scan(path).points - SCAN.points * factor).max() < 0.6e-3


@pytest.mark.parametrize("code", [2263, 2225, 32600, 32661, 2992])
def test_a_system_that_is_only_a_code_and_may_be_in_feet_is_refused(tmp_path, code):
    path = write_las(
        tmp_path / "s.las", SCAN.points, records=[keys_record((1024, 1), (3072, code))]
    )
    error = refused(FormatError, path, read_scan, path).value
    assert f"EPSG:{code}" in error.problem
    assert f"a_srs=EPSG:{code}" in error.hint


def test_degrees_without_a_record_are_recognised_by_span_and_resolution(tmp_path):
    degrees = np.array([-94.68, 31.04, 40.0]) + SCAN.points * [1e-5, 1e-5, 1]
    path = write_las(tmp_path / "s.las", degrees, scale=1e-7)
    error = refused(FormatError, path, read_scan, path)
    assert "degrees" in error.value.problem
    assert "EPSG:32615" in error.value.hint  # The zone of UTM at 94.68° west
    # A fine scan of a room is none.
    assert len(read_scan(write_las(tmp_path / "r.las", SCAN.points / 100, scale=1e-7))) == 100


def test_damaged_bounds_are_no_degrees(tmp_path):
    path = write_las(tmp_path / "s.las", SCAN.points)
    content = bytearray(path.read_bytes())
    content[MAX_X:MIN_X] = struct.pack("<d", np.inf)
    content[MIN_X:MAX_Y] = struct.pack("<d", np.inf)
    path.write_bytes(content)
    assert len(read_scan(path)) == len(SCAN)


def test_the_code_of_a_system_in_metres_may_stand_for_the_unit(tmp_path):
    """As programs of Leica write it."""
    record = keys_record((1024, 1), (3076, 32632), (4099, 9001))
    path = write_las(tmp_path / "s.las", SCAN.points, records=[record])
    assert np.abs(read_scan(path).points - SCAN.points).max() < 0.6e-3
