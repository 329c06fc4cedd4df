# SPDX-License-Identifier: MIT
"""Whatever a file holds, its reader returns or raises an error of ours, soon and in little memory.

``FUZZ_CASES`` is how many files each reader gets in the slow test.
"""

import faulthandler
import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from limits import bounded
from mutations import damaged
from readers import Reader, readers
from tiny_network import TinyNetwork

from salsanext_cli.errors import SalsanextError
from salsanext_cli.network.architectures import ARCHITECTURES

FEW_CASES = 100
LONGEST = 2000
"""Characters of an error, which is one line to read."""
MANY_CASES = int(os.environ.get("FUZZ_CASES", "5000"))
NAMES = (
    *("pickle of a checkpoint", "pickle of a published one"),
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


def attack(reader: Reader, folder: Path, cases: int) -> None:
    """Give a reader damaged files."""
    path = folder / reader.place

    @settings(
        max_examples=cases,
        derandomize=True,
        database=None,
        deadline=None,
        phases=(Phase.generate, Phase.shrink),
        suppress_health_check=list(HealthCheck),
    )
    @given(damaged(reader.seeds))
    def run(content: bytes) -> None:
        path.write_bytes(content)
        said = ""
        with bounded(len(content)):
            try:
                reader.read(path)
            except SalsanextError as error:
                said = str(error)
        assert len(said) < LONGEST, said

    run()
    path.write_bytes(reader.seeds[0])


@pytest.mark.parametrize("name", NAMES)
def test_a_few_damaged_files(every: dict[str, Reader], tmp_path: Path, name: str) -> None:
    attack(every[name], tmp_path, FEW_CASES)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_many_damaged_files(every: dict[str, Reader], tmp_path: Path, name: str) -> None:
    faulthandler.enable()
    attack(every[name], tmp_path, MANY_CASES)
