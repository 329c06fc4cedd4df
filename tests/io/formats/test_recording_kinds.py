# SPDX-License-Identifier: MIT
"""Kinds of recordings by the suffixes of their files."""

from pathlib import Path

import pytest
from scans import refused

from salsanext_cli.core.errors import FormatError
from salsanext_cli.io.formats import SCAN_SUFFIXES, recording_kinds
from salsanext_cli.io.formats.recording_kinds import (
    BAG,
    RECORDING_KINDS,
    RECORDING_SUFFIXES,
    SITE,
    RecordingKind,
    kind_of,
)
from salsanext_cli.io.formats.recordings import files_of, is_recording, scan_name


@pytest.mark.parametrize("kind", RECORDING_KINDS)
def test_a_suffix_belongs_to_one_kind_in_upper_and_lower_case(kind):
    for suffix in kind.suffixes:
        assert RECORDING_SUFFIXES.count(suffix) == 1
        assert suffix not in SCAN_SUFFIXES
        assert kind_of(Path(f"drive{suffix}")) is kind
        assert kind_of(Path(f"drive{suffix.upper()}")) is kind


def test_a_folder_is_of_the_kind_whose_files_it_has(tmp_path, monkeypatch):
    bag = tmp_path / "drive"
    survey = tmp_path / "site.bag"
    for path in (bag / "metadata.yaml", bag / "drive_0.db3.zstd", survey / "index.xml"):
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(b"")
    assert kind_of(bag) is BAG
    assert files_of(bag) == [bag / "metadata.yaml", bag / "drive_0.db3.zstd"]
    assert not is_recording(survey)
    refused(FormatError, survey, kind_of, survey)
    folders = RecordingKind(
        suffixes=(".survey",),
        noun="a survey",
        open_files=lambda path, files: files,
        files_in=lambda folder: sorted(folder.glob("*.xml")),
    )
    monkeypatch.setattr(recording_kinds, "RECORDING_KINDS", (*RECORDING_KINDS, folders))
    assert is_recording(survey)
    assert kind_of(survey) is folders
    assert files_of(survey) == [survey / "index.xml"]
    assert kind_of(bag) is BAG
    (bag / "drive_0.db3.zstd").unlink()
    assert not is_recording(bag)


def test_names_of_scans_are_their_keys():
    assert scan_name(1_600_000_000_123_456_789, 0) == "1600000000123456789"
    assert scan_name(5, 2) == "0000000000000000005_2"
    assert scan_name(5, 0, SITE) == "000005"
