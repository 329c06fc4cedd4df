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

    def row(self, network: Network) -> Row:
        """Return the scores as columns of the log, with a temperature of 1 where none is best."""
        result = scores(self.confusion, network.card.space)
        best = best_temperature(self.logits.T.contiguous(), self.truth) if len(self.truth) else 1.0
        lowest, highest = TEMPERATURES
        return {
            "accuracy": result.accuracy,
            "miou": result.iou_mean_present,
            "temperature": best if lowest <= best <= highest else 1.0,
            **{f"iou_{score.name}": score.iou for score in result.classes},
        }


def validate(network: Network, source: Source, group: ProcessGroup = SINGLE_PROCESS) -> Validation:
    """Predict labelled scans as `predict` does, each by one worker of a group."""
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
    counts = group.sum(torch.from_numpy(confusion.matrix).to(network.device)).cpu().numpy()
    all_logits, all_truth = (
        torch.cat(group.gather(torch.cat(own, dim=-1).to(network.device)), dim=-1).cpu()
        for own in (logits, truth)
    )
    return Validation(Confusion(space.class_count, counts), all_logits, all_truth)
