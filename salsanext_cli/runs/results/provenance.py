# SPDX-License-Identifier: MIT
"""Provenance of the results in a folder: their classes, sensor, weights and threshold."""

import hashlib
import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TypeVar

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.classes.merging import ClassMerging, contradiction
from salsanext_cli.core.errors import LabelError, OutputError
from salsanext_cli.core.network.card import RiskThreshold
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.texts import first_few
from salsanext_cli.core.wording import argument, command, setting
from salsanext_cli.io.sensors import sensor
from salsanext_cli.runs.records.digest_files import (
    NO_SCANS,
    RecordedScans,
    digests_of_guarantee,
    recorded_scans,
)
from salsanext_cli.runs.records.stage_settings import (
    PredictSettings,
    RefineSettings,
    WeightsSettings,
)
from salsanext_cli.runs.results.folder_names import ERROR
from salsanext_cli.runs.results.manifest import FORMER, Manifest
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_selection import ScanSelection
from salsanext_cli.runs.scans.selection import space_of

Kind = TypeVar("Kind")
UNCERTAINTY_SETTINGS = ("method", "samples", "seed", "noise", "weights")
"""Settings of `uncertainty` that an evaluation records."""


@dataclass(frozen=True, slots=True)
class Provenance:
    """What the records of a folder state about its results."""

    root: Path

    @property
    def manifest(self) -> Manifest:
        """Records of the folder."""
        return Manifest(self.root)

    def origins(self, stages: Iterable[str]) -> dict[str, str]:
        """Return digests of the settings of stages that ran, for the records of later stages."""
        digests: dict[str, str] = {}
        for stage in stages:
            record = self.manifest.record(stage)
            if record is None:
                continue
            # Digests that older versions recorded are of their keys.
            settings = {FORMER.get(key, key): value for key, value in record.settings.items()}
            text = json.dumps(settings, sort_keys=True)
            digests[stage] = hashlib.sha256(text.encode()).hexdigest()[:12]
        return digests

    def label_space(self, *folders: str) -> LabelSpace | None:
        """Return the classes of the first recorded folder, by default of the predictions."""
        settings = self.manifest.settings_of(*(folders or ("predictions", "pixel_labels")))
        return self._recorded(settings.label_space, "label space") if settings else None

    def compared_space(
        self,
        scans: Sequence[ScanFile],
        space: LabelSpace | None = None,
        classes: LabelSpace | None = None,
        *,
        other_ids: bool = False,
    ) -> LabelSpace:
        """Return the classes in which predictions and labels are compared, with the labels' splits.

        They are the classes of the predictions, which may be merged classes of the labels, or
        `classes`, into which both are merged. `space`: classes of the labels, by default of the
        data set; `other_ids`: whether labels may have other raw ids for classes of the same names.
        """
        recorded = self.label_space()
        space = space or space_of(scans, recorded)
        target = classes or recorded or space
        named_alike = other_ids and space.names == target.names
        if classes is not None:
            ClassMerging.needed(recorded or space, classes)
            if not named_alike:
                ClassMerging.needed(space, classes)
        elif target.fits(space):
            return space
        elif not named_alike and contradiction(space, target):
            named = first_few(target.differences(space))
            problem = f"has predictions in the classes of {target.name} ({named})"
            merged = f"merge both with {argument('classes')}"
            hint = f"predict with weights for the classes of the labels, or {merged}"
            raise LabelError(self.root, problem, f"{space.name}, as the labels", hint)
        return replace(target, splits=space.splits or (classes or space).splits)

    def merging_into(self, space: LabelSpace) -> ClassMerging | None:
        """Return the merging of the classes of the probabilities into a label space, if needed."""
        finer = self.label_space("probabilities")
        return None if finer is None or finer.fits(space) else ClassMerging.between(finer, space)

    def prediction(self) -> PredictSettings | None:
        """Return the settings of `predict`, None if the labels are not its own."""
        return (
            self.manifest.settings("predict")
            if self.manifest.owner("predictions") == "predict"
            else None
        )

    def risk_threshold(self, space: LabelSpace) -> RiskThreshold | None:
        """Return the guarantee of `tune risk` for the labels, if they are in its classes."""
        prediction = self.prediction()
        recorded = self.label_space("predictions")
        if prediction is None or recorded is None or not recorded.fits(space):
            return None
        return prediction.guarantee

    def recorded_sensor(self) -> Sensor | None:
        """Return the recorded sensor of the results, if there is one."""
        folders = ("pixel_labels", "predictions", "uncertainty/epistemic", "range")
        settings = self.manifest.settings_of(*folders)
        return self._recorded(settings.sensor, "sensor") if settings else None

    def sensor(self) -> Sensor:
        """Return the recorded sensor of the results, else the HDL-64."""
        return self.recorded_sensor() or sensor("hdl64")

    def weights(self, folder: str) -> str | None:
        """Return the SHA-256 of the weights of a folder of results, if it is recorded."""
        stage = self._network_stage(folder)
        settings = self.manifest.settings(stage) if stage else None
        return settings.weights if isinstance(settings, WeightsSettings) else None

    def trained_on(self) -> RecordedScans:
        """Return the scans that the weights of the predictions were trained on."""
        stage = self._network_stage("predictions")
        settings = self.manifest.settings(stage) if stage else None
        if stage is None or not isinstance(settings, WeightsSettings):
            return NO_SCANS
        return recorded_scans(settings.trained_on or "", self.manifest.path(stage))

    def _network_stage(self, folder: str) -> str | None:
        """Return the stage that ran the network for a folder of results."""
        settings = self.manifest.settings_of(folder)
        # Without origins, an earlier version refined labels of another program.
        if isinstance(settings, RefineSettings) and settings.origins is not None:
            return self._network_stage("pixel_labels")
        return self.manifest.owner(folder)

    def require_same_weights(self) -> None:
        """Refuse an uncertainty of other weights or classes than the labels."""
        labels = self.weights("predictions")
        space = self.label_space("predictions")
        words = f"salsanext uncertainty SCANS {self.root}"
        sampled = self.manifest.settings("uncertainty")
        settings = [] if sampled is None else sampled.sampling_as_typed()
        hint = f"run `{command(words, *settings, setting('overwrite', True))}` with the"
        for folder in ("uncertainty/epistemic", ERROR):
            estimated = self.weights(folder)
            other = self.label_space(folder)
            if labels and estimated and labels != estimated:
                both = f"{labels[:12]}…, uncertainty of {estimated[:12]}…"
                problem = f"has labels of the weights {both}"
                hint = f"{hint} weights of the labels"
                raise OutputError(self.root, problem, "the same weights", hint)
            if labels and space and other and not space.fits(other):
                problem = f"has labels in the classes of {space.name}, uncertainty in {other.name}"
                hint = f"{hint} {argument('classes')} of the labels"
                raise OutputError(self.root, problem, "the same classes", hint)

    def rejected_above(self, folder: str = "predictions") -> float | None:
        """Return the uncertainty above which the run of a folder of results rejected points."""
        settings = self.manifest.settings_of(folder)
        return settings.reject if isinstance(settings, PredictSettings) else None

    def scans_of_threshold(self) -> RecordedScans:
        """Return the scans that `tune risk` chose the threshold of the predictions on."""
        stage = self.manifest.owner("predictions")
        record = self.manifest.record(stage) if stage else None
        if stage is None or record is None:
            return NO_SCANS
        return recorded_scans(digests_of_guarantee(record.settings), self.manifest.path(stage))

    def recorded_settings(
        self, selection: ScanSelection, dataset: Path | None
    ) -> dict[str, object]:
        """Return a selection and the settings of its predictions, as plain data.

        `dataset`: place of scans and labels, if not the recorded one.
        """
        stage = self.manifest.owner("predictions")
        softmax = self.manifest.settings("predict")
        estimated = self.manifest.settings("uncertainty")
        made_by = {name for name in (stage, "uncertainty" if estimated else None) if name}
        uncertainty = None
        if estimated:
            values = {name: getattr(estimated, name) for name in UNCERTAINTY_SETTINGS}
            uncertainty = {name: value for name, value in values.items() if value is not None}
        recorded = {
            "dataset": str(dataset.absolute()) if dataset else None,
            "predictions_of": stage,
            "weights": self.weights("predictions"),
            "temperature": softmax.temperature if softmax else None,
            "reject": self.rejected_above(),
            "uncertainty": uncertainty,
            "origins": self.origins(sorted(made_by)),
        }
        return asdict(selection) | recorded

    def _recorded(self, value: Kind | None, name: str) -> Kind:
        """Return a setting that the record must contain."""
        if value is None:
            hint = "delete the record or use another folder"
            raise OutputError(self.root, f"has a record without {name}", hint=hint)
        return value
