# SPDX-License-Identifier: MIT
"""What to do with the labels of a run: use them, merge classes, label scans, or none of these."""

from __future__ import annotations

import math
import shlex
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from salsanext_cli.core.checks.warning_codes import WarningCode
from salsanext_cli.core.classes.label_space import MAX_COARSE_CLASSES
from salsanext_cli.core.measures.expected_accuracy import OF_RUN, ExpectedAccuracy
from salsanext_cli.core.texts import counted, percentage
from salsanext_cli.core.wording import command, setting

DOUBTFUL = 0.1
"""A point is doubtful if its label is wrong with a greater probability."""
MOST = 0.5  # Warnings decide if more than this share of the scans has one of them


class Decision(StrEnum):
    """What to do with the labels of a run."""

    USE = "use"
    COARSE = "coarse"
    LABEL_TEN = "label-10"
    LABEL_FORTY = "label-40"
    CORRECT = "correct"
    UNSUITED = "unsuited"


ADVICE = {
    Decision.USE: "Use the labels as they are",
    Decision.COARSE: "Use coarse classes",
    Decision.LABEL_TEN: "Label ten scans",
    Decision.LABEL_FORTY: "Label forty scans",
    Decision.CORRECT: "Correct the scans first",
    Decision.UNSUITED: "Do not use these labels",
}
COMMANDS: Mapping[Decision, tuple[str, str, str, object]] = {
    Decision.COARSE: ("predict", "coarse/", "classes", "coarse"),
    Decision.LABEL_TEN: ("pick", "to-label/", "count", 10),
    Decision.LABEL_FORTY: ("pick", "to-label/", "count", 40),
}
"""Stage, folder, argument and its value that do what the advice says."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Level:
    """Least quality of labels for a decision."""

    decision: Decision
    least_accuracy: float  # Estimated or measured, 0…1
    most_doubtful: float  # Largest share of doubtful points among those with a label, 0…1


LEVELS = (
    Level(decision=Decision.USE, least_accuracy=0.85, most_doubtful=0.4),
    Level(decision=Decision.COARSE, least_accuracy=0.75, most_doubtful=0.65),
    Level(decision=Decision.LABEL_TEN, least_accuracy=0.6, most_doubtful=0.85),
    Level(decision=Decision.LABEL_FORTY, least_accuracy=0.0, most_doubtful=1.0),
)
"""From the best to the worst; the first whose two limits hold decides.

With weights version 6, 60 real and simulated drives were divided by the estimate and the share of
doubtful points (docs/experiments/default-weights.md). 85 % or more of the labels were right on the
five of the first level, and of the coarse labels on 37 of the 39 of the second; on the 16 others 55
to 81 % of the labels were right. A few labelled scans gained a median of 13.8 percentage points
where at most 75 % were right before, and of 1.4 where more were (`label_gains`).
"""
UNSUITED_FOR = (WarningCode.DEPTH_IMAGE, WarningCode.INDOOR)
"""Warnings that the classes or the images of the weights do not suit the scans."""
CORRECTED_FOR = (
    WarningCode.ACCUMULATED,
    WarningCode.FEW_POINTS,
    WarningCode.MISSING_POINTS,
    WarningCode.MIXED_SENSORS,
    WarningCode.NOT_MEASURED,
    WarningCode.OTHER_IMAGES,
    WarningCode.OUT_OF_PLACE,
    WarningCode.OUT_OF_VIEW,
    WarningCode.TILTED,
    WarningCode.UNITS,
    WarningCode.UPSIDE_DOWN,
)
"""Warnings whose hints correct the scans or the settings."""
LABELLED_FOR = (
    WarningCode.FEW_DIRECTIONS,
    WarningCode.HEIGHT,
    WarningCode.LOW_CONFIDENCE,
    WarningCode.NEAR_RETURNS,
    WarningCode.NOISY,
    WarningCode.ONE_CLASS,
    WarningCode.SPARSE,
)
"""Warnings that the scans are unlike the training data: only labels measure the accuracy."""
CODES = {
    Decision.UNSUITED: UNSUITED_FOR,
    Decision.CORRECT: CORRECTED_FOR,
    Decision.LABEL_TEN: LABELLED_FOR,
}
"""Warnings by the decision that they lead to, the gravest first."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """Numbers about the labels of a run."""

    scans: int  # Number of scans
    class_count: int  # Number of classes of the labels, class 0 included
    expected: ExpectedAccuracy | None = None  # Estimate without labels
    measured: float | None = None  # Measured share of right labels, 0…1
    # Share of the points with a label, 0…1, whose error is above `DOUBTFUL`; None if the error was
    # not computed, or if labels were rejected
    doubtful: float | None = None
    warned: Mapping[str, Collection[str]] = field(default_factory=dict)  # Names of scans by code

    @property
    def accuracy(self) -> float | None:
        """Measured accuracy, else the estimate, 0…1; None without either."""
        if self.measured is not None:
            return self.measured
        return self.expected.accuracy if self.expected else None

    @property
    def deciding(self) -> dict[str, Collection[str]]:
        """Names of the scans by code of the warnings of `CODES`, the gravest first."""
        codes = [code for group in CODES.values() for code in group]
        return {code: self.warned[code] for code in codes if self.warned.get(code)}

    @property
    def unlike(self) -> set[str]:
        """Names of the scans with any of these warnings."""
        return {name for names in self.deciding.values() for name in names}


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """A decision and its reason in words."""

    decision: Decision
    reason: str

    @property
    def sentence(self) -> str:
        """Advice and reason."""
        return f"{ADVICE[self.decision]}: {self.reason}."

    def command(self, scans: str, settings: Sequence[str]) -> str:
        """Return the command that does what the advice says; empty if there is none.

        Parameters
        ----------
        scans : str
            Folder of the scans.
        settings : sequence of str
            Settings that choose scans in the folder, and the weights, as `setting` spells them.
        """
        if self.decision not in COMMANDS:
            return ""
        stage, target, name, value = COMMANDS[self.decision]
        words = shlex.join(["salsanext", stage, scans, target])
        return command(words, setting(name, value), *settings)


def verdict(evidence: Evidence) -> Verdict | None:
    """Decide what to do with the labels of a run.

    Parameters
    ----------
    evidence : Evidence
        Numbers about the labels.

    Returns
    -------
    Verdict or None
        None if neither accuracy nor error is known and no warning decides.
    """
    by_warnings = _decision_by_warnings(evidence)
    if by_warnings in (Decision.UNSUITED, Decision.CORRECT):
        return Verdict(decision=by_warnings, reason=_warnings(evidence, by_warnings))
    reasons = _numbers(evidence)
    if by_warnings is not None:
        reasons.append(_warnings(evidence, by_warnings))
    elif reasons and evidence.unlike:
        reasons.append(_exceptions(evidence))
    if not reasons:
        return None
    is_known = evidence.accuracy is not None and by_warnings is None
    best = Decision.USE if is_known else Decision.LABEL_TEN
    return Verdict(decision=_level(evidence, best), reason=", and ".join(reasons))


def _decision_by_warnings(evidence: Evidence) -> Decision | None:
    """Return the gravest decision that the warnings of most scans, or graver ones, lead to."""
    warned: set[str] = set()
    for decision, codes in CODES.items():
        for code in codes:
            warned.update(evidence.warned.get(code, ()))
        concerns_all = any(evidence.warned.get(code) for code in codes if code in OF_RUN)
        if concerns_all or len(warned) > MOST * evidence.scans:
            return decision
    return None


def _level(evidence: Evidence, best: Decision) -> Decision:
    """Return the decision of the first level whose limits hold, no better than `best`."""
    is_coarse = evidence.class_count <= MAX_COARSE_CLASSES
    order = [level.decision for level in LEVELS]
    for level in LEVELS[order.index(best) :]:
        if level.decision is Decision.COARSE and is_coarse:
            continue
        accurate = evidence.accuracy is None or evidence.accuracy >= level.least_accuracy
        sure = evidence.doubtful is None or evidence.doubtful <= level.most_doubtful
        if accurate and sure:
            return level.decision
    return Decision.LABEL_FORTY


def _numbers(evidence: Evidence) -> list[str]:
    """Return accuracy and share of doubtful points in words; empty if neither is known."""
    words = []
    expected = evidence.expected
    if evidence.measured is not None:
        words.append(f"{percentage(evidence.measured)} of the labelled points are right")
    elif expected and expected.interval:
        low = math.floor(100 * expected.interval[0])
        high = math.ceil(100 * expected.interval[1])
        covered = f" of {counted(expected.scans, 'scan')}" if expected.withheld else ""
        words.append(f"the estimated accuracy{covered} is {low} to {high} %")
    elif expected or evidence.doubtful is not None:
        words.append("the accuracy is unknown")
    if evidence.doubtful is not None:
        doubtful = f"{percentage(evidence.doubtful)} of the points with a label"
        words.append(f"{doubtful} have a probability of error above {percentage(DOUBTFUL, 0)}")
    return words


def _warnings(evidence: Evidence, decision: Decision) -> str:
    """Return how many scans have each code that leads to a decision, or to a graver one."""
    order = list(CODES)
    deciding = order[: order.index(decision) + 1]
    counts: dict[str, int] = {
        code: len(evidence.warned[code])
        for level in deciding
        for code in CODES[level]
        if evidence.warned.get(code)
    }
    if evidence.scans == 1:
        noun = "warnings" if len(counts) > 1 else "warning"
        return f"the scan has the {noun} {' and '.join(counts)}"
    return f"of {counted(evidence.scans, 'scan')}, {_counts_in_words(counts)}"


def _exceptions(evidence: Evidence) -> str:
    """Return the number of scans whose warnings do not decide, and their codes."""
    scans = counted(evidence.scans, "scan")
    counts = {code: len(names) for code, names in evidence.deciding.items()}
    return f"this may not hold for {len(evidence.unlike)} of {scans}: {_counts_in_words(counts)}"


def _counts_in_words(counts: Mapping[str, int]) -> str:
    """Return numbers of scans by code in words."""
    return ", ".join(f"{number:,} with {code}" for code, number in counts.items())
