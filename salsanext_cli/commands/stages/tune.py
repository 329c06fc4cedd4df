# SPDX-License-Identifier: MIT
"""Stages of `tune`: one part of the weights, fitted to scans; each has a report of its own.

Scans that the weights were trained on, and copies, are skipped. A fit that is not better on
held-out scans leaves the part as it is.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Generic, TypeVar

from salsanext_cli.commands.jobs.risk_picture import risk_picture
from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.engines.device import is_int8
from salsanext_cli.core.errors import WeightsError
from salsanext_cli.core.network.card import RiskThreshold, WeightsCard
from salsanext_cli.core.network.tuned_settings import KEY_OF
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.plain_data import plain
from salsanext_cli.io.files.atomic import require_target, write_target
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.runs.loop.run import Progress
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_selection import ScanSelection
from salsanext_cli.runs.scans.selection import select_scans
from salsanext_cli.training.tuning.risk_level import RiskLevel, require_scans
from salsanext_cli.training.tuning.scan_choice import labelled_scans, unseen_scans
from salsanext_cli.training.tuning.scans import TuningScans

if TYPE_CHECKING:
    # They import torch, which takes a second; `--help` and wrong usage need none of them.
    from salsanext_cli.training.tuning.dropout_rate import DropoutFit
    from salsanext_cli.training.tuning.error import ErrorFit
    from salsanext_cli.training.tuning.risk_report import RiskFit
    from salsanext_cli.training.tuning.temperature import TemperatureFit

Fit = TypeVar("Fit")

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class TuneReport(Generic[Fit]):
    """Report of a stage that fits a part of the weights to labelled scans."""

    part: str  # As on the command line
    fit: Fit
    skipped: int  # Scans that the weights were trained on, and copies
    weights: Path  # File that was written
    picture: Path | None = None  # Picture of the fit, if it has one

    def to_dict(self) -> dict[str, object]:
        """Return plain data for JSON, with the fields of the fit in the same object."""
        data = {
            "stage": f"tune {self.part}",
            **plain(self.fit),
            "skipped": self.skipped,
            "weights": str(self.weights),
        }
        return data if self.picture is None else {**data, "picture": str(self.picture)}


@dataclass(frozen=True, slots=True, kw_only=True)
class Int8Report:
    """Report of `tune int8`."""

    scans: int
    layers: int  # Quantised layers
    weights: Path  # File that was written

    def to_dict(self) -> dict[str, object]:
        """Return plain data for JSON."""
        return {
            "stage": "tune int8",
            "scans": self.scans,
            "layers": self.layers,
            "weights": str(self.weights),
        }


def tune_temperature(
    source: Path,
    target: Path,
    *,
    settings: NetworkSettings = NetworkSettings(),
    selection: ScanSelection = ScanSelection(),
    overwrite: bool = False,
    progress: Progress | None = None,
) -> "TuneReport[TemperatureFit]":
    """Write weights with the temperature that calibrates the class probabilities.

    Parameters
    ----------
    source : Path
        Labelled data set.
    target : Path
        Weights file to write.
    settings : NetworkSettings
        Network that the temperature is for.
    selection : ScanSelection
        By default the scans of the split ``valid`` and of no split.
    overwrite : bool
        Whether to replace an existing file.
    progress : callable, optional
        Called after each scan with the number of finished scans and of all scans.

    Returns
    -------
    TuneReport
    """
    candidates = _candidates(source, target, settings, selection, overwrite=overwrite)
    from salsanext_cli.training.tuning.temperature import fit_temperature

    chosen = candidates.chosen(settings, progress)
    tuned = fit_temperature(chosen.scans)
    if not tuned.fit.changed:
        chosen.log_unchanged("temperature")
    _write(settings, target, tuned.card, overwrite=overwrite)
    return TuneReport(part="temperature", fit=tuned.fit, skipped=chosen.skipped, weights=target)


def tune_error(
    source: Path,
    target: Path,
    *,
    settings: NetworkSettings = NetworkSettings(),
    selection: ScanSelection = ScanSelection(),
    overwrite: bool = False,
    progress: Progress | None = None,
) -> "TuneReport[ErrorFit]":
    """Write weights with a model of the probability that a label is wrong.

    Parameters
    ----------
    source : Path
        Labelled data set.
    target : Path
        Weights file to write.
    settings : NetworkSettings
        Network whose labels are judged.
    selection : ScanSelection
        By default the scans of the split ``valid`` and of no split.
    overwrite : bool
        Whether to replace an existing file.
    progress : callable, optional
        Called after each scan with the number of finished scans and of all scans.

    Returns
    -------
    TuneReport
    """
    candidates = _candidates(source, target, settings, selection, overwrite=overwrite)
    from salsanext_cli.training.tuning.error import fit_error_model

    chosen = candidates.chosen(settings, progress)
    tuned = fit_error_model(chosen.scans)
    if not tuned.fit.changed:
        chosen.log_unchanged("error model")
    _write(settings, target, tuned.card, overwrite=overwrite)
    return TuneReport(part="error", fit=tuned.fit, skipped=chosen.skipped, weights=target)


def tune_risk(
    source: Path,
    target: Path,
    *,
    at_most: float,
    confidence: float | None = None,
    settings: NetworkSettings = NetworkSettings(),
    selection: ScanSelection = ScanSelection(),
    overwrite: bool = False,
    progress: Progress | None = None,
) -> "TuneReport[RiskFit]":
    """Write weights with the threshold of `predict --reject risk`, and a picture of the risk.

    Parameters
    ----------
    source : Path
        Labelled data set.
    target : Path
        Weights file to write; the picture is beside it, with ``_risk.png`` after its stem.
    at_most : float
        Largest share of the points that are accepted and wrong, 0…1.
    confidence : float, optional
        Share of scans or drives within the limit, 0…1; by default the limit is for their mean.
    settings : NetworkSettings
        Network whose labels are judged.
    selection : ScanSelection
        By default the scans of the split ``valid`` and of no split.
    overwrite : bool
        Whether to replace an existing file.
    progress : callable, optional
        Called after each scan with the number of finished scans and of all scans.

    Returns
    -------
    TuneReport

    Raises
    ------
    TooFewScansError
        If so few scans cannot guarantee the level.
    """
    candidates = _candidates(source, target, settings, selection, overwrite=overwrite)
    picture = target.with_name(f"{target.stem}_risk.png")
    require_target(picture, overwrite, ".png")
    level = RiskLevel(at_most=at_most, confidence=confidence)
    require_scans(source, candidates.count, level)
    from salsanext_cli.training.tuning.risk import fit_risk

    chosen = candidates.chosen(settings, progress)
    tuned = fit_risk(chosen.scans, level)
    png = risk_picture(tuned.fit)
    _write(settings, target, tuned.card, overwrite=overwrite)
    write_target(picture, png, overwrite=overwrite)
    return TuneReport(
        part="risk", fit=tuned.fit, skipped=chosen.skipped, weights=target, picture=picture
    )


def tune_dropout(
    source: Path,
    target: Path,
    *,
    samples: int = 30,
    settings: NetworkSettings = NetworkSettings(),
    selection: ScanSelection = ScanSelection(),
    overwrite: bool = False,
    progress: Progress | None = None,
) -> "TuneReport[DropoutFit]":
    """Write weights with the best dropout rate for `uncertainty`.

    Parameters
    ----------
    source : Path
        Labelled data set.
    target : Path
        Weights file to write.
    samples : int
        Monte-Carlo passes per scan and rate.
    settings : NetworkSettings
        Network that is sampled.
    selection : ScanSelection
        By default the scans of the split ``valid`` and of no split.
    overwrite : bool
        Whether to replace an existing file.
    progress : callable, optional
        Called after each scan with the number of finished scans and of all scans.

    Returns
    -------
    TuneReport
    """
    candidates = _candidates(source, target, settings, selection, overwrite=overwrite)
    from salsanext_cli.training.tuning.dropout_rate import fit_dropout

    chosen = candidates.chosen(settings, progress)
    tuned = fit_dropout(chosen.scans, samples)
    if not tuned.fit.changed:
        chosen.log_unchanged("dropout rate")
    _write(settings, target, tuned.card, overwrite=overwrite)
    return TuneReport(part="dropout", fit=tuned.fit, skipped=chosen.skipped, weights=target)


def tune_int8(
    source: Path,
    target: Path,
    *,
    settings: NetworkSettings = NetworkSettings(),
    selection: ScanSelection = ScanSelection(),
    overwrite: bool = False,
) -> Int8Report:
    """Write weights with the ranges for `--precision int8`, fitted to scans without labels.

    Parameters
    ----------
    source : Path
        Scans, which need no labels.
    target : Path
        Weights file to write.
    settings : NetworkSettings
        Network, which computes in float32 on the CPU.
    selection : ScanSelection
        Choice of the scans; a limit takes evenly spaced ones.
    overwrite : bool
        Whether to replace an existing file.

    Returns
    -------
    Int8Report

    Raises
    ------
    WeightsError
        If the network has no layer that int8 can compute.
    """
    require_target(target, overwrite)
    space = read_card(settings.path).space
    files = select_scans(source, selection, space, evenly=True)

    from salsanext_cli.runs.fit.scan_reading import read_prepared
    from salsanext_cli.training.tuning.int8 import int8_inputs
    from salsanext_cli.training.tuning.scans import FitOfScans

    exact = replace(settings, device="cpu", precision="float32")
    network = exact.load()
    fit = FitOfScans.from_files(files, source, exact, network)
    inputs = [
        read_prepared(file, fit.network, fit.origins.get(file.name)).scan.input for file in files
    ]
    int8 = int8_inputs(network.module, inputs)
    if not int8:
        raise WeightsError(settings.path, "has no hidden layer that int8 can compute")
    card = replace(_without_thresholds_of_int8(network.card), int8=int8)
    _write(settings, target, card, overwrite=overwrite)
    return Int8Report(scans=len(files), layers=len(int8), weights=target)


def _without_thresholds_of_int8(card: WeightsCard) -> WeightsCard:
    """Return a card without thresholds chosen with int8, of any width: new ranges end them."""

    def is_of_int8(risk: RiskThreshold | None) -> bool:
        return risk is not None and is_int8(risk.settings.get(KEY_OF["precision"]))

    if any(is_of_int8(parts.risk) for parts in (card.parts, *card.parts_of_widths.values())):
        log.log(NOTICE, "the threshold of `tune risk` is removed: it was chosen with other ranges")
    return card.without_risk(is_of_int8)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Chosen:
    """Scans of a fit with the loaded network, and the number of skipped ones."""

    scans: TuningScans
    skipped: int

    def log_unchanged(self, name: str) -> None:
        """Log that the named part of the weights stays as it is, and why."""
        reason = "the new fit is not better on held-out scans"
        if len(self.scans.files) == 1:
            reason = "a single scan cannot show that a new fit is better"
        log.log(NOTICE, "the %s is unchanged: %s", name, reason)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Candidates:
    """Labelled scans that a part of the weights may be fitted to."""

    source: Path
    files: Sequence[ScanFile]
    space: LabelSpace  # Classes of the labels
    limit: int | None  # Largest number of scans that are used

    @property
    def count(self) -> int:
        """Number of scans that are used if the weights were trained on none of them."""
        return min(len(self.files), self.limit or len(self.files))

    def chosen(self, settings: NetworkSettings, progress: Progress | None) -> _Chosen:
        """Load the network, and choose the scans that its weights were not trained on."""
        network = settings.load()
        chosen = unseen_scans(self.files, network, self.source, self.limit)
        scans = TuningScans(
            source=self.source,
            files=chosen.files,
            space=self.space,
            settings=settings,
            loaded=network,
            progress=progress,
        )
        return _Chosen(scans=scans, skipped=chosen.skipped)


def _candidates(
    source: Path,
    target: Path,
    settings: NetworkSettings,
    selection: ScanSelection,
    *,
    overwrite: bool,
) -> _Candidates:
    """Find the labelled scans of a fit; refuse an existing file first."""
    require_target(target, overwrite)
    labelled = labelled_scans(source, selection, read_card(settings.path))
    return _Candidates(
        source=source, files=labelled.files, space=labelled.space, limit=selection.limit
    )


def _write(settings: NetworkSettings, target: Path, card: WeightsCard, *, overwrite: bool) -> None:
    """Write the weights with another card, which is no longer that of a version."""
    from salsanext_cli.io.weights.weights import save_with_card

    save_with_card(settings.path, target, replace(card, version=None), overwrite=overwrite)
