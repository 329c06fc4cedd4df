# SPDX-License-Identifier: MIT
"""Stage `export-onnx`: weights as an ONNX model with their card, in float32 or int8."""

import logging
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from salsanext_cli.engines.device import openvino_core
from salsanext_cli.engines.graphs import Graph
from salsanext_cli.engines.loading import network_of_module, read_onnx
from salsanext_cli.engines.network import Network
from salsanext_cli.engines.onnx_export import OPSET, difference, exported, quantised
from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.errors import UsageError, counted
from salsanext_cli.files.atomic import require_target, write_bytes
from salsanext_cli.files.optional_packages import import_extra, import_nncf
from salsanext_cli.fitting.label_scan import prepared_for
from salsanext_cli.fitting.sensor_fit import ScanSample, fit_scans
from salsanext_cli.network.card import ONNX_SUFFIX, WeightsCard
from salsanext_cli.network.weights import read_weights
from salsanext_cli.option_fields import ScanSelection
from salsanext_cli.records import Float
from salsanext_cli.results.paths import ScanFile
from salsanext_cli.results.selection import select_scans
from salsanext_cli.sensors.sensor import Sensor

MIN_SCANS = 2  # Fewest for calibration: a single scan has the ranges of one place

log = logging.getLogger(__name__)


def export_onnx(
    weights: Path,
    target: Path,
    *,
    view: Sensor | None = None,
    dynamic_width: bool = False,
    calibrate: Path | None = None,
    selection: ScanSelection = ScanSelection(),
    overwrite: bool = False,
) -> dict[str, Any]:
    """Write weights as an ONNX model of normalised range images to logits; compare it with torch.

    `view`: sensor of the images, if not that of the weights, its intensity matched to theirs;
    `calibrate`: scans for int8, seen as `predict` sees them.
    """
    for package in ("onnx", "onnxruntime"):
        import_extra(package, "onnx")
    module, card = read_weights(weights)
    if view is not None:
        trained = card.sensor.intensity_quantiles
        card = replace(card, sensor=replace(view, intensity_quantiles=trained))
    scans: list[ScanFile] = []
    if calibrate is not None:
        import_nncf()
        scans = select_scans(calibrate, selection, card.space, evenly=True)
        if len(scans) < MIN_SCANS:
            raise UsageError("--calibrate", "a single scan", "some tens, of different places")
    require_target(target, overwrite, ONNX_SUFFIX)
    model = exported(module, card, dynamic_width=dynamic_width)
    content = model.SerializeToString()
    width = "any" if dynamic_width else card.sensor.width
    report = {
        "stage": "export-onnx",
        "opset": OPSET,
        "input": [1, 5, card.sensor.height, width],
        "output": [1, card.space.class_count, card.sensor.height, width],
        "difference": difference(content, module, card),
    }
    if scans:
        settings = NetworkSettings(weights, fit=view is None, intensity="auto")
        network = network_of_module(module, card, "cpu")
        network = fit_scans(settings, network, ScanSample(scans, card.sensor))
        content, share = _int8(model, network, scans)
        report |= {"scans": len(scans), "equal_labels": share}
    write_bytes(target, content, durable=True)
    return report | {"bytes": len(content)}


def _int8(model: Any, network: Network, scans: list[ScanFile]) -> tuple[bytes, float]:
    """Quantise a model; return it, and the share of labels that are those of float32."""
    from onnx import helper

    card, images = network.card, partial(_input, network=network)
    small = quantised(model, scans, images)
    done = f"Quantised to int8 on {counted(len(scans), 'scan')}."
    helper.set_model_props(small, card.changed(done).to_metadata())
    content = small.SerializeToString()
    graphs = [_graph(each, card) for each in (model.SerializeToString(), content)]
    equal = points = 0
    for file in scans:
        image = images(file)
        # A normalised pixel without a point is 0 in all channels.
        occupied = image[0].any(axis=0)
        full, short = (compute(image)[0][0].argmax(0) for compute in graphs)
        equal += int((full == short)[occupied].sum())
        points += int(occupied.sum())
        log.info("%s: done", file.name)
    return content, equal / max(points, 1)


def _input(file: ScanFile, network: Network) -> Float:
    """Return what the network sees of a scan, (1, 5, H, W)."""
    return prepared_for(network, file).input


def _graph(content: bytes, card: WeightsCard) -> Graph:
    size = (card.sensor.height, card.sensor.width)
    model = read_onnx(content, "the ONNX model", card, size)
    hints = {"INFERENCE_PRECISION_HINT": "f32"}
    return Graph(openvino_core().compile_model(model, "CPU", hints))
