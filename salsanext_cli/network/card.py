# SPDX-License-Identifier: MIT
"""Card of a weights file: the metadata that says what its tensors are and how to use them."""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import safetensors

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import FormatError, UsageError, WeightsError, error_text, shortened
from salsanext_cli.files.identity import fingerprint
from salsanext_cli.files.optional_packages import import_openvino
from salsanext_cli.files.reading import is_folder, present, reading, refusing_damage
from salsanext_cli.network.error_model import ErrorModel, valid_temperature
from salsanext_cli.records import Scan
from salsanext_cli.sensors.sensor import Sensor
from salsanext_cli.version import __version__

KEY = "salsanext"  # The only key: safetensors writes several in an order drawn each time
FORMAT = "salsanext-2"
TABLES = ("architecture", "label_space", "sensor", "recipe", "scores")  # Mappings of a card
FITTED = {"risk": ("threshold", "at_most", "scans"), "accuracy": ("slope", "offset", "deviation")}
"""Parts that are mappings and may be absent, and the numbers that each holds."""
OF_ERROR = re.compile(r"The error is fitted to ([^.]*)\. ?")
"""Sentence on the error model in the description of older files."""
INHERITED = "inherited_from"  # Key of a fitted part: names the weights that it was fitted to
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


@dataclass(frozen=True, slots=True, eq=False)
class WeightsCard:
    """Metadata of a weights file."""

    # Name and numbers of the network, as `registry.build` takes them
    architecture: Mapping[str, Any]
    space: LabelSpace  # The classes that the logits stand for
    sensor: Sensor  # The geometry and normalisation that the network was trained with
    # The resolved training recipe; empty if unknown
    recipe: Mapping[str, Any] = field(default_factory=dict)
    # Measurements with these weights, and the data; empty if there are none
    scores: Mapping[str, Any] = field(default_factory=dict)
    description: str = ""  # A sentence or two on these weights
    # Divides the logits before the softmax, so that its values are probabilities; 1 if none was
    # fitted
    temperature: float = 1.0
    # Model of the probability that a label is wrong; None if none was fitted
    error: ErrorModel | None = None
    # Threshold above which `predict --reject risk` rejects: its `kind` of uncertainty, `threshold`,
    # `at_most`, `confidence`, `unit`, `scans` and `sequences` that it was chosen on, `settings`,
    # those that labels depend on, by option, `view` that was fitted, and thresholds of `classes`
    # that have their own; empty without
    risk: Mapping[str, Any] = field(default_factory=dict)
    # Line from the logit of a run's mean confidence to that of its accuracy: `slope`, `offset`, and
    # `deviation` of the accuracy from it, 0…1; empty if none was fitted
    accuracy: Mapping[str, Any] = field(default_factory=dict)
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
        parts = {"error model": self.error.scores if self.error else {}}
        parts["expected accuracy"] = self.accuracy
        of = {what: shortened(part[INHERITED]) for what, part in parts.items() if INHERITED in part}
        names = " and ".join(dict.fromkeys(of.values()))
        return f"{' and '.join(of)} of {names}" if of else ""

    def changed(self, done: str) -> WeightsCard:
        """Return the card of changed weights, by a sentence: without scores and what was fitted."""
        bare = replace(self, scores={}, error=None, risk={}, accuracy={}, version=None)
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
        known: dict[str, Any] = {"error": self.error.to_dict() if self.error else {}}
        known |= {name: dict(getattr(self, name)) for name in FITTED}
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
                remedy = "use the version that wrote it"
                raise WeightsError(source, f"format {shortened(form)}", FORMAT, remedy)
            tables = (*TABLES, *(name for name in ("error", *FITTED) if name in values))
            if bad := [key for key in tables if not isinstance(values[key], dict)]:
                raise TypeError(f"{bad[0]} is no table")
            # A view that a threshold holds for is that of a sensor.
            risk = values.get("risk", {})
            for view in (risk.get("view", {}), *risk.get("other_views", ())):
                Sensor.from_dict({**values["sensor"], **view}, source)
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
                error=None if error is None else ErrorModel.from_dict(error),
                **{name: _numbers_of(name, values[name]) for name in FITTED if name in values},
                trained_on=frozenset(parted(values.get("trained_on", ""))),
                version=values.get("weights_version"),
            )
        except UsageError as error:
            raise WeightsError(source, f"damaged metadata: {error.found}") from error
        except (KeyError, TypeError, ValueError, ArithmeticError, RecursionError) as error:
            raise WeightsError(source, f"damaged metadata: {error_text(error)}") from error


def _numbers_of(part: str, values: Any) -> dict[str, Any]:
    """Check the numbers of a part that is a mapping."""
    numbers = [values[name] for name in FITTED[part]]
    if not all(type(each) in (int, float) and math.isfinite(each) for each in numbers):
        raise ValueError(f"{part} holds {shortened(numbers)}")
    if part == "risk":
        of_risk = {"kind", "confidence", "sequences"} <= values.keys()
        tables = [values.get(name, {}) for name in ("settings", "classes")]
        if not (of_risk and all(isinstance(table, dict) for table in tables)):
            raise ValueError("risk does not say what it holds for")
        if not all(type(each) in (int, float) for each in tables[1].values()):
            raise ValueError(f"risk holds {shortened(tables[1])}")
    return dict(values)


def read_card(path: Path) -> WeightsCard:
    """Read only the metadata of a weights file, or of an ONNX file of `export-onnx`."""
    metadata_of, kind = _of_safetensors, "a .safetensors file"
    remedy = "convert a published checkpoint with `salsanext import-weights`"
    if path.suffix == ONNX_SUFFIX:
        metadata_of, kind = _of_onnx, "an ONNX file"
        remedy = "write it with `salsanext export-onnx`"
    try:
        with reading(path), refusing_damage(path, kind):
            metadata = metadata_of(path)
    except FormatError as error:
        found = error.found if present(path) else "no such file"
        if is_folder(path):
            found, remedy = "a folder", "name the file in it"
        raise WeightsError(path, found, kind, remedy) from error
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
