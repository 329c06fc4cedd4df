# SPDX-License-Identifier: MIT
"""Readers of damaged files return or raise a `SalsanextError`, in bounded time and memory.

``FUZZ_CASES`` is the number of files for each reader in the slow test.
"""

import os
import warnings
from contextlib import suppress
from random import Random

import pytest
from fuzzing.limits import UnmeasuredError, bounded
from fuzzing.mutations import damage
from fuzzing.readers import READERS
from tiny_network import TinyNetwork

from salsanext_cli.core.errors import SalsanextError
from salsanext_cli.core.network.registry import ARCHITECTURES
from salsanext_cli.io.formats import FORMATS, format_of

FEW_CASES = 12
MANY_CASES = int(os.environ.get("FUZZ_CASES", "5000"))
MAX_CHARACTERS = 2000
"""Largest length of an error."""


@pytest.fixture
def made(tmp_path, monkeypatch):
    """Return a function from the name of a reader to the reader; weights have a tiny network."""
    monkeypatch.setitem(ARCHITECTURES, "salsanext", TinyNetwork)
    return lambda name: READERS[name](tmp_path / "valid")


def replace(path, content, number):
    """Write a file in place of another, with a time of its own: readers cache files by it.

    A file that is only truncated would be waited for until it is on the disk, at least with ext4.
    """
    path.unlink()
    path.write_bytes(content)
    os.utime(path, ns=(number, number))


def read_damaged(reader, path, size):
    """Read a damaged file of `size` bytes without a warning or an error of another kind."""
    message = ""
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        with bounded(size):
            try:
                reader.read(path)
            except SalsanextError as error:
                message = str(error)
    assert len(message) < MAX_CHARACTERS, message
    assert not warned, warned[0]


def test_every_format_of_scans_has_a_reader():
    """The name of a reader begins with the suffix of its files."""
    read = [format_of(f"a.{name.partition(' ')[0]}") for name in READERS]
    assert [name for name, form in FORMATS.items() if form not in read] == []


@pytest.mark.parametrize("cases", [FEW_CASES, pytest.param(MANY_CASES, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", READERS)
def test_damaged_files(made, tmp_path, name, cases):
    """Valid files are read first, which also imports and compiles."""
    reader = made(name)
    path = tmp_path / reader.place
    read = 0
    for seed in reader.seeds:
        path.write_bytes(seed)
        with suppress(SalsanextError):
            reader.read(path)
            read += 1
    assert read, "no valid file is read"
    for case in range(cases):
        content = damage(Random(f"{name} {case}"), reader.seeds)
        try:
            replace(path, content, case)
            try:
                read_damaged(reader, path, len(content))
            except UnmeasuredError:
                read_damaged(reader, path, len(content))
        except Exception as error:
            error.add_note(f"case {case}: {content!r}"[:5000])
            raise
