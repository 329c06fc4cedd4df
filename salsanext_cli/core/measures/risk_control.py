# SPDX-License-Identifier: MIT
"""Threshold of an uncertainty chosen from labelled scans, with a guarantee about a new scan.

The loss of a scan at a threshold is the share of its scored points that are accepted and wrong. It
rises with the threshold. Scans, or drives if there are enough, are assumed to be exchangeable;
points are not. Consecutive scans of a drive are not exchangeable with later ones. The loss of a
drive is the mean of its scans. Arrays of losses are (n, T): scans or drives by rising threshold.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.measures.accepted_labels import AcceptedCounts
from salsanext_cli.core.measures.scores import Ratios
from salsanext_cli.core.network.card import RiskThreshold
from salsanext_cli.core.texts import counted, first_few, percentage

CONSECUTIVE = "most of the scans that the threshold was chosen on follow each other"
RISK_BOUND_EXCEEDED = (
    "the share of accepted and wrong points exceeds the limit of the guarantee: by chance, in the "
    "choice of these scans or of those that the threshold was chosen on, or because location, "
    "sensor or weather differ\nhint: choose the threshold with `salsanext tune risk` on more "
    "labelled scans like these"
)


def means_of_units(losses: Ratios, units: npt.NDArray[Any]) -> Ratios:
    """Return the mean loss of each unit, such as a drive.

    Parameters
    ----------
    losses : (n, …) float64
        Losses of the scans.
    units : (n,) array
        Name of the unit of each scan.

    Returns
    -------
    (U, …) float64
        In the sorted order of the names.
    """
    return np.stack([losses[units == unit].mean(axis=0) for unit in np.unique(units)])


def held_thresholds(
    losses: Ratios, at_most: float, confidence: float | None = None, scans: int | None = None
) -> int:
    """Return the number of thresholds that hold a level.

    Without a confidence they bound the expected loss of a new scan: (Σ losses + 1) / (n + 1) ≤
    level, conformal risk control (Angelopoulos et al. 2022, arXiv 2208.02814, eq. 4) of a loss of
    at most 1. The expectation is also over the choice of the n scans. Otherwise, with this
    confidence over that choice, at most a share 1 − confidence of all scans has a larger loss.

    Parameters
    ----------
    losses : (n, T) float64
        Losses of scans or drives by rising threshold, 0…1.
    at_most : float
        The level, 0…1.
    confidence : float, optional
        Confidence, 0…1; None bounds the expected loss.
    scans : int, optional
        The number n, if it is not that of the losses.

    Returns
    -------
    int
    """
    n = scans or len(losses)
    if confidence is None:
        return int(((n * losses.mean(axis=0) + 1) / (n + 1) <= at_most).sum())
    return int(((losses > at_most).sum(axis=0) <= allowed_scans(n, confidence)).sum())


def allowed_scans(scans: int, confidence: float) -> int:
    """Return the number of bad scans among n that 1 − confidence still bounds; −1: n is too small.

    It is the largest for which the bound of Clopper and Pearson (1934) is low enough.
    """
    bad = 0
    while binomial(bad, scans, 1 - confidence) <= 1 - confidence:
        bad += 1
    return bad - 1


def binomial(most: int, count: int, chance: float) -> float:
    """Return the probability of at most so many events.

    Parameters
    ----------
    most : int
        Largest number of events.
    count : int
        Number of trials.
    chance : float
        Probability of an event in a trial, above 0 and at most 1.

    Returns
    -------
    float
    """
    if most >= count or chance >= 1:
        return float(most >= count)
    logs = (
        math.lgamma(count + 1)
        - math.lgamma(k + 1)
        - math.lgamma(count - k + 1)
        + k * math.log(chance)
        + (count - k) * math.log1p(-chance)
        for k in range(most + 1)
    )
    return math.fsum(map(math.exp, logs))


def needed_scans(at_most: float, confidence: float | None) -> int:
    """Return the least number of scans for which a threshold can hold a level."""
    if confidence is None:
        # Rounded, as 1 / 0.05 - 1 is more than 19 by the last digit.
        return math.ceil(round(1 / at_most - 1, 9))
    return math.ceil(round(math.log(1 - confidence) / math.log(confidence), 9))


def share_left(scans: int, at_most: float) -> float:
    """Return the largest mean of the losses of n scans that holds a level: ((n + 1) a − 1) / n.

    The rest of the level is set aside for the new scan. Below 0, no threshold holds it.
    """
    return ((scans + 1) * at_most - 1) / scans


def useful_scans(at_most: float, confidence: float | None) -> int:
    """Return the least number of scans that leaves room for wrong labels.

    On average it is half of the level; with a confidence, one scan may exceed it.
    """
    needed = needed_scans(at_most, confidence)
    if confidence is None:
        return 2 * needed
    while allowed_scans(needed, confidence) < 1:
        needed += 1
    return needed


def likely_thresholds(losses: Ratios, at_most: float, confidence: float | None, scans: int) -> int:
    """Return the number of thresholds that a number of scans would hold if their losses were these.

    Parameters
    ----------
    losses : (n, T) float64
        Losses of scans or drives by rising threshold, 0…1.
    at_most : float
        Level of the guarantee, 0…1.
    confidence : float, optional
        Confidence, 0…1; None bounds the expected loss.
    scans : int
        Number of scans.

    Returns
    -------
    int
    """
    if confidence is None:
        return held_thresholds(losses, at_most, scans=scans)
    above = (losses > at_most).mean(axis=0)
    return int((above <= allowed_scans(scans, confidence) / scans).sum())


def enough_drives(drives: int, at_most: float, confidence: float | None) -> bool:
    """Return whether the drive, and not the scan, is the unit of a guarantee."""
    return drives >= needed_drives(at_most, confidence)


def needed_drives(at_most: float, confidence: float | None) -> int:
    """Return the number of drives from which on the drive is the unit of a guarantee.

    On average, twice the least number is needed: with fewer drives, more than half of the level is
    set aside for the new drive, and few points are accepted.
    """
    least = useful_scans if confidence is None else needed_scans
    return least(at_most, confidence)


@dataclass(frozen=True, slots=True, kw_only=True)
class RiskBoundCheck:
    """Guarantee about scans or drives, and their losses, which are shares of scored points."""

    at_most: float  # Level of the guarantee, 0…1
    confidence: float | None  # None if the guarantee is about the mean loss
    unit: str  # "scan" or "drive"
    units: int  # Number of scans or drives
    above: int  # Number of those with a loss above the level
    mean: float  # Mean loss, 0…1
    worst: float  # Largest loss, 0…1
    scope: str = ""  # Scans that the guarantee covers, in words
    are_others: bool = False  # Whether the scans are evidently not such; False proves nothing
    incomparable: str = ""  # Why no comparison could show that they are not such
    consecutive: bool = False  # As of `RiskThreshold`

    @classmethod
    def from_scans(
        cls,
        guaranteed: RiskThreshold | None,
        scans: Mapping[str, AcceptedCounts],
        *,
        are_others: bool = False,
    ) -> Self | None:
        """Compare a guarantee with the points of scans.

        Parameters
        ----------
        guaranteed : RiskThreshold, optional
            Threshold of the run with its guarantee.
        scans : mapping of str to AcceptedCounts
            Points of each scan by its name.
        are_others : bool
            Whether the scans are evidently not such as the guarantee covers.

        Returns
        -------
        RiskBoundCheck or None
            None without a guarantee, or without scored points.
        """
        judged = {name: scan.loss for name, scan in scans.items() if scan.points}
        if guaranteed is None or not judged:
            return None
        losses = np.array(list(judged.values()))
        unit = guaranteed.unit
        if unit == "drive":
            drives = np.array([name.rpartition("/")[0] for name in judged])
            losses = means_of_units(losses, drives)
        return cls(
            at_most=guaranteed.at_most,
            confidence=guaranteed.confidence,
            unit=unit,
            units=len(losses),
            above=int((losses > guaranteed.at_most).sum()),
            mean=float(losses.mean()),
            worst=float(losses.max()),
            scope=_scope(guaranteed),
            are_others=are_others,
            consecutive=bool(guaranteed.consecutive),
        )

    @property
    def exceeds_limit(self) -> bool:
        """Whether the losses are larger than the guarantee allows."""
        return self.measured > self.limit

    @property
    def warning(self) -> str:
        """Warning if the losses are larger than the guarantee allows, else an empty text."""
        return RISK_BOUND_EXCEEDED if self.exceeds_limit else ""

    @property
    def measured(self) -> float:
        """Mean loss, or share of scans or drives with a larger loss than `at_most`, 0…1."""
        return self.mean if self.confidence is None else self.above / self.units

    @property
    def limit(self) -> float:
        """Largest value of `measured` that the guarantee allows, 0…1."""
        # 1 - 0.9 is less than 0.1 by the last digit.
        return self.at_most if self.confidence is None else round(1 - self.confidence, 9)

    @property
    def sentence(self) -> str:
        """Guarantee and measured losses in words."""
        measured = f"{self.above} of {counted(self.units, self.unit)}"
        if self.confidence is None:
            mean = f"{percentage(self.mean)} on average over {counted(self.units, self.unit)}"
            measured = f"{mean}, each {self.unit} counting the same"
        bound = _bound(self.at_most, self.confidence, self.unit)
        guaranteed = f"guaranteed for {self.scope}: {bound}"
        if self.are_others:
            guaranteed = (
                "not guaranteed, because the scans are unlike those that the threshold was chosen "
                f"on: {bound}"
            )
        elif self.consecutive:
            guaranteed = f"not guaranteed, because {CONSECUTIVE}: {bound}"
        elif self.incomparable:
            guaranteed = (
                "these scans cannot be compared with those that the threshold was chosen on "
                f"({self.incomparable}); the guarantee holds only for {self.scope}: {bound}"
            )
        worst = f"{percentage(self.worst)} in the worst {self.unit}"
        return f"{guaranteed}; measured: {measured}, {worst}"


def guarantee_text(risk: RiskThreshold) -> str:
    """Return the guarantee of the threshold of weights in words."""
    bound = _bound(risk.at_most, risk.confidence, risk.unit)
    doubt = f"; not guaranteed, because {CONSECUTIVE}" if risk.consecutive else ""
    return f"{risk.kind} up to {risk.threshold:.4g} accepted: {bound}, for {_scope(risk)}{doubt}"


def _scope(risk: RiskThreshold) -> str:
    """Return the scans that a guarantee covers in words."""
    sequences = first_few(risk.sequences)
    if risk.data_set:
        sequences = f"{risk.data_set}: {sequences}"
    chosen = f"was chosen on ({counted(risk.scans, 'scan')} of {sequences})"
    if risk.unit == "drive":
        return f"drives like those that the threshold {chosen}"
    return f"scans drawn in the same way from the drives that the threshold {chosen}, not others"


def _bound(at_most: float, confidence: float | None, unit: str) -> str:
    level = percentage(at_most, figures=3)
    if confidence is None:
        return (
            f"on average over new {unit}s and over choices of the labelled ones, at most {level} "
            "of the points of known classes are accepted and wrong"
        )
    others = percentage(1 - confidence, figures=3)
    return (
        f"with {percentage(confidence, figures=3)} confidence, at most {others} of {unit}s have "
        f"more than {level} of their points of known classes accepted and wrong"
    )
