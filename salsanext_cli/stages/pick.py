# SPDX-License-Identifier: MIT
"""Stage `pick`: the scans most worth labelling, as a data set that is ready to label."""

import hashlib
import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.engines.backend import PixelPrediction
from salsanext_cli.engines.network import Network
from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.errors import NOTICE, NoInputError, counted
from salsanext_cli.files.json_files import plain
from salsanext_cli.fitting.label_scan import PreparedScan, labelled, prepared_for
from salsanext_cli.fitting.sensor_fit import ScanSample, fit_scans, settings_of_network
from salsanext_cli.formats.kitti import encode_labels
from salsanext_cli.labelling.picked_data_set import (
    STAGE,
    TABLE,
    PickedDataSet,
    PickedScan,
    PickRecord,
    PickSettings,
)
from salsanext_cli.labelling.scan_choice import choose_scans, require_choice
from salsanext_cli.measures.scan_summary import RunSummary, ScanSummary, ScanWarning, log_recorded
from salsanext_cli.option_fields import KnnParameters, ScanSelection
from salsanext_cli.parallel.network_task import NetworkTask
from salsanext_cli.parallel.run import Failure, Outcome, RunOptions, run_over_scans
from salsanext_cli.report.picked import picked_cloud, picked_csv, picked_scans
from salsanext_cli.results.manifest import settings_json
from salsanext_cli.results.paths import ScanFile, find_scans
from salsanext_cli.results.selection import choose, evenly_spaced, scans_of, space_of
from salsanext_cli.uncertainty.estimate import Estimate
from salsanext_cli.uncertainty.monte_carlo import require_sampling
from salsanext_cli.uncertainty.scan_description import (
    DescribeJob,
    ScanDescription,
    checked_sample,
)

SAMPLES = 8  # Passes of Monte-Carlo dropout, whose masks are the same for all scans

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Picking:
    """Result of picking scans."""

    picked: tuple[PickedScan, ...]  # The scan most worth labelling first
    scans: int  # Number of scans to choose from
    outcome: Outcome  # Picked scans written and there already; all scans that failed, picked or not
    warnings: list[ScanWarning]  # Reasons to doubt scans, picked or not

    def to_dict(self) -> dict[str, object]:
        """Return plain data for JSON."""
        return {
            "stage": STAGE,
            "scans": self.scans,
            "picked": plain(self.picked),
            "failures": plain(self.outcome.failures),
            "warnings": plain(self.warnings),
        }


@dataclass(frozen=True, slots=True)
class PickJob:
    """Job that writes picked scans, and coloured clouds with the labels that a network guesses."""

    network: Network
    seed: int
    data_set: PickedDataSet

    def prepare(self, file: ScanFile) -> PreparedScan:
        """Read, check and project a scan."""
        return prepared_for(self.network, file)

    def compute(self, scans: Sequence[PreparedScan]) -> list[Estimate]:
        """Sample each scan."""
        return [checked_sample(p, network, SAMPLES, self.seed) for p, network, _ in scans]

    def finish(self, scan: PreparedScan, estimate: Estimate) -> tuple[ScanFile, bytes]:
        """Write the scan and its cloud; return the labels by the mean softmax, encoded."""
        file, space = scan.projected.file, scan.network.space
        guess = labelled(scan, PixelPrediction.of(estimate.probabilities), KnnParameters())
        information = estimate.uncertainty.mutual_information
        self.data_set.write_points(file, scan.network.sensor)
        cloud = picked_cloud(guess, information, space)
        self.data_set.write_missing(self.data_set.paths(file.sequence, file.stem).cloud, cloud)
        return file, encode_labels(space.to_raw(guess.labels))


def pick(
    source: Path,
    out: Path,
    *,
    count: int = 10,
    seed: int = 0,
    settings: NetworkSettings = NetworkSettings(),
    selection: ScanSelection = ScanSelection(),
    options: RunOptions = RunOptions(),
    labelled: Sequence[Path] = (),
) -> Picking:
    """Pick the scans most worth labelling; write a data set of them in SemanticKITTI's layout.

    Files that are there stay; a pick that nobody changed may be overwritten. `labelled`: data sets
    of scans that others are picked unlike.
    """
    require_choice(count, seed)
    network = settings.load()
    require_sampling(network, SAMPLES)
    every, data_set = scans_of(source), PickedDataSet(out)
    data_set.require_apart(every)
    space = space_of(every, network.space)
    scans = _candidates(every, selection, space, source)
    known = {scan.name for path in labelled for scan in find_scans(path)}
    if len(done := {scan for scan in scans if scan.name in known}) == len(scans):
        raise NoInputError(source, "every scan is labelled already", "others to pick")
    with data_set.open():
        network = fit_scans(settings, network, ScanSample(every, network.sensor))
        recorded = PickSettings(
            network=settings_of_network(network),
            count=count,
            seed=seed,
            scans=_digest(scans),
            labelled=_digest(sorted(done)) if labelled else None,
            samples=SAMPLES,
        )
        record = data_set.earlier(recorded, overwrite=options.overwrite)
        if record and data_set.is_complete(record):
            log_recorded(record.warnings)
            return _picking(record, scans)
        resolved = settings.resolved(network)
        if record is None:
            describe = partial(DescribeJob, samples=SAMPLES, seed=seed)
            task = NetworkTask(describe, resolved, network, batch=1)
            summary = RunSummary.of_scans(scans, network.sensor)
            if not (record := _chosen(task, scans, recorded, done, summary, options)).picked:
                return _picking(record, scans)
            data_set.begin_anew(record)
        write = partial(PickJob, seed=seed, data_set=data_set)
        task = NetworkTask(write, resolved, network, batch=1)
        classes = space if space.fits(network.space) else space_of([], network.space)
        outcome = _written(task, data_set, record, scans, options, classes)
    return replace(_picking(record, scans), outcome=outcome)


def _picking(record: PickRecord, scans: Sequence[ScanFile]) -> Picking:
    """Return a result of which every scan was written before."""
    outcome = Outcome(len(record.picked), _failures(record, scans), 0)
    return Picking(tuple(record.picked), len(scans), outcome, record.warnings)


def _candidates(
    every: list[ScanFile], selection: ScanSelection, space: LabelSpace, source: Path
) -> list[ScanFile]:
    """Return the scans to choose from, those of a limit evenly spaced."""
    selected = choose(every, replace(selection, limit=None), space, source)
    return evenly_spaced(selected, selection.limit or 0)


def _digest(scans: Sequence[ScanFile]) -> str:
    """Return the number of scans and a digest of their names and places."""
    names = "\n".join(f"{scan.name} {scan.path}" for scan in scans)
    digest = hashlib.sha256(names.encode("utf-8", "surrogateescape")).hexdigest()
    return f"{len(scans)}, {digest[:16]}"


def _chosen(
    task: NetworkTask,
    scans: Sequence[ScanFile],
    settings: PickSettings,
    done: set[ScanFile],
    summary: RunSummary,
    options: RunOptions,
) -> PickRecord:
    """Describe scans, and choose those unlike each other and unlike those that are done."""
    of_scan: dict[ScanFile, ScanDescription] = {}

    def keep(scan: ScanDescription) -> None:
        of_scan[scan.file] = scan
        summary.add(ScanSummary(scan.file, scan.check))

    failures = run_over_scans(task, scans, options, on_result=keep).failures
    described = [of_scan[scan] for scan in scans if scan in of_scan]
    labelled = [index for index, scan in enumerate(described) if scan.file in done]
    picked: list[PickedScan] = []
    if left := len(described) - len(labelled):
        if settings.count > left:
            log.log(NOTICE, "only %s: all are picked", counted(left, "scan"))
        features = np.stack([scan.features for scan in described])
        uncertainty = [scan.uncertainty for scan in described]
        choices = choose_scans(features, uncertainty, settings.count, labelled)
        picked = picked_scans(choices, [scan.file for scan in described])
    failed, warnings = [each.to_dict() for each in failures], summary.finished().warnings()
    return PickRecord(settings_json(settings), picked, failed, warnings)


def _written(
    task: NetworkTask,
    data_set: PickedDataSet,
    record: PickRecord,
    scans: Sequence[ScanFile],
    options: RunOptions,
    space: LabelSpace,
) -> Outcome:
    """Write what is missing of a data set of picked scans."""
    files, guesses = {scan.name: scan for scan in scans}, dict[ScanFile, bytes]()
    picked = [files[each.name] for each in record.picked if each.name in files]
    outcome = run_over_scans(task, picked, options, on_result=lambda each: guesses.update([each]))
    data_set.write_guesses(record, guesses)
    data_set.write_label_space(space, record.picked)
    data_set.write_missing(data_set.root / TABLE, picked_csv(record.picked))
    if len(guesses) == len(record.picked):
        # Poses of a part would stay: what is there is not written again.
        data_set.write_poses(guesses)
    return replace(outcome, failures=(*_failures(record, scans), *outcome.failures))


def _failures(record: PickRecord, scans: Sequence[ScanFile]) -> tuple[Failure, ...]:
    """Return the scans that could not be looked at when the choice was made."""
    files = {str(scan.path): scan for scan in scans}
    known = (failure for failure in record.failures if failure["scan"] in files)
    return tuple(
        Failure(files[f["scan"]], f["reason"], f.get("hint", ""), f["code"]) for f in known
    )
