# SPDX-License-Identifier: MIT
"""A data set and an output folder for tests of stages."""

import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scans import SMALL, write_sequence

from salsanext_cli import read_labels, write_labels
from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.io.files.json_files import record_of
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.records.stage_settings import settings_type
from salsanext_cli.runs.results.folder_names import SUFFIX_OF_FOLDER
from salsanext_cli.runs.results.output_run import OutputRun, output_run
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_selection import ScanSelection

EVERY = ScanSelection(sequences=("00", "08"))


@dataclass
class World:
    """Two sequences with equal file names, one of them in the split "valid"."""

    data: Path
    out: Path
    network: NetworkSettings

    @classmethod
    def made(cls, folder: Path, weights: Path) -> "World":
        """Write three scans; names of folders have a space and an umlaut."""
        data = folder / "Daten für 1"
        write_sequence(data / "sequences/00", ["000000"], seed=7)
        write_sequence(data / "sequences/08", ["000000", "000001"])
        return cls(data, folder / "öut put", NetworkSettings(weights, "cpu", engine="torch"))

    def unfitted(self) -> "World":
        """Return the world with the sensor of its scans, to which no sensor is fitted.

        A fit takes a fifth of a short run.
        """
        sensor = replace(SMALL, min_range=1.0, ego_box=())
        return replace(self, network=replace(self.network, sensor=sensor))

    def scan(self, sequence: str = "08", stem: str = "000000") -> Path:
        return self.data / "sequences" / sequence / "velodyne" / f"{stem}.bin"

    def result(self, folder: str, sequence: str = "08", stem: str = "000000") -> Path:
        suffix = SUFFIX_OF_FOLDER[folder]
        return self.out / "sequences" / sequence / folder / f"{stem}{suffix}"

    def labels(self, sequence: str = "08", stem: str = "000000") -> np.ndarray:
        return read_labels(self.result("predictions", sequence, stem))

    def predict(self) -> None:
        """Leave predictions for every scan."""
        predict_scans(self.data, self.out, settings=self.network)

    def tune(self, part: str, target: Path, **changes: Any) -> dict[str, Any]:
        """Tune a part of the weights on every scan; return the report as JSON has it."""
        from salsanext_cli.commands.stages import tune  # it takes torch

        stage = getattr(tune, f"tune_{part}")
        given = {"settings": self.network, "selection": EVERY, **changes}
        return stage(self.data, target, **given).to_dict()

    def predict_by_hand(self, raw: int = 10, count: int = 1500) -> None:
        """Leave predictions of unknown origin for every scan."""
        for sequence, stem in (("00", "000000"), ("08", "000000"), ("08", "000001")):
            path = self.result("predictions", sequence, stem)
            write_labels(path, np.full(count, raw, np.uint32))


class Stored:
    """A world with results that are made once; each test gets it in the same folder.

    Records of results hold absolute names and times of modification, which copies preserve.
    """

    def __init__(self, folder: Path, weights: Path, fill: Callable[[World], None]) -> None:
        self.place, self.kept = folder / "now", folder / "kept"
        self.world = World.made(self.place, weights)
        fill(self.world)
        self.place.rename(self.kept)

    def restored(self) -> World:
        """Return the world as it was when its results were made."""
        shutil.rmtree(self.place, ignore_errors=True)
        shutil.copytree(self.kept, self.place)
        return replace(self.world)


def begin_and_end(
    out: Path,
    stage: str,
    settings: Mapping[str, Any],
    folders: Iterable[str],
    scans: Sequence[ScanFile] = (),
    *,
    overwrite: bool = False,
) -> OutputRun:
    """Register a run in an output folder that has nothing to do, as if it had been killed.

    Its record stays, although it has no results.
    """
    typed = record_of(settings_type(stage), settings, Path("settings"))
    with output_run(out, stage, typed, folders, scans, overwrite=overwrite) as output:
        written = {path: path.read_bytes() for path in out.glob("*.*") if path.is_file()}
    out.mkdir(parents=True, exist_ok=True)
    for path, content in written.items():
        if not path.exists() and not path.name.startswith("."):
            path.write_bytes(content)
    return output
