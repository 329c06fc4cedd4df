# SPDX-License-Identifier: MIT
"""Bags that were cut off anywhere: what is whole is read, and the rest is one error."""

import struct
from contextlib import suppress

import numpy as np
import pytest

pytest.importorskip("rosbags")

from bags import KINDS, START, STEP, messages, structured, write_bag

from salsanext_cli import read_scan
from salsanext_cli.errors import FormatError, SalsanextError
from salsanext_cli.formats.recordings.recorded_scans import LOST
from salsanext_cli.results.layout import find_scans

COUNT = 12
POINTS = [structured(2000, seed) for seed in range(COUNT)]
TIMES = [f"{START + n * STEP}" for n in range(COUNT)]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Return the bytes of a bag of each kind, of several chunks."""
    folder = tmp_path_factory.mktemp("bags")
    return {kind: write_bag(folder / kind, kind, messages(POINTS)).read_bytes() for kind in KINDS}


def read_all(path):
    """Return the number of scans that are read, which must be those of the whole bag."""
    scans = find_scans(path)
    assert [scan.stem for scan in scans[:-1]] == TIMES[: len(scans) - 1]
    for n, scan in enumerate(scans[:-1]):
        np.testing.assert_array_equal(read_scan(scan.path).points[:, 0], POINTS[n]["x"])
    assert scans[-1].stem == LOST
    with pytest.raises(FormatError, match=rf"{path.name}: cut off"):
        read_scan(scans[-1].path)
    return len(scans) - 1


@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_cut_anywhere(tmp_path, whole, kind):
    data, found = whole[kind], []
    random = np.random.default_rng(0)
    places = [
        *random.integers(0, len(data), 30),
        *(random.integers(1, len(data) // 4096, 10) * 4096),
    ]
    for place in sorted(map(int, places)):
        path = tmp_path / f"cut{place}{kind}"
        path.write_bytes(data[:place])
        found.append(0)
        with suppress(SalsanextError):
            found[-1] = read_all(path)
    assert found == sorted(found)
    assert COUNT // 2 < max(found) <= COUNT
    assert len(set(found)) > 3


def test_a_bag_that_was_never_closed_lacks_its_index_only(tmp_path, whole):
    data = bytearray(whole[".bag"])
    place = data.index(b"index_pos=") + len("index_pos=")
    (index,) = struct.unpack_from("<Q", data, place)
    data[place : place + 8] = bytes(8)
    path = tmp_path / "drive.bag"
    path.write_bytes(data[:index])
    assert [scan.stem for scan in find_scans(path)] == TIMES
    np.testing.assert_array_equal(read_scan(find_scans(path)[7].path).points[:, 0], POINTS[7]["x"])


def test_of_a_folder_with_a_cut_file_the_rest_is_read(tmp_path, whole):
    path = write_bag(tmp_path, ".db3", messages(POINTS))
    path.write_bytes(whole[".db3"][: len(whole[".db3"]) * 2 // 3])
    scans = find_scans(path.parent)
    assert 3 < len(scans) < COUNT
    assert scans[-1].stem == LOST
    np.testing.assert_array_equal(read_scan(scans[0].path).points[:, 0], POINTS[0]["x"])
