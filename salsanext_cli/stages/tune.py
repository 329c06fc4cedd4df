# SPDX-License-Identifier: MIT
"""Stage `tune`: one part of the weights, fitted to scans."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.files.atomic import require_absent, require_target
from salsanext_cli.network.card import require_tensors
from salsanext_cli.network.weights import save_with_card
from salsanext_cli.options import ScanSelection
from salsanext_cli.parallel.run import Progress
from salsanext_cli.report.tuning_plots import risk_curve
from salsanext_cli.training.tuning.dropout_rate import fit_dropout
from salsanext_cli.training.tuning.error import fit_error_model
from salsanext_cli.training.tuning.risk import fit_risk
from salsanext_cli.training.tuning.scans import VALIDATION, Tuned, TuningScans, labelled_scans
from salsanext_cli.training.tuning.temperature import fit_temperature

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
    selection: ScanSelection | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
    **numbers: Any,
) -> dict[str, Any]:
    """Write weights of which one part is fitted to scans; return what its fit reports.

    `part`: a name of `FITS`; `selection`: by default the scans for validation, and a limit takes
    evenly spaced ones; `numbers`: those of the part's fit.
    """
    fit = FITS[part]
    require_tensors(settings.path)
    network = settings.load()
    files, space = labelled_scans(source, selection or VALIDATION, network.card)
    require_target(target, overwrite)
    curve = target.with_name(f"{target.stem}_risk.png")
    if part == "risk":
        require_absent(curve, overwrite)
    card, found = fit(TuningScans(source, files, space, settings, network, progress), **numbers)
    report = {"stage": f"tune {part}", **found}
    if part == "risk":
        risk_curve(curve, report)
        report["curve"] = str(curve)
    save_with_card(settings.path, target, card)
    return report
