# SPDX-License-Identifier: MIT
"""LAS files with some of their points, opened again by laspy."""

import numpy as np
import pytest
from las_files import text_record, write_las
from scans import make_scan, refused

from salsanext_cli.core.errors import FormatError, LabelError
from salsanext_cli.io.formats.subsets import subsets_of

laspy = pytest.importorskip("laspy")
SCAN = make_scan(300)
KEEP = np.random.default_rng(0).random(300) < 0.4
TIMES = np.linspace(1e8, 1e8 + 1, 300)
UTM = (500_123.4, 5_400_456.7, 312.0)
OTHERS = ("LASF_Spec", "laszip encoded")  # The latter remains in files without points.
SYSTEM = 'PROJCS["UTM 32N",UNIT["metre",1]]'


def content(record):
    return record.user_id, record.record_id, record.record_data_bytes()


def written(path, kind, **options):
    fields = {"gps_time": TIMES, "classification": np.arange(300, dtype=np.uint8) % 20}
    fields["point_source_id"] = np.arange(300, dtype=np.uint16)
    extra = {"echo": np.arange(300, dtype=np.float32)}
    records = [text_record(SYSTEM), laspy.VLR("mine", 7, "", b"abc")]
    points = SCAN.points + np.array(UTM)
    return write_las(
        path, points, kind=kind, offsets=UTM, records=records, extra=extra, **fields, **options
    )


@pytest.mark.parametrize("name", ["s.las", "s.laz"])
@pytest.mark.parametrize("kind", [1, 3, 6, 7])
@pytest.mark.parametrize("keep", [KEEP, KEEP | True, KEEP & False])
def test_header_records_and_fields_stay(tmp_path, name, kind, keep):
    path = written(tmp_path / name, kind)
    target = tmp_path / f"few{path.suffix}"
    target.write_bytes(subsets_of(path)(keep))
    whole, few = laspy.read(path), laspy.read(target)
    np.testing.assert_array_equal(few.points.array, whole.points.array[keep])
    for field in ("version", "point_format", "system_identifier", "generating_software"):
        assert getattr(few.header, field) == getattr(whole.header, field)
    assert few.header.creation_date == whole.header.creation_date
    np.testing.assert_array_equal(few.header.scales, whole.header.scales)
    np.testing.assert_array_equal(few.header.offsets, whole.header.offsets)
    # The record of the extra dimensions has their bounds, which change.
    before, after = (sorted(map(content, cloud.header.vlrs)) for cloud in (whole, few))
    assert [c for c in before if c[0] not in OTHERS] == [c for c in after if c[0] not in OTHERS]
    assert len(before) == 3
    assert few.header.point_count == keep.sum()
    assert few.header.are_points_compressed == (path.suffix == ".laz")
    if keep.any():
        np.testing.assert_allclose(few.header.mins, np.min(whole.xyz[keep], axis=0), atol=1e-6)


def test_records_behind_the_points_stay_and_those_of_their_order_go(tmp_path):
    path = written(tmp_path / "s.las", 6)
    cloud = laspy.read(path)
    cloud.vlrs.append(laspy.VLR("copc", 1, "", bytes(160)))
    own = laspy.VLR("mine", 9, "", b"behind")
    cloud.evlrs = laspy.vlrs.vlrlist.VLRList([own, laspy.VLR("copc", 1000, "", bytes(32))])
    cloud.write(path)
    target = tmp_path / "few.las"
    target.write_bytes(subsets_of(path)(KEEP))
    few = laspy.read(target)
    assert [record.record_data_bytes() for record in few.evlrs] == [b"behind"]
    assert "copc" not in {record.user_id for record in few.header.vlrs}


def test_other_masks_and_waveforms_are_refused(tmp_path):
    path = written(tmp_path / "s.las", 6)
    refused(LabelError, path, subsets_of(path), KEEP[1:])
    cloud = laspy.read(path)
    cloud.header.global_encoding.waveform_data_packets_internal = True
    cloud.write(path)
    assert "waveforms" in refused(FormatError, path, subsets_of, path).value.problem
