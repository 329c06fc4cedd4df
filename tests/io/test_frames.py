# SPDX-License-Identifier: MIT
"""Files of the frames of scans."""

import pytest
from scans import refused

from salsanext_cli.core.errors import FormatError
from salsanext_cli.io.frames import encode_frames, is_ignored, read_frames, read_written_frames


def test_frames_are_read_as_written(tmp_path):
    path = tmp_path / "frames.json"
    assert read_frames(path) == {}
    frames = {"000001": (500_000.0, 5_400_000.0, 0.0), "000000": (0.0, -1e4, 0.0)}
    path.write_bytes(encode_frames(frames))
    assert read_frames(path) == frames


@pytest.mark.parametrize(
    "content",
    [
        *('{"a": "far"}', '{"a": "123"}', '{"a": 1}', '{"a": []}', "[1, 2, 3]", "3", "[]"),
        *('[{"file": "a.bin", "time": 1.0}]', '{"frames": [[1, 2, 3]]}'),
    ],
)
def test_other_contents_are_no_frames_and_a_warning_names_the_file(tmp_path, caplog, content):
    path = tmp_path / "frames.json"
    path.write_text(content)
    for _ in range(2):
        assert read_frames(path) == {}
    assert caplog.text.count(f"{path}: is not a file of frames") == 1
    assert is_ignored(path)


@pytest.mark.parametrize(
    "content",
    [
        *('{"a": [1, 2]}', '{"a": [1, 2, NaN]}', '{"a": [1, null, 2]}', '{"a": [1, 2, 3, 4]}'),
        *('{"a": [1, 2, 3], "b": [true, false, null]}', '{"a": [1, 2, 3], "b": "far"}'),
        f'{{"a": [1, 2, 1{"0" * 400}]}}',
        *('{"a": [1, 2, 3],}', "[", "", "\0", "[" * 20_000),
    ],
    ids=range(12),
)
def test_damaged_frames_are_refused(tmp_path, content):
    path = tmp_path / "frames.json"
    path.write_text(content)
    caught = refused(FormatError, path, read_frames, path)
    for words in ("delete it and run that command again", "another program"):
        assert words in caught.value.hint


def test_an_empty_file_of_an_output_folder_has_no_frames(tmp_path):
    """A power cut leaves it."""
    path = tmp_path / "frames.json"
    assert read_written_frames(path) == {}
    path.write_bytes(b"")
    assert read_written_frames(path) == {}
    path.write_bytes(b"\0")
    refused(FormatError, path, read_written_frames, path)
    frames = {"000000": (0.0, -1e4, 0.0)}
    path.write_bytes(encode_frames(frames))
    assert read_written_frames(path) == frames


def test_what_cannot_be_read_is_refused(tmp_path):
    path = tmp_path / "frames.json"
    path.mkdir()
    refused(FormatError, path, read_frames, path)
