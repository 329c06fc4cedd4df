# SPDX-License-Identifier: MIT
"""How much accuracy a few labelled scans gave: trials on drives that were not trained on.

The trials are those of docs/experiments/few-labels.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from statistics import median

MANY_RIGHT = 0.75
"""Trials that began with a smaller share of right labels gained several times as much."""


@dataclass(frozen=True, slots=True)
class LabelTrial:
    """One fine-tuning on a few labelled scans, scored on other scans."""

    data_set: str
    drives: str  # Drives that were scored, whose labels were not trained on
    scans: int  # Number of labelled scans
    before: float  # Share of right labels before, 0…1
    after: float  # The same after fine-tuning
    version: int  # Of the default weights that the training started from

    @property
    def gain(self) -> float:
        """Gain in accuracy, in percentage points."""
        return 100 * (self.after - self.before)


TRIALS = (
    LabelTrial("SemanticKITTI", "08, x2", 7, 0.798, 0.798, version=5),
    LabelTrial("SemanticKITTI", "00, x1", 5, 0.862, 0.870, version=5),
    LabelTrial("SemanticKITTI", "two others", 12, 0.830, 0.858, version=4),
    LabelTrial("SemanticKITTI", "08, x2", 7, 0.796, 0.808, version=4),
    LabelTrial("SemanticKITTI", "00, x1", 5, 0.826, 0.837, version=4),
    LabelTrial("SemanticKITTI", "x1", 8, 0.685, 0.823, version=2),
    LabelTrial("SemanticKITTI", "00", 9, 0.803, 0.816, version=2),
    LabelTrial("SemanticKITTI", "08", 9, 0.762, 0.778, version=2),
    LabelTrial("SemanticKITTI", "x2", 10, 0.774, 0.879, version=2),
    LabelTrial("nuScenes", "in five classes", 2, 0.937, 0.958, version=2),
    LabelTrial("PandaSet", "the same drive", 4, 0.600, 0.822, version=0),
    LabelTrial("PandaSet", "the same drive", 10, 0.600, 0.797, version=0),
)


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
    def usual(self) -> float:
        """Median of the gains, in percentage points."""
        return median(trial.gain for trial in self.trials)

    @property
    def text(self) -> str:
        """One line for people."""
        fewest = min(trial.scans for trial in self.trials)
        most = max(trial.scans for trial in self.trials)
        before = [100 * trial.before for trial in self.trials]
        gains = f"{self.worst:.1f} to {self.best:.1f} points of accuracy (median {self.usual:.1f})"
        began = f"{min(before):.0f} to {max(before):.0f} % right labels"
        data_sets = " and ".join(dict.fromkeys(trial.data_set for trial in self.trials))
        trials = f"{len(self.trials)} trials on {data_sets} that began with {began}"
        return f"{fewest} to {most} labelled scans gained {gains} in {trials}"


def gains_of_trials(accuracy: float | None) -> list[GainRange]:
    """Return the gains of the trials that began about as well as a run.

    Parameters
    ----------
    accuracy : float, optional
        Estimated share of right labels of the run, 0…1.

    Returns
    -------
    list of GainRange
        Of the like trials; of both kinds of trials if the accuracy is unknown.
    """
    many = tuple(trial for trial in TRIALS if trial.before >= MANY_RIGHT)
    few = tuple(trial for trial in TRIALS if trial.before < MANY_RIGHT)
    if accuracy is None:
        return [GainRange(many), GainRange(few)]
    return [GainRange(many if accuracy >= MANY_RIGHT else few)]
