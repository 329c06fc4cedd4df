# SPDX-License-Identifier: MIT
"""Networks from weights files: on which device, by which engine, in which number type."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.classes.merging import ClassMerging
from salsanext_cli.engines.device import choose_device, choose_engine, choose_precision
from salsanext_cli.engines.engine import Engine
from salsanext_cli.engines.network import Network
from salsanext_cli.engines.onnx_engine import load_onnx
from salsanext_cli.errors import WeightsError
from salsanext_cli.files.identity import fingerprint
from salsanext_cli.files.user_cache import check_once
from salsanext_cli.geometry.network_input import ScanFit
from salsanext_cli.network.card import ONNX_SUFFIX, WeightsCard, default_weights, read_card
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
    fit = ScanFit(sensor or card.sensor, card.sensor)
    size = (fit.sensor.height, fit.sensor.width)
    if file.suffix == ONNX_SUFFIX:
        return Network(load_onnx(file, card, size, device, precision, engine), fit, merging)
    sha256, place = fingerprint(file), choose_device(device)
    loaded = Engine(
        lambda: _read_module(file, place, sha256),
        card,
        size,
        place,
        choose_precision(precision, place),
        choose_engine(engine, place),
        "default weights" if path is None else str(path),
        sha256,
    )
    if loaded.library == "torch":
        _ = loaded.module
    else:
        check_once(sha256, lambda: loaded.module)  # what was read once needs no torch
    return Network(loaded, fit, merging)


def network_of_module(module: "SegmentationNetwork", card: WeightsCard, device: str) -> Network:
    """Return the network of a module that is on a device already, computed by torch."""
    size = (card.sensor.height, card.sensor.width)
    return Network(Engine(lambda: module, card, size, device), ScanFit(card.sensor, card.sensor))


def _read_module(file: Path, device: str, sha256: str) -> "SegmentationNetwork":
    import torch

    from salsanext_cli.network.weights import read_weights

    module, _ = read_weights(file)
    if fingerprint(file) != sha256:
        found = "was replaced since the run began"
        raise WeightsError(file, found, "the same file", "run again with --overwrite")
    return module.to(device).to(memory_format=torch.channels_last)  # type: ignore[call-overload, no-any-return]


def with_dropout(network: Network, rate: float) -> Network:
    """Return the network with another dropout rate, from 0 to below 1.

    Both share their weights, and graphs, which take the factors of dropout as inputs. One that was
    trained without dropout gets it where the paper has it.
    """
    import torch

    from salsanext_cli.network.registry import build

    architecture = {**network.card.architecture, "dropout": rate}
    # On "meta" nothing is drawn: torch's global generator stays as it is.
    with torch.device("meta"):
        module = build(architecture)
    module.load_state_dict(network.module.state_dict(), assign=True)
    card = replace(network.card, architecture=architecture)
    return replace(network, engine=replace(network.engine, load_module=module.eval, card=card))
