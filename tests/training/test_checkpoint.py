# SPDX-License-Identifier: MIT
import io
import pickle
from collections.abc import Callable
from pathlib import Path
from zipfile import ZipFile

import pytest
import torch
from tiny_network import TinyNetwork

from salsanext_cli.errors import TrainingError
from salsanext_cli.training.checkpoint import TrainingState, load_checkpoint, save_checkpoint
from salsanext_cli.training.optimise import Learner
from salsanext_cli.training.recipe import Recipe


def learner(classes: int = 3, precision: str = "auto") -> Learner:
    recipe = Recipe(optimiser="adamw", average=0.9, precision=precision)
    return Learner.of(TinyNetwork(classes), recipe, torch.ones(classes), torch.device("cpu"))


def trained() -> Learner:
    learning = learner()
    learning.step(torch.randn(2, 5, 16, 16), torch.ones(2, 16, 16, dtype=torch.uint8), 0, 1)
    return learning


def test_round_trip(tmp_path: Path) -> None:
    learning, progress = trained(), TrainingState(2, 0.5, [{"epoch": 1, "loss": 2.5}], [0.1], 3.5)
    save_checkpoint(tmp_path / "c.pt", learning, progress)
    other = learner()
    assert load_checkpoint(tmp_path / "c.pt", other) == progress
    for mine, theirs in ((learning.module, other.module), (learning.average, other.average)):
        for a, b in zip(mine.state_dict().values(), theirs.state_dict().values(), strict=True):
            assert torch.equal(a, b)
    kept = learning.optimiser.state_dict()["state"]
    for key, state in other.optimiser.state_dict()["state"].items():
        for name, value in state.items():
            assert torch.equal(value, kept[key][name])


def test_the_scale_of_float16_is_kept(tmp_path: Path) -> None:
    learning = learner(precision="float16")
    learning.scaler.scale(torch.zeros(()))  # what a scaler has begins with its first use
    learning.scaler.update(4096.0)
    save_checkpoint(tmp_path / "c.pt", learning, TrainingState())
    other = learner(precision="float16")
    load_checkpoint(tmp_path / "c.pt", other)
    assert other.scaler.get_scale() == 4096


def test_a_checkpoint_of_another_network(tmp_path: Path) -> None:
    save_checkpoint(tmp_path / "c.pt", trained(), TrainingState())
    with pytest.raises(TrainingError, match="cannot be resumed from"):
        load_checkpoint(tmp_path / "c.pt", learner(classes=4))


@pytest.mark.parametrize("cut", [0, 100, 5000])
def test_a_damaged_checkpoint(cut: int, tmp_path: Path) -> None:
    save_checkpoint(tmp_path / "c.pt", trained(), TrainingState())
    data = (tmp_path / "c.pt").read_bytes()
    (tmp_path / "c.pt").write_bytes(data[:cut])
    with pytest.raises(TrainingError, match=r"c\.pt · cannot be resumed from"):
        load_checkpoint(tmp_path / "c.pt", learner())


@pytest.mark.parametrize("share", [0.1, 0.3, 0.5, 0.7, 0.9])
def test_a_flipped_bit_is_noticed(share: float, tmp_path: Path) -> None:
    save_checkpoint(tmp_path / "c.pt", trained(), TrainingState())
    with ZipFile(tmp_path / "c.pt") as archive:
        largest = max(archive.infolist(), key=lambda member: member.file_size)
    data = bytearray((tmp_path / "c.pt").read_bytes())
    # Behind the header of the member, whose padding nobody reads.
    data[largest.header_offset + 200 + int(share * (largest.file_size - 200))] ^= 4
    (tmp_path / "c.pt").write_bytes(data)
    with pytest.raises(TrainingError, match="checksum"):
        load_checkpoint(tmp_path / "c.pt", learner())


def test_a_file_of_something_else(tmp_path: Path) -> None:
    torch.save(torch.zeros(3), tmp_path / "c.pt")
    with pytest.raises(TrainingError, match="cannot be resumed from"):
        load_checkpoint(tmp_path / "c.pt", learner())


class Malicious:
    """What runs code when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[object, tuple[str, ...]]:
        return (Path.touch, (self.path,))


def pickled(value: object) -> bytes:
    return pickle.dumps(value, protocol=2)


def zipped(value: object) -> bytes:
    file = io.BytesIO()
    torch.save(value, file)
    return file.getvalue()


@pytest.mark.parametrize("form", [pickled, zipped])
def test_nothing_in_a_checkpoint_is_executed(
    form: Callable[[object], bytes], tmp_path: Path
) -> None:
    (tmp_path / "c.pt").write_bytes(form({"module": Malicious(tmp_path / "executed")}))
    with pytest.raises(TrainingError, match="cannot be resumed from"):
        load_checkpoint(tmp_path / "c.pt", learner())
    assert not (tmp_path / "executed").exists()
