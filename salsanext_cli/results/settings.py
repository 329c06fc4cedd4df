# SPDX-License-Identifier: MIT
"""Settings of stages, as `OUT/<stage>.json` records them."""

from collections.abc import Mapping
from dataclasses import dataclass

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.network.card import AccuracyLine, RiskThreshold, parted
from salsanext_cli.option_fields import FusionReach, KnnParameters
from salsanext_cli.sensors.sensor import Sensor


@dataclass(frozen=True, slots=True, kw_only=True)
class StageSettings:
    """Resolved settings that decide what the results of a stage are; None are not among them."""

    label_space: LabelSpace | None = None  # Classes of the labels
    sensor: Sensor | None = None  # Sensor that the scans were projected for
    weights: str | None = None  # SHA-256 of the weights file, hexadecimal
    weights_version: int | None = None  # Of the default weights
    inherited: str | None = None  # Fitted parts of the weights that other weights had before
    precision: str | None = None  # Number type and library that computed
    engine: str | None = None
    temperature: float | None = None  # Divisor of the logits
    knn: KnnParameters | None = None
    reject: float | None = None  # Uncertainty, 0…1, above which points are unlabelled
    reject_by: str | None = None  # Kind of that uncertainty, if not the error
    accuracy: AccuracyLine | None = None
    promised: RiskThreshold | None = None  # Threshold of the weights that `reject` is
    objects: bool | None = None  # True if labels hold numbers of objects
    method: str | None = None  # Numbers of `UncertaintyMethod`, and the noise of the sensor
    aleatoric: str | None = None
    samples: int | None = None
    seed: int | None = None
    noise: tuple[float, float] | None = None
    labels: str | None = None  # Folder of the labels that `knn-refine` refined, absolute
    reach: FusionReach | None = None
    fused_of: str | None = None  # Folder of the labels of single scans, relative to the fused ones
    colours: tuple[str, ...] | None = None  # Values that pictures show, and ends of their scales
    scales: Mapping[str, tuple[float, ...]] | None = None
    colour: str | None = None  # The same of point clouds
    scale: tuple[float, ...] | None = None
    max_error: float | None = None  # Error above which points are shown as unlabelled
    origins: Mapping[str, str] | None = None  # Digest of the settings of each stage before, by name
    trained_on: str | None = None  # Digests of the scans that the weights were trained on, joined

    def __post_init__(self) -> None:
        parted(self.trained_on or "")  # Raises an error if these are no digests.
        if any(len(ends) < 2 for ends in (*(self.scales or {}).values(), self.scale or (0, 1))):
            raise ValueError("a scale with fewer than two numbers")
