# SPDX-License-Identifier: MIT
"""Reader of an output folder: its scans, their results, classes and provenance."""

import logging
import os
import shlex
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.classes.label_space import LabelSpace, RawIds
from salsanext_cli.core.errors import NoInputError, OutputError
from salsanext_cli.core.records import Float
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.texts import counted, first_few
from salsanext_cli.core.uncertainty.kinds import DEFAULT_UNCERTAINTIES, UNCERTAINTY
from salsanext_cli.core.wording import argument, command, setting
from salsanext_cli.io.files.reading import is_folder, present
from salsanext_cli.io.formats import read_scan
from salsanext_cli.io.formats.recordings import recording_of
from salsanext_cli.runs.results.folder_names import (
    PREDICTION_STAGES,
    SINGLE_SCAN_STAGES,
    SUFFIX_OF_FOLDER,
)
from salsanext_cli.runs.results.making_commands import PREDICT_VOTES, making_hint
from salsanext_cli.runs.results.manifest import Manifest, ScanSource
from salsanext_cli.runs.results.merged_labels import are_in_merged_classes, hint_for_error
from salsanext_cli.runs.results.moved_scans import (
    recorded_scans,
    scans_beside,
    scans_of_data_set,
    scans_of_renamed,
)
from salsanext_cli.runs.results.output_paths import find_outputs, output_path, with_outputs
from salsanext_cli.runs.results.provenance import Provenance
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.results.recorded_origins import sensor_of_result
from salsanext_cli.runs.results.scan_results import (
    PointLabels,
    ScanResults,
    read_kind,
    read_point_labels,
    read_truth,
)
from salsanext_cli.runs.scans.layouts import SCAN_FOLDER
from salsanext_cli.runs.scans.scan_file import ScanFile, require_unique_stems
from salsanext_cli.runs.scans.scan_selection import ScanSelection
from salsanext_cli.runs.scans.selection import (
    MissingResults,
    choose,
    data_set_of,
    space_of_labels,
    with_splits,
)

FOLDER_OF_COLUMN = {
    **dict.fromkeys(("label", "wrong"), "predictions"),
    **{kind: f"uncertainty/{kind}" for kind in UNCERTAINTY},
}
"""Folders of the values of points by column; other columns are in no folder."""
# A scan with a file in one of these has results; `predict` writes the confidence too.
FOLDERS = ("predictions", *(f"uncertainty/{k}" for k in UNCERTAINTY if k != "least_confidence"))

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class ChosenResults:
    """Selected scans with and without results."""

    listed: list[ScanFile]  # All scans to choose from
    scans: list[ScanFile]  # With labels or an uncertainty, at least one
    space: LabelSpace  # Classes of the labels
    labels: LabelSpace  # Meaning of the raw ids of the truth
    missing: MissingResults  # The other scans of the selection


@dataclass(frozen=True, slots=True)
class ResultFolder:
    """Results of scans in an output folder of earlier stages."""

    root: Path
    dataset: Path | None = None  # Place of scans and labels, if not the recorded one

    @property
    def manifest(self) -> Manifest:
        """Records of the stages that wrote the results."""
        return Manifest(self.root)

    @property
    def provenance(self) -> Provenance:
        """What the records state about the results."""
        return Provenance(self.root)

    def scans(self, sequence: str | None = None) -> list[ScanFile]:
        """Find the scans of the sequences with results; log results whose scans are gone."""
        self._require_current()
        with_results = self._names_with_results(sequence)
        sequences = sorted({name for name, _ in with_results})
        if not sequences:
            raise self._no_results()
        sources = self.manifest.sources()
        if self.dataset and len(sequences) == 1 and _is_sequence(self.dataset):
            scans = scans_of_renamed(self.dataset, sequences[0])
        else:
            scans = []
            for name in sequences:
                scans += self._scans_of_sequence(name, sources.get(name))
        scans = _one_of_each_name(scans, sources, with_results)
        gone = sorted(with_results - {(scan.sequence, scan.stem) for scan in scans})
        if gone:
            names = first_few(["/".join(name) for name in gone])
            text = "%s with results skipped, no such file: %s"
            log.warning(text, counted(len(gone), "scan"), names)
        if not scans:
            raise self._no_scans(sequences[0], sources.get(sequences[0]))
        return scans

    def _names_with_results(self, sequence: str | None) -> set[tuple[str, str]]:
        """Return sequence and stem of each scan with any result, of one sequence or of all."""
        names: set[tuple[str, str]] = set()
        for folder in SUFFIX_OF_FOLDER:
            names.update(find_outputs(self.root, folder))
        return {name for name in names if sequence in (None, name[0])}

    def _no_results(self) -> NoInputError:
        """Return the error of a folder without results."""
        if any(is_folder(folder) for folder in self.root.glob(f"sequences/*/{SCAN_FOLDER}")):
            return self._is_data_set()
        problem = "contains no results" if is_folder(self.root) else "no such folder"
        expected = "the output folder of an earlier stage"
        return NoInputError(self.root, problem, expected, making_hint("label", self.root))

    def _require_current(self) -> None:
        """Refuse fused labels if the labels of single scans were replaced since."""
        fused = self.manifest.settings("fuse")
        if fused is None or fused.fused_of is None:
            return
        single = Manifest(self.root / fused.fused_of)
        origins = Provenance(single.root).origins(SINGLE_SCAN_STAGES)
        if origins and origins != fused.origins:
            out = Path(os.path.normpath(single.root))
            if single.owner("votes", "probabilities"):
                words = shlex.join(["salsanext", "fuse", str(out), str(self.root)])
                again = command(words, setting("overwrite", True))
            else:
                again = PREDICT_VOTES.text(out, overwrite=True)
            problem = f"is outdated: labels in {out} were replaced"
            raise OutputError(self.root, problem, hint=f"run `{again}`")

    def _is_data_set(self) -> NoInputError:
        """Return the error of a data set that was given as results."""
        new = f"{os.path.normpath(self.root)}-out"
        predict = shlex.join(["salsanext", "predict", str(self.root), new])
        hint = f"run `{predict}`, then give {shlex.quote(new)}"
        return NoInputError(self.root, "is a data set", "a folder with results", hint)

    def _scans_of_sequence(self, sequence: str, source: ScanSource | None) -> list[ScanFile]:
        """Find the scans of a sequence: those that were recorded, else those of the data set."""
        scans: list[ScanFile] = []
        if source and not self.dataset:
            scans = recorded_scans(source, sequence)
        if not scans:
            scans = scans_of_data_set(self.dataset, sequence, is_recorded=source is not None)
        if not scans and source and not self.dataset:
            scans = scans_beside(self.root, sequence)
        if not scans:
            raise self._no_scans(sequence, source)
        return scans

    def _no_scans(self, sequence: str, source: ScanSource | None) -> NoInputError:
        """Return the error of a sequence whose scans were not found."""
        if source is None and scans_beside(self.root, sequence):
            return self._is_data_set()
        folder = self.dataset or (Path(source.folder) if source else Path().absolute())
        problem = f"no scans of it in {folder}"
        hint = f"give with {argument('dataset')} the folder that contains sequences/"
        fused = self.manifest.record("fuse")
        moved = fused.moved.get(sequence) if fused else None
        if moved:
            hint = f"{hint}; `fuse` took the scans from {moved}"
        return NoInputError(self.root / "sequences" / sequence, problem, hint=hint)

    def missing_predictions(self, scans: Iterable[ScanFile]) -> MissingResults:
        """Divide scans without predictions by whether the stage was asked for them."""
        sources = {stage: record.scans for stage, record in self.manifest.records().items()}
        # `knn-refine` works on the scans of `predict`.
        owner = self.manifest.owner("predictions") or ""
        return _missing(scans, [sources.get(owner) or sources.get("predict", {})])

    def missing_results(self, scans: Iterable[ScanFile]) -> MissingResults:
        """Divide scans without labels and uncertainty by whether any stage was asked for them."""
        records = self.manifest.records()
        return _missing(scans, [records[s].scans for s in PREDICTION_STAGES if s in records])

    def predicted(
        self,
        selection: ScanSelection,
        space: LabelSpace | None = None,
        classes: LabelSpace | None = None,
    ) -> tuple[list[ScanFile], LabelSpace]:
        """Select scans; return them and the classes of the comparison (see `compared_space`)."""
        return self.selected(self.scans(), selection, space, classes)

    def selected(
        self,
        scans: list[ScanFile],
        selection: ScanSelection,
        space: LabelSpace | None = None,
        classes: LabelSpace | None = None,
    ) -> tuple[list[ScanFile], LabelSpace]:
        """Select some of the scans that `scans` found, as `predicted`."""
        space = self.provenance.compared_space(scans, space, classes, other_ids=True)
        if selection.split:
            space = with_splits(space, data_set_of(scans[0]))
        chosen = choose(scans, selection, space, self.root)
        if selection.split:
            members = set(space.split(selection.split))
            sequences = {scan.sequence for scan in chosen}
            absent = sorted(members - sequences)
            if absent and members & sequences:
                log.warning("no results for %s of split %s", ", ".join(absent), selection.split)
        return chosen, space

    def chosen(self, query: ResultQuery) -> ChosenResults:
        """Select scans with results of any stage; log how many lack them."""
        limit = query.selection.limit
        unlimited = replace(query.selection, limit=None)
        listed = self.scans()
        chosen, space = self.selected(listed, unlimited, query.label_space, query.classes)
        self.provenance.require_same_weights()
        scans = with_outputs(chosen, self.root, *FOLDERS)[:limit]
        if not scans:
            hint = making_hint("label", self.root, chosen)
            raise NoInputError(self.root, "contains no results of these scans", hint=hint)
        if len(scans) == limit:
            # Scans after the last one of the limit are not missing.
            chosen = chosen[: chosen.index(scans[-1]) + 1]
        missing = self.missing_results(set(chosen) - set(scans))
        missing.log_error(len(chosen), "results")
        labels = space_of_labels(scans, space, query.label_space)
        return ChosenResults(
            listed=listed, scans=scans, space=space, labels=labels, missing=missing
        )

    def read(
        self,
        file: ScanFile,
        sensor: Sensor | None = None,
        classes: LabelSpace | None = None,
        truth_in: tuple[LabelSpace, LabelSpace] | None = None,
    ) -> ScanResults:
        """Read a scan and its results in this folder and in the data set.

        `classes`: classes into which predicted ones are merged; `truth_in`: label space of the ids
        of the truth, and the label space to convert it to.
        """
        scan = read_scan(file.path, sensor)
        labels = self._predicted_labels(file, len(scan))
        label = labels.raw if labels else None
        if label is not None and classes is not None:
            label = classes.to_raw(classes.to_train(label, strict=False))
        truth = read_truth(file, len(scan), *truth_in) if truth_in else None
        uncertainty: dict[str, Float] = {}
        for kind in UNCERTAINTY:
            path = self._path(file, kind)
            if present(path):
                uncertainty[kind] = read_kind(path, kind, len(scan))
        return ScanResults(
            scan=scan,
            label=label,
            truth=truth,
            uncertainty=uncertainty,
            sensor=sensor_of_result(self.root, file, scan, sensor) if sensor else None,
            rejected=self._rejected(label, classes),
            instance=labels.objects if labels else None,
        )

    def _predicted_labels(self, file: ScanFile, count: int) -> PointLabels | None:
        """Read the predicted labels, with numbers of objects if there are any; None without."""
        labels = read_point_labels(self._path(file, "label"), count)
        if labels is None or labels.objects is None:
            return labels
        prediction = self.provenance.prediction()
        has_objects = prediction is not None and prediction.objects
        if has_objects or labels.objects.any():
            return labels
        return replace(labels, objects=None)

    def _rejected(
        self, label: RawIds | None, classes: LabelSpace | None
    ) -> npt.NDArray[np.bool_] | None:
        """Return which points have no label in a run that rejects labels, (N,); else None."""
        space = classes or self.provenance.label_space()
        if label is None or space is None or self.provenance.rejected_above() is None:
            return None
        return space.to_train(label, strict=False) == 0

    def with_column(self, column: str, scans: Sequence[ScanFile]) -> list[ScanFile]:
        """Return the scans with the files for a column, one of `COLOURINGS`."""
        with_column = list(scans)
        if column in ("truth", "wrong"):
            with_column = [scan for scan in with_column if present(scan.label_path)]
        if column not in FOLDER_OF_COLUMN:
            return with_column
        return with_outputs(with_column, self.root, FOLDER_OF_COLUMN[column])

    def require_column(self, column: str, scans: Sequence[ScanFile]) -> None:
        """Raise `missing_column` if no scan has the column."""
        if not self.with_column(column, scans):
            raise self.missing_column(column, scans[0])

    def missing_column(self, column: str, file: ScanFile) -> NoInputError:
        """Return the error of a scan without the file for a column."""
        if column in ("truth", "wrong") and not present(file.label_path):
            return NoInputError(file.path, "has no labels", f"the file {file.label_path}")
        expected = f"the file {self._path(file, column)}"
        hint = making_hint(column, self.root, [file])
        weights = self.provenance.weights("predictions")
        if column == "error" and are_in_merged_classes(self.provenance.label_space(), weights):
            hint = hint_for_error(self.root, file)
        return NoInputError(file.path, f"has no {column}", expected, hint)

    def _path(self, file: ScanFile, column: str) -> Path:
        return output_path(self.root, file.sequence, FOLDER_OF_COLUMN[column], file.stem)

    def default_uncertainty(self, scans: Sequence[ScanFile]) -> str:
        """Return the kind for "uncertainty": the error if all scans have it, else the first one."""
        if len(self.with_column("error", scans)) == len(scans):
            return "error"
        for kind in DEFAULT_UNCERTAINTIES:
            if self.with_column(kind, scans):
                return kind
        return DEFAULT_UNCERTAINTIES[0]


def is_result_folder(folder: Path) -> bool:
    """Return whether a folder has results of scans, or the record of a stage that ran in it."""
    if not is_folder(folder):
        return False
    if any(find_outputs(folder, name) for name in FOLDERS):
        return True
    try:
        return bool(Manifest(folder).records())
    except OutputError:
        return False  # A file of somebody else that has the name of a record.


def _is_sequence(dataset: Path) -> bool:
    """Return whether it is a folder of scans or a recording, not a data set."""
    is_data_set = is_folder(dataset / "sequences")
    return bool(recording_of(dataset.absolute())) or (is_folder(dataset) and not is_data_set)


def _one_of_each_name(
    scans: Iterable[ScanFile],
    sources: Mapping[str, ScanSource],
    with_results: Container[tuple[str, str]],
) -> list[ScanFile]:
    """Return the recorded file of each name, sorted; refuse ambiguous scans with results."""
    chosen = []
    for key, group in groupby(sorted(scans), lambda scan: (scan.sequence, scan.stem)):
        files = list(group)
        sequence, stem = key
        suffix = sources[sequence].suffixes.get(stem) if sequence in sources else None
        if suffix:
            files = [file for file in files if file.path.name == stem + suffix]
        if key in with_results:
            require_unique_stems(files)
        chosen += files[:1]
    return chosen


def _missing(
    scans: Iterable[ScanFile], sources: Sequence[Mapping[str, ScanSource]]
) -> MissingResults:
    listed = sorted(scans)

    def was_requested(scan: ScanFile) -> bool:
        recorded = [
            stage_sources[scan.sequence]
            for stage_sources in sources
            if scan.sequence in stage_sources
        ]
        return not recorded or any(scan.stem in source.suffixes for source in recorded)

    missing = tuple(scan for scan in listed if was_requested(scan))
    return MissingResults(scans=missing, not_asked_for=len(listed) - len(missing))
