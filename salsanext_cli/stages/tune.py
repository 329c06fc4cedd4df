# SPDX-License-Identifier: MIT
"""Stage `tune`: one part of the weights, fitted to scans."""

import logging
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.engines.network import Network
from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.errors import NOTICE
from salsanext_cli.files.atomic import require_target
from salsanext_cli.network.weights import save_with_card
from salsanext_cli.option_fields import ScanSelection
from salsanext_cli.parallel.run import Progress
from salsanext_cli.results.paths import ScanFile
from salsanext_cli.results.selection import select_scans
from salsanext_cli.training.tuning.dropout_rate import fit_dropout
from salsanext_cli.training.tuning.error import fit_error_model
from salsanext_cli.training.tuning.int8 import fit_int8
from salsanext_cli.training.tuning.risk import fit_risk
from salsanext_cli.training.tuning.scans import Tuned, TuningScans, labelled_scans, unseen
from salsanext_cli.training.tuning.temperature import fit_temperature

NAMES = {"error": "error model", "dropout": "dropout rate"}  # Names of parts in messages

log = logging.getLogger(__name__)

FITS: dict[str, Callable[..., Tuned]] = {
    "temperature": fit_temperature,
    "error": fit_error_model,
    "dropout": fit_dropout,
    "risk": fit_risk,
    "int8": fit_int8,
}
"""Functions that fit a part of the weights to `TuningScans`."""


def tune(
    part: str,
    source: Path,
    target: Path,
    *,
    settings: NetworkSettings = NetworkSettings(),
    selection: ScanSelection = ScanSelection(),
    overwrite: bool = False,
    progress: Progress | None = None,
    **numbers: Any,
) -> dict[str, Any]:
    """Write weights with one part fitted to labelled scans, and return the report of the fit.

    Scans that the weights were trained on, and copies, are skipped. A fit that is not better on
    held-out scans leaves the part as it is.

    Parameters
    ----------
    part : {"temperature", "error", "dropout", "risk", "int8"}
    source, target : Path
        Labelled data set, for int8 any scans, and weights file to write.
    settings, selection : NetworkSettings, ScanSelection
        By default the scans are those of the split ``valid`` and of no split, for int8 all.
    overwrite : bool
        Whether to replace an existing file.
    progress : callable, optional
        Called after each scan with the number of finished scans and of all scans.
    **numbers
        Further arguments of the fit.

    Returns
    -------
    dict
        Plain data for JSON.
    """
    if part == "int8":
        settings = replace(settings, precision="float32")  # The weights may have no ranges yet
    network = settings.load()
    require_target(target, overwrite)
    every, files, space = _scans(part, source, selection, network)
    scans = TuningScans(source, files, space, settings, network, progress)
    card, results = FITS[part](scans, **numbers)
    report = {"stage": f"tune {part}", **results, "skipped": len(every) - len(files)}
    if not report.get("changed", True):
        reason = "the new fit is not better on held-out scans"
        if len(files) == 1:
            reason = "a single scan cannot show that a new fit is better"
        log.log(NOTICE, "the %s is unchanged: %s", NAMES.get(part, part), reason)
    save_with_card(settings.path, target, replace(card, version=None), overwrite=overwrite)
    return report


def _scans(
    part: str, source: Path, selection: ScanSelection, network: Network
) -> tuple[list[ScanFile], list[ScanFile], LabelSpace]:
    """Return the selected scans, the scans to fit a part to, and the classes of their labels."""
    if part == "int8":
        scans = select_scans(source, selection, network.space, evenly=True)
        return scans, scans, network.space
    scans, space = labelled_scans(source, selection, network.card)
    return scans, unseen(scans, network, source), space
