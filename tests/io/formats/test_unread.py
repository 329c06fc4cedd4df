# SPDX-License-Identifier: MIT
"""Files that are not read, and the commands that convert them."""

import shlex
from pathlib import Path

import pytest

from salsanext_cli.io.formats.unread import (
    OTHERWISE,
    conversion_hint,
    folder_hint,
    pcapng_hint,
    unread_kind,
)


def command_in(hint):
    """Return the words of the command in a hint."""
    return shlex.split(hint.split("`")[1])


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("a.bag.active", ".bag.active"),
        ("a.PKL.GZ", ".pkl.gz"),
        ("a.tar.gz", ".tar.gz"),
        ("a.bin.gz", ".gz"),
        ("a.pcapng", ".pcapng"),
        ("a.bin", ""),
    ],
)
def test_the_longest_suffix_is_the_kind_of_a_file(name, kind):
    assert unread_kind(name) == kind


def test_a_bag_that_was_not_closed_is_indexed_and_renamed():
    hint = conversion_hint(Path("my drive/a.bag.active"))
    assert command_in(hint) == ["rosbag", "reindex", "my drive/a.bag.active"]
    assert hint.endswith(" a.bag")


def test_a_capture_is_never_converted_onto_itself():
    for name, target in (("a.pcapng", "a.pcap"), ("a.pcap", "a-converted.pcap")):
        words = command_in(pcapng_hint(Path("my drive", name)))
        assert words == ["editcap", "-F", "pcap", f"my drive/{name}", f"my drive/{target}"]


def test_the_command_for_pickles_reads_the_folder_of_the_file():
    folder = Path('it\'s "mine"')
    hint = conversion_hint(folder / "a.pkl")
    words = shlex.split(hint.partition(": ")[2])
    assert words[:2] == ["python", "-c"]
    compile(words[2], "hint", "exec")
    assert 'glob("*.pkl")' in words[2]


def test_the_hint_of_a_folder_is_about_its_most_frequent_kind():
    folder = Path("drive")
    assert folder_hint(folder, ["a.bin", "b.txt"]) == ""
    names = ["c.zip", "b.pcapng", "a.pcapng", "d.bin"]
    assert folder_hint(folder, names) == f"a.pcapng: {pcapng_hint(folder / 'a.pcapng')}"
    assert conversion_hint(folder / "d.xyz") == OTHERWISE
