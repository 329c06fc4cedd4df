# SPDX-License-Identifier: MIT
"""How much accuracy a few labelled scans gave: the trials of docs/experiments/few-labels.md.

All trials of that page that state a gain count, of the recipe as it was then, also those that
scored the drive whose scans were labelled. Trials of the newest weights go before earlier ones.
"""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass

MANY_RIGHT = 0.75
"""Trials that began with a smaller share of right labels gained several times as much."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelTrial:
    """One fine-tuning on a few labelled scans, scored on other scans."""

    version: int  # Of the default weights that the training started from
    data_set: str
    drives: str  # Drives that were scored
    scans: int  # Number of labelled scans
    before: float | None = None  # Share of right labels before, 0…1; None if the page has the gain
    gain: float  # Gain in accuracy, in percentage points
    same_drive: bool = False  # Whether the labelled scans were of the drive that was scored


KITTI = "SemanticKITTI"
PANDASET = "PandaSet"
FIVE = (
    LabelTrial(version=5, data_set=KITTI, drives="five drives", scans=27, gain=1.9),
    LabelTrial(version=5, data_set=KITTI, drives="two drives", scans=27, gain=2.0),
    LabelTrial(version=5, data_set=KITTI, drives="08, x2", scans=7, before=0.798, gain=0.0),
    LabelTrial(version=5, data_set=KITTI, drives="00, x1", scans=5, before=0.862, gain=0.8),
)
FOUR = (
    LabelTrial(version=4, data_set=KITTI, drives="two drives", scans=12, before=0.83, gain=2.8),
    LabelTrial(version=4, data_set=KITTI, drives="08, x2", scans=7, before=0.796, gain=1.2),
    LabelTrial(version=4, data_set=KITTI, drives="00, x1", scans=5, before=0.826, gain=1.1),
)
TWO = (
    LabelTrial(version=2, data_set=KITTI, drives="x1", scans=8, before=0.685, gain=13.8),
    LabelTrial(version=2, data_set=KITTI, drives="00", scans=9, before=0.803, gain=1.3),
    LabelTrial(version=2, data_set=KITTI, drives="08", scans=9, before=0.762, gain=1.6),
    LabelTrial(version=2, data_set=KITTI, drives="x2", scans=10, before=0.774, gain=10.5),
    LabelTrial(version=2, data_set=KITTI, drives="folds", scans=1, before=0.745, gain=3.7),
    LabelTrial(version=2, data_set=KITTI, drives="folds", scans=8, before=0.745, gain=6.2),
    LabelTrial(
        version=2, data_set="nuScenes", drives="five classes", scans=2, before=0.937, gain=2.1
    ),
)
ZERO = (
    LabelTrial(
        version=0, data_set=PANDASET, drives="one", scans=4, before=0.6, gain=22.2, same_drive=True
    ),
    LabelTrial(
        version=0, data_set=PANDASET, drives="one", scans=10, before=0.6, gain=19.7, same_drive=True
    ),
    LabelTrial(
        version=0,
        data_set=PANDASET,
        drives="one, 5 seeds",
        scans=4,
        before=0.6,
        gain=18.6,
        same_drive=True,
    ),
    LabelTrial(
        version=0, data_set="simulated drives", drives="8 scenes", scans=4, before=0.449, gain=13.6
    ),
)
TRIALS = (*FIVE, *FOUR, *TWO, *ZERO)
"""Trials, those of the newest weights first."""


@dataclass(frozen=True, slots=True)
class GainRange:
    """Gains of trials that began with many right labels, or with few."""

    trials: tuple[LabelTrial, ...]

    @property
    def worst(self) -> float:
        """Least gain, in percentage points."""
        return min(trial.gain for trial in self.trials)

    @property
    def best(self) -> float:
        """Largest gain, in percentage points."""
        return max(trial.gain for trial in self.trials)

    @property
    def median(self) -> float:
        """Median of the gains, in percentage points."""
        return statistics.median(trial.gain for trial in self.trials)

    @property
    def text(self) -> str:
        """One line for people."""
        fewest = min(trial.scans for trial in self.trials)
        most = max(trial.scans for trial in self.trials)
        span = f"{self.worst:.1f} to {self.best:.1f}"
        gains = f"{span} percentage points of accuracy (median {self.median:.1f})"
        data_sets = _listed([trial.data_set for trial in self.trials])
        trials = f"{len(self.trials)} trials of {self._versions} on {data_sets}"
        same = sum(trial.same_drive for trial in self.trials)
        drives = f"; {same} of them scored the drive whose scans were labelled" if same else ""
        return f"{fewest} to {most} labelled scans gained {gains} in {trials}{self._began}{drives}"

    @property
    def _versions(self) -> str:
        """The versions of the default weights in words."""
        versions = sorted({trial.version for trial in self.trials})
        noun = "versions" if len(versions) > 1 else "version"
        return f"weights {noun} {_listed([str(version) for version in versions])}"

    @property
    def _began(self) -> str:
        """How many labels were right before, in words."""
        before = [100 * trial.before for trial in self.trials if trial.before is not None]
        if not before:
            return ""
        measured = " where measured" if len(before) < len(self.trials) else ""
        return f" that began with {min(before):.0f} to {max(before):.0f} % right labels{measured}"


def gains_of_trials(accuracy: float | None) -> list[GainRange]:
    """Return the gains of the trials that began about as well as a run.

    Parameters
    ----------
    accuracy : float, optional
        Estimated share of right labels of the run, 0…1.

    Returns
    -------
    list of GainRange
        Of the like trials; of both kinds of trials if the accuracy is unknown. Trials of earlier
        weights count only if none of the newest ones is like the run.
    """
    if accuracy is None:
        return [GainRange(_newest(is_high)) for is_high in (True, False)]
    return [GainRange(_newest(accuracy >= MANY_RIGHT))]


def _newest(began_high: bool) -> tuple[LabelTrial, ...]:
    """Return the trials of the newest weights that began well or not, else of earlier weights."""
    like = tuple(
        trial
        for trial in TRIALS
        # SemanticKITTI has about 80 % right labels before.
        if (trial.before is None or trial.before >= MANY_RIGHT) == began_high
    )
    present = max(trial.version for trial in TRIALS)
    return tuple(trial for trial in like if trial.version == present) or like


def _listed(words: Sequence[str]) -> str:
    """Return different words, joined by commas and an "and"."""
    *others, last = dict.fromkeys(words)
    return f"{', '.join(others)} and {last}" if others else last
