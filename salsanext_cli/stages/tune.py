# SPDX-License-Identifier: MIT
"""Stage `tune`: one part of the weights, fitted to scans."""

import logging
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from salsanext_cli.engines.network import Network
from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.errors import NOTICE, NoInputError, WeightsError
from salsanext_cli.files.atomic import require_absent, require_target, writing
from salsanext_cli.fitting.sensor_fit import ScanSample, fit_scans
from salsanext_cli.network.weights import save_with_card
from salsanext_cli.option_fields import ScanSelection
from salsanext_cli.parallel.run import Progress
from salsanext_cli.records import Float
from salsanext_cli.report.tuning_plots import risk_curve
from salsanext_cli.results.selection import select_scans
from salsanext_cli.training.tuning.dropout_rate import fit_dropout
from salsanext_cli.training.tuning.error import fit_error_model
from salsanext_cli.training.tuning.int8 import fit_int8, inputs_of
from salsanext_cli.training.tuning.risk import fit_risk
from salsanext_cli.training.tuning.scans import Tuned, TuningScans, labelled_scans, unseen
from salsanext_cli.training.tuning.temperature import fit_temperature

USUAL_EQUAL = 0.98  # Least share of equal labels of int8 and float32 that needs no warning
NAMES = {"error": "error model", "dropout": "dropout rate"}  # Names of parts in messages

log = logging.getLogger(__name__)

FITS: dict[str, Callable[..., Tuned]] = {
    "temperature": fit_temperature,
    "error": fit_error_model,
    "dropout": fit_dropout,
    "risk": fit_risk,
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
    network = settings.load()
    labelled, space = labelled_scans(source, selection, network.card)
    require_target(target, overwrite)
    curve = target.with_name(f"{target.stem}_risk.png")
    if part == "risk":
        require_absent(curve, overwrite)
    files = unseen(labelled, network, source)
    scans = TuningScans(source, files, space, settings, network, progress)
    card, results = FITS[part](scans, **numbers)
    report = {"stage": f"tune {part}", **results, "skipped": len(labelled) - len(files)}
    if not report.get("changed", True):
        reason = "the new fit is not better on held-out scans"
        if len(files) == 1:
            reason = "a single scan cannot show that a new fit is better"
        log.log(NOTICE, "the %s is unchanged: %s", NAMES.get(part, part), reason)
    with ExitStack() as whole:
        if part == "risk":
            # The curve gets its name after the weights, so that neither exists without the other.
            file = whole.enter_context(writing(curve, overwrite=overwrite))
            file.write(risk_curve(report))
            file.flush()
            report["curve"] = str(curve)
        save_with_card(settings.path, target, replace(card, version=None), overwrite=overwrite)
    return report


def tune_int8(
    source: Path,
    target: Path,
    *,
    settings: NetworkSettings = NetworkSettings(),
    selection: ScanSelection = ScanSelection(),
    overwrite: bool = False,
) -> dict[str, Any]:
    """Write weights with ranges for ``--precision int8``, and compare the labels with float32.

    Parameters
    ----------
    source, target : Path
        Scans, which need no labels, and weights file to write.
    settings, selection : NetworkSettings, ScanSelection
        Up to 16 of the scans are read, evenly spaced.
    overwrite : bool
        Whether to replace an existing file.

    Returns
    -------
    dict
        Plain data for JSON: numbers of scans and layers, and `equal`, the share of the occupied
        pixels with the same label in float32 and int8; None without OpenVINO.

    Raises
    ------
    NoInputError
        If no scan can be read.
    WeightsError
        If the network has no layer that int8 can compute.
    """
    network = replace(settings, precision="float32").load()
    files = select_scans(source, selection, network.card.space, evenly=True)
    require_target(target, overwrite)
    sample = ScanSample(files, network.sensor)
    network = fit_scans(settings, network, sample)
    settings.announce(network)
    inputs = inputs_of(network, sample.scans)
    if not inputs:
        raise NoInputError(source, "has no readable scan", "scans that `predict` can label")
    int8 = fit_int8(network.module, inputs)
    if not int8.layers:
        raise WeightsError(settings.path, "has no hidden layer that int8 can compute")
    card = replace(network.card, int8=int8, version=None)
    save_with_card(settings.path, target, card, overwrite=overwrite)
    equal = None
    if network.backend.library == "openvino":
        tuned = replace(settings, weights=target, device="cpu", precision="int8").load()
        equal = _equal_labels(network, tuned, inputs)
        if equal < USUAL_EQUAL:
            differ = 100 - 100 * equal
            log.warning("%s: int8 changes %.1f %% of the labels of these scans", target, differ)
    return {"stage": "tune int8", "scans": len(inputs), "layers": len(int8.layers), "equal": equal}


def _equal_labels(network: Network, other: Network, inputs: Sequence[Float]) -> float:
    """Return the share of the pixels with a point that two networks label the same."""
    equal = occupied = 0
    for image in inputs:
        labels, others = (n.backend.predict([image], 1.0)[0].labels for n in (network, other))
        there = image[0].any(axis=0)  # Empty pixels are 0 in all channels
        equal += int(((labels == others) & there).sum())
        occupied += int(there.sum())
    return equal / occupied
