# SPDX-License-Identifier: MIT
"""Stage `tune`: one part of the weights, fitted to scans."""

import logging
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from salsanext_cli.core.errors import WeightsError
from salsanext_cli.core.network.tuned_settings import KEY_OF
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.io.files.atomic import require_target
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.runs.loop.run import Progress
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.results.scan_selection import ScanSelection
from salsanext_cli.runs.results.selection import select_scans
from salsanext_cli.training.tuning.risk_level import RiskLevel, require_scans
from salsanext_cli.training.tuning.scan_choice import labelled_scans, unseen
from salsanext_cli.training.tuning.scans import Tuned, TuningScans

NAMES = {"error": "error model", "dropout": "dropout rate"}  # Names of parts in messages

log = logging.getLogger(__name__)


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
    part : {"temperature", "error", "dropout", "risk"}
    source, target : Path
        Labelled data set, and weights file to write.
    settings, selection : NetworkSettings, ScanSelection
        By default the scans are those of the split ``valid`` and of no split.
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
    require_target(target, overwrite)
    candidates, space = labelled_scans(source, selection, read_card(settings.path))
    if part == "risk":
        count = min(len(candidates), selection.limit or len(candidates))
        require_scans(source, count, RiskLevel(**numbers))
    # From here on it takes seconds: torch is imported, and the network is loaded.
    fit = _fit_of(part)
    network = settings.load()
    chosen = unseen(candidates, network, source, selection.limit)
    scans = TuningScans(source, chosen.files, space, settings, network, progress)
    card, results = fit(scans, **numbers)
    report = {"stage": f"tune {part}", **results, "skipped": chosen.skipped}
    if not report.get("changed", True):
        reason = "the new fit is not better on held-out scans"
        if len(chosen.files) == 1:
            reason = "a single scan cannot show that a new fit is better"
        log.log(NOTICE, "the %s is unchanged: %s", NAMES.get(part, part), reason)
    from salsanext_cli.io.weights.weights import save_with_card

    save_with_card(settings.path, target, replace(card, version=None), overwrite=overwrite)
    return report


def _fit_of(part: str) -> Callable[..., Tuned]:
    """Return the function that fits a part to `TuningScans`; importing torch takes a second."""
    from salsanext_cli.training.tuning.dropout_rate import fit_dropout
    from salsanext_cli.training.tuning.error import fit_error_model
    from salsanext_cli.training.tuning.risk import fit_risk
    from salsanext_cli.training.tuning.temperature import fit_temperature

    fits: dict[str, Callable[..., Tuned]] = {
        "temperature": fit_temperature,
        "error": fit_error_model,
        "dropout": fit_dropout,
        "risk": fit_risk,
    }
    return fits[part]


def tune_int8(
    source: Path,
    target: Path,
    *,
    settings: NetworkSettings = NetworkSettings(),
    selection: ScanSelection = ScanSelection(),
    overwrite: bool = False,
) -> dict[str, Any]:
    """Write weights with the ranges for `--precision int8`, fitted to scans without labels.

    Parameters
    ----------
    source, target : Path
        Scans, and weights file to write.
    settings, selection : NetworkSettings, ScanSelection
        The network computes in float32 on the CPU; a limit takes evenly spaced scans.
    overwrite : bool
        Whether to replace an existing file.

    Returns
    -------
    dict
        Plain data for JSON: numbers of scans and of quantised layers.
    """
    require_target(target, overwrite)
    space = read_card(settings.path).space
    files = select_scans(source, selection, space, evenly=True)

    from salsanext_cli.io.weights.weights import save_with_card
    from salsanext_cli.runs.fit.scan_reading import read_prepared
    from salsanext_cli.training.tuning.int8 import int8_inputs

    network = replace(settings, device="cpu", precision="float32").load()
    inputs = [read_prepared(file, network).scan.input for file in files]
    if not (int8 := int8_inputs(network.module, inputs)):
        raise WeightsError(settings.path, "has no hidden layer that int8 can compute")
    risk = network.card.risk
    if risk and risk.settings.get(KEY_OF["precision"]) == "int8":
        log.log(NOTICE, "the threshold of `tune risk` is removed: it was chosen with other ranges")
        risk = None
    card = replace(network.card, int8=int8, risk=risk, version=None)
    save_with_card(settings.path, target, card, overwrite=overwrite)
    return {"stage": "tune int8", "scans": len(files), "layers": len(int8)}
