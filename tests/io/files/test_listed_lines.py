# SPDX-License-Identifier: MIT
"""Entries of text files keep the numbers that an editor shows."""

import pytest
from scans import refused

from salsanext_cli.core.errors import FormatError
from salsanext_cli.io.files.listed_lines import listed_lines


def test_entries_have_the_numbers_of_their_lines(tmp_path):
    path = tmp_path / "list.txt"
    # Other characters that end lines, such as U+2028, may be in names.
    path.write_bytes("\ufeff\n a b \r\n# c\n\n#\n\u2028d\u2028e".encode())
    entries = [(line.number, line.text) for line in listed_lines(path, "names")]
    assert entries == [(2, "a b"), (6, "d\u2028e")]


@pytest.mark.parametrize("content", [b"\xff", b"a\x00"])
def test_what_is_no_text_is_refused(tmp_path, content):
    path = tmp_path / "list.txt"
    path.write_bytes(content)
    refused(FormatError, path, listed_lines, path, "names")
