# SPDX-License-Identifier: MIT
"""Card of a weights file: the metadata that says what its tensors are and how to use them."""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import asdict, dataclass, field, replace
from importlib import resources
from pathlib import Path

import numpy as np
import safetensors

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import FormatError, UsageError, WeightsError, error_text, shortened
from salsanext_cli.files.identity import fingerprint
from salsanext_cli.files.json_files import Json, decoded, plain
from salsanext_cli.files.optional_packages import import_openvino
from salsanext_cli.files.reading import is_folder, present, reading, refusing_damage
from salsanext_cli.network.error_model import ErrorModel, valid_temperature
from salsanext_cli.records import Scan
from salsanext_cli.sensors.sensor import FittedView, Sensor
from salsanext_cli.version import __version__

KEY = "salsanext"  # The only key: safetensors writes several in an order drawn each time
FORMAT = "salsanext-2"
TABLES = ("architecture", "label_space", "sensor", "recipe", "scores")  # Mappings of a card
OF_ERROR = re.compile(r"The error is fitted to ([^.]*)\. ?")
"""Sentence on the error model in the description of older files."""
INHERITED = "inherited_from"  # Key of an error model: names the weights that it was fitted to
ONNX_SUFFIX = ".onnx"
DIGITS = 24  # Of a digest: by chance, two of 20 000 scans agree once in 10¹¹ cases


def scan_digest(scan: Scan) -> str:
    """Return the digest of a scan: of the number of its points, then of their coordinates."""
    of_points = hashlib.sha256(np.ascontiguousarray(scan.points).data).hexdigest()
    return f"{len(scan):08x}{of_points}"[:DIGITS]


def is_among(digests: Collection[str], count: int, read: Callable[[], Scan]) -> bool:
    """Return whether digests name a scan of so many points; it is read only where it may be one."""
    some = any(digest.startswith(f"{count:08x}") for digest in digests)
    return some and scan_digest(read()) in digests


def parted(text: object) -> list[str]:
    """Return the digests that make up a text; anything else raises `ValueError`."""
    if not isinstance(text, str) or not re.fullmatch(f"([0-9a-f]{{{DIGITS}}})*", text):
        raise ValueError("no digests of scans")
    return [text[i : i + DIGITS] for i in range(0, len(text), DIGITS)]


@dataclass(frozen=True, slots=True)
class RiskThreshold:
    """Threshold above which `predict --reject risk` rejects a label, and its guarantee."""

    kind: str  # Kind of uncertainty that the threshold is of
    threshold: float
    at_most: float  # Largest share of the points that may be accepted and wrong, 0…1
    confidence: float | None  # That the guarantee holds for most units; None: for their mean
    scans: int  # Number of scans that it was chosen on
    sequences: tuple[str, ...]  # Their sequences
    unit: str = "scan"  # {"scan", "drive"}: what the guarantee is about
    digests: str = ""  # Digests of these scans, joined
    settings: Json = field(default_factory=dict)  # As of `labels_depend_on`
    view: FittedView | None = None  # Fitted to these scans
    other_views: tuple[FittedView, ...] = ()  # Of the other sensors, if there are several
    # Thresholds of classes that have one of their own
    classes: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        numbers = (self.threshold, self.at_most, *self.classes.values())
        if not all(map(math.isfinite, numbers)):
            raise ValueError(f"risk holds {shortened(numbers)}")
        parted(self.digests)  # Raises an error if these are no digests.

    @property
    def views(self) -> tuple[FittedView, ...]:
        """Views of all sensors; empty where none was fitted."""
        return (self.view, *self.other_views) if self.view else ()


@dataclass(frozen=True, slots=True)
class AccuracyLine:
    """Line from the logit of a run's mean confidence to that of its accuracy."""

    slope: float
    offset: float
    deviation: float  # Root mean square of the accuracy about the line, 0…1
    inherited_from: str | None = None  # Weights that it was fitted to, if these are others

    def to_dict(self) -> Json:
        """Return plain data, without what is not set."""
        return {name: value for name, value in asdict(self).items() if value is not None}

    def __post_init__(self) -> None:
        if not all(map(math.isfinite, (self.slope, self.offset, self.deviation))):
            raise ValueError(f"accuracy holds {self}")


FITTED = {"error": ErrorModel, "risk": RiskThreshold, "accuracy": AccuracyLine}
"""Parts of a card that may be absent."""


@dataclass(frozen=True, slots=True, eq=False)
class WeightsCard:
    """Metadata of a weights file."""

    # Name and numbers of the network, as `registry.build` takes them
    architecture: Json
    space: LabelSpace  # The classes that the logits stand for
    sensor: Sensor  # The geometry and normalisation that the network was trained with
    # The resolved training recipe; empty if unknown
    recipe: Json = field(default_factory=dict)
    # Measurements with these weights, and the data; empty if there are none
    scores: Json = field(default_factory=dict)
    description: str = ""  # A sentence or two on these weights
    # Divides the logits before the softmax, so that its values are probabilities; 1 if none was
    # fitted
    temperature: float = 1.0
    # Model of the probability that a label is wrong; None if none was fitted
    error: ErrorModel | None = None
    risk: RiskThreshold | None = None  # None if none was chosen
    accuracy: AccuracyLine | None = None  # None if none was fitted
    # Digests of the scans that the weights were trained on, as far as they are known
    trained_on: frozenset[str] = frozenset()
    version: int | None = None  # Version of the default weights; None for other weights

    def named(self, path: Path) -> str:
        """Return the version of these weights, else the name of their file, and its SHA-256."""
        name = f"default weights version {self.version}" if self.version else path.name
        return f"{name} (SHA-256 {fingerprint(path)[:16]})"

    def title(self, path: Path) -> str:
        """Name default weights with their description up to the first colon or full stop."""
        start = re.split(r"[:.](?:\s|$)", self.description, maxsplit=1)[0]
        summary = shortened(start[:1].lower() + start[1:])
        return f"{self.named(path)}, {summary}," if self.version else f"default weights ({summary})"

    def inherited(self) -> str:
        """Name the parts that were fitted to the weights that these began from; "" for none."""
        parts = {
            "error model": self.error and self.error.scores.get(INHERITED),
            "expected accuracy": self.accuracy and self.accuracy.inherited_from,
        }
        of = {what: shortened(name) for what, name in parts.items() if name}
        names = " and ".join(dict.fromkeys(of.values()))
        return f"{' and '.join(of)} of {names}" if of else ""

    def changed(self, done: str) -> WeightsCard:
        """Return the card of changed weights, by a sentence: without scores and what was fitted."""
        bare = replace(self, scores={}, error=None, risk=None, accuracy=None, version=None)
        return replace(bare, description=f"{self.description} {done}".lstrip())

    def to_metadata(self) -> dict[str, str]:
        """Return what a safetensors header holds; equal cards give equal text."""
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
        known = {name: plain(part) for name in FITTED if (part := getattr(self, name))}
        known |= {"trained_on": "".join(sorted(self.trained_on)), "weights_version": self.version}
        return {KEY: json.dumps(values | {name: part for name, part in known.items() if part})}

    @classmethod
    def from_metadata(cls, metadata: Mapping[str, str], source: object) -> WeightsCard:
        """Read what a safetensors header holds; anything amiss raises `WeightsError`."""
        try:
            values = json.loads(metadata.get(KEY, "{}"))
            if not isinstance(values, dict):
                raise TypeError(f"{KEY} is no table")
            if (form := values.get("format")) is None:
                expected = "a file that `train`, `import-weights` or `export-onnx` wrote"
                raise WeightsError(source, "lacks what salsanext writes", expected)
            if form != FORMAT:
                hint = "use the version that wrote it"
                raise WeightsError(source, f"format {shortened(form)}", FORMAT, hint)
            fitted = [name for name in FITTED if name in values]
            if bad := [key for key in (*TABLES, *fitted) if not isinstance(values[key], dict)]:
                raise TypeError(f"{bad[0]} is no table")
            if type(version := values.get("weights_version", 1)) is not int or version < 1:
                raise ValueError(f"weights_version is {shortened(version)}")
            description, error = str(values["description"]), values.get("error")
            if error and (statement := OF_ERROR.search(description)):
                # It describes the error model, so it goes when the error model is replaced.
                description = OF_ERROR.sub("", description)
                error["scores"] = {"fitted_to": statement[1], **error["scores"]}
            return cls(
                architecture=values["architecture"],
                space=LabelSpace.from_dict(values["label_space"], source),
                sensor=Sensor.from_dict(values["sensor"], source),
                recipe=values["recipe"],
                scores=values["scores"],
                description=description,
                temperature=valid_temperature(values["temperature"]),
                **{name: decoded(FITTED[name], values[name]) for name in fitted},
                trained_on=frozenset(parted(values.get("trained_on", ""))),
                version=values.get("weights_version"),
            )
        except UsageError as error:
            raise WeightsError(source, f"damaged metadata: {error.problem}") from error
        except (KeyError, TypeError, ValueError, ArithmeticError, RecursionError) as error:
            raise WeightsError(source, f"damaged metadata: {error_text(error)}") from error


@dataclass(frozen=True, slots=True)
class DescribedWeights:
    """Card of a weights file, and its size and digest."""

    path: Path
    sha256: str
    size: int  # In bytes
    card: WeightsCard

    def to_dict(self) -> dict[str, object]:
        """Return plain data for JSON."""
        card = self.card
        names = ("description", "architecture", "temperature", "recipe", "scores", "risk")
        return {
            "path": str(self.path),
            **({"version": card.version} if card.version else {}),
            "sha256": self.sha256,
            "bytes": self.size,
            **{name: plain(getattr(card, name)) for name in (*names, "accuracy", "sensor")},
            "label_space": card.space.name,
            "classes": list(card.space.names),
            "error": card.error and dict(card.error.scores),
            "trained_on": len(card.trained_on),
        }


def read_card(path: Path) -> WeightsCard:
    """Read only the metadata of a weights file, or of an ONNX file of `export-onnx`."""
    metadata_of, kind = _of_safetensors, "a .safetensors file"
    hint = "convert a published checkpoint with `salsanext import-weights`"
    if path.suffix == ONNX_SUFFIX:
        metadata_of, kind = _of_onnx, "an ONNX file"
        hint = "write it with `salsanext export-onnx`"
    try:
        with reading(path), refusing_damage(path, kind):
            metadata = metadata_of(path)
    except FormatError as error:
        found = error.problem if present(path) else "no such file"
        if is_folder(path):
            found, hint = "a folder", "name the file in it"
        raise WeightsError(path, found, kind, hint) from error
    return WeightsCard.from_metadata(metadata, path)


def _of_safetensors(path: Path) -> dict[str, str]:
    with safetensors.safe_open(path, framework="np") as file:
        return file.metadata() or {}


def _of_onnx(path: Path) -> dict[str, str]:
    # Of all frontends, that of ONNX alone says what is wrong, and nothing on the terminal.
    frontend = import_openvino().frontend.FrontEndManager().load_by_framework("onnx")
    try:
        model, place = frontend.convert(frontend.load(path)), ["framework", KEY]
    except RuntimeError as error:
        # Its text names places in its own source.
        raise FormatError(path, "no ONNX file that OpenVINO reads, or a cut one") from error
    return {KEY: model.get_rt_info(place).astype(str)} if model.has_rt_info(place) else {}


def require_tensors(path: Path) -> None:
    """Raise `WeightsError` for an ONNX file, whose weights cannot be changed or taken apart."""
    if path.suffix == ONNX_SUFFIX:
        found = "an ONNX model: labels and probabilities only"
        raise WeightsError(path, found, "a .safetensors file", "give the weights it was made from")


def default_weights() -> Path:
    """Return the place of the weights that come with the package."""
    return Path(str(resources.files("salsanext_cli") / "presets/weights/default.safetensors"))
