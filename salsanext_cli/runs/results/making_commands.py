# SPDX-License-Identifier: MIT
"""Commands that make the results of scans, for hints about results that are missing."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from salsanext_cli.core.errors import NoInputError
from salsanext_cli.core.wording import command, setting
from salsanext_cli.runs.results.folder_names import ERROR
from salsanext_cli.runs.results.manifest import Manifest, ScanSource
from salsanext_cli.runs.results.repeated_settings import (
    extras_of_run,
    network_record,
    settings_of_run,
)
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.runs.scans.selection import data_set_of

UNKNOWN_SCANS = "SCANS"
"""Word for scans that are not known, or in several folders."""
MAX_NAMED_PARTS = 3
"""Files or folders of a part of a data set that a command names; it names the whole for more."""
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
        self, out: Path, *files: ScanFile, target: Path | None = None, overwrite: bool = False
    ) -> str:
        """Return the command line, with the settings of the run in a folder.

        Parameters
        ----------
        out : Path
            Folder with results.
        *files : ScanFile
            Scans of the results, if they are known.
        target : Path, optional
            Folder that the command writes to, by default the same.
        overwrite : bool
            Whether the command replaces results.

        Returns
        -------
        str
        """
        words = ["salsanext", self.stage]
        settings: list[str] = []
        if self.stage != "fuse":
            words += _sources(files, Manifest(out).sources())
            settings += settings_of_run(Manifest(out), self.omitted)
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
        return command(shlex.join([*words, str(target or out)]), *settings)


def _sources(files: Sequence[ScanFile], recorded: Mapping[str, ScanSource]) -> list[str]:
    """Return the data set or folder of each scan, or the part of it that the run was asked for.

    Parameters
    ----------
    files : sequence of ScanFile
        Scans of the results; the word `SCANS` stands for none.
    recorded : mapping of str to ScanSource
        Scans that the runs were asked for, by sequence; empty where it is not recorded.

    Returns
    -------
    list of str
    """
    if not files:
        return [UNKNOWN_SCANS]
    wholes = [str(data_set_of(file) or file.path.parent) for file in files]
    number = sum(len(source.suffixes) for source in recorded.values())
    if not number or number >= sum(map(_number_of_scans, wholes)):
        return wholes
    for part in (
        _recorded_files(recorded),
        sorted({source.folder for source in recorded.values()}),
    ):
        if 0 < len(part) <= MAX_NAMED_PARTS:
            return part
    return wholes


def _number_of_scans(whole: str) -> int:
    """Return the number of scans in a folder, 0 if it is no more."""
    try:
        return len(find_scans(Path(whole), unique=False))
    except NoInputError:
        return 0


def _recorded_files(recorded: Mapping[str, ScanSource]) -> list[str]:
    """Return the paths of the files of recorded scans, none if one has no file of its own."""
    names = [
        (Path(source.folder) / stem, suffix)
        for source in recorded.values()
        for stem, suffix in sorted(source.suffixes.items())
    ]
    if not all(suffix for _, suffix in names):
        return []
    return [f"{path}{suffix}" for path, suffix in names]


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


def making_hint(column: str, out: Path, *files: ScanFile) -> str:
    """Return the hint for a folder of results of scans without labels or a kind of uncertainty."""
    text = MADE_BY.get(column, PREDICT).text(out, *files)
    if column != "error":
        return f"run `{text}` first"
    record = network_record(Manifest(out))
    if record is None or not record.weights_file:
        return f"run `{text}`"
    return f"run `{text}`; the weights need an error model, which `salsanext tune error` fits"
