# SPDX-License-Identifier: MIT
"""Validation of a network in training: scores on labelled scans, and the temperature that fits."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch

from salsanext_cli.classes.label_space import TrainIds
from salsanext_cli.engines.network import Network
from salsanext_cli.geometry.knn import knn_refine
from salsanext_cli.geometry.projection import project
from salsanext_cli.measures.scores import Counts, confusion_matrix, scores
from salsanext_cli.network.card import WeightsCard
from salsanext_cli.network.error_model import TEMPERATURES
from salsanext_cli.parallel.job import Steps
from salsanext_cli.parallel.network_task import network_pipeline
from salsanext_cli.records import Float, RangeImage
from salsanext_cli.results.paths import ScanFile
from salsanext_cli.training.data.sources import Source, read_labelled
from salsanext_cli.training.distributed import SINGLE_PROCESS, ProcessGroup
from salsanext_cli.training.log import Row
from salsanext_cli.training.tuning.temperature import best_temperature, with_temperature

MAX_VALIDATED_POINTS = 200_000  # Points of a validation that the temperature is fitted to


class ProjectedTruth(NamedTuple):
    """Scan with labels, projected for the sensor of its sequence."""

    network: Network  # For that sensor
    labels: TrainIds  # (N,) uint8
    image: RangeImage


class ValidatedScan(NamedTuple):
    """Numbers about a validated scan."""

    confusion: Counts  # (C, C)
    logits: torch.Tensor  # (C, M) float32: of some points of the classes that count
    truth: torch.Tensor  # (M,) int64


def validate(
    network: Network, source: Source, group: ProcessGroup = SINGLE_PROCESS
) -> tuple[Row, WeightsCard]:
    """Score scans labelled as `predict` does, shared by workers; fit the card's temperature."""
    card, space = network.card, network.card.space
    confusion = np.zeros((space.class_count, space.class_count), np.int64)
    logits, truth = [torch.empty(space.class_count, 0)], [torch.empty(0, dtype=torch.int64)]

    def read(file: ScanFile) -> ProjectedTruth:
        own = network.for_sensor(source.sensor_of(file))
        scan, labels = read_labelled(file, source.space, own.sensor)
        return ProjectedTruth(own, labels, project(scan, own.sensor))

    def logits_of(scans: Sequence[ProjectedTruth]) -> list[Float]:
        inputs = [own.input(image.channels) for own, _, image in scans]
        return network.backend.logits(inputs)

    def compare(scan: ProjectedTruth, of_pixels: Float) -> ValidatedScan:
        _, labels, image = scan
        refined = knn_refine(image, of_pixels.argmax(axis=0), space.class_count)
        of_classes = confusion_matrix(labels, refined, space.class_count)
        usable = np.flatnonzero(space.scored[labels] & (image.pixel_of_point >= 0))
        chosen = usable[:: max(1, len(usable) * len(source.files) // MAX_VALIDATED_POINTS)]
        of_points = of_pixels.reshape(space.class_count, -1)[:, image.pixel_of_point[chosen]]
        of_truth = torch.from_numpy(labels[chosen].astype(np.int64))
        return ValidatedScan(of_classes, torch.from_numpy(of_points), of_truth)

    job = Steps(read, logits_of, compare)
    for scan in network_pipeline(job, network).results(source.files[group.rank :: group.size]):
        confusion += scan.confusion
        logits.append(scan.logits)
        truth.append(scan.truth)
    counts = group.sum(torch.from_numpy(confusion).to(network.device)).cpu().numpy()
    all_logits, all_truth = (
        torch.cat(group.gather(torch.cat(own, dim=-1).to(network.device)), dim=-1).cpu()
        for own in (logits, truth)
    )
    result, (lowest, highest) = scores(counts, space), TEMPERATURES
    of_points = all_logits.T.contiguous()
    best = best_temperature(of_points, all_truth) if len(all_truth) else card.temperature
    card = with_temperature(card, best if lowest <= best <= highest else 1.0, of_points)
    row: Row = {
        "accuracy": result.accuracy,
        "miou": result.iou_mean_present,
        "temperature": card.temperature,
        **{f"iou_{score.name}": score.iou for score in result.classes},
    }
    return row, card
