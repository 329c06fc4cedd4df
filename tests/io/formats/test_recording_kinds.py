# SPDX-License-Identifier: MIT
"""Kinds of recordings by the suffixes of their files."""

from pathlib import Path

import pytest

from salsanext_cli.io.formats import SCAN_SUFFIXES
from salsanext_cli.io.formats.recording_kinds import (
    BAG,
    RECORDING_KINDS,
    RECORDING_SUFFIXES,
    SITE,
    kind_of,
)
from salsanext_cli.io.formats.recordings import scan_name


@pytest.mark.parametrize("kind", RECORDING_KINDS)
def test_a_suffix_belongs_to_one_kind_in_upper_and_lower_case(kind):
    for suffix in kind.suffixes:
        assert RECORDING_SUFFIXES.count(suffix) == 1
        assert suffix not in SCAN_SUFFIXES
        assert kind_of(Path(f"drive{suffix}")) is kind
        assert kind_of(Path(f"drive{suffix.upper()}")) is kind


def test_a_folder_is_a_bag(tmp_path):
    assert kind_of(tmp_path) is BAG


def test_names_of_scans_are_their_keys():
    assert scan_name(1_600_000_000_123_456_789, 0) == "1600000000123456789"
    assert scan_name(5, 2) == "0000000000000000005_2"
    assert scan_name(5, 0, SITE) == "000005"
