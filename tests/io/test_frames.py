# SPDX-License-Identifier: MIT
"""Files of the frames of scans."""

import pytest
from scans import refused

from salsanext_cli.core.errors import FormatError, SalsanextError
from salsanext_cli.io.frames import encode_frames, read_frames


def test_frames_are_read_as_written(tmp_path):
    path = tmp_path / "frames.json"
    assert read_frames(path) == {}
    frames = {"000001": (500_000.0, 5_400_000.0, 0.0), "000000": (0.0, -1e4, 0.0)}
    path.write_bytes(encode_frames(frames))
    assert read_frames(path) == frames


@pytest.mark.parametrize("content", ['{"a": [1, 2]}', '{"a": "far"}', '{"a": 1}'])
def test_other_contents_are_refused(tmp_path, content):
    path = tmp_path / "frames.json"
    path.write_text(content)
    refused(FormatError, path, read_frames, path)


def test_damaged_files_are_refused(tmp_path):
    path = tmp_path / "frames.json"
    path.write_text("[")
    refused(SalsanextError, path, read_frames, path)
