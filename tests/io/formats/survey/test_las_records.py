# SPDX-License-Identifier: MIT
"""Records about the coordinate system of a LAS file, written by laspy."""

import numpy as np
import pytest
from las_files import text_record, write_las
from scans import refused

from salsanext_cli import read_scan
from salsanext_cli.core.errors import FormatError
from salsanext_cli.io.formats.survey import las_records
from salsanext_cli.io.formats.survey.las_records import projection_records

START_OF_RECORDS = 235  # Position of the start of extended records in the header
laspy = pytest.importorskip("laspy")


def records_of(path):
    size = path.stat().st_size
    with path.open("rb") as file, laspy.open(path) as reader:
        return projection_records(file, reader.header, size)


def test_records_in_front_of_the_points_precede_those_behind_and_others_do_not_count(tmp_path):
    path = write_las(
        tmp_path / "s.las",
        np.ones((3, 3)),
        records=[laspy.VLR("mine", 34735, "", b"1234"), text_record("front")],
        extended_records=[
            laspy.VLR("mine", 34736, "", b"12345678"),
            text_record("behind"),
            laspy.VLR("liblas", 34735, "", b"12"),
        ],
    )
    contents = records_of(path)
    assert contents[2112].rstrip(b"\0") == b"front"
    assert (sorted(contents), contents[34735]) == ([2112, 34735], b"12")


def test_large_records_are_skipped_and_incomplete_ones_refused(tmp_path):
    large = laspy.VLR("LASF_Projection", 2112, "", bytes(las_records.MAX_CONTENT_BYTES + 1))
    path = write_las(
        tmp_path / "s.las", np.ones((3, 3)), extended_records=[large, text_record("behind")]
    )
    assert records_of(path)[2112].rstrip(b"\0") == b"behind"
    content = path.read_bytes()
    for length in (len(content) - 1, len(content) - 50, len(content) - 100):
        path.write_bytes(content[:length])
        with pytest.raises(ValueError, match="more records"):
            records_of(path)


@pytest.mark.parametrize("start", [0, 2**63, 2**64 - 1])
def test_impossible_starts_are_damage(tmp_path, start):
    path = write_las(tmp_path / "s.las", np.ones((3, 3)), extended_records=[text_record("a")])
    content = bytearray(path.read_bytes())
    content[START_OF_RECORDS : START_OF_RECORDS + 8] = start.to_bytes(8, "little")
    path.write_bytes(content)
    refused(FormatError, path, read_scan, path)
