# SPDX-License-Identifier: MIT
"""A network ready to use: range image in, probabilities out."""

import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch
from torch import Tensor

from salsanext_cli.errors import UsageError, WeightsError
from salsanext_cli.geometry.normalise import normalise
from salsanext_cli.inference.engine import choose_precision, engine_for
from salsanext_cli.inference.parallel_for import single_threaded_torch
from salsanext_cli.network.registry import build
from salsanext_cli.network.segmentation import SegmentationNetwork
from salsanext_cli.network.weights import WeightsCard, default_weights, read_weights
from salsanext_cli.records import Float, RangeImage
from salsanext_cli.sensors import Sensor

log = logging.getLogger(__name__)
Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True, eq=False)
class Network:
    """Weights on a device, in evaluation mode.

    Attributes
    ----------
    module : SegmentationNetwork
        (B, 5, H, W) normalised range images to (B, C, H, W) logits.
    card : WeightsCard
        Architecture, label space, sensor and origin of the weights.
    sensor : Sensor
        Geometry and normalisation of the range images: the card's unless another was asked for.
    device : torch.device
        Place of the module.
    precision : {"float32", "bfloat16", "float16"}
        Number type of the engine.
    weights : str
        Name of the weights file, for errors.
    """

    module: SegmentationNetwork
    card: WeightsCard
    sensor: Sensor
    device: torch.device
    precision: str = "float32"
    weights: str = "the weights"

    @cached_property
    def engine(self) -> SegmentationNetwork:
        """Engine that computes as the module does, faster; float32 in and out.

        It is made on first use and does not follow later changes of the module.
        """
        return engine_for(self.module, self.device, self.precision)

    @cached_property
    def batch_sizes(self) -> dict[str, int]:
        """Number of items by name that there was room for at once; empty until memory runs out."""
        return {}

    def input(self, channels: Float) -> Tensor:
        """Return (5, H, W) channels normalised as the network takes them, (1, 5, H, W)."""
        normalised = torch.from_numpy(normalise(channels, self.sensor))[None]
        return normalised.to(self.device, memory_format=torch.channels_last)

    @contextmanager
    def inference_mode(self) -> Iterator[None]:
        """Set torch up for the engine while the body runs: no gradients, its threads or its GPU.

        On a GPU float32 is float32, without the ten bits that convolutions may have by default,
        and algorithms are those that give the same bits each time.
        """
        cudnn = {"enabled": True, "benchmark": False, "deterministic": True, "allow_tf32": False}
        with torch.inference_mode():
            if self.device.type == "cuda":
                with torch.cuda.device(self.device), torch.backends.cudnn.flags(**cudnn):
                    yield
            elif self.engine.manages_threads:
                with single_threaded_torch():
                    yield
            else:
                yield

    def logits(self, image: RangeImage) -> Float:
        """Return the logits of every pixel, (C, H, W) float32."""
        with self.inference_mode():
            logits: Float = self.engine(self.input(image.channels))[0].cpu().numpy()
        return logits

    def probabilities(self, image: RangeImage, source: object = "a scan") -> Float:
        """Return the softmax of every pixel, (C, H, W) float32, sum over C = 1.

        The logits are divided by the card's temperature, which leaves their order as it is.

        Parameters
        ----------
        image : RangeImage
            One scan.
        source : object
            What to call it in an error.

        Raises
        ------
        WeightsError
            If the softmax is not finite.
        """
        (probabilities,) = self.pixel_probabilities([image.channels])
        self.require_finite(probabilities, source)
        return probabilities

    def pixel_probabilities(self, channels: Sequence[Float]) -> list[Float]:
        """Return the softmax of every pixel of some range images, as `probabilities` does.

        They are computed together, half as many where memory runs out; no bit depends on it.

        Parameters
        ----------
        channels : sequence of (5, H, W) float32
            Of range images of the network's sensor.

        Raises
        ------
        torch.OutOfMemoryError
            If there is no room for a single one.
        """

        def softmax(batch: Sequence[Float]) -> Iterable[Float]:
            with self.inference_mode():
                logits = self.engine(torch.cat([self.input(image) for image in batch]))
                return torch.softmax(logits / self.card.temperature, dim=1).cpu().numpy()

        return self.in_batches(softmax, channels, len(channels), "scans")

    def in_batches(
        self,
        function: Callable[[Sequence[Item]], Iterable[Result]],
        items: Sequence[Item],
        most: int,
        name: str,
    ) -> list[Result]:
        """Return the results of a function of batches, halved where memory runs out.

        The network remembers for how many items of a name there was room.

        Raises
        ------
        torch.OutOfMemoryError
            If there is no room for a single item.
        """
        found: list[Result] = []
        while len(found) < len(items):
            size = min(most, self.batch_sizes.get(name, most))
            batch = items[len(found) : len(found) + size]
            try:
                found.extend(function(batch))
            except torch.OutOfMemoryError:
                if len(batch) == 1:
                    raise
                size = self.batch_sizes[name] = len(batch) // 2
                log.warning("not enough memory for %d %s at once: %d now", len(batch), name, size)
        return found

    def require_finite(self, probabilities: Float, source: object) -> None:
        """Raise `WeightsError`, naming weights and scan, if a softmax is not finite."""
        if not np.isfinite(probabilities).all():
            found = f"their logits for {source} are not finite"
            raise WeightsError(self.weights, found, "finite logits", "use other weights")


def load_network(
    path: Path | str | None = None,
    device: str = "auto",
    sensor: Sensor | None = None,
    precision: str = "float32",
) -> Network:
    """Load weights onto a device.

    Parameters
    ----------
    path : Path or str, optional
        A weights file; None for the default weights.
    device : str
        ``"cpu"``, ``"cuda"``, ``"cuda:1"`` … or ``"auto"``: the first GPU if there is one.
    sensor : Sensor, optional
        Origin of the range images, if not the sensor that the weights name.
    precision : str
        As `engine.choose_precision` takes it; ``"auto"`` is what the device is fast at.

    Raises
    ------
    WeightsError
        If the file cannot be used.
    UsageError
        If the device does not exist, or does not compute in that precision.
    """
    module, card = read_weights(default_weights() if path is None else Path(path))
    place = choose_device(device)
    module = module.to(place).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    chosen = choose_precision(precision, place)
    name = "default weights" if path is None else str(path)
    return Network(module, card, sensor or card.sensor, place, chosen, name)


def with_dropout(network: Network, rate: float) -> Network:
    """Return the network with another dropout rate, from 0 to below 1; both share their weights.

    One that was trained without dropout gets it where the paper has it.
    """
    architecture = {**network.card.architecture, "dropout": rate}
    # On "meta" nothing is drawn: torch's global generator stays as it is.
    with torch.device("meta"):
        module = build(architecture)
    module.load_state_dict(network.module.state_dict(), assign=True)
    card = replace(network.card, architecture=architecture)
    return replace(network, module=module.eval(), card=card)


def choose_device(name: str) -> torch.device:
    """Return the device of a name; ``"auto"`` is the first GPU, else the CPU."""
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
    except RuntimeError as error:
        raise UsageError(f"device {name}", "no such device", "cpu, cuda, cuda:0 …") from error
    if device.type == "cuda":
        count = torch.cuda.device_count()
        if (device.index or 0) >= count:
            raise UsageError(
                f"device {name}", f"{count} GPUs visible to torch", "one of them, or cpu"
            )
    elif device.type != "cpu":
        raise UsageError(f"device {name}", "not supported", "cpu or cuda")
    return device
