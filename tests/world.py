# SPDX-License-Identifier: MIT
"""A data set and an output folder for tests of stages."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from salsanext_cli import read_labels, write_labels
from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.results.layout import SUFFIX_OF_FOLDER


@dataclass
class World:
    """Two sequences of equal file names, of which the split "valid" names one."""

    data: Path
    out: Path
    network: NetworkSettings

    def scan(self, sequence: str = "08", stem: str = "000000") -> Path:
        return self.data / "sequences" / sequence / "velodyne" / f"{stem}.bin"

    def result(self, folder: str, sequence: str = "08", stem: str = "000000") -> Path:
        suffix = SUFFIX_OF_FOLDER[folder]
        return self.out / "sequences" / sequence / folder / f"{stem}{suffix}"

    def labels(self, sequence: str = "08", stem: str = "000000") -> np.ndarray:
        return read_labels(self.result("predictions", sequence, stem))

    def predict_by_hand(self, raw: int = 10, count: int = 1500) -> None:
        """Leave predictions of unknown origin for every scan."""
        for sequence, stem in (("00", "000000"), ("08", "000000"), ("08", "000001")):
            path = self.result("predictions", sequence, stem)
            write_labels(path, np.full(count, raw, np.uint32))
