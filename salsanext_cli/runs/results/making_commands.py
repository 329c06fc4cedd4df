# SPDX-License-Identifier: MIT
"""Commands that make the results of scans, for hints about results that are missing."""

from __future__ import annotations

import os
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from salsanext_cli.core.wording import command, setting
from salsanext_cli.runs.results.folder_names import ERROR
from salsanext_cli.runs.results.manifest import Manifest
from salsanext_cli.runs.results.repeated_settings import (
    extras_of_run,
    network_record,
    settings_of_run,
)
from salsanext_cli.runs.results.scan_arguments import scan_arguments
from salsanext_cli.runs.results.scan_places import PlaceState, moved_data_set, place_state
from salsanext_cli.runs.scans.scan_file import ScanFile

UNKNOWN_DATA_SET = "DATASET"
"""Word for a data set where no folder has the scans of all sequences."""
WITHOUT_NOISE = "none"  # Value of `UncertaintyMethod.aleatoric`


@dataclass(frozen=True, slots=True, kw_only=True)
class MakingCommand:
    """Command that makes results in a folder."""

    stage: str
    extras: tuple[str, ...] = ()  # Further results of `predict`
    # Settings of the run that the command does not take, or must not repeat
    omitted: frozenset[str] = frozenset()
    needs_noise: bool = False  # Whether a run without the noise of the sensor has no such results

    def text(
        self,
        out: Path,
        scans: Sequence[ScanFile] = (),
        *,
        target: Path | None = None,
        overwrite: bool = False,
    ) -> str:
        """Return the command line, with the settings of the run in a folder.

        Parameters
        ----------
        out : Path
            Folder with results.
        scans : sequence of ScanFile
            Scans that need the results, if they are known.
        target : Path, optional
            Folder that the command writes to, by default that of the method `target`.
        overwrite : bool
            Whether the command replaces results.

        Returns
        -------
        str
        """
        words = ["salsanext", self.stage]
        settings: list[str] = []
        if self.stage != "fuse":
            arguments = scan_arguments(out, scans)
            words += arguments.sources
            settings += arguments.settings()
            settings += settings_of_run(Manifest(out), self.omitted)
        elif place_state(out, scans) is PlaceState.MOVED:
            data_set = moved_data_set(out, scans) or UNKNOWN_DATA_SET
            settings.append(setting("dataset", data_set))
        if self.stage == "predict":
            settings += extras_of_run(Manifest(out), self.extras)
        sampled = Manifest(out).settings("uncertainty") if self.stage == "uncertainty" else None
        if sampled is not None and self.needs_noise and sampled.aleatoric == WITHOUT_NOISE:
            sampled = replace(sampled, aleatoric=None)
            overwrite = True
        if sampled is not None:
            settings += sampled.sampling_as_typed()
        if overwrite:
            settings.append(setting("overwrite", True))
        target = target or self.target(out, scans)
        return command(shlex.join([*words, str(target)]), *settings)

    def target(self, out: Path, scans: Sequence[ScanFile]) -> Path:
        """Return the folder of the results: the same, or another one for scans that were moved.

        A folder takes no further results of these, since they may be others of the same names.
        """
        if self.stage == "fuse" or place_state(out, scans) is PlaceState.RECORDED:
            return out
        return Path(f"{os.path.normpath(out)}-{self.stage}")


def words_of_target(out: Path, target: Path) -> str:
    """Return the words about the folder to give afterwards; empty for the same one."""
    return "" if target == out else f", then give {shlex.quote(str(target))}"


PREDICT = MakingCommand(stage="predict")
PREDICT_ERROR = MakingCommand(stage="predict", extras=(ERROR,))
PREDICT_UNMERGED_ERROR = MakingCommand(
    stage="predict", extras=(ERROR,), omitted=frozenset({"classes"})
)
PREDICT_VOTES = MakingCommand(stage="predict", extras=("votes",))
UNCERTAINTY_STAGE = MakingCommand(stage="uncertainty", omitted=frozenset({"origin"}))
UNCERTAINTY_OF_NOISE = replace(UNCERTAINTY_STAGE, needs_noise=True)
FUSE = MakingCommand(stage="fuse")
MADE_BY = {
    "error": PREDICT_ERROR,
    "epistemic": UNCERTAINTY_STAGE,
    "aleatoric": UNCERTAINTY_OF_NOISE,
    "total": UNCERTAINTY_OF_NOISE,
    "entropy": UNCERTAINTY_STAGE,
    "mutual_information": UNCERTAINTY_STAGE,
    "disagreement": FUSE,
}
"""Command by kind of uncertainty; labels and their confidence are made by `PREDICT`."""


def making_hint(column: str, out: Path, scans: Sequence[ScanFile] = ()) -> str:
    """Return the hint for a folder of results of scans without labels or a kind of uncertainty."""
    making = MADE_BY.get(column, PREDICT)
    target = making.target(out, scans)
    run = f"run `{making.text(out, scans, target=target)}`"
    following = words_of_target(out, target)
    if column != "error":
        return f"{run}{following or ' first'}"
    record = network_record(Manifest(out))
    if record is None or not record.weights_file:
        return f"{run}{following}"
    return f"{run}{following}; the weights need an error model, which `salsanext tune error` fits"
