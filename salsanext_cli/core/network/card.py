# SPDX-License-Identifier: MIT
"""Card of a weights file: the metadata that describe its tensors and their use."""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import asdict, dataclass, field, replace

import numpy as np

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.errors import UsageError, WeightsError
from salsanext_cli.core.network.error_model import ErrorModel, valid_temperature
from salsanext_cli.core.network.int8_inputs import Int8Input
from salsanext_cli.core.network.tuned_settings import KEY_OF
from salsanext_cli.core.network.unit_traits import UnitTraits
from salsanext_cli.core.plain_data import Json, decoded, plain
from salsanext_cli.core.records import Scan
from salsanext_cli.core.sensors.sensor import FittedView, Sensor
from salsanext_cli.core.texts import error_text, shortened
from salsanext_cli.version import __version__

KEY = "salsanext"  # The only key: safetensors writes several keys in random order
FORMAT = "salsanext-2"
TABLES = ("architecture", "label_space", "sensor", "recipe", "scores")  # Mappings of a card
ERROR_SENTENCE = re.compile(r"The error is fitted to ([^.]*)\. ?")
"""Sentence on the error model in the description of older files, such as the default weights."""
INHERITED = "inherited_from"  # Key of an error model: names the weights that it was fitted to
DIGITS = 24  # Of a digest: two of 20 000 scans agree by chance once in 10¹¹ cases


def scan_digest(scan: Scan) -> str:
    """Return the digest of a scan: number of its points, then digest of their coordinates."""
    coordinates = hashlib.sha256(np.ascontiguousarray(scan.points).data).hexdigest()
    return f"{len(scan):08x}{coordinates}"[:DIGITS]


def is_among(digests: Collection[str], count: int, read: Callable[[], Scan]) -> bool:
    """Return whether digests contain a scan.

    Parameters
    ----------
    digests : collection of str
        Digests of `scan_digest`.
    count : int
        Number of points of the scan.
    read : callable
        Returns the scan; called only if a digest begins with its number of points.
    """
    fits = any(digest.startswith(f"{count:08x}") for digest in digests)
    return fits and scan_digest(read()) in digests


def split_digests(text: object) -> list[str]:
    """Return the digests that a text joins; anything else raises `ValueError`."""
    if not isinstance(text, str) or not re.fullmatch(f"([0-9a-f]{{{DIGITS}}})*", text):
        raise ValueError("no digests of scans")
    return [text[i : i + DIGITS] for i in range(0, len(text), DIGITS)]


@dataclass(frozen=True, slots=True)
class RiskThreshold:
    """Threshold above which `predict --reject risk` rejects a label, and its guarantee.

    Scans, sequences, digests and views are those on which the threshold was chosen.
    """

    kind: str  # Kind of uncertainty that is compared with the threshold
    threshold: float
    at_most: float  # Largest share of the points that may be accepted and wrong, 0…1
    # Share of the units for which the guarantee holds; None if it is about their mean
    confidence: float | None
    scans: int  # Number of the scans
    sequences: tuple[str, ...]
    unit: str = "scan"  # Unit of the guarantee: "scan" or "drive"
    digests: str = ""  # Joined digests of the scans
    settings: Json = field(default_factory=dict)  # As `label_settings` returns them
    views: tuple[FittedView, ...] = ()  # Fields of view of the sensors
    population: tuple[UnitTraits, ...] = ()  # Of each unit; empty in files of early versions
    data_set: str | None = None  # Name of its folder; None in files of early versions
    # True if most scans follow each other, so that a guarantee of scans may not hold as stated
    consecutive: bool | None = None

    def __post_init__(self) -> None:
        if not all(map(math.isfinite, (self.threshold, self.at_most))):
            raise ValueError(f"risk has threshold {self.threshold} and limit {self.at_most}")
        split_digests(self.digests)  # Raises an error for other text.


DEVIATIONS = 3.5
"""Half the interval, in deviations, of a line that does not state it: of weights before version 6.
With 2.0, the interval of version 5 held for seven of eleven further drives."""


@dataclass(frozen=True, slots=True)
class AccuracyLine:
    """Line from the logit of a run's mean confidence to the logit of its accuracy."""

    slope: float
    offset: float
    deviation: float  # Root mean square of the accuracy about the line, 0…1
    half_width: float | None = None  # Half the interval of an estimate, 0…1; None: `DEVIATIONS`
    inherited_from: str | None = None  # Other weights to which the line was fitted

    @property
    def margin(self) -> float:
        """Half the interval of an estimated accuracy, 0…1."""
        return DEVIATIONS * self.deviation if self.half_width is None else self.half_width

    def to_dict(self) -> Json:
        """Return plain data without fields that are None."""
        return {name: value for name, value in asdict(self).items() if value is not None}

    def __post_init__(self) -> None:
        if not all(map(math.isfinite, (self.slope, self.offset, self.margin))):
            raise ValueError(f"accuracy holds {self}")


FITTED = {
    "error": ErrorModel,
    "risk": RiskThreshold,
    "accuracy": AccuracyLine,
    "int8": Mapping[str, Int8Input],
}
"""Parts of a card that may be absent."""


@dataclass(frozen=True, slots=True, eq=False)
class FittedParts:
    """Parts of a card that hold for images of one width."""

    temperature: float = 1.0
    error: ErrorModel | None = None
    risk: RiskThreshold | None = None
    accuracy: AccuracyLine | None = None

    def to_dict(self) -> Json:
        """Return plain data without absent parts."""
        values = {name: plain(getattr(self, name)) for name in PARTS}
        return {name: value for name, value in values.items() if value is not None}

    @classmethod
    def from_dict(cls, data: Json, source: object) -> FittedParts:
        """Read the result of `to_dict`; invalid data raise a `ValueError` or the like."""
        values: Json = {name: data[name] for name in PARTS if name in data}
        if "risk" in values:
            values["risk"] = _with_current_keys(values["risk"], source)
        temperature = valid_temperature(values.pop("temperature"))
        fitted = {name: decoded(FITTED[name], value) for name, value in values.items()}
        return cls(temperature, **fitted)


PARTS = ("temperature", "error", "risk", "accuracy")  # Fields of `FittedParts`


@dataclass(frozen=True, slots=True, eq=False)
class WeightsCard:
    """Metadata of a weights file."""

    architecture: Json  # Name and numbers of the network, as `registry.build` takes them
    space: LabelSpace  # Classes of the logits
    sensor: Sensor  # Geometry and normalisation that the network was trained with
    recipe: Json = field(default_factory=dict)  # Resolved training recipe; empty if unknown
    scores: Json = field(default_factory=dict)  # Measurements with these weights
    description: str = ""
    temperature: float = 1.0  # Divisor of the logits that makes the softmax a probability
    error: ErrorModel | None = None
    risk: RiskThreshold | None = None
    accuracy: AccuracyLine | None = None
    # Quantised inputs of layers by name; the other layers compute in float32
    int8: Mapping[str, Int8Input] = field(default_factory=dict)
    trained_on: frozenset[str] = frozenset()  # Digests of scans, as far as known
    version: int | None = None  # Version of the default weights; None for other weights
    tensors_sha256: str = ""  # As `tensor_digest` returns it; empty in files of early versions
    # Widths of the images of training, the default of the weights first; none for the sensor's
    widths: tuple[int, ...] = ()
    # Parts for images of other widths than the sensor's
    parts_of_widths: Mapping[int, FittedParts] = field(default_factory=dict)

    @property
    def trained_widths(self) -> tuple[int, ...]:
        """Widths of images that the weights were trained with, the default first."""
        return self.widths or (self.sensor.width,)

    @property
    def parts(self) -> FittedParts:
        """The parts for images of the width of the sensor."""
        return FittedParts(**{name: getattr(self, name) for name in PARTS})

    @property
    def substitutes(self) -> FittedParts:
        """Parts for a width that has none of its own: those of the default width, without risk."""
        default = self.trained_widths[0]
        parts = self.parts if self.sensor.width == default else self.parts_of_widths[default]
        return replace(parts, risk=None)

    def at_width(self, width: int) -> WeightsCard:
        """Return the card for images of another width, if the weights were trained with it."""
        if width == self.sensor.width or width not in self.trained_widths:
            return self
        others = dict(self.parts_of_widths)
        parts = others.pop(width, self.substitutes)
        is_default = self.sensor.width == self.trained_widths[0]
        if is_default or self.parts.to_dict() != self.substitutes.to_dict():
            others[self.sensor.width] = self.parts
        fitted = {name: getattr(parts, name) for name in PARTS}
        return replace(
            self, sensor=self.sensor.resized(width=width), parts_of_widths=others, **fitted
        )

    def without_risk(self, is_removed: Callable[[RiskThreshold | None], bool]) -> WeightsCard:
        """Return the card without the thresholds of risk, of any width, that a function names."""
        parts_of_widths = {
            width: replace(parts, risk=None) if is_removed(parts.risk) else parts
            for width, parts in self.parts_of_widths.items()
        }
        risk = None if is_removed(self.risk) else self.risk
        return replace(self, risk=risk, parts_of_widths=parts_of_widths)

    def parts_of_default_width(self) -> str:
        """Name the parts that were fitted to images of the default width instead; "" for none."""
        default = self.trained_widths[0]
        if self.sensor.width == default:
            return ""
        titles = {
            "temperature": "temperature",
            "error": "error model",
            "accuracy": "estimated accuracy",
        }
        parts = self.parts.to_dict()
        substitutes = self.substitutes.to_dict()
        same = [
            title
            for key, title in titles.items()
            if key in parts and parts[key] == substitutes.get(key)
        ]
        return f"{', '.join(same)} of images of {default} columns" if same else ""

    def inherited(self) -> str:
        """Name the parts that were fitted to the initial weights of the training; "" for none."""
        parts = {
            "error model": self.error and self.error.scores.get(INHERITED),
            "estimated accuracy": self.accuracy and self.accuracy.inherited_from,
        }
        origins = {title: shortened(name) for title, name in parts.items() if name}
        names = " and ".join(dict.fromkeys(origins.values()))
        return f"{' and '.join(origins)} of {names}" if origins else ""

    def to_metadata(self) -> dict[str, str]:
        """Return the metadata of a safetensors file at the default width; equal cards are equal."""
        if self.sensor.width != self.trained_widths[0]:
            return self.at_width(self.trained_widths[0]).to_metadata()
        values = {
            "format": FORMAT,
            "version": __version__,
            "description": self.description,
            "architecture": dict(self.architecture),
            "temperature": self.temperature,
            "sensor": self.sensor.to_dict(),
            "label_space": self.space.to_dict(),
            "recipe": dict(self.recipe),
            "scores": dict(self.scores),
        }
        optional = {name: plain(getattr(self, name)) for name in FITTED}
        optional |= {
            "trained_on": "".join(sorted(self.trained_on)),
            "weights_version": self.version,
            "tensors_sha256": self.tensors_sha256,
            "widths": list(self.widths),
            "of_widths": {
                width: plain(parts) for width, parts in sorted(self.parts_of_widths.items())
            },
        }
        values |= {name: value for name, value in optional.items() if value}
        return {KEY: json.dumps(values)}

    @classmethod
    def from_metadata(cls, metadata: Mapping[str, str], source: object) -> WeightsCard:
        """Read the metadata of a safetensors file; invalid data raise `WeightsError`."""
        try:
            values = json.loads(metadata.get(KEY, "{}"))
            if not isinstance(values, dict):
                raise TypeError(f"{KEY} is not a table")
            version_of_format = values.get("format")
            if version_of_format is None:
                hint = "convert a published checkpoint with `salsanext import-weights`"
                raise WeightsError(source, "has no metadata of salsanext", hint=hint)
            if version_of_format != FORMAT:
                problem = f"has format {shortened(version_of_format)}"
                hint = "update salsanext"
                raise WeightsError(source, problem, FORMAT, hint)
            fitted = [name for name in FITTED if name in values]
            bad = [key for key in (*TABLES, *fitted) if not isinstance(values[key], dict)]
            if bad:
                raise TypeError(f"{bad[0]} is not a table")
            if "risk" in fitted:
                values["risk"] = _with_current_keys(values["risk"], source)
            version = values.get("weights_version", 1)
            if type(version) is not int or version < 1:
                raise ValueError(f"weights_version is {shortened(version)}")
            description = str(values["description"])
            error = values.get("error")
            statement = ERROR_SENTENCE.search(description)
            if error and statement:
                # The sentence must go when the error model is replaced.
                description = ERROR_SENTENCE.sub("", description)
                error["scores"] = {"fitted_to": statement[1], **error["scores"]}
            sensor = Sensor.from_dict(values["sensor"], source)
            return cls(
                architecture=values["architecture"],
                space=LabelSpace.from_dict(values["label_space"], source),
                sensor=sensor,
                recipe=values["recipe"],
                scores=values["scores"],
                description=description,
                temperature=valid_temperature(values["temperature"]),
                **{name: decoded(FITTED[name], values[name]) for name in fitted},
                trained_on=frozenset(split_digests(values.get("trained_on", ""))),
                version=values.get("weights_version"),
                tensors_sha256=_sha256(values.get("tensors_sha256", "")),
                widths=_checked_widths(values.get("widths", []), sensor.width),
                parts_of_widths={
                    int(width): FittedParts.from_dict(parts, source)
                    for width, parts in values.get("of_widths", {}).items()
                },
            )
        except UsageError as error:
            raise WeightsError(source, f"has damaged metadata: {error.problem}") from error
        except (KeyError, TypeError, ValueError, ArithmeticError, RecursionError) as error:
            raise WeightsError(source, f"has damaged metadata: {error_text(error)}") from error


def _sha256(text: object) -> str:
    """Return a digest of tensors, or no text; anything else raises `ValueError`."""
    if not isinstance(text, str) or not re.fullmatch("([0-9a-f]{64})?", text):
        raise ValueError(f"tensors_sha256 is {shortened(text)}")
    return text


def _checked_widths(widths: object, default: int) -> tuple[int, ...]:
    """Return the widths of a file, which begin with that of its sensor; none for old files."""
    if not isinstance(widths, list) or not all(type(width) is int for width in widths):
        raise TypeError("widths are not a list of numbers")
    if widths and (widths[0] != default or len(set(widths)) < len(widths) or min(widths) < 1):
        raise ValueError(f"widths are {shortened(widths)}, not {default} and others")
    return tuple(widths)


def _with_current_keys(risk: Json, source: object) -> Json:
    """Return a threshold of an early version with the keys of this one."""
    if risk.pop("classes", None):
        hint = "run `salsanext tune risk` on the weights that it was chosen for"
        raise WeightsError(source, "has thresholds of classes", "one for all classes", hint)
    view = risk.pop("view", None)
    if view:
        risk["views"] = [view, *risk.pop("other_views", ())]
    settings = risk.get("settings", {})
    sensor = settings.get(KEY_OF["sensor"], {})
    if "width" in sensor:
        settings[KEY_OF["width"]] = sensor.pop("width")
    return risk
