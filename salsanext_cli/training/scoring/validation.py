# SPDX-License-Identifier: MIT
"""Validation of a network in training: scores on labelled scans, and the best temperature."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import torch

from salsanext_cli.core.classes.label_space import LabelSpace, TrainIds
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.geometry.knn import knn_refine
from salsanext_cli.core.geometry.projection import project
from salsanext_cli.core.geometry.sensor_of_scan import sensor_of
from salsanext_cli.core.labellers import computes_on_gpu
from salsanext_cli.core.measures.scores import confusion_matrix, scores
from salsanext_cli.core.network.card import WeightsCard
from salsanext_cli.core.network.error_model import TEMPERATURES
from salsanext_cli.core.records import Float, RangeImage
from salsanext_cli.core.texts import counted, with_hint
from salsanext_cli.core.wording import setting
from salsanext_cli.runs.loop.job import ScanJob, Steps
from salsanext_cli.runs.loop.network_task import network_pipeline
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.training.data.sources import Source, read_labelled
from salsanext_cli.training.distributed import SINGLE_PROCESS, ProcessGroup, agreed_precision
from salsanext_cli.training.run_folder import Row
from salsanext_cli.training.scoring.device_validation import DeviceValidation
from salsanext_cli.training.scoring.validated_scan import (
    ValidatedScan,
    ValidatedScans,
    sample_interval,
)
from salsanext_cli.training.tuning.temperature import best_temperature, with_temperature

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ProjectedTruth:
    """Scan with labels, projected for the sensor of its sequence."""

    network: Network  # For that sensor
    labels: TrainIds  # (N,) uint8
    image: RangeImage


def validate_widths(
    network: Network, source: Source, widths: Sequence[int], group: ProcessGroup = SINGLE_PROCESS
) -> tuple[Row, WeightsCard]:
    """Score images of each width as `validate` does; without widths, those of the sensor alone.

    The first width is that of the network. Accuracy and mean IoU of the others have it in their
    keys, such as ``miou_1024``. The card has a temperature for each.
    """
    first, *others = dict.fromkeys(widths or [source.sensor.width])
    row, card = validate(network, source.at_width(first), group)
    parts = dict(card.parts_of_widths)
    for width in others:
        measured, tempered = validate(network, source.at_width(width), group)
        row |= {f"{key}_{width}": measured[key] for key in ("accuracy", "miou")}
        parts[width] = tempered.parts
    return row, replace(card, parts_of_widths=parts)


def validate(
    network: Network, source: Source, group: ProcessGroup = SINGLE_PROCESS
) -> tuple[Row, WeightsCard]:
    """Score labels as `predict` makes them; return a row of the log, and a tempered card.

    Where logits overflow in a shorter number type, all scans are validated again in float32, with a
    warning: `predict` refuses such logits. The workers of a group divide the scans, and compute in
    one number type, so that all of them validate again or none does.
    """
    card = network.card
    precision = agreed_precision(network.backend.precision, network.device, group)
    scans = _validated(_in_precision(network, precision), source, group)
    if scans.infinite_scans and precision != "float32":
        overflowed = scans.infinite_scans
        scans = _validated(_in_precision(network, "float32"), source, group)
        if group.is_main:
            _warn_of_overflow(precision, overflowed, scans.infinite_scans)
    best = best_temperature(scans.logits, scans.truth) if len(scans.truth) else card.temperature
    lowest, highest = TEMPERATURES
    temperature = best if lowest <= best <= highest else 1.0
    card = with_temperature(card, temperature, scans.logits)
    result = scores(scans.confusion, card.space)
    row: Row = {
        "accuracy": result.accuracy,
        "miou": result.iou_mean_present,
        "temperature": card.temperature,
        **{f"iou_{score.name}": score.iou for score in result.classes},
    }
    return row, card


def _in_precision(network: Network, precision: str) -> Network:
    """Return a network that computes in a number type."""
    if network.backend.precision == precision:
        return network
    return replace(network, backend=replace(network.backend, precision=precision))


def _warn_of_overflow(precision: str, scans: int, scans_in_float32: int) -> None:
    """Warn of scans whose logits are not finite, and of those where float32 does not help."""
    text = f"logits of {counted(scans, 'scan')} are not finite in {precision}: validated in float32"
    hint = f"predict with {setting('precision', 'float32')}"
    if scans_in_float32:
        text += f", where those of {counted(scans_in_float32, 'scan')} are not finite either"
        hint = ""
    log.warning("%s", with_hint(text, hint))


def _validated(network: Network, source: Source, group: ProcessGroup) -> ValidatedScans:
    """Compare the labels of all scans with the truth, each scan in one worker of a group."""
    space = network.card.space
    confusion = np.zeros((space.class_count, space.class_count), np.int64)
    logits = [torch.empty(space.class_count, 0)]
    truth = [torch.empty(0, dtype=torch.int64)]
    infinite_scans = 0

    def gathered(parts: Sequence[torch.Tensor]) -> torch.Tensor:
        """Return the points of all workers, on the CPU."""
        points = torch.cat(list(parts), dim=-1).to(network.device)
        return torch.cat(group.gather(points), dim=-1).cpu()

    job = validation_job(network, source)
    files = source.files[group.rank :: group.size]
    for scan in network_pipeline(job, network).results(files):
        confusion += scan.confusion
        logits.append(scan.logits)
        truth.append(scan.truth)
        infinite_scans += not scan.is_finite
    counts = group.sum(torch.from_numpy(confusion).to(network.device))
    infinite = group.sum(torch.tensor(infinite_scans, device=network.device))
    return ValidatedScans(
        confusion=counts.cpu().numpy(),
        logits=gathered(logits).T.contiguous(),
        truth=gathered(truth),
        infinite_scans=int(infinite),
    )


def validation_job(network: Network, source: Source) -> ScanJob[Any, Any, ValidatedScan]:
    """Return the job of a scan of the validation: on a GPU of torch if the network is there."""
    if computes_on_gpu(network):
        return DeviceValidation(network=network, source=source)

    def read(file: ScanFile) -> ProjectedTruth:
        fitted = network.for_sensor(source.sensor_of(file))
        annotated = read_labelled(file, source.space, fitted.sensor)
        fitted = fitted.for_sensor(sensor_of(annotated.scan, fitted.sensor))
        image = project(annotated.scan, fitted.sensor)
        return ProjectedTruth(network=fitted, labels=annotated.labels, image=image)

    def logits_of(scans: Sequence[ProjectedTruth]) -> list[Float]:
        return network.backend.logits([s.network.input(s.image.channels) for s in scans])

    compare = partial(_compared, space=network.card.space, scans=len(source.files))
    return Steps(prepare=read, compute=logits_of, finish=compare)


def _compared(
    scan: ProjectedTruth, logits_of_pixels: Float, space: LabelSpace, scans: int
) -> ValidatedScan:
    """Compare the labels of a scan, one of a number of scans, with the truth."""
    labels = scan.labels
    image = scan.image
    refined = knn_refine(image, logits_of_pixels.argmax(axis=0), space.class_count)
    usable = np.flatnonzero(space.scored[labels] & (image.pixel_of_point >= 0))
    chosen = usable[:: sample_interval(len(usable), scans)]
    columns = logits_of_pixels.reshape(space.class_count, -1)
    logits_of_points = columns[:, image.pixel_of_point[chosen]]
    return ValidatedScan(
        confusion=confusion_matrix(labels, refined, space.class_count),
        logits=torch.from_numpy(logits_of_points),
        truth=torch.from_numpy(labels[chosen].astype(np.int64)),
        is_finite=bool(np.isfinite(logits_of_pixels).all()),
    )
