# SPDX-License-Identifier: MIT
"""Labels and softmax of single scans in an output folder that can be fused."""

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.errors import NoInputError, OutputError, SalsanextError, UsageError
from salsanext_cli.core.fusion.drive import Drive
from salsanext_cli.core.fusion.reach import FusionReach
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.texts import counted
from salsanext_cli.core.wording import argument, setting
from salsanext_cli.runs.drives.by_sequence import by_sequence
from salsanext_cli.runs.drives.scans_of_drive import drive_of_scans
from salsanext_cli.runs.records.digest_files import recorded_scans
from salsanext_cli.runs.records.stage_settings import FuseSettings, PredictSettings
from salsanext_cli.runs.results.folder_names import SINGLE_SCAN_STAGES
from salsanext_cli.runs.results.making_commands import PREDICT_VOTES, words_of_target
from salsanext_cli.runs.results.output_paths import with_outputs
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.results.recorded_origins import recorded_origins
from salsanext_cli.runs.results.result_folder import ResultFolder
from salsanext_cli.runs.scans.scan_file import ScanFile, drive_order
from salsanext_cli.runs.scans.selection import MissingResults, choose

SOFTMAX_FOLDERS = ("probabilities", "votes")


@dataclass(frozen=True, slots=True, kw_only=True)
class FusibleResults:
    """Labels and softmax of single scans that can be fused."""

    results: ResultFolder
    listed: Sequence[ScanFile]  # All scans of the sequences with results
    scans: Sequence[ScanFile]  # Selected scans with labels and softmax
    members: Mapping[str, Sequence[ScanFile]]  # All scans with both in the order of the drive
    space: LabelSpace
    sensor: Sensor
    missing: MissingResults  # Selected scans without labels or softmax

    @property
    def sequences(self) -> list[str]:
        """Names of the sequences of the selected scans."""
        return sequences_of(self.scans)

    def drives_by_poses(
        self, sequences: Sequence[str], poses: Path | None, *, stop: bool
    ) -> dict[str, Drive | SalsanextError | None]:
        """Return the drives of sequences by their poses or registration, or their errors.

        Parameters
        ----------
        sequences : sequence of str
            Names of sequences of selected scans.
        poses : Path, optional
            Poses of the only sequence; by default those in the folder of each sequence.
        stop : bool
            Whether to raise the first error.

        Returns
        -------
        dict
            By name of the sequence; None without a file, if the scans are not registered.
        """
        if poses is not None and len(self.sequences) > 1:
            problem = f"is one file for {counted(len(self.sequences), 'sequence')}"
            hint = f"choose one sequence with {argument('sequences')}"
            raise UsageError(argument("poses"), problem, hint=hint)
        origin_of = recorded_origins(self.results.root, self.sensor)

        def drive_of(name: str) -> Drive | None:
            return drive_of_scans(self.members[name], self.sensor, origin_of, poses)

        return by_sequence(sequences, drive_of, stop=stop)

    def settings_of_votes(self, reach: FusionReach) -> FuseSettings:
        """Return the settings to record beside the labels of single scans."""
        return FuseSettings(
            reach=reach, origins=self.results.provenance.origins(SINGLE_SCAN_STAGES)
        )

    def settings_of_labels(self, reach: FusionReach, target: Path) -> FuseSettings:
        """Return the settings to record for the fused labels in a folder."""
        prediction = self.results.manifest.settings("predict") or PredictSettings()
        # The record of the fused labels has a file of its own.
        trained = recorded_scans(prediction.trained_on or "", self.results.manifest.path("predict"))
        return FuseSettings(
            label_space=self.space,
            sensor=self.sensor,
            weights=prediction.weights,
            weights_version=prediction.weights_version,
            inherited=prediction.inherited,
            trained_on="".join(sorted(trained.digests)) or prediction.trained_on,
            temperature=prediction.temperature,
            reach=reach,
            fused_of=os.path.relpath(self.results.root, target),
            origins=self.results.provenance.origins(SINGLE_SCAN_STAGES),
        )


def sequences_of(scans: Iterable[ScanFile]) -> list[str]:
    """Return the names of the sequences of scans."""
    return list(dict.fromkeys(file.sequence for file in scans))


def fusible_results(out: Path, query: ResultQuery) -> FusibleResults:
    """Return the results of `predict` in a folder; refuse those that cannot be fused.

    Parameters
    ----------
    out : Path
        Folder with labels and softmax of single scans.
    query : ResultQuery
        Choice of scans and data set.

    Returns
    -------
    FusibleResults

    Raises
    ------
    SalsanextError
        If another run writes into the folder, labels were rejected, or no scan has a softmax in
        the classes of its labels.
    """
    _require_unrejected(out)
    results = ResultFolder(out, query.dataset)
    all_scans = results.scans()
    with_softmax = with_outputs(all_scans, out, *SOFTMAX_FOLDERS)
    with_softmax = with_outputs(with_softmax, out, "predictions")
    space = results.provenance.label_space()
    softmax_space = results.provenance.label_space(*SOFTMAX_FOLDERS)
    if not with_softmax or space is None or softmax_space is None:
        raise _no_softmax(results, all_scans)
    if not space.fits(softmax_space):
        problem = f"has labels of {space.name}, but softmax of {softmax_space.name}"
        raise OutputError(out, problem, "the same label space", "predict both again")
    compared_space = results.provenance.compared_space(with_softmax, other_ids=True)
    selected = choose(all_scans, query.selection, compared_space, out)
    fusible = {*selected} & {*with_softmax}
    missing = results.missing_predictions({*selected} - fusible)
    missing.log_error(len(selected), "softmax and labels")
    return FusibleResults(
        results=results,
        listed=all_scans,
        scans=[file for file in selected if file in fusible],
        members=_in_order_of_drives(with_softmax),
        space=space,
        sensor=results.provenance.sensor(),
        missing=missing,
    )


def _require_unrejected(out: Path) -> None:
    """Refuse a folder in which another run predicts, or with rejected labels."""
    predictions = OwnedFolder(out, "predict")
    if predictions.is_shared():
        raise predictions.busy()
    if ResultFolder(out).provenance.rejected_above() is not None:
        problem = "has labels of which some were rejected"
        hint = f"predict without {argument('reject')}"
        raise OutputError(out, problem, "all labels, since votes replace rejected ones", hint)


def _no_softmax(results: ResultFolder, scans: Sequence[ScanFile]) -> NoInputError:
    """Return the error of a folder without a softmax, with the command that writes one."""
    was_fused = results.manifest.record("fuse") is not None
    target = PREDICT_VOTES.target(results.root, scans)
    predict = PREDICT_VOTES.text(results.root, scans, target=target, overwrite=was_fused)
    following = words_of_target(results.root, target)
    hint = f"run `{predict}`, or with {setting('extras', ('probabilities',))}{following}"
    return NoInputError(results.root, "has no softmax of any scan", "votes or probabilities", hint)


def _in_order_of_drives(scans: Sequence[ScanFile]) -> dict[str, list[ScanFile]]:
    """Return the scans of each sequence in the order of its drive."""
    members: dict[str, list[ScanFile]] = {}
    for file in sorted(scans, key=drive_order):
        members.setdefault(file.sequence, []).append(file)
    return members
