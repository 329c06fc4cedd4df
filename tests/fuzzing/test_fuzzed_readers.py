# SPDX-License-Identifier: MIT
"""Whatever a file holds, its reader returns or raises an error of ours, soon and in little memory.

``FUZZ_CASES`` is how many files each reader gets in the slow test.
"""

import os
from contextlib import suppress
from pathlib import Path
from random import Random

import pytest
from hypothesis import HealthCheck, given, settings
from limits import bounded, ending
from mutations import damage, damaged
from readers import Reader, readers
from tiny_network import TinyNetwork

from salsanext_cli.errors import SalsanextError
from salsanext_cli.network.registry import ARCHITECTURES

FEW_CASES, DRAWN_CASES = 75, 20
"""Of a generator that is fast, and of Hypothesis, which makes what fails simpler."""
LONGEST = 2000
"""Characters of an error, which is one line to read."""
MANY_CASES = int(os.environ.get("FUZZ_CASES", "5000"))
NAMES = (
    "pickle of a published one",
    *("bin", "pcd.bin", "label", "npy", "npy of uncertainty", "npy of probabilities", "ply"),
    *("pcd ascii", "pcd binary", "pcd binary_compressed", "yaml", "toml of a sensor"),
    *("toml of a recipe", "safetensors", "checkpoint", "published", "published, old"),
    *("manifest", "source", "train.json", "class_counts.json", "json"),
)


@pytest.fixture(scope="module")
def every(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Reader]:
    """Return all readers; the network of the weights is a tiny one."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(ARCHITECTURES, "salsanext", TinyNetwork)
        yield readers(tmp_path_factory.mktemp("valid"))


def test_every_reader_is_named(every: dict[str, Reader]) -> None:
    assert (*every,) == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_valid_files_are_read(every: dict[str, Reader], tmp_path: Path, name: str) -> None:
    """Otherwise damaging them would prove nothing."""
    reader = every[name]
    path = tmp_path / reader.place
    read = 0
    for seed in reader.seeds:
        path.write_bytes(seed)
        try:
            reader.read(path)
            read += 1
        except SalsanextError:
            pass
    path.write_bytes(reader.seeds[0])
    assert read


def put(reader: Reader, folder: Path) -> Path:
    """Return where damaged files go; what is imported or compiled at the first file is by now."""
    path = folder / reader.place
    for seed in reader.seeds:
        path.write_bytes(seed)
        with suppress(SalsanextError):
            reader.read(path)
    return path


def endure(reader: Reader, path: Path, content: bytes) -> None:
    """Let a reader read a damaged file."""
    path.write_bytes(content)
    said = ""
    with bounded(len(content)):
        try:
            reader.read(path)
        except SalsanextError as error:
            said = str(error)
    assert len(said) < LONGEST, said


@pytest.mark.parametrize("name", NAMES)
def test_damaged_files_of_hypothesis(every: dict[str, Reader], tmp_path: Path, name: str) -> None:
    reader = every[name]
    path = put(reader, tmp_path)

    @settings(
        max_examples=DRAWN_CASES,
        derandomize=True,
        database=None,
        deadline=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(damaged(reader.seeds))
    def attack(content: bytes) -> None:
        endure(reader, path, content)

    with ending(DRAWN_CASES):
        attack()
    path.write_bytes(reader.seeds[0])


def bombard(reader: Reader, folder: Path, name: str, cases: int) -> None:
    """Give a reader so many damaged files."""
    path = put(reader, folder)
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
def test_a_few_damaged_files(every: dict[str, Reader], tmp_path: Path, name: str) -> None:
    bombard(every[name], tmp_path, name, FEW_CASES)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_many_damaged_files(every: dict[str, Reader], tmp_path: Path, name: str) -> None:
    bombard(every[name], tmp_path, name, MANY_CASES)
