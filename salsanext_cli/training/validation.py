# SPDX-License-Identifier: MIT
"""Validation of a network in training: labelled scans, predicted as `predict` does, and scored."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from salsanext_cli.engines.network import Network
from salsanext_cli.geometry.projection import project
from salsanext_cli.measures.scores import Confusion, scores
from salsanext_cli.network.card import TEMPERATURES
from salsanext_cli.training.data.sources import Source, read_labelled
from salsanext_cli.training.distributed import SINGLE_PROCESS, ProcessGroup
from salsanext_cli.training.log import Row
from salsanext_cli.training.tuning.temperature import best_temperature

MAX_POINTS = 200_000
"""Bound of the points of a validation whose logits the temperature is fitted to."""


@dataclass(frozen=True, slots=True, eq=False)
class Validation:
    """Predictions for labelled scans."""

    confusion: Confusion  # Truth by predicted label of all points
    # (C, M) float32: of some points of the classes that count, evenly spaced in every scan
    logits: Tensor
    truth: Tensor  # (M,) int64: their classes

    def across(self, group: ProcessGroup, device: torch.device) -> "Validation":
        """Return those of all workers together."""
        counts = group.sum(torch.from_numpy(self.confusion.matrix).to(device)).cpu().numpy()
        logits, truth = (
            torch.cat(group.gather(each.to(device)), dim=-1).cpu()
            for each in (self.logits, self.truth)
        )
        return Validation(Confusion(len(counts), counts), logits, truth)

    def row(self, network: Network) -> Row:
        """Return the scores as columns of the log: accuracy, miou, temperature, iou_<class>.

        The temperature is that of the least negative log-likelihood; 1 where there is none, since
        the network knows nothing yet, or every point is right.
        """
        space = network.card.space
        result = scores(self.confusion, space)
        temperature = 1.0
        if len(self.truth):
            found = best_temperature(self.logits.T.contiguous(), self.truth)
            lowest, highest = TEMPERATURES
            temperature = found if lowest <= found <= highest else temperature
        named = {f"iou_{score.name}": score.iou for score in result.classes}
        return {
            "accuracy": result.accuracy,
            "miou": result.iou_mean_present,
            "temperature": temperature,
            **named,
        }


def validate(network: Network, source: Source, group: ProcessGroup = SINGLE_PROCESS) -> Validation:
    """Predict a worker's share of labelled scans as `predict` does."""
    space = network.card.space
    confusion = Confusion(space.class_count)
    logits, truth = [torch.empty(space.class_count, 0)], [torch.empty(0, dtype=torch.int64)]
    for file in source.files[group.rank :: group.size]:
        own = network.for_sensor(source.sensor_of(file))
        scan, labels = read_labelled(file, source.space, own.sensor)
        image = project(scan, own.sensor)
        of_pixels = own.logits(image)
        confusion.update(labels, own.labels(image, of_pixels))
        usable = np.flatnonzero(space.scored[labels] & (image.pixel_of_point >= 0))
        chosen = usable[:: max(1, len(usable) * len(source.files) // MAX_POINTS)]
        pixels = image.pixel_of_point[chosen]
        logits.append(torch.from_numpy(of_pixels.reshape(space.class_count, -1)[:, pixels]))
        truth.append(torch.from_numpy(labels[chosen].astype(np.int64)))
    return Validation(confusion, torch.cat(logits, dim=1), torch.cat(truth))
