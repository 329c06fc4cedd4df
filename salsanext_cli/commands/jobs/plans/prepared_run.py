# SPDX-License-Identifier: MIT
"""Run of a stage that is prepared: to begin it, or to foresee what it would do."""

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path

from salsanext_cli.core.engines.network import Network
from salsanext_cli.runs.loop.run_origins import OriginsOfRun
from salsanext_cli.runs.records.stage_settings import StageSettings
from salsanext_cli.runs.results.output_run import OutputRun, foreseen_run, output_run
from salsanext_cli.runs.scans.scan_file import ScanFile


@dataclass(frozen=True, slots=True, kw_only=True)
class PreparedRun:
    """Run before its first scan.

    Attributes
    ----------
    out : Path
        Output folder.
    stage : str
        Name of the record.
    listed, scans : sequence of ScanFile
        All scans of the source, and those that were selected.
    recorded : StageSettings
        Settings to record.
    folders : tuple of str
        Folders of the results.
    overwrite : bool
        Whether existing results are replaced.
    records_scans : bool
        Whether the record states where the scans are.
    moved : mapping of str to str
        Folder by sequence where scans are that were moved since an earlier stage recorded them.
    weights : Path, optional
        File that the user named, whose path is recorded.
    options : mapping of str to object
        Further settings of the network that the user named, by argument.
    """

    out: Path
    stage: str
    listed: Sequence[ScanFile]
    scans: Sequence[ScanFile]
    recorded: StageSettings
    folders: tuple[str, ...]
    overwrite: bool
    records_scans: bool = True
    moved: Mapping[str, str] = field(default_factory=dict)
    weights: Path | None = None
    options: Mapping[str, object] = field(default_factory=dict)

    def opened(self) -> AbstractContextManager[OutputRun]:
        """Begin the run in its folder, or refuse it."""
        return output_run(
            self.out,
            self.stage,
            self.recorded,
            self.folders,
            self.scans,
            overwrite=self.overwrite,
            record_scans=self.records_scans,
            moved=self.moved,
            weights=self.weights,
            options=self.options,
        )

    def foreseen(self) -> OutputRun:
        """Return the run that `opened` would begin, or refuse it; write nothing."""
        return foreseen_run(
            self.out,
            self.stage,
            self.recorded,
            self.folders,
            self.scans,
            overwrite=self.overwrite,
            record_scans=self.records_scans,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class PreparedNetworkRun(PreparedRun):
    """Run of a network before its first scan."""

    network: Network  # Fitted to the scans
    origins: OriginsOfRun  # Origins of registered scans
