# SPDX-License-Identifier: MIT
"""Run of a stage that copies whole bags with other clouds, for `filter` and `export-bag`."""

import logging
import shlex
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from salsanext_cli.core.errors import FormatError, NoInputError, OutputError, SalsanextError
from salsanext_cli.core.geometry.point_sample import measured_ranges
from salsanext_cli.core.texts import counted, first_few, with_hint
from salsanext_cli.io.files.atomic import refusal
from salsanext_cli.io.files.locks import temporary_folder
from salsanext_cli.io.files.reading import filled, is_folder, present
from salsanext_cli.io.formats import read_scan
from salsanext_cli.io.formats.recording_kinds import BAG, kind_of
from salsanext_cli.io.formats.recordings import (
    files_of,
    is_recording,
    recorded_paths,
    recording_of,
    sequence_of,
)
from salsanext_cli.io.formats.ros.bag_copies import CloudChange, Types, copy_bag
from salsanext_cli.io.formats.ros.bags import HINT, Bag
from salsanext_cli.runs.copies.bag_sources import BagSources, BagState
from salsanext_cli.runs.copies.cloud_progress import CloudProgress
from salsanext_cli.runs.loop.event_file import opened_events
from salsanext_cli.runs.loop.run import Failure, Outcome, RunOptions
from salsanext_cli.runs.results.making_commands import making_hint
from salsanext_cli.runs.results.output_paths import output_path
from salsanext_cli.runs.results.owned_folder import OwnedFolder, files_at
from salsanext_cli.runs.results.result_folder import ResultFolder
from salsanext_cli.runs.scans.scan_file import ScanFile

NewTopic = Callable[[Bag, str], str]
"""Function from a bag and a topic of it to the topic of the new clouds."""
NewCloud = Callable[[ScanFile, Any, Types], Any]
"""Function from a scan, its message and the classes of messages to the new message."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True, order=True)
class BagOfResults:
    """Bag with the topics whose clouds have results."""

    path: Path
    folders: tuple[Path, ...]  # Of the topics, as recordings name them
    first: ScanFile  # First scan with results, which stands for the bag in lists of failures

    def clouds(self) -> list[ScanFile]:
        """Return all clouds of the topics, with results or not."""
        return [
            ScanFile(sequence=self.first.sequence, stem=path.name, path=path)
            for folder in self.folders
            for path in recorded_paths(folder)
        ]


def bags_of(scans: Sequence[ScanFile]) -> list[BagOfResults]:
    """Return the bags that scans are clouds of, in their order; none for scans in files."""
    first_by_folder: dict[Path, ScanFile] = {}
    for scan in scans:
        first_by_folder.setdefault(scan.path.parent, scan)
    folders_by_bag: dict[Path, list[Path]] = {}
    for folder in first_by_folder:
        recording = recording_of(folder)
        if recording is not None and is_bag(recording):
            folders_by_bag.setdefault(recording, []).append(folder)
    return [
        BagOfResults(path=path, folders=tuple(folders), first=first_by_folder[folders[0]])
        for path, folders in folders_by_bag.items()
    ]


def is_bag(recording: Path) -> bool:
    """Return whether a recording is a ROS bag."""
    return kind_of(recording) is BAG


@dataclass(frozen=True, slots=True, kw_only=True)
class BagsToCopy:
    """Bags without a copy, and what is done."""

    clouds: Mapping[BagOfResults, Sequence[ScanFile]]  # All clouds of each bag without a copy
    done: int  # Number of the clouds of the other bags


@dataclass(frozen=True, slots=True, kw_only=True)
class BagRun:
    """Copies of bags in a folder that a stage fills.

    A bag gets its name when it is complete, and one that fails leaves nothing.
    """

    results: ResultFolder
    owned: OwnedFolder
    new_topic: NewTopic
    new_cloud: NewCloud

    def to_copy(
        self, bags: Sequence[BagOfResults], options: RunOptions, failures: list[Failure]
    ) -> BagsToCopy:
        """Return the bags of this shard without a copy; add unreadable ones to `failures`."""
        self._require_a_name_each(bags)
        clouds_of_bags: dict[BagOfResults, list[ScanFile]] = {}
        done = 0
        for bag in options.shard.select(bags):
            with _listed_failure(bag, failures, options):
                clouds = bag.clouds()
                if self._is_done(bag, len(clouds)) and not options.overwrite:
                    done += len(clouds)
                else:
                    clouds_of_bags[bag] = clouds
        return BagsToCopy(clouds=clouds_of_bags, done=done)

    def run(self, bags: Sequence[BagOfResults], options: RunOptions) -> Outcome:
        """Copy the bags of this shard that are not done, one after the other."""
        start = time.monotonic()
        failures: list[Failure] = []
        to_copy = self.to_copy(bags, options, failures)
        total = sum(map(len, to_copy.clouds.values()))
        progress = CloudProgress(total=total, show=options.progress)
        progress.begin()
        done = 0
        with opened_events(options.events, total) as events:
            for bag, clouds in to_copy.clouds.items():
                with (
                    _listed_failure(bag, failures, options),
                    progress.attempt(len(clouds)),
                    events.together(clouds),
                ):
                    done += self._copy(bag, clouds, progress)
        return Outcome(
            skipped=to_copy.done,
            failures=tuple(sorted(failures, key=lambda failure: failure.scan)),
            done=done,
            seconds=time.monotonic() - start,
        )

    @property
    def _sources(self) -> BagSources:
        return BagSources(self.owned)

    def target(self, bag: BagOfResults) -> Path:
        """Return the path of a copy: a file for ROS 1, a folder for ROS 2."""
        suffix = ".bag" if bag.path.suffix.lower() == ".bag" and not is_folder(bag.path) else ""
        return self.owned.root / f"{sequence_of(bag.path)}{suffix}"

    def _require_a_name_each(self, bags: Sequence[BagOfResults]) -> None:
        """Refuse two bags whose copies would have the same name."""
        sources: dict[Path, Path] = {}
        for bag in bags:
            target = self.target(bag)
            if target in sources:
                problem = f"would be the copy of both {sources[target]} and {bag.path}"
                raise OutputError(target, problem, "one bag of this name", "rename one of them")
            sources[target] = bag.path

    def _is_done(self, bag: BagOfResults, clouds: int) -> bool:
        """Return whether there is a whole copy of a bag as it is now, with a number of clouds."""
        target = self.target(bag)
        if not present(target) or not is_recording(target):
            return False
        if self._sources.state(target.name) != BagState.from_bag(bag.path, clouds):
            return False
        return all(map(filled, files_at(target))) and not self.owned.foreign_members(target)

    def _copy(self, bag: BagOfResults, clouds: Sequence[ScanFile], progress: CloudProgress) -> int:
        """Copy a bag; return the number of its clouds with results."""
        target = self.target(bag)
        state = BagState.from_bag(bag.path, len(clouds))  # A change while it is copied shows later
        self.owned.refuse_foreign_members(target)
        self._require_labels(bag, clouds)
        opened = Bag(bag.path, files_of(bag.path))
        changes = self._changes(opened, bag, clouds, progress)
        self._warn_of_other_topics(opened, target, changes)
        try:
            with temporary_folder(self.owned.root) as temporary:
                written = temporary / target.name
                count = copy_bag(opened, written, changes)
                if count != len(clouds):
                    problem = f"has {count:,} clouds, and {len(clouds):,} in its index"
                    raise FormatError(bag.path, problem, "a complete bag", HINT)
                self.owned.adopt(written, target)
            self._sources.record(target.name, state)
        except OSError as error:
            raise refusal(target, error) from error
        return count

    def _changes(
        self, opened: Bag, bag: BagOfResults, clouds: Sequence[ScanFile], progress: CloudProgress
    ) -> Mapping[str, CloudChange]:
        """Return the new clouds by topic; each one counts as progress."""
        scans = {cloud.path: cloud for cloud in clouds}

        def new_message(path: Path, message: Any, types: Types) -> Any:
            if path not in scans:
                raise FormatError(path, "is not in the index of the bag", "a complete bag", HINT)
            new = self.new_cloud(scans[path], message, types)
            progress.add_cloud()
            return new

        topics = [t for t in opened.cloud_topics() if bag.path / t.strip("/") in bag.folders]
        return {
            topic: CloudChange(topic=self.new_topic(opened, topic), new_message=new_message)
            for topic in topics
        }

    def _require_labels(self, bag: BagOfResults, clouds: Sequence[ScanFile]) -> None:
        """Refuse a bag if a cloud with measurements has no labels: a bag is copied as a whole."""
        missing = [cloud for cloud in clouds if not present(label_path(self.results, cloud))]
        # The first one that should have labels is enough; reading a cloud takes time.
        measured = next(filter(has_measurements, missing), None)
        if measured is None:
            return
        share = f"{len(missing):,} of {counted(len(clouds), 'cloud')}"
        problem = f"has no labels of {share}, such as {measured.stem}"
        # If runs were asked for the first clouds only, the last one needs a run over all.
        hint = making_hint("label", self.results.root, missing[-1:])
        raise NoInputError(bag.path, problem, "labels of all clouds of the topic", hint)

    def _warn_of_other_topics(
        self, opened: Bag, target: Path, changes: Mapping[str, CloudChange]
    ) -> None:
        """Warn that other topics with points of the bag stay as they are."""
        others = opened.other_points(changes)
        if not others or any(topic != change.topic for topic, change in changes.items()):
            return
        text = f"{opened.path}: these topics still have all their points: {first_few(others)}"
        clouds = [topic for topic in others if topic in opened.cloud_topics()]
        hint = "do not play them"
        if clouds:
            words = shlex.join(["salsanext", "predict", str(target / clouds[0].strip("/")), "OUT"])
            hint = f"do not play them, or label the new bag too, `{words}`, and filter it by OUT"
        log.warning("%s", with_hint(text, hint))


@contextmanager
def _listed_failure(
    bag: BagOfResults, failures: list[Failure], options: RunOptions
) -> Iterator[None]:
    """Add the error of a bag in the body to a list, unless the first one ends the run."""
    try:
        yield
    except SalsanextError as error:
        if options.on_error == "stop":
            raise
        failures.append(Failure.from_error(bag.first, error))


def label_path(results: ResultFolder, file: ScanFile) -> Path:
    """Return the path of the predicted labels of a scan."""
    return output_path(results.root, file.sequence, "predictions", file.stem)


def has_measurements(file: ScanFile) -> bool:
    """Return whether any point of a scan has a measurement; the first of a driver may have none."""
    return bool(measured_ranges(read_scan(file.path).points)[1].any())
