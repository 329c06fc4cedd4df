# SPDX-License-Identifier: MIT
"""Provenance of results: their classes, sensor and weights."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.classes.merging import ClassMerging, contradiction
from salsanext_cli.errors import LabelError, OutputError, first_few
from salsanext_cli.network.card import RiskThreshold, parted
from salsanext_cli.results.manifest import Manifest
from salsanext_cli.results.paths import ERROR, ScanFile
from salsanext_cli.results.selection import space_of
from salsanext_cli.results.settings import StageSettings
from salsanext_cli.sensors.sensor import Sensor, sensor

Kind = TypeVar("Kind")


class Rejection(NamedTuple):
    """Rule by which a run rejected points."""

    above: float  # Threshold of the uncertainty; some classes may have other thresholds
    chosen_on: frozenset[str]  # Digests of the scans that `tune risk` chose the threshold on


@dataclass(frozen=True, slots=True)
class Provenance(Manifest):
    """Classes, sensor and weights in the records of an output folder."""

    def label_space(self, *folders: str) -> LabelSpace | None:
        """Return the classes of the first recorded folder, by default of the predictions."""
        settings = self.settings_of(*(folders or ("predictions", "pixel_labels")))
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
            for finer in (recorded or space, *(() if named_alike else (space,))):
                ClassMerging.needed(finer, classes)
        elif target.fits(space):
            return space
        elif not named_alike and contradiction(space, target):
            named = first_few(target.differences(space))
            problem = f"has predictions in the classes of {target.name} ({named})"
            hint = (
                "predict with weights for the classes of the labels, or merge both with --classes"
            )
            raise LabelError(self.root, problem, f"{space.name}, as the labels", hint)
        return replace(target, splits=space.splits or (classes or space).splits)

    def merging_into(self, space: LabelSpace) -> ClassMerging | None:
        """Return the merging of the classes of the probabilities into a label space, if needed."""
        finer = self.label_space("probabilities")
        return None if finer is None or finer.fits(space) else ClassMerging.between(finer, space)

    def guarantee(self, space: LabelSpace) -> RiskThreshold | None:
        """Return the guarantee of `tune risk` for the labels, if they are in its classes."""
        recorded, settings = self.label_space("predictions"), self.settings_of("predictions")
        return settings.guarantee if settings and recorded and recorded.fits(space) else None

    def known_sensor(self) -> Sensor | None:
        """Return the recorded sensor of the results, if there is one."""
        folders = ("pixel_labels", "predictions", "uncertainty/epistemic", "range")
        settings = self.settings_of(*folders)
        return self._recorded(settings.sensor, "sensor") if settings else None

    def sensor(self) -> Sensor:
        """Return the recorded sensor of the results, else the HDL-64."""
        return self.known_sensor() or sensor("hdl64")

    def weights(self, folder: str) -> str | None:
        """Return the SHA-256 of the weights of a folder of results, if it is recorded."""
        settings = self._network_of(folder)
        return settings.weights if settings else None

    def trained_on(self) -> frozenset[str]:
        """Return the digests of the scans that the weights of the predictions were trained on."""
        settings = self._network_of("predictions")
        return frozenset(parted(settings.trained_on or "")) if settings else frozenset()

    def _network_of(self, folder: str) -> StageSettings | None:
        """Return the settings of the stage that ran the network for a folder of results."""
        settings = self.settings_of(folder)
        if settings and self.owner(folder) == "knn-refine" and settings.labels is None:
            return self._network_of("pixel_labels")
        return settings

    def require_same_weights(self) -> None:
        """Refuse an uncertainty of other weights or classes than the labels."""
        labels, space = self.weights("predictions"), self.label_space("predictions")
        hint = f"run `salsanext uncertainty SCANS {self.root} --overwrite` with the"
        for folder in ("uncertainty/epistemic", ERROR):
            estimated, other = self.weights(folder), self.label_space(folder)
            if labels and estimated and labels != estimated:
                problem = (
                    f"has labels of the weights {labels[:12]}…, uncertainty of {estimated[:12]}…"
                )
                raise OutputError(
                    self.root, problem, "the same weights", f"{hint} weights of the labels"
                )
            if labels and space and other and not space.fits(other):
                problem = f"has labels in the classes of {space.name}, uncertainty in {other.name}"
                hint = f"{hint} --classes of the labels"
                raise OutputError(self.root, problem, "the same classes", hint)

    def rejection(self, folder: str = "predictions") -> Rejection | None:
        """Return the rule by which the run of a folder of results rejected points, if it did."""
        settings = self.settings_of(folder)
        if settings is None or settings.reject is None:
            return None
        digests = settings.guarantee.digests if settings.guarantee else ""
        return Rejection(settings.reject, frozenset(parted(digests)))

    def _recorded(self, value: Kind | None, name: str) -> Kind:
        """Return a setting that the record must contain."""
        if value is None:
            hint = "delete the record or use another folder"
            raise OutputError(self.root, f"has a record without {name}", hint=hint)
        return value
