# SPDX-License-Identifier: MIT
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from salsanext_cli.errors import FormatError, LabelError
from salsanext_cli.formats.kitti import read_labels, write_labels


@given(hnp.arrays(np.uint32, st.integers(0, 50)))
def test_labels_survive_the_round_trip(tmp_path_factory, raw):
    path = tmp_path_factory.mktemp("label") / "s.label"
    write_labels(path, raw)
    assert path.read_bytes() == b"".join(struct.pack("<I", value) for value in raw.tolist())
    np.testing.assert_array_equal(read_labels(path, len(raw)), raw)
    with pytest.raises(LabelError, match=f"{len(raw)} labels? · expected {len(raw) + 53}"):
        read_labels(path, len(raw) + 53)
    path.write_bytes(path.read_bytes() + b"cut")
    with pytest.raises(FormatError, match=f"{4 * len(raw) + 3} bytes"):
        read_labels(path)


@pytest.mark.parametrize("kind", ["<u4", "<u2", "u1"])
def test_labels_of_one_two_or_four_bytes(tmp_path, kind):
    path = tmp_path / "s.label"
    raw = np.arange(100, dtype=kind)
    path.write_bytes(raw.tobytes())
    read = read_labels(path, 100)
    assert read.dtype == np.uint32
    np.testing.assert_array_equal(read, raw)
    with pytest.raises(LabelError, match=r"\d+ labels · expected 99"):
        read_labels(path, 99)
    if raw.itemsize < 4:
        path.write_bytes(np.arange(25 * raw.itemsize, dtype="<u4").tobytes())
        with pytest.raises(LabelError, match=r"\d+ labels · expected 100"):
            read_labels(path, 100)
        path.write_bytes(bytes(100 * raw.itemsize))
        assert not read_labels(path, 100).any()
    path.write_bytes(raw.tobytes())
    # Without the number of points they are four.
    assert len(read_labels(path)) == raw.nbytes // 4
