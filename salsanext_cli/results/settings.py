# SPDX-License-Identifier: MIT
"""Settings of stages, as in `OUT/<stage>.json`."""

from collections.abc import Mapping
from dataclasses import dataclass

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.network.card import AccuracyLine, RiskThreshold, parted
from salsanext_cli.option_fields import FusionReach, KnnParameters
from salsanext_cli.sensors.sensor import Sensor


@dataclass(frozen=True, slots=True, kw_only=True)
class StageSettings:
    """Resolved settings that decide the results of a stage; None are not recorded."""

    label_space: LabelSpace | None = None  # Classes of the labels
    sensor: Sensor | None = None  # Sensor that the scans were projected for
    weights: str | None = None  # SHA-256 of the weights file, hexadecimal
    weights_version: int | None = None  # Of the default weights
    inherited: str | None = None  # Parts of the weights that were fitted for other weights
    precision: str | None = None  # Number type and library that computed
    engine: str | None = None
    temperature: float | None = None  # Divisor of the logits
    knn: KnnParameters | None = None
    reject: float | None = None  # Uncertainty, 0…1, above which points are rejected
    reject_by: str | None = None  # Kind of that uncertainty, if not the error
    accuracy: AccuracyLine | None = None
    guarantee: RiskThreshold | None = None  # Of `--reject risk`
    objects: bool | None = None  # Whether labels contain numbers of objects
    method: str | None = None  # Fields of `UncertaintyMethod`, and the noise of the sensor
    aleatoric: str | None = None
    samples: int | None = None
    seed: int | None = None
    noise: tuple[float, float] | None = None
    labels: str | None = None  # Folder of the pixel labels of `knn-refine`, absolute
    reach: FusionReach | None = None
    fused_of: str | None = None  # Folder of the labels of single scans, relative to fused labels
    colours: tuple[str, ...] | None = None  # Values in pictures, and ends of their scales
    scales: Mapping[str, tuple[float, ...]] | None = None
    colour: str | None = None  # Value in point clouds, and ends of its scale
    scale: tuple[float, ...] | None = None
    max_error: float | None = None  # Largest error of the points that `filter` writes
    origins: Mapping[str, str] | None = None  # Digests of the settings of earlier stages, by name
    trained_on: str | None = None  # Joined digests of the scans that the weights were trained on

    def __post_init__(self) -> None:
        parted(self.trained_on or "")  # Raises an error for invalid digests.
        if any(len(ends) < 2 for ends in (*(self.scales or {}).values(), self.scale or (0, 1))):
            raise ValueError("a scale with fewer than two numbers")
