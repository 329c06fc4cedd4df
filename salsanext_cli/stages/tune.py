# SPDX-License-Identifier: MIT
"""Stage `tune`: one part of the weights, fitted to scans."""

import logging
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.errors import NOTICE
from salsanext_cli.files.atomic import require_absent, require_target, writing
from salsanext_cli.network.weights import save_with_card
from salsanext_cli.option_fields import ScanSelection
from salsanext_cli.parallel.run import Progress
from salsanext_cli.report.tuning_plots import risk_curve
from salsanext_cli.training.tuning.dropout_rate import fit_dropout
from salsanext_cli.training.tuning.error import fit_error_model
from salsanext_cli.training.tuning.risk import fit_risk
from salsanext_cli.training.tuning.scans import Tuned, TuningScans, labelled_scans, unseen
from salsanext_cli.training.tuning.temperature import fit_temperature

NAMES = {"error": "error model", "dropout": "dropout rate"}  # Names of parts in sentences

log = logging.getLogger(__name__)

FITS: dict[str, Callable[..., Tuned]] = {
    "temperature": fit_temperature,
    "error": fit_error_model,
    "dropout": fit_dropout,
    "risk": fit_risk,
}
"""Functions that fit a part of the weights: take `TuningScans`, and numbers of their own."""


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
    """Write weights of which one part is fitted to scans; return what its fit reports.

    `part`: a name of `FITS`; `selection`: as `labelled_scans` takes it; `numbers`: those of the
    part's fit. Scans that the weights were trained on, and copies, are skipped. A fit that is no
    better than the weights on held-out scans leaves them as they are.
    """
    fit = FITS[part]
    network = settings.load()
    labelled, space = labelled_scans(source, selection, network.card)
    require_target(target, overwrite)
    curve = target.with_name(f"{target.stem}_risk.png")
    if part == "risk":
        require_absent(curve, overwrite)
    files = unseen(labelled, network, source)
    card, found = fit(TuningScans(source, files, space, settings, network, progress), **numbers)
    report = {"stage": f"tune {part}", **found, "skipped": len(labelled) - len(files)}
    if not report.get("changed", True):
        why = "the new fit is not better on held-out scans"
        if len(files) == 1:
            why = "a single scan cannot show that a new fit is better"
        log.log(NOTICE, "the %s is unchanged: %s", NAMES.get(part, part), why)
    with ExitStack() as whole:
        if part == "risk":
            # It gets its name after the weights, so that neither is there without the other.
            file = whole.enter_context(writing(curve, overwrite=overwrite))
            file.write(risk_curve(report))
            file.flush()
            report["curve"] = str(curve)
        save_with_card(settings.path, target, replace(card, version=None), overwrite=overwrite)
    return report
