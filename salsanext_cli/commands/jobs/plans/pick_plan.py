# SPDX-License-Identifier: MIT
"""Plan of a run of `pick`."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

from salsanext_cli.commands.jobs.plans.prepared_pick import PreparedPick
from salsanext_cli.commands.jobs.plans.run_plan import RunPlan, bytes_of_results, mean_points
from salsanext_cli.core.texts import counted
from salsanext_cli.core.uncertainty.error_features import knows_error
from salsanext_cli.io.files.reading import filled
from salsanext_cli.runs.annotation.picked_data_set import PREDICTED, PickRecord
from salsanext_cli.runs.loop.run_options import Shard
from salsanext_cli.runs.results.folder_names import ERROR, LEAST_CONFIDENCE
from salsanext_cli.runs.results.output_paths import output_path
from salsanext_cli.runs.scans.scan_file import ScanFile

POINT_BYTES = 16 + 4 + 27
"""Bytes of a point in `.bin`, `.label` and coloured `.ply`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PickPlan(RunPlan):
    """Plan of a choice of scans; its size is without files for a labelling tool."""

    picked: int  # Number of scans that are picked

    @classmethod
    def from_prepared(cls, prepared: PreparedPick, record: PickRecord | None) -> Self:
        """Return the plan of a prepared choice; `record`: that of an earlier run to go on."""
        network = prepared.network
        scans = prepared.scans if record is None else prepared.files(record)
        count = prepared.count if record is None else len(scans)
        done: set[ScanFile] = set() if record is None else _done(prepared, record, scans)
        plan = RunPlan.from_scans(prepared.listed, scans, Shard(), done.__contains__)
        points = mean_points(scans, network.sensor)
        kinds = (ERROR,) if knows_error(network) else ()
        predicted = (*kinds, LEAST_CONFIDENCE, "predictions")
        scan_bytes = POINT_BYTES * points + bytes_of_results(predicted, points, network.sensor)
        return cls(
            scans=plan.scans,
            done=plan.done,
            todo=plan.todo,
            points_per_scan=points,
            size=(count - plan.done) * scan_bytes,
            sensor=network.sensor,
            trained=network.card.sensor,
            picked=count,
        )

    def to_dict(self) -> dict[str, object]:
        """Return plain data for JSON."""
        return {**RunPlan.to_dict(self), "picked": self.picked}

    def lines(self) -> list[str]:
        """Return lines about the choice."""
        return [f"picked: {counted(self.picked, 'scan')}"]


def _done(prepared: PreparedPick, record: PickRecord, picked: Sequence[ScanFile]) -> set[ScanFile]:
    """Return the picked scans whose files are complete; all are written again if some are not."""
    data_set = prepared.data_set
    if not data_set.is_complete(record):
        return set()
    out = data_set.root / PREDICTED
    return {
        scan for scan in picked if filled(output_path(out, scan.sequence, "predictions", scan.stem))
    }
