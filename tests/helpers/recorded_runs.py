# SPDX-License-Identifier: MIT
"""Runs of `predict` that record their settings."""

from dataclasses import asdict
from pathlib import Path

from world import begin_and_end

from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.runs.records.stage_settings import PredictSettings
from salsanext_cli.runs.scans.scan_file import ScanFile

KNN = asdict(KnnParameters())
SETTINGS = {"weights": "abc", "knn": KNN}
TYPED = PredictSettings(weights="abc", knn=KnnParameters())


def scans_of(tmp_path: Path, *stems: str, sequence: str = "08") -> list[ScanFile]:
    """Return scans of a data set in a folder, which nobody reads."""
    folder = tmp_path / "data" / sequence / "velodyne"
    return [ScanFile(sequence=sequence, stem=stem, path=folder / f"{stem}.bin") for stem in stems]


def predict(out: Path, settings=SETTINGS, folders=("predictions",), scans=(), overwrite=False):
    """Begin and end a run of `predict`; return its record."""
    return begin_and_end(out, "predict", settings, folders, scans, overwrite=overwrite)
