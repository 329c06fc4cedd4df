# SPDX-License-Identifier: MIT
"""Stage `tune`: one part of the weights, fitted to scans."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from salsanext_cli.engines.network import Network
from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.files.atomic import require_absent, require_target
from salsanext_cli.fitting.scan_fit import ScanSample, fit_scans
from salsanext_cli.network.card import require_tensors
from salsanext_cli.network.weights import save_with_card
from salsanext_cli.options import ScanSelection
from salsanext_cli.parallel.run import Progress
from salsanext_cli.report.plots import rate_curve
from salsanext_cli.results.layout import find_scans
from salsanext_cli.results.selection import select_evenly
from salsanext_cli.training.tuning.batchnorm import fit_batchnorm, require_batchnorm
from salsanext_cli.training.tuning.dropout_rate import fit_dropout, require_dropout_search
from salsanext_cli.training.tuning.error import fit_error_model
from salsanext_cli.training.tuning.scans import VALIDATION, Tuned, TuningScans, labelled_scans
from salsanext_cli.training.tuning.temperature import fit_temperature


def _require_nothing(_: Network) -> None: ...


@dataclass(frozen=True, slots=True)
class Part:
    """Part of the weights that can be fitted."""

    fit: Callable[..., Tuned]  # Takes `TuningScans`, and the numbers of its own
    # Takes the network and the numbers; raises what is wrong with them before a scan is read
    require: Callable[..., object] = _require_nothing
    labelled: bool = True  # Whether it needs labels


PARTS = {
    "temperature": Part(fit_temperature),
    "error": Part(fit_error_model),
    "dropout": Part(fit_dropout, require_dropout_search),
    "batchnorm": Part(fit_batchnorm, require_batchnorm, labelled=False),
}


def tune(
    part: str,
    source: Path,
    target: Path,
    *,
    network: NetworkSettings = NetworkSettings(),
    selection: ScanSelection | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
    **numbers: Any,
) -> dict[str, Any]:
    """Write a weights file of which one part is fitted to scans; all else stays, bit for bit.

    `part`: a name of `PARTS`; `source`: labelled scans that the network was not trained on, but any
    scans for "batchnorm"; `target`: the `.safetensors` file to write; `network`: weights, device
    and sensor; `selection`: which scans, by default those for validation, or all where no labels
    are needed; a limit takes scans that are evenly spaced; `overwrite`: whether the target may
    exist; `progress`: called after each step; `numbers`: of the part's `fit`.

    Returns plain data: the name of the `stage`, and what the part's `fit` reports.
    """
    way = PARTS[part]
    require_tensors(network.path)
    loaded = network.load()
    way.require(loaded, **numbers)
    if way.labelled:
        files, space = labelled_scans(source, selection or VALIDATION, loaded.card)
    else:
        space = loaded.card.space
        files = select_evenly(source, selection or ScanSelection(), space)
    require_target(target, overwrite)
    if part == "dropout":
        require_absent(curve_of(target), overwrite)
    loaded = fit_scans(network, loaded, ScanSample(find_scans(source), loaded.sensor))
    network.announce(loaded)
    tuned = way.fit(TuningScans(source, files, space, loaded, progress), **numbers)
    report = tuned.report
    if part == "dropout":
        rate_curve(curve_of(target), report["rates"], report["objectives"], report["best"])
    save_with_card(network.path, target, tuned.card, tuned.tensors)
    return {"stage": f"tune {part}", **report}


def curve_of(target: Path) -> Path:
    """Return the path of the curve of "dropout" that goes with a weights file."""
    return target.with_name(f"{target.stem}_dropout.png")
