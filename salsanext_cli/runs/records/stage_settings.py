# SPDX-License-Identifier: MIT
"""Settings that decide the results of each stage, as its record in an output folder holds them.

The order of the fields is that of the keys in the file; values of None are not recorded.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.fusion.reach import FusionReach
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.core.network.card import AccuracyLine, RiskThreshold
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.wording import setting
from salsanext_cli.runs.records.digest_files import require_digests


@dataclass(frozen=True, slots=True, kw_only=True)
class StageSettings:
    """Settings that results of all stages have: their classes and their sensor."""

    label_space: LabelSpace | None = None  # None for range images
    sensor: Sensor | None = None  # Sensor that the scans were projected for


@dataclass(frozen=True, slots=True, kw_only=True)
class ProjectSettings(StageSettings):
    """Settings of `project`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WeightsSettings(StageSettings):
    """Settings of results that come from weights."""

    weights: str | None = None  # SHA-256 of the weights file, hexadecimal
    weights_version: int | None = None  # Of the default weights
    inherited: str | None = None  # Parts of the weights that were fitted for other weights
    # Joined digests of the scans that the weights were trained on, or the name of their file
    trained_on: str | None = None

    def __post_init__(self) -> None:
        require_digests(self.trained_on or "")

    def to_dict(self) -> dict[str, object]:
        """Return the settings by name, the long list of digests last."""
        content = {field.name: getattr(self, field.name) for field in fields(self)}
        trained_on = content.pop("trained_on")
        return {**content, "trained_on": trained_on}


@dataclass(frozen=True, slots=True, kw_only=True)
class ComputedSettings(WeightsSettings):
    """Settings of results that a network computed in this run."""

    precision: str | None = None  # Number type that computed; of int8 also how the CPU computes it
    engine: str | None = None  # Library that computed


@dataclass(frozen=True, slots=True, kw_only=True)
class PredictSettings(ComputedSettings):
    """Settings of `predict`; those of labels of points are None for labels of range images."""

    temperature: float | None = None  # Divisor of the logits
    knn: KnnParameters | None = None
    reject: float | None = None  # Uncertainty, 0…1, above which points are rejected
    reject_by: str | None = None  # Kind of that uncertainty, if not the error
    accuracy: AccuracyLine | None = None
    guarantee: RiskThreshold | None = None  # Of `--reject risk`
    objects: bool | None = None  # Whether labels contain numbers of objects


@dataclass(frozen=True, slots=True, kw_only=True)
class RefineSettings(StageSettings):
    """Settings of `knn-refine`."""

    knn: KnnParameters | None = None
    # Digests of the settings of earlier stages, by name; None for labels of another program
    origins: Mapping[str, str] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class UncertaintySettings(ComputedSettings):
    """Settings of `uncertainty`."""

    knn: KnnParameters | None = None
    method: str | None = None
    aleatoric: str | None = None  # This and the next two are fields of `UncertaintyMethod`
    samples: int | None = None
    seed: int | None = None
    noise: tuple[float, float] | None = None  # Of the sensor: metres, units of intensity

    def sampling_as_typed(self) -> list[str]:
        """Return the settings of the samples that a user gave, as `setting` spells them."""
        from salsanext_cli.core.uncertainty.method import UncertaintyMethod

        defaults = UncertaintyMethod()
        names = [field.name for field in fields(UncertaintyMethod)]
        values = {name: getattr(self, name) for name in names}
        return [
            setting(name, value)
            for name, value in values.items()
            if value not in (None, getattr(defaults, name))
        ]


@dataclass(frozen=True, slots=True, kw_only=True)
class FuseSettings(WeightsSettings):
    """Settings of `fuse`; only reach and origins beside the labels of single scans."""

    temperature: float | None = None  # Of the softmax that votes
    reach: FusionReach | None = None
    fused_of: str | None = None  # Folder of the labels of single scans, relative to fused labels
    origins: Mapping[str, str] | None = None  # Digests of the settings of earlier stages, by name


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureSettings(StageSettings):
    """Settings of `picture`."""

    colours: tuple[str, ...] | None = None  # Values in the pictures
    scales: Mapping[str, tuple[float, ...]] | None = None  # Ends of the scale of each value
    origins: Mapping[str, str] | None = None  # Digests of the settings of earlier stages, by name

    def __post_init__(self) -> None:
        _require_ends((self.scales or {}).values())


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportSettings(StageSettings):
    """Settings of `export-ply`."""

    colour: str | None = None  # Value that colours the points
    scale: tuple[float, ...] | None = None  # Ends of its scale
    origins: Mapping[str, str] | None = None  # Digests of the settings of earlier stages, by name

    def __post_init__(self) -> None:
        if self.scale is not None:
            _require_ends([self.scale])


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportLasSettings(StageSettings):
    """Settings of `export-las`; without compression, by which the stages of records differ."""

    origins: Mapping[str, str] | None = None  # Digests of the settings of earlier stages, by name
    frames: str | None = None  # Digest of the frames in files beside the scans; None without any

    def is_of_inputs_of(self, other: "ExportLasSettings") -> bool:
        """Return whether both are of the same results and the same frames."""
        return (self.origins, self.frames) == (other.origins, other.frames)


def settings_type(stage: str) -> type[StageSettings]:
    """Return the class of the settings of a stage whose results are in an output folder.

    Parameters
    ----------
    stage : str
        Name of the record, such as ``predict`` or ``export-ply-error``.

    Returns
    -------
    type
        A subclass of `StageSettings`.
    """
    if stage.startswith("export-ply"):
        return ExportSettings
    return _TYPES[stage]


_TYPES: dict[str, type[StageSettings]] = {
    "project": ProjectSettings,
    "predict": PredictSettings,
    "knn-refine": RefineSettings,
    "uncertainty": UncertaintySettings,
    "fuse": FuseSettings,
    "picture": PictureSettings,
    "export-las": ExportLasSettings,
    "export-laz": ExportLasSettings,
}


def _require_ends(scales: Iterable[tuple[float, ...]]) -> None:
    """Raise `ValueError` for a scale without two ends."""
    if any(len(ends) < 2 for ends in scales):
        raise ValueError("a scale with fewer than two numbers")
