# SPDX-License-Identifier: MIT
"""Provenance of results: the classes, the sensor and the weights that they were made with."""

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
    """Rule by which a run left points unlabelled."""

    above: float  # Points above it are unlabelled; classes may have thresholds of their own
    chosen_on: frozenset[str]  # Digests of the scans that `tune risk` chose it on


@dataclass(frozen=True, slots=True)
class Provenance(Manifest):
    """Answers of the records in an output folder about its results."""

    def label_space(self, *folders: str) -> LabelSpace | None:
        """Return the classes of the first folder that a stage fills, of predictions by default."""
        settings = self.settings_of(*(folders or ("predictions", "pixel_labels")))
        return self._recorded(settings.label_space, "label space") if settings else None

    def compared_space(
        self,
        scans: Sequence[ScanFile],
        space: LabelSpace | None = None,
        classes: LabelSpace | None = None,
        *,
        own_ids: bool = False,
    ) -> LabelSpace:
        """Return the classes in which predictions and labels are compared, with the labels' splits.

        They are those of both, or those of the predictions if these are merged ones of the labels',
        or `classes`, into which both are merged. `space`: of the labels, if not the data set's;
        `own_ids`: whether labels may have other raw ids for classes of the same names.
        """
        recorded = self.label_space()
        space = space or space_of(scans, recorded)
        target = classes or recorded or space
        named_alike = own_ids and space.names == target.names
        if classes is not None:
            for own in (recorded or space, *(() if named_alike else (space,))):
                ClassMerging.needed(own, classes)
        elif target.fits(space):
            return space
        elif not named_alike and contradiction(space, target):
            named = first_few(target.differences(space))
            found = f"predictions in the classes of {target.name} ({named})"
            hint = "predict with weights for these classes, or merge both with --classes"
            raise LabelError(self.root, found, f"those of {space.name}, as the labels", hint)
        return replace(target, splits=space.splits or (classes or space).splits)

    def merging_into(self, space: LabelSpace) -> ClassMerging | None:
        """Return the merging of the classes of the probabilities into others, if one is needed."""
        own = self.label_space("probabilities")
        return None if own is None or own.fits(space) else ClassMerging.between(own, space)

    def promised(self, space: LabelSpace) -> RiskThreshold | None:
        """Return the guarantee of `tune risk` for the labels, if these are its classes."""
        own, settings = self.label_space("predictions"), self.settings_of("predictions")
        return settings.promised if settings and own and own.fits(space) else None

    def known_sensor(self) -> Sensor | None:
        """Return the sensor that results were made through, if one is recorded."""
        folders = ("pixel_labels", "predictions", "uncertainty/epistemic", "range")
        settings = self.settings_of(*folders)
        return self._recorded(settings.sensor, "sensor") if settings else None

    def sensor(self) -> Sensor:
        """Return the sensor that labels were made through; else the HDL-64."""
        return self.known_sensor() or sensor("hdl64")

    def weights(self, folder: str) -> str | None:
        """Return the SHA-256 of the weights behind a folder of results, if one is recorded."""
        settings = self._network_of(folder)
        return settings.weights if settings else None

    def trained_on(self) -> frozenset[str]:
        """Return the digests of the scans that the weights of the predictions were trained on."""
        settings = self._network_of("predictions")
        return frozenset(parted(settings.trained_on or "")) if settings else frozenset()

    def _network_of(self, folder: str) -> StageSettings | None:
        """Return the settings of the stage that computed what a folder of results is made of."""
        settings = self.settings_of(folder)
        if settings and self.owner(folder) == "knn-refine" and settings.labels is None:
            return self._network_of("pixel_labels")
        return settings

    def require_same_weights(self) -> None:
        """Refuse to show the uncertainty of one network, or in other classes, beside the labels."""
        labels, space = self.weights("predictions"), self.label_space("predictions")
        hint = f"run `salsanext uncertainty SCANS {self.root} --overwrite` with the"
        for folder in ("uncertainty/epistemic", ERROR):
            estimated, other = self.weights(folder), self.label_space(folder)
            if labels and estimated and labels != estimated:
                found = f"labels by the weights {labels[:12]}…, uncertainty by {estimated[:12]}…"
                expected, hint = "the same weights for both", f"{hint} weights of the labels"
                raise OutputError(self.root, found, expected, hint)
            if labels and space and other and not space.fits(other):
                classes = f"the classes of {space.name}, uncertainty in those of {other.name}"
                hint = f"{hint} --classes of the labels"
                raise OutputError(self.root, f"labels in {classes}", "the same for both", hint)

    def rejection(self, folder: str = "predictions") -> Rejection | None:
        """Return by what points were left unlabelled; `folder`: of results of the same run."""
        settings = self.settings_of(folder)
        if settings is None or settings.reject is None:
            return None
        digests = settings.promised.digests if settings.promised else ""
        return Rejection(settings.reject, frozenset(parted(digests)))

    def _recorded(self, value: Kind | None, name: str) -> Kind:
        """Return a setting that every stage records whose results have it."""
        if value is None:
            found, hint = f"a record without {name}", "delete it or use another folder"
            raise OutputError(self.root, found, "what the stage wrote", hint)
        return value
