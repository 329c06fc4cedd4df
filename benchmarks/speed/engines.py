# SPDX-License-Identifier: MIT
"""Speed and labels of the network by every engine that is installed, on this CPU, for one scan.

Eager torch in float32 and NCHW is compared with torch with channels last, ONNX Runtime (needs onnx
and onnxruntime) and OpenVINO as the toolkit uses it, each on all cores. The engines take turns in
every round; a turn is the fastest of three calls after one that is not timed. The script prints the
median time, the median, lowest and highest ratio of a round to eager, and the share of pixels with
a point that have the label of eager.

Run: python -m benchmarks.speed.engines 000000.bin [--rounds 5 --sensors hdl64-512 hdl64]
"""

import argparse
import io
import statistics
import warnings
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from typing import cast

import numpy as np
import torch

import salsanext_cli as sn
from benchmarks.speed.speed_hardware import seconds_of
from salsanext_cli.core.compiled import thread_count
from salsanext_cli.core.engines.device import bfloat16_instructions
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.engines.openvino_backend import OpenVinoBackend
from salsanext_cli.core.engines.torch_backend import TorchBackend

KINDS = ("float32", "bfloat16") if bfloat16_instructions() else ("float32",)
Engine = Callable[[np.ndarray], np.ndarray]
"""Takes a normalised range image (1, 5, H, W), returns logits (1, C, H, W)."""


def by_torch(module: torch.nn.Module, layout: torch.memory_format) -> Engine:
    module.to(memory_format=layout)  # type: ignore[call-overload]

    def run(image: np.ndarray) -> np.ndarray:
        with torch.inference_mode():
            return module(torch.from_numpy(image).to(memory_format=layout)).numpy()

    return run


def by_onnx_runtime(module: torch.nn.Module, image: np.ndarray) -> Engine:
    import onnxruntime

    file, settings = io.BytesIO(), onnxruntime.SessionOptions()
    settings.intra_op_num_threads = thread_count()
    inputs = (torch.from_numpy(image),)
    with warnings.catch_warnings(action="ignore"):
        torch.onnx.export(
            module,
            inputs,
            file,  # type: ignore[arg-type]
            opset_version=17,
            input_names=["x"],
            dynamo=False,
        )
    session = onnxruntime.InferenceSession(file.getvalue(), settings, ["CPUExecutionProvider"])
    return lambda image: session.run(None, {"x": image})[0]


def by_openvino(network: Network) -> Engine:
    graph = cast(OpenVinoBackend, network.backend).output_graph(None)
    return lambda image: graph(image)[0]


def engines(load: Callable[[str, str], Network], image: np.ndarray) -> dict[str, Engine]:
    """Return the engines by name, the eager one first."""
    plain = load("torch", "float32").module
    found = {"eager float32": by_torch(plain, torch.contiguous_format)}
    for kind in KINDS:
        module = cast(TorchBackend, load("torch", kind).backend).torch_module
        found[f"channels last {kind}"] = by_torch(module, torch.channels_last)
    if find_spec("onnx") and find_spec("onnxruntime"):
        found["ONNX Runtime float32"] = by_onnx_runtime(plain, image)
    for kind in KINDS:
        found[f"OpenVINO {kind}"] = by_openvino(load("openvino", kind))
    return found


def compare(scan: sn.Scan, sensor: sn.Sensor, weights: str | None, rounds: int) -> None:
    def load(engine: str, kind: str) -> Network:
        return sn.load_network(weights, "cpu", sensor, kind, engine)

    projected = sn.project(scan, sensor)
    image = load("torch", "float32").input(projected.channels)
    found = engines(load, image)
    times: dict[str, list[float]] = {name: [] for name in found}
    for _ in range(rounds):
        for name, run in found.items():
            times[name].append(min(seconds_of(partial(run, image))))
    seen, eager = projected.point_of_pixel >= 0, next(iter(found))
    labels = {name: run(image)[0].argmax(axis=0)[seen] for name, run in found.items()}
    print(f"{sensor.height}×{sensor.width}, {thread_count()} threads")
    for name, measured in times.items():
        ratios = [plain / own for plain, own in zip(times[eager], measured, strict=True)]
        ratio = f"{statistics.median(ratios):5.2f} × ({min(ratios):.2f} to {max(ratios):.2f})"
        same = (labels[name] == labels[eager]).mean()
        print(f"{name:42}{statistics.median(measured):8.4f} s {ratio}  {same:.2%}")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("scan")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--weights", help="the default ones if not given")
    parser.add_argument("--sensors", nargs="+", default=["hdl64-512", "hdl64"])
    options = parser.parse_args()
    torch.set_num_threads(thread_count())
    for sensor in map(sn.sensor, options.sensors):
        compare(sn.read_scan(options.scan, sensor), sensor, options.weights, options.rounds)


if __name__ == "__main__":
    main()
