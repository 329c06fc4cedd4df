# SPDX-License-Identifier: MIT
"""Networks from weights files and ONNX files: on which device, by which engine and number type."""

import hashlib
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.classes.merging import ClassMerging
from salsanext_cli.engines.backend import Backend
from salsanext_cli.engines.device import (
    choose_device,
    choose_engine,
    choose_precision,
    openvino_core,
)
from salsanext_cli.engines.network import Network
from salsanext_cli.engines.openvino_backend import OpenVinoBackend
from salsanext_cli.errors import MissingDependency, UsageError, WeightsError, error_text
from salsanext_cli.files.identity import fingerprint
from salsanext_cli.files.plug_ins import DISTRIBUTION
from salsanext_cli.files.user_cache import check_once
from salsanext_cli.network.card import ONNX_SUFFIX, WeightsCard, default_weights, read_card
from salsanext_cli.records import CHANNELS
from salsanext_cli.sensors.sensor import Sensor

if TYPE_CHECKING:
    from salsanext_cli.network.segmentation import SegmentationNetwork


def load_network(
    path: Path | str | None = None,
    device: str = "auto",
    sensor: Sensor | None = None,
    precision: str = "float32",
    engine: str = "auto",
    classes: LabelSpace | None = None,
) -> Network:
    """Load weights onto a device.

    Parameters
    ----------
    path : Path or str, optional
        A weights file, or an ONNX file of `export-onnx`, which gives labels and probabilities only
        and is computed by OpenVINO; None for the default weights.
    device : str
        ``"cpu"``, ``"cuda"``, ``"cuda:1"`` … or ``"auto"``: the first GPU if there is one.
    sensor : Sensor, optional
        Origin of the range images, if not the sensor that the weights name.
    precision : str
        As `device.choose_precision` takes it; ``"auto"`` is what the device is fast at.
    engine : str
        As `device.choose_engine` takes it.
    classes : LabelSpace, optional
        Into whose classes those of the weights are merged.

    Raises
    ------
    WeightsError
        If the file cannot be used.
    UsageError
        If the device does not exist, or does not compute in that precision or with that engine; or
        if the classes are not merged ones of the weights'.
    MissingDependency
        If OpenVINO was asked for and does not start.
    """
    file = default_weights() if path is None else Path(path)
    card = read_card(file)
    merging = ClassMerging.needed(card.space, classes)
    sensor = sensor or card.sensor
    size = (sensor.height, sensor.width)
    if file.suffix == ONNX_SUFFIX:
        return Network(_load_onnx(file, card, size, device, precision, engine), sensor, merging)
    sha256, own_device = fingerprint(file), choose_device(device)
    backend = _backend_class(choose_engine(engine, own_device))(
        lambda: _read_module(file, own_device, sha256),
        card,
        size,
        own_device,
        choose_precision(precision, own_device),
        "default weights" if path is None else str(path),
        sha256,
        code=_code_of_plug_in(card),
    )
    if backend.library == "torch" or DISTRIBUTION in card.architecture:
        _ = backend.module
    else:
        check_once(sha256, lambda: backend.module)  # what was read once needs no torch
    return Network(backend, sensor, merging)


def _backend_class(library: str) -> type[Backend]:
    """Return the backend that computes with a library."""
    if library == "openvino":
        return OpenVinoBackend
    from salsanext_cli.engines.torch_backend import TorchBackend

    return TorchBackend


def network_of_module(module: "SegmentationNetwork", card: WeightsCard, device: str) -> Network:
    """Return the network of a module that is on a device already, computed by torch."""
    size = (card.sensor.height, card.sensor.width)
    return Network(_backend_class("torch")(lambda: module, card, size, device), card.sensor)


def _code_of_plug_in(card: WeightsCard) -> str:
    """Return a digest of the code of a plug-in's network, empty for a built-in one."""
    if DISTRIBUTION not in card.architecture:
        return ""
    from salsanext_cli.network.registry import plug_in_of

    plug_in = plug_in_of(card.architecture)
    return plug_in.digest() if plug_in else ""


def _read_module(file: Path, device: str, sha256: str) -> "SegmentationNetwork":
    import torch

    from salsanext_cli.network.weights import read_weights

    # Tensors of inference could not be copied into another module, which others may ask for.
    with torch.inference_mode(False):
        module, _ = read_weights(file)
        if fingerprint(file) != sha256:
            raise replaced(file)
        return module.to(device).to(memory_format=torch.channels_last)  # type: ignore[call-overload]


def replaced(file: Path) -> WeightsError:
    """Return the error about a weights file that is another than before."""
    found = "was replaced since the run began"
    return WeightsError(file, found, "the same file", "run again with --overwrite")


def with_dropout(network: Network, rate: float) -> Network:
    """Return the network with another dropout rate; both share weights and graphs."""
    import torch

    from salsanext_cli.network.registry import build

    architecture = {**network.card.architecture, "dropout": rate}
    # On "meta" nothing is drawn: torch's global generator stays as it is.
    with torch.device("meta"):
        module = build(architecture)
    module.load_state_dict(network.module.state_dict(), assign=True)
    card = replace(network.card, architecture=architecture)
    return replace(network, backend=replace(network.backend, load_module=module.eval, card=card))


def _load_onnx(
    path: Path, card: WeightsCard, size: tuple[int, int], device: str, precision: str, engine: str
) -> OpenVinoBackend:
    if device not in ("auto", "cpu"):
        raise UsageError("--device", f"{device} for an ONNX model", "cpu, or .safetensors weights")
    if engine == "torch":
        raise UsageError("--engine", "torch for an ONNX model", "openvino, or .safetensors weights")
    number_type = choose_precision(precision, "cpu")
    try:
        choose_engine("openvino", "cpu")
    except MissingDependency as error:
        hint = "install it again, or give the .safetensors weights"
        raise MissingDependency(error.subject, error.problem, hint=hint) from error
    sha256 = fingerprint(path)

    def no_module() -> "SegmentationNetwork":
        return _read_module(path, "cpu", sha256)  # raises what is to be said

    def read_model() -> Any:
        try:
            content = path.read_bytes()
        except OSError as error:
            raise WeightsError(path, f"cannot be read: {error_text(error)}") from error
        if hashlib.sha256(content).hexdigest() != sha256:
            raise replaced(path)
        return read_onnx(content, path, card, size)

    import openvino

    shape = "x".join(map(str, size))
    check_once(f"{sha256}.{shape}-{openvino.__version__}", read_model)
    return OpenVinoBackend(
        no_module, card, size, "cpu", number_type, str(path), sha256, read_model=read_model
    )


def read_onnx(content: bytes, source: object, card: WeightsCard, size: tuple[int, int]) -> Any:
    """Read an ONNX model of range images (1, 5, H, W) to logits; `source` names it in errors."""
    import openvino

    shape = [1, len(CHANNELS), *size]
    try:
        model = openvino_core().read_model(content)
        shapes = [port.get_partial_shape() for port in (*model.inputs, *model.outputs)]
        if len(model.inputs) != 1 or len(model.outputs) != 1:
            count = f"{len(model.inputs)} inputs and {len(model.outputs)} outputs"
            raise WeightsError(source, count, "one of each")
        if not shapes[0].compatible(openvino.PartialShape(shape)):
            hint = "export it again with --sensor, or with --dynamic-width"
            raise WeightsError(source, f"takes images {shapes[0]}", f"{shape}", hint)
        model.reshape(shape)
    except (RuntimeError, ValueError, TypeError, MemoryError) as error:
        found = f"cannot be read by OpenVINO: {error_text(error)}"
        hint = "write it with `salsanext export-onnx`"
        raise WeightsError(source, found, "an ONNX model", hint) from error
    logits, expected = model.output(0).get_partial_shape(), [1, card.space.class_count, *size]
    if logits != openvino.PartialShape(expected):
        raise WeightsError(source, f"its logits are {logits}", f"{expected}, as its card says")
    return model
