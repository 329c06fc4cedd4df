# SPDX-License-Identifier: MIT
"""Whatever a file holds, its reader returns or raises an error of ours, soon and in little memory.

``FUZZ_CASES`` is how many files each reader gets in the slow test.
"""

import os
import warnings
from contextlib import suppress
from random import Random

import pytest
from limits import bounded, ending
from mutations import damage
from readers import readers
from tiny_network import TinyNetwork

from salsanext_cli.errors import SalsanextError
from salsanext_cli.network.registry import ARCHITECTURES

FEW_CASES = 100
MANY_CASES = int(os.environ.get("FUZZ_CASES", "5000"))
LONGEST = 2000
"""Characters of an error, which is one line to read."""
NAMES = (
    *("bin", "pcd.bin", "label", "npy", "npy of uncertainty", "npy of probabilities", "ply"),
    *("pcd ascii", "pcd binary", "pcd binary_compressed", "yaml", "toml of a sensor"),
    *("toml of a recipe", "safetensors", "checkpoint", "published", "published, old"),
    *("pickle of a published one", "manifest", "source", "train.json", "class_counts.json"),
    "json",
)


@pytest.fixture(scope="module")
def every(tmp_path_factory):
    """Return all readers; the network of the weights is a tiny one."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(ARCHITECTURES, "salsanext", TinyNetwork)
        yield readers(tmp_path_factory.mktemp("valid"))


def test_every_reader_is_named(every):
    assert {*every} == {*NAMES}


@pytest.mark.parametrize("name", NAMES)
def test_valid_files_are_read(every, tmp_path, name):
    """Otherwise damaging them would prove nothing."""
    reader = every[name]
    path = tmp_path / reader.place
    read = 0
    for seed in reader.seeds:
        path.write_bytes(seed)
        with suppress(SalsanextError):
            reader.read(path)
            read += 1
    path.write_bytes(reader.seeds[0])
    assert read


def endure(reader, path, content):
    """Let a reader read a damaged file; it must not warn of what it refuses, or takes."""
    path.write_bytes(content)
    said = ""
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        with bounded(len(content)):
            try:
                reader.read(path)
            except SalsanextError as error:
                said = str(error)
    assert len(said) < LONGEST, said
    assert not [str(warning.message) for warning in warned]


def bombard(reader, folder, name, cases):
    """Give a reader so many damaged files."""
    path = folder / reader.place
    # What is imported or compiled at the first file is no matter of a damaged one.
    for seed in reader.seeds:
        path.write_bytes(seed)
        with suppress(SalsanextError):
            reader.read(path)
    with ending(cases):
        for case in range(cases):
            content = damage(Random(f"{name} {case}"), reader.seeds)
            try:
                endure(reader, path, content)
            except Exception as error:
                error.add_note(f"case {case}: {content!r}"[:5000])
                raise
    path.write_bytes(reader.seeds[0])


@pytest.mark.parametrize("name", NAMES)
def test_a_few_damaged_files(every, tmp_path, name):
    bombard(every[name], tmp_path, name, FEW_CASES)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_many_damaged_files(every, tmp_path, name):
    bombard(every[name], tmp_path, name, MANY_CASES)
