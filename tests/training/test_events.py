# SPDX-License-Identifier: MIT
from pathlib import Path

import numpy as np
import pytest

from salsanext_cli.training import events
from salsanext_cli.training.events import Events, TensorBoardEvents, events_in

ROW = {"epoch": 2, "loss": 2.5, "miou": 0.25, "iou_car": float("nan"), "iou_other-vehicle": 0.5}
PICTURE = np.zeros((4, 6, 3), np.uint8)


class Recorder:
    """What is asked of TensorBoard's writer."""

    def __init__(self) -> None:
        self.scalars: dict[str, tuple[float, int]] = {}
        self.images: list[tuple[str, tuple[int, ...], int, str]] = []
        self.flushed = 0

    def add_scalar(self, name: str, value: float, step: int) -> None:
        self.scalars[name] = (value, step)

    def add_image(self, name: str, image: np.ndarray, step: int, dataformats: str) -> None:
        self.images.append((name, image.shape, step, dataformats))

    def flush(self) -> None:
        self.flushed += 1


def test_an_epoch_is_scalars_and_an_image() -> None:
    recorder = Recorder()
    TensorBoardEvents(recorder).add(ROW, PICTURE)
    assert recorder.scalars == {"loss": (2.5, 2), "miou": (0.25, 2), "iou/other-vehicle": (0.5, 2)}
    assert recorder.images == [("sample", (4, 6, 3), 2, "HWC")]
    assert recorder.flushed == 1


@pytest.mark.parametrize("wanted", [True, False])
def test_without_tensorboard_nothing_is_written(
    wanted: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(events, "find_spec", lambda name: None)
    with events_in(tmp_path / "tensorboard", wanted=wanted) as writer:
        writer.add(ROW, PICTURE)
    assert type(writer) is Events
    assert not list(tmp_path.iterdir())


def test_tensorboard_reads_what_was_written(tmp_path: Path) -> None:
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    with events_in(tmp_path) as writer:
        writer.add(ROW, PICTURE)
    found = EventAccumulator(str(tmp_path)).Reload()
    assert set(found.Tags()["scalars"]) == {"loss", "miou", "iou/other-vehicle"}
    assert [(e.step, e.value) for e in found.Scalars("miou")] == [(2, 0.25)]
    assert [(e.step, e.width) for e in found.Images("sample")] == [(2, 6)]
