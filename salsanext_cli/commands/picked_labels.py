# SPDX-License-Identifier: MIT
"""Labels of picked scans, to look at and to decide whether labelling is worth it."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.core.measures.decision import DOUBTFUL, Evidence, Verdict, verdict
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.runs.annotation.picked_data_set import PREDICTED
from salsanext_cli.runs.loop.run import Failure
from salsanext_cli.runs.loop.run_options import RunOptions
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.results.folder_names import ERROR
from salsanext_cli.runs.results.output_paths import find_outputs
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.results.scan_results import read_kind

COLUMNS = "x,y,z,intensity"  # Of the scans that `pick` writes


@dataclass(frozen=True, slots=True, kw_only=True)
class PickedLabels:
    """Results of picked scans, which `report` and `eval` read."""

    folder: Path
    failures: tuple[Failure, ...]
    accuracy: float | None  # Estimated share of right labels, 0…1; None if unknown
    verdict: Verdict | None  # What to do with such labels


def label_picked_scans(
    data_set: Path, settings: NetworkSettings, options: RunOptions
) -> PickedLabels:
    """Predict the scans of a data set of `pick` into a folder in it.

    Parameters
    ----------
    data_set : Path
        Data set of picked scans.
    settings : NetworkSettings
        Network of the choice.
    options : RunOptions
        Workers; whether to replace the results of an earlier choice.

    Returns
    -------
    PickedLabels
    """
    out = data_set / PREDICTED
    if options.overwrite:
        # Results of scans that are no longer picked would stay.
        earlier = OwnedFolder(out, "predict")
        earlier.remove_written(earlier.written())
    has_error_model = read_card(settings.path).error is not None
    with _warnings_silenced():
        outcome = predict_scans(
            data_set,
            out,
            settings=replace(settings, columns=COLUMNS, intensity_field=None),
            extras=(ERROR,) if has_error_model else (),
            options=options,
        )
    summary = outcome.summary
    scans = len(find_outputs(out, "predictions"))
    if summary is None or summary.space is None or not scans:
        return PickedLabels(folder=out, failures=outcome.failures, accuracy=None, verdict=None)
    expected = summary.expected_accuracy()
    evidence = Evidence(
        scans=scans,
        class_count=summary.space.class_count,
        expected=expected,
        doubtful=doubtful_share(out),
        warned={warning.code: warning.scans for warning in summary.warnings()},
    )
    accuracy = expected.accuracy if expected else None
    return PickedLabels(
        folder=out, failures=outcome.failures, accuracy=accuracy, verdict=verdict(evidence)
    )


def doubtful_share(out: Path) -> float | None:
    """Return the share of the points with a label, 0…1, whose error is above `DOUBTFUL`.

    None without such results.
    """
    doubtful = 0
    points = 0
    for path in find_outputs(out, ERROR).values():
        error = read_kind(path, "error", None)
        labelled = np.isfinite(error)
        doubtful += int((error[labelled] > np.float32(DOUBTFUL)).sum())
        points += int(labelled.sum())
    return doubtful / points if points else None


@contextmanager
def _warnings_silenced() -> Iterator[None]:
    """Print no notices and warnings: the choice of these scans has printed them."""
    log = logging.getLogger("salsanext_cli")
    level = log.level
    log.setLevel(logging.ERROR)
    try:
        yield
    finally:
        log.setLevel(level)
