# SPDX-License-Identifier: MIT
"""Stage `pick`: a data set of the scans most worth labelling."""

import logging
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from salsanext_cli.commands.jobs.pick_job import PickJob, PreLabel
from salsanext_cli.commands.jobs.plans.pick_plan import PickPlan
from salsanext_cli.commands.jobs.plans.prepared_pick import SAMPLES, PreparedPick, prepare_pick
from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.measures.scan_choice import choose_scans
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.plain_data import plain
from salsanext_cli.core.records import Origin
from salsanext_cli.core.texts import counted
from salsanext_cli.io.annotation_tools.registry import tool_named
from salsanext_cli.io.annotation_tools.tool import AnnotationTool
from salsanext_cli.report.picked import picked_csv, picked_scans, scans_of_list
from salsanext_cli.runs.annotation.map_frames import frames_beside
from salsanext_cli.runs.annotation.picked_data_set import (
    NAMED,
    STAGE,
    TABLE,
    PickedScan,
    PickRecord,
    PickSettings,
    UncertaintyScale,
)
from salsanext_cli.runs.annotation.picked_frames import frames_of_copies, origins_of, picked_frames
from salsanext_cli.runs.annotation.scan_description import DescribeJob, ScanDescription
from salsanext_cli.runs.annotation.tool_files import SensorPositions, require_places, write_for_tool
from salsanext_cli.runs.loop.network_task import NetworkTask, sampling_task
from salsanext_cli.runs.loop.run import Failure, Outcome, RunOptions, run_over_scans
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.results.manifest import settings_json
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_selection import PICKED_SCANS, ScanSelection
from salsanext_cli.runs.scans.selection import space_of
from salsanext_cli.runs.summary.run_summary import RunSummary
from salsanext_cli.runs.summary.scan_summary import ScanSummary
from salsanext_cli.runs.summary.scan_warnings import ScanWarning, log_recorded

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class Picking:
    """Result of picking scans."""

    picked: tuple[PickedScan, ...]  # The scan most worth labelling first
    scans: int  # Number of scans to choose from
    outcome: Outcome  # Of the picked scans, and failures of all scans
    warnings: list[ScanWarning]  # Of all scans
    scale: UncertaintyScale | None = None  # None without described scans

    def to_dict(self) -> dict[str, object]:
        """Return plain data for JSON."""
        return {
            "stage": STAGE,
            "scans": self.scans,
            "picked": plain(self.picked),
            "scale": plain(self.scale),
            "failures": plain(self.outcome.failures),
            "warnings": plain(self.warnings),
        }


def pick(
    source: Path,
    out: Path,
    *,
    count: int = PICKED_SCANS,
    seed: int = 0,
    settings: NetworkSettings = NetworkSettings(),
    selection: ScanSelection = ScanSelection(),
    options: RunOptions = RunOptions(),
    labelled: Sequence[Path] = (),
    names: Path | None = None,
    tool: str | None = None,
) -> Picking:
    """Write a data set of the scans most worth labelling, in the layout of SemanticKITTI.

    Parameters
    ----------
    source : Path
        Scans to choose from.
    out : Path
        Folder of the data set.
    count : int
        Number of scans to pick.
    seed : int
        Seed of the dropout masks.
    settings : NetworkSettings, optional
        Weights, device and sensor of the network; by default those of the package.
    selection : ScanSelection, optional
        Subset of the scans, evenly spaced if limited; all by default.
    options : RunOptions, optional
        Workers, progress, and treatment of an existing data set.
    labelled : sequence of Path
        Data sets of labelled scans, which the picked ones are to differ from.
    names : Path, optional
        Text file with the names of the scans to pick, one per line, instead of `count` scans.
    tool : str, optional
        Labelling tool, for which the picked scans are also written into the folder ``tools``.

    Returns
    -------
    Picking
    """
    labelling_tool = None if tool is None else tool_named(tool)
    prepared = prepare_pick(
        source,
        out,
        count=count,
        seed=seed,
        settings=settings,
        selection=selection,
        labelled=labelled,
        names=names,
    )
    data_set = prepared.data_set
    scans = prepared.scans
    network = prepared.network
    by_poses = prepared.origins
    with data_set.open():
        record = _earlier(prepared, labelling_tool, options)
        if record:
            data_set.restore_frames(record)
        if record and data_set.is_complete(record):
            log_recorded(record.warnings)
            _add_files_of_tool(prepared, labelling_tool, record)
            return _picking(record, scans)
        beside = _frames(prepared, record)
        resolved = settings.resolved(network)
        origins = by_poses.scan_origins(scans, network.sensor)
        if record is None:
            describe = partial(DescribeJob, samples=SAMPLES, seed=seed, origins=origins)
            task = sampling_task(describe, resolved, network)
            record = _chosen(task, prepared, beside, options)
            if not record.picked:
                return _picking(record, scans)
            data_set.begin(record)
            # Another run goes on with this choice.
            _require_places(prepared, labelling_tool, record)
        picked = prepared.files(record)
        recorded = record.frames or {}
        unrecorded = [scan for scan in picked if scan.name not in recorded]
        if unrecorded:
            frames = frames_of_copies(out, unrecorded, network.sensor, beside)
            recorded = dict(sorted({**recorded, **frames}.items()))
            record = data_set.record_frames(record, recorded)
        write = partial(
            PickJob,
            seed=seed,
            samples=SAMPLES,
            data_set=data_set,
            origins=origins,
            beside=beside,
            recorded=origins_of(recorded, [scan for scan in picked if scan.name in recorded]),
        )
        task = sampling_task(write, resolved, network)
        outcome = _written(task, prepared, record, options)
        _add_files_of_tool(prepared, labelling_tool, record)
    return replace(_picking(record, scans), outcome=outcome)


def plan_pick(
    source: Path,
    out: Path,
    *,
    count: int = PICKED_SCANS,
    seed: int = 0,
    settings: NetworkSettings = NetworkSettings(),
    selection: ScanSelection = ScanSelection(),
    options: RunOptions = RunOptions(),
    labelled: Sequence[Path] = (),
    names: Path | None = None,
    tool: str | None = None,
) -> PickPlan:
    """Return what `pick` would do with the same arguments; write nothing into `out`.

    Parameters
    ----------
    source, out, count, seed, settings, selection, options, labelled, names, tool
        As for `pick`.

    Returns
    -------
    PickPlan
        The scans to do are all scans to choose from, or the picked scans without all their files
        where an earlier run has chosen them.

    Raises
    ------
    SalsanextError
        What the run would refuse.
    """
    labelling_tool = None if tool is None else tool_named(tool)
    prepared = prepare_pick(
        source,
        out,
        count=count,
        seed=seed,
        settings=settings,
        selection=selection,
        labelled=labelled,
        names=names,
    )
    record = _earlier(prepared, labelling_tool, options)
    if record is not None:
        prepared.data_set.lost_frames(record)  # Refuses edited ones
    if record is None or not prepared.data_set.is_complete(record):
        _frames(prepared, record)  # Refuses damaged ones
    return PickPlan.from_prepared(prepared, record)


def _earlier(
    prepared: PreparedPick, tool: AnnotationTool | None, options: RunOptions
) -> PickRecord | None:
    """Return the record of an earlier run to go on with, None for a new pick; or refuse the run."""
    data_set = prepared.data_set
    record = data_set.earlier(prepared.settings, overwrite=options.overwrite)
    if record is None:
        data_set.refuse_lost_frames(prepared.scans)
    _require_places(prepared, tool, record)
    return record


def _frames(prepared: PreparedPick, record: PickRecord | None) -> dict[ScanFile, Origin]:
    """Read the frames beside the picked scans of a record, beside all scans without one."""
    return frames_beside(prepared.scans if record is None else prepared.files(record))


def _require_places(
    prepared: PreparedPick, tool: AnnotationTool | None, record: PickRecord | None
) -> None:
    """Refuse scans with one place in the folder of a tool, if it is known that they are picked."""
    if tool is None:
        return
    picked: Sequence[ScanFile] = []
    unlabelled = [scan for scan in prepared.scans if scan not in prepared.labelled]
    if record is not None:
        picked = prepared.files(record)
    elif prepared.count == len(unlabelled):
        picked = unlabelled
    require_places(tool, [(scan.sequence, scan.stem) for scan in picked])


def _picking(record: PickRecord, scans: Sequence[ScanFile]) -> Picking:
    """Return the result if every picked scan was written before."""
    outcome = Outcome(skipped=len(record.picked), failures=_failures(record, scans), done=0)
    return Picking(
        picked=tuple(record.picked),
        scans=len(scans),
        outcome=outcome,
        warnings=record.warnings,
        scale=record.scale,
    )


def _chosen(
    task: NetworkTask,
    prepared: PreparedPick,
    beside: Mapping[ScanFile, Origin],
    options: RunOptions,
) -> PickRecord:
    """Describe scans; choose uncertain ones that differ from each other and from labelled ones.

    `beside`: frames in files beside the scans, metres.
    """
    scans = prepared.scans
    network = prepared.network
    summary = RunSummary(sensor=network.sensor, scans=scans)
    descriptions: dict[ScanFile, ScanDescription] = {}

    def add(scan: ScanDescription) -> None:
        descriptions[scan.file] = scan
        summary.add(ScanSummary(file=scan.file, check=scan.check))

    failures = run_over_scans(task, scans, options, on_result=add).failures
    described = [descriptions[scan] for scan in scans if scan in descriptions]
    picked = _picked(described, prepared.labelled, prepared.settings)
    picked_names = {scan.name for scan in picked}
    stated = {scan.file: scan.frame for scan in described if scan.file.name in picked_names}
    return PickRecord(
        settings=settings_json(prepared.settings),
        picked=picked,
        failures=[failure.to_dict() for failure in failures],
        warnings=summary.finished().warnings(),
        scale=_scale(described, network.space) if described else None,
        frames=picked_frames(stated, beside),
    )


def _picked(
    described: Sequence[ScanDescription], done: set[ScanFile], settings: PickSettings
) -> list[PickedScan]:
    """Pick scans by their descriptions; none if all of them are labelled."""
    labelled = [index for index, scan in enumerate(described) if scan.file in done]
    unlabelled = len(described) - len(labelled)
    if not unlabelled:
        return []
    if settings.strategy == NAMED:
        return scans_of_list(described)
    if settings.count > unlabelled:
        log.log(NOTICE, "all of only %s are picked", counted(unlabelled, "scan"))
    features = np.stack([scan.features for scan in described])
    uncertainty = [scan.uncertainty for scan in described]
    choices = choose_scans(features, uncertainty, settings.count, labelled)
    return picked_scans(choices, [scan.file for scan in described])


def _scale(described: Sequence[ScanDescription], space: LabelSpace) -> UncertaintyScale:
    """Return the scale of the uncertainties of described scans."""
    values = [scan.uncertainty for scan in described]
    return UncertaintyScale(
        least=min(values),
        median=statistics.median(values),
        most=max(values),
        class_count=space.class_count,
    )


def _written(
    task: NetworkTask, prepared: PreparedPick, record: PickRecord, options: RunOptions
) -> Outcome:
    """Write the missing files of a data set of picked scans."""
    data_set = prepared.data_set
    picked = prepared.files(record)
    pre_labels: dict[ScanFile, bytes] = {}

    def add(pre_label: PreLabel) -> None:
        pre_labels[pre_label.scan] = pre_label.content

    outcome = run_over_scans(task, picked, options, on_result=add)
    if len(pre_labels) == len(record.picked):
        # Existing files are not replaced, so incomplete poses would remain.
        data_set.write_poses(origins_of(record.frames or {}, picked))
    data_set.write_pre_labels(record, pre_labels)
    network_space = prepared.network.space
    is_same = prepared.space.fits(network_space)
    space = prepared.space if is_same else space_of([], network_space)
    data_set.write_label_space(space, record.picked)
    data_set.write_missing(data_set.root / TABLE, picked_csv(record.picked))
    return replace(outcome, failures=(*_failures(record, prepared.scans), *outcome.failures))


def _add_files_of_tool(
    prepared: PreparedPick, tool: AnnotationTool | None, record: PickRecord
) -> None:
    """Write the picked scans for a labelling tool, if any."""
    if tool is None:
        return
    sensor = prepared.network.sensor
    origins = prepared.origins.sample_origins(prepared.files(record), sensor)
    positions = SensorPositions(sensor=sensor, origins=origins)
    write_for_tool(prepared.data_set, tool, record.picked, positions)


def _failures(record: PickRecord, scans: Sequence[ScanFile]) -> tuple[Failure, ...]:
    """Return the scans that could not be read for the choice."""
    files = {str(scan.path): scan for scan in scans}
    return tuple(
        Failure(
            scan=files[failure["scan"]],
            reason=failure["reason"],
            hint=failure.get("hint", ""),
            code=failure["code"],
        )
        for failure in record.failures
        if failure["scan"] in files
    )
