# SPDX-License-Identifier: MIT
"""Report of `tune risk`: the threshold, its guarantee, and what the labelled scans show of it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.measures.accepted_labels import AcceptedCounts, AcceptedLabels
from salsanext_cli.core.measures.risk_control import guarantee_text
from salsanext_cli.core.measures.scores import Ratios
from salsanext_cli.core.network.card import RiskThreshold
from salsanext_cli.core.plain_data import plain
from salsanext_cli.core.texts import percentage
from salsanext_cli.runs.summary.scan_warnings import ScanWarning
from salsanext_cli.training.tuning.risk_level import RiskLevel

MAX_LISTED = 5  # Held-out sequences that are listed, the worst ones


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldOutSequence:
    """Points of a sequence below the threshold of the other sequences, shares 0…1."""

    sequence: str
    scans: int
    accepted: float  # Mean share of the points of a scan that are accepted
    loss: float  # Mean share of the points of a scan that are accepted and wrong
    worst: float  # Largest such share of a scan
    above: float  # Share of the scans above the level

    def exceeds(self, level: RiskLevel) -> bool:
        """Return whether more labels are wrong than the level allows."""
        if level.confidence is None:
            return self.loss > level.at_most
        # 1 - 0.9 is less than 0.1 by the last digit.
        return self.above > round(1 - level.confidence, 9)

    @property
    def sentence(self) -> str:
        """Shares of the sequence in words."""
        accepted = f"{percentage(self.accepted)} accepted"
        wrong = f"{percentage(self.loss)} of the points of known classes accepted and wrong"
        worst = f", {percentage(self.worst)} in the worst scan" if self.scans > 1 else ""
        shares = f"{accepted}, {wrong}{worst}"
        return f"{self.sequence} with the threshold chosen on the others: {shares}"


@dataclass(frozen=True, slots=True, kw_only=True)
class AcceptedScan:
    """Scored points of a scan below the threshold."""

    scan: str  # Name, as sequence/scan
    digest: str
    points: int  # All scored points
    accepted: int
    wrong: int  # Accepted and wrong

    @property
    def counts(self) -> AcceptedCounts:
        """Numbers of the points."""
        return AcceptedCounts(points=self.points, accepted=self.accepted, wrong=self.wrong)

    @property
    def share_accepted(self) -> float:
        """Share of the points that are accepted, 0…1."""
        return self.accepted / self.points

    @property
    def share_wrong(self) -> float:
        """Share of the points that are accepted and wrong, 0…1."""
        return self.wrong / self.points


@dataclass(frozen=True, slots=True, kw_only=True)
class FewScansReport:
    """What few scans or drives leave, and what more of them would accept."""

    left: float  # Share of the points, or of the scans above the level, that the level leaves, 0…1
    useful: int  # Number of scans or drives that leaves room
    accepted_by_useful: float  # Share of the points that as many with equal losses would accept


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RiskCurve:
    """What thresholds accept, about one for each percent of the points; means over scans."""

    accepted: Ratios  # (T,): share of the points that are accepted, 0…1, rising
    wrong: Ratios  # (T,): share of the points that are accepted and wrong, 0…1

    @classmethod
    def from_shares(cls, accepted: Ratios, wrong: Ratios) -> "RiskCurve":
        """Return the curve of n scans at B thresholds, from shares (n, B)."""
        mean_accepted = accepted.mean(axis=0)
        every_percent = np.linspace(0, mean_accepted[-1], 101)
        thresholds = np.unique(np.searchsorted(mean_accepted, every_percent))
        return cls(accepted=mean_accepted[thresholds], wrong=wrong.mean(axis=0)[thresholds])


@dataclass(frozen=True, slots=True, kw_only=True)
class ComputedBy:
    """What computed the labels."""

    device: str
    engine: str  # Library
    precision: str  # Number type

    @classmethod
    def from_network(cls, network: Network) -> "ComputedBy":
        """Return what computes the labels of a network."""
        backend = network.backend
        return cls(device=backend.device, engine=backend.library, precision=backend.precision)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RiskFit:
    """Threshold of `tune risk`, and what the labelled scans show of it."""

    threshold: RiskThreshold
    accepted: AcceptedLabels  # Of all scans together
    held_out: Sequence[HeldOutSequence]  # Empty for a single sequence
    scans: Sequence[AcceptedScan]
    few: FewScansReport | None  # None for enough scans or drives
    curve: RiskCurve
    computed_by: ComputedBy
    warnings: Sequence[ScanWarning]  # Reasons to doubt the guarantee

    @property
    def guarantee(self) -> str:
        """Guarantee of the threshold in words."""
        return guarantee_text(self.threshold)

    @property
    def sentences(self) -> list[str]:
        """Sentences about the accepted labels and the held-out sequences."""
        return [*self.accepted.sentences, *_sentences(self.held_out)]

    def to_dict(self) -> dict[str, object]:
        """Return plain data for JSON, with the fields of the threshold in the same object."""
        return {
            "guarantee": self.guarantee,
            **plain(self.threshold),
            "accepted": plain(self.accepted),
            "held_out": plain(self.held_out),
            "names": [scan.scan for scan in self.scans],
            "of_scans": [[scan.share_accepted, scan.share_wrong] for scan in self.scans],
            "sentences": self.sentences,
            "few": plain(self.few),
            "curve": plain(self.curve),
            "computed_by": plain(self.computed_by),
            "warnings": plain(self.warnings),
        }


def _sentences(sequences: Sequence[HeldOutSequence]) -> Iterator[str]:
    """Yield sentences about held-out sequences, the worst ones first."""
    worst = sorted(sequences, key=lambda sequence: -sequence.loss)[:MAX_LISTED]
    for sequence in worst:
        yield sequence.sentence
    more = len(sequences) - len(worst)
    if more:
        noun = "sequence" if more == 1 else "sequences"
        yield f"{more} more {noun} with a smaller share of wrong points"
