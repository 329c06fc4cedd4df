# SPDX-License-Identifier: MIT
"""Networks from weights files: on which device, by which engine, in which precision."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.classes.merging import ClassMerging
from salsanext_cli.core.engines.device import choose_device, choose_precision
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.engines.registry import LIBRARIES, choose_engine
from salsanext_cli.core.errors import WeightsError
from salsanext_cli.core.network.card import WeightsCard
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.wording import setting
from salsanext_cli.io.files.reading import fingerprint
from salsanext_cli.io.files.user_cache import check_once
from salsanext_cli.io.weights.card_file import default_weights, read_card

if TYPE_CHECKING:
    from salsanext_cli.core.network.segmentation import SegmentationNetwork


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
        A weights file; default: the weights of the package.
    device : str
        ``"cpu"``, ``"cuda"``, ``"cuda:1"`` … or ``"auto"``: the first GPU if there is one.
    sensor : Sensor, optional
        Sensor of the range images; default: the sensor of the weights.
    precision : {"auto", "float32", "bfloat16", "float16", "int8"}
        Number type; ``"auto"`` is the fastest float on the device.
    engine : str
        Library, a name of `LIBRARIES`; ``"auto"`` is the fastest that starts on the device.
    classes : LabelSpace, optional
        Classes into which the classes of the weights are merged.

    Returns
    -------
    Network

    Raises
    ------
    WeightsError
        If the file cannot be used.
    UsageError
        If device, precision, engine or `classes` are impossible.
    MissingDependency
        If the library was requested and does not start.
    """
    file = default_weights() if path is None else Path(path)
    card = read_card(file)
    merging = ClassMerging.needed(card.space, classes)
    sensor = sensor or card.sensor
    sha256 = fingerprint(file)
    device = choose_device(device)
    library = choose_engine(engine, device)
    is_built_in = card.architecture.get("name") == "salsanext"
    backend = LIBRARIES[library].backend_class()(
        load_module=lambda: _read_module(file, device, sha256),
        card=card.at_width(sensor.width),
        size=(sensor.height, sensor.width),
        device=device,
        precision=_number_type(precision, device, library, file, card),
        name="default weights" if path is None else str(path),
        sha256=sha256,
        code="" if is_built_in else _code_of_plug_in(card),
    )
    if backend.needs_module or not is_built_in:
        _ = backend.module
    else:
        check_once(sha256, lambda: backend.module)  # Weights that passed once need no torch.
    return Network(backend, sensor, merging)


def _number_type(precision: str, device: str, library: str, file: Path, card: WeightsCard) -> str:
    """Return the number type of a precision; refuse int8 without the ranges that it needs."""
    number_type = choose_precision(precision, device, library)
    if number_type == "int8" and not card.int8:
        hint = "fit them with `salsanext tune int8 SCANS WEIGHTS_OUT`"
        problem = f"has no ranges for {setting('precision', 'int8')}"
        raise WeightsError(file, problem, hint=hint)
    return number_type


def network_of_module(
    module: "SegmentationNetwork", card: WeightsCard, device: str, precision: str = "float32"
) -> Network:
    """Return the network of a torch module in training that is on the device already.

    Its calls are not recorded as CUDA graphs: an epoch later, the recordings are of no use.
    """
    from salsanext_cli.core.engines.torch_backend import TorchBackend

    size = (card.sensor.height, card.sensor.width)
    backend = TorchBackend(
        load_module=lambda: module,
        card=card,
        size=size,
        device=device,
        precision=precision,
        records=False,
    )
    return Network(backend, card.sensor)


def _code_of_plug_in(card: WeightsCard) -> str:
    """Return a digest of the source of a plug-in's network."""
    from salsanext_cli.core.network.registry import plug_in_of

    plug_in = plug_in_of(card.architecture.get("name"))
    return plug_in.digest() if plug_in else ""


def _read_module(file: Path, device: str, sha256: str) -> "SegmentationNetwork":
    import torch

    from salsanext_cli.io.weights.weights import read_weights

    # Tensors of the inference mode could not be shared with another module later.
    with torch.inference_mode(False):
        module, _ = read_weights(file)
        if fingerprint(file) != sha256:
            raise replaced_file_error(file)
        return module.to(device).to(memory_format=torch.channels_last)  # type: ignore[call-overload]


def replaced_file_error(file: Path) -> WeightsError:
    """Return the error about a weights file that changed during a run."""
    hint = f"run again with {setting('overwrite', True)}"
    return WeightsError(file, "was replaced during the run", hint=hint)


def with_dropout(network: Network, rate: float) -> Network:
    """Return the network with another dropout rate; both share weights and graphs."""
    import torch

    from salsanext_cli.core.network.registry import build

    architecture = {**network.card.architecture, "dropout": rate}
    # On "meta" no weights are drawn: torch's global generator does not change.
    with torch.device("meta"):
        module = build(architecture)
    module.load_state_dict(network.module.state_dict(), assign=True)
    card = replace(network.card, architecture=architecture)
    return replace(network, backend=replace(network.backend, load_module=module.eval, card=card))
