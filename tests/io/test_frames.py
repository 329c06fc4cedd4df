# SPDX-License-Identifier: MIT
"""Files of the frames of scans."""

import pytest
from scans import refused

from salsanext_cli.core.errors import FormatError
from salsanext_cli.io.frames import encode_frames, read_frames


def test_frames_are_read_as_written(tmp_path):
    path = tmp_path / "frames.json"
    assert read_frames(path) == {}
    frames = {"000001": (500_000.0, 5_400_000.0, 0.0), "000000": (0.0, -1e4, 0.0)}
    path.write_bytes(encode_frames(frames))
    assert read_frames(path) == frames


@pytest.mark.parametrize(
    "content",
    [
        *('{"a": [1, 2]}', '{"a": "far"}', '{"a": "123"}', '{"a": 1}', '{"a": [1, 2, NaN]}'),
        '{"a": [1, 2, 3], "b": [true, false, null]}',
        *('[{"file": "a.bin", "time": 1.0}]', '{"frames": [[1, 2, 3]]}', "[1, 2, 3]", "3"),
        *("[", "", "\0", "[" * 20_000),
    ],
    ids=range(14),
)
def test_other_contents_are_no_frames_and_a_warning_names_the_file(tmp_path, caplog, content):
    path = tmp_path / "frames.json"
    path.write_text(content)
    for _ in range(2):
        assert read_frames(path) == {}
    assert caplog.text.count(f"{path}: is not a file of frames") == 1


def test_what_cannot_be_read_is_refused(tmp_path):
    path = tmp_path / "frames.json"
    path.mkdir()
    refused(FormatError, path, read_frames, path)
