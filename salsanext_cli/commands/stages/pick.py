# SPDX-License-Identifier: MIT
"""Stage `pick`: a data set of the scans most worth labelling."""

import hashlib
import logging
import statistics
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from salsanext_cli.commands.jobs.pick_job import PickJob, PreLabel
from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.errors import NoInputError, UsageError
from salsanext_cli.core.measures.scan_choice import choose_scans, require_choice
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.plain_data import plain
from salsanext_cli.core.records import Origin
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.texts import counted
from salsanext_cli.core.uncertainty.monte_carlo import require_sampling
from salsanext_cli.core.wording import argument
from salsanext_cli.io.labelling_tools.registry import tool_named
from salsanext_cli.io.labelling_tools.tool import LabellingTool
from salsanext_cli.report.picked import picked_csv, picked_scans, scans_of_list
from salsanext_cli.runs.fit.scan_sample import sample_of_files
from salsanext_cli.runs.fit.sensor_fit import fit_scans, settings_of_network
from salsanext_cli.runs.labelling.map_frames import add_frames
from salsanext_cli.runs.labelling.picked_data_set import (
    CHOSEN,
    NAMED,
    STAGE,
    TABLE,
    PickedDataSet,
    PickedScan,
    PickRecord,
    PickSettings,
    UncertaintyScale,
)
from salsanext_cli.runs.labelling.scan_description import DescribeJob, ScanDescription
from salsanext_cli.runs.labelling.tool_files import SensorPositions, write_for_tool
from salsanext_cli.runs.loop.event_file import opened_events
from salsanext_cli.runs.loop.network_task import NetworkTask, sampling_task
from salsanext_cli.runs.loop.run import Failure, Outcome, RunOptions, run_over_scans
from salsanext_cli.runs.loop.run_origins import OriginsOfSource
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.records.stage_settings import ComputedSettings
from salsanext_cli.runs.results.manifest import settings_json
from salsanext_cli.runs.results.named_scans import named_scans, read_names
from salsanext_cli.runs.results.paths import ScanFile, find_scans
from salsanext_cli.runs.results.scan_selection import PICKED_SCANS, ScanSelection
from salsanext_cli.runs.results.selection import choose, evenly_spaced, scans_of, space_of
from salsanext_cli.runs.summary.scan_summary import RunSummary, ScanSummary
from salsanext_cli.runs.summary.scan_warnings import ScanWarning, log_recorded

SAMPLES = 8  # Passes of Monte-Carlo dropout, with the same masks for all scans

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
    require_choice(count, seed)
    labelling_tool = None if tool is None else tool_named(tool)
    network = settings.for_sampling().load()
    require_sampling(network, SAMPLES)
    listed = scans_of(source)
    data_set = PickedDataSet(out)
    data_set.require_apart(listed)
    space = space_of(listed, network.space)
    selected = choose(listed, replace(selection, limit=None), space, source)
    scans = _candidates(selected, selection, labelled, names)
    count = count if names is None else len(scans)
    done = _done(scans, labelled, source)
    with data_set.open():
        by_poses = OriginsOfSource(listed=listed)
        sample = sample_of_files(listed, network.sensor, origins_of=by_poses.sample_origins)
        network = fit_scans(settings, network, sample)
        recorded = _settings(
            network, count, seed, scans, done if labelled else None, is_list=names is not None
        )
        record = data_set.earlier(recorded, overwrite=options.overwrite)
        if record and data_set.is_complete(record):
            log_recorded(record.warnings)
            _add_files_of_tool(data_set, labelling_tool, record, scans, network.sensor, by_poses)
            with opened_events(options.events, 0):
                return _picking(record, scans)
        resolved = settings.resolved(network)
        origins = by_poses.scan_origins(scans, network.sensor)
        if record is None:
            describe = partial(DescribeJob, samples=SAMPLES, seed=seed, origins=origins)
            task = sampling_task(describe, resolved, network)
            record = _chosen(task, network, scans, recorded, done, options)
            if not record.picked:
                return _picking(record, scans)
            data_set.begin(record)
        write = partial(PickJob, seed=seed, samples=SAMPLES, data_set=data_set, origins=origins)
        task = sampling_task(write, resolved, network)
        space = space if space.fits(network.space) else space_of([], network.space)
        outcome = _written(task, data_set, record, scans, options, space)
        _add_files_of_tool(data_set, labelling_tool, record, scans, network.sensor, by_poses)
    return replace(_picking(record, scans), outcome=outcome)


def _settings(
    network: Network,
    count: int,
    seed: int,
    scans: Sequence[ScanFile],
    done: set[ScanFile] | None,
    *,
    is_list: bool,
) -> PickSettings:
    """Return the settings of a choice among scans, some of which are labelled already."""
    return PickSettings(
        network=settings_of_network(network, ComputedSettings),
        count=count,
        seed=seed,
        scans=_digest(scans),
        labelled=None if done is None else _digest(sorted(done)),
        samples=SAMPLES,
        strategy=NAMED if is_list else CHOSEN,
    )


def _done(scans: Sequence[ScanFile], labelled: Sequence[Path], source: Path) -> set[ScanFile]:
    """Return the scans that the data sets of labelled scans contain; refuse if all are."""
    labelled_names = {scan.name for path in labelled for scan in find_scans(path)}
    done = {scan for scan in scans if scan.name in labelled_names}
    if len(done) == len(scans):
        raise NoInputError(source, "has only labelled scans", "others to pick")
    return done


def _candidates(
    scans: Sequence[ScanFile],
    selection: ScanSelection,
    labelled: Sequence[Path],
    names: Path | None,
) -> list[ScanFile]:
    """Return the scans of a list of names, else evenly spaced ones.

    Options that choose scans too are refused beside a list.
    """
    if names is None:
        return evenly_spaced(scans, selection.limit or 0)
    if selection.limit:
        raise _chooses_too("selection.limit")
    if labelled:
        raise _chooses_too("labelled")
    return named_scans(read_names(names), scans, str(names))


def _chooses_too(name: str) -> UsageError:
    """Return the error of an argument beside a list of names."""
    problem = f"chooses scans, and so does {argument('names')}"
    return UsageError(argument(name), problem, "one of both")


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


def _digest(scans: Sequence[ScanFile]) -> str:
    """Return the number of scans and a digest of their names and places."""
    names = "\n".join(f"{scan.name} {scan.path}" for scan in scans)
    digest = hashlib.sha256(names.encode("utf-8", "surrogateescape")).hexdigest()
    return f"{len(scans)}, {digest[:16]}"


def _chosen(
    task: NetworkTask,
    network: Network,
    scans: Sequence[ScanFile],
    settings: PickSettings,
    done: set[ScanFile],
    options: RunOptions,
) -> PickRecord:
    """Describe scans; choose uncertain ones that differ from each other and from labelled ones."""
    summary = RunSummary(sensor=network.sensor, scans=scans)
    descriptions: dict[ScanFile, ScanDescription] = {}

    def add(scan: ScanDescription) -> None:
        descriptions[scan.file] = scan
        summary.add(ScanSummary(file=scan.file, check=scan.check))

    failures = run_over_scans(task, scans, options, on_result=add).failures
    described = [descriptions[scan] for scan in scans if scan in descriptions]
    return PickRecord(
        settings=settings_json(settings),
        picked=_picked(described, done, settings),
        failures=[failure.to_dict() for failure in failures],
        warnings=summary.finished().warnings(),
        scale=_scale(described, network.space) if described else None,
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


def _files(record: PickRecord, scans: Sequence[ScanFile]) -> list[ScanFile]:
    """Return the picked scans that are among those to choose from."""
    files = {scan.name: scan for scan in scans}
    return [files[scan.name] for scan in record.picked if scan.name in files]


def _written(
    task: NetworkTask,
    data_set: PickedDataSet,
    record: PickRecord,
    scans: Sequence[ScanFile],
    options: RunOptions,
    space: LabelSpace,
) -> Outcome:
    """Write the missing files of a data set of picked scans."""
    picked = _files(record, scans)
    pre_labels: dict[ScanFile, bytes] = {}
    frames: dict[ScanFile, Origin] = {}

    def add(pre_label: PreLabel) -> None:
        pre_labels[pre_label.scan] = pre_label.content
        frames[pre_label.scan] = pre_label.frame

    outcome = run_over_scans(task, picked, options, on_result=add)
    # The data set is complete with its other files, so these come first.
    add_frames(data_set, frames)
    if len(pre_labels) == len(record.picked):
        # Existing files are not replaced, so incomplete poses would remain.
        data_set.write_poses(frames)
    data_set.write_pre_labels(record, pre_labels)
    data_set.write_label_space(space, record.picked)
    data_set.write_missing(data_set.root / TABLE, picked_csv(record.picked))
    return replace(outcome, failures=(*_failures(record, scans), *outcome.failures))


def _add_files_of_tool(
    data_set: PickedDataSet,
    tool: LabellingTool | None,
    record: PickRecord,
    scans: Sequence[ScanFile],
    sensor: Sensor,
    by_poses: OriginsOfSource,
) -> None:
    """Write the picked scans for a labelling tool, if any."""
    if tool is None:
        return
    origins = by_poses.sample_origins(_files(record, scans), sensor)
    write_for_tool(data_set, tool, record.picked, SensorPositions(sensor=sensor, origins=origins))


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
