# SPDX-License-Identifier: MIT
"""Scans are found by their whole names, and by stems that only one sequence has."""

import pytest
from numbered_scans import scans_of
from scans import refused

from salsanext_cli.core.errors import FormatError, UsageError
from salsanext_cli.runs.scans.named_scans import named_scans, read_names

FILES = scans_of([("00", 1), ("08", 1), ("08", 2)])


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["08/000002", "00/000001"], ["08/000002", "00/000001"]),
        (["000002"], ["08/000002"]),
        (["000002", "08/000002", "000002"], ["08/000002"]),
        ([], []),
    ],
)
def test_scans_come_in_the_order_of_their_names_without_repetitions(names, expected):
    assert [file.name for file in named_scans(names, FILES, "from")] == expected


@pytest.mark.parametrize("name", ["000001", "000003", "08", "", "08/000002.bin"])
def test_names_of_no_scan_or_several_are_refused(name):
    refused(UsageError, "from", named_scans, ["000002", name], FILES, "from")


def test_a_list_has_a_name_per_line_and_comments(tmp_path):
    path = tmp_path / "tagged.txt"
    path.write_bytes("\ufeff# tagged\r\n\r\n 08/000002 \r\n#08/000001\r\nStraße/a".encode())
    assert read_names(path) == ["08/000002", "Straße/a"]


@pytest.mark.parametrize("content", [b"", b"# only a comment\n", b"\xff\xfe0\x008\x00"])
def test_lists_without_names_are_refused(content, tmp_path):
    path = tmp_path / "tagged.txt"
    path.write_bytes(content)
    refused(FormatError, path, read_names, path)
