# SPDX-License-Identifier: MIT
"""SalsaNext's whole method written plainly, as published implementations have it.

Points are sorted by range and written into the image, the farthest first. The network is eager,
in float32 and NCHW. Neighbours are unfolded, gathered and voted for with torch. Each Monte-Carlo
pass carries means and variances through the whole network. Counting adds one at a time. What
`speed.py` compares with is this file; it needs torch, numpy and safetensors only.

Run: python -m benchmarks.speed.baseline 000000.bin OUT.label [--weights FILE --device cuda]
"""

import argparse
import json
import tomllib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import safetensors
import safetensors.torch
import torch
import torch.nn.functional as F
from torch import Tensor

from benchmarks.processes import ROOT
from benchmarks.speed.baseline_network import (
    STRIDE,
    Moments,
    Numbers,
    SalsaNext,
    drop,
    softmax_moments,
)

DEFAULT_WEIGHTS = ROOT / "salsanext_cli/presets/weights/default.safetensors"
K, WINDOW, SIGMA, CUTOFF = 5, 5, 1.0, 1.0


def read_points(path: Path) -> np.ndarray:
    """Read points (N, 4): x, y, z, intensity."""
    return np.fromfile(path, np.float32).reshape(-1, 4)


def seen(points: np.ndarray, sensor: dict[str, Any]) -> np.ndarray:
    """Return which points (N, 4) measured something that the sensor keeps."""
    depth = np.linalg.norm(points[:, :3], axis=1)
    kept = np.isfinite(depth) & (depth > 0)
    if sensor["out_of_view"] == "drop":
        with np.errstate(invalid="ignore"):
            pitch = np.degrees(np.arcsin(points[:, 2] / depth))
        kept &= (pitch >= sensor["fov_down"]) & (pitch <= sensor["fov_up"])
    return kept


def project(points: np.ndarray, sensor: dict[str, Any]) -> tuple[np.ndarray, ...]:
    """Project points (N, 4) that are seen.

    Returns the image (5, H, W) of range, x, y, z, intensity, -1 where it is empty, and of each
    point its flat pixel (N,) and range (N,).
    """
    height, width = sensor["height"], sensor["width"]
    up, down = np.radians(sensor["fov_up"]), np.radians(sensor["fov_down"])
    depth = np.linalg.norm(points[:, :3], axis=1)
    yaw = np.arctan2(points[:, 1], points[:, 0])
    pitch = np.arcsin(points[:, 2] / depth)
    u = 0.5 * (1 - yaw / np.pi) * width
    v = (1 - (pitch - down) / (up - down)) * height
    u = np.clip(np.floor(u), 0, width - 1).astype(np.int32)
    v = np.clip(np.floor(v), 0, height - 1).astype(np.int32)
    # The nearest is written last, and stays.
    order = np.argsort(depth)[::-1]
    image = np.full((height, width, 5), -1, np.float32)
    image[v[order], u[order]] = np.column_stack((depth, points))[order]
    return image.transpose(2, 0, 1), v * width + u, depth


def as_input(image: np.ndarray, sensor: dict[str, Any], device: torch.device) -> Tensor:
    """Normalise an image (5, H, W) and pad it to (1, 5, H', W'): around, and empty below."""
    means = np.array(sensor["means"], np.float32)[:, None, None]
    stds = np.array(sensor["stds"], np.float32)[:, None, None]
    return padded((image - means) / stds * (image[0] > 0), device)


def input_variance(image: np.ndarray, sensor: dict[str, Any], device: torch.device) -> Tensor:
    """Return the variance of the input by the sensor's noise, along the ray and in intensity."""
    ray = np.concatenate((np.ones_like(image[:1]), image[1:4] / image[0])) * sensor["range_noise"]
    noise = np.concatenate((ray, np.full_like(image[:1], sensor["intensity_noise"])))
    stds = np.array(sensor["stds"], np.float32)[:, None, None]
    return padded(np.square(noise / stds) * (image[0] > 0), device)


def padded(image: np.ndarray, device: torch.device) -> Tensor:
    height, width = image.shape[1:]
    image = np.pad(image, ((0, 0), (0, 0), (0, -width % STRIDE)), mode="wrap")
    image = np.pad(image, ((0, 0), (0, -height % STRIDE), (0, 0)))
    return torch.from_numpy(np.ascontiguousarray(image, np.float32))[None].to(device)


def vote(
    ranges: np.ndarray,
    labels: np.ndarray,
    pixel: np.ndarray,
    depth: np.ndarray,
    classes: int,
    device: torch.device,
) -> np.ndarray:
    """Give points labels (N,) by their nearest neighbours in the image (RangeNet++).

    Unfolds the whole image of ranges and labels (H, W), gathers each point's window and lets the
    nearest vote; the padding counts as range 0, the image has an end, nobody's vote is class 1.
    """
    where, own = torch.from_numpy(pixel).long().to(device), torch.from_numpy(depth).to(device)
    images = torch.from_numpy(np.stack((ranges, labels.astype(np.float32)))).to(device)
    windows = F.unfold(images[:, None], WINDOW, padding=WINDOW // 2)[:, :, where]
    near, classes_near = windows[0], windows[1].long()
    near[near < 0] = torch.inf
    near[WINDOW**2 // 2] = own
    offset = torch.arange(WINDOW, device=device) - WINDOW // 2
    gaussian = torch.exp(-(offset[:, None] ** 2 + offset**2) / (2 * SIGMA**2))
    weights = 1 - gaussian / gaussian.sum()
    distance, nearest = ((near - own).abs() * weights.view(-1, 1)).topk(K, 0, largest=False)
    voters = classes_near.gather(0, nearest)
    voters[distance > CUTOFF] = classes
    votes = torch.zeros(classes + 1, len(own), device=device)
    votes.scatter_add_(0, voters, torch.ones_like(distance))
    return (votes[1:-1].argmax(0) + 1).to(torch.uint8).cpu().numpy()


def confusion(truth: np.ndarray, predicted: np.ndarray, classes: int) -> np.ndarray:
    """Count pairs of train ids (N,) into a matrix (classes, classes), truth × prediction."""
    matrix = np.zeros((classes, classes), np.int64)
    np.add.at(matrix, (truth, predicted), 1)
    return matrix


class Baseline:
    """Weights, and what to do with them.

    Parameters
    ----------
    weights : Path
        A weights file of salsanext.
    device : str
        As torch names it.
    sensor : dict, optional
        Another one than that of the weights, in the same form.
    """

    def __init__(
        self, weights: Path, device: str = "cpu", sensor: dict[str, Any] | None = None
    ) -> None:
        with safetensors.safe_open(weights, framework="pt") as file:
            card = json.loads(file.metadata()["salsanext"])
        self.device, self.sensor = torch.device(device), sensor or card["sensor"]
        torch.backends.cudnn.benchmark = True
        raw = card["label_space"]["learning_map_inv"]
        self.raw_ids = np.array([raw[str(c)] for c in range(len(raw))], np.uint32)
        self.classes, dropout = len(raw), card["architecture"]["dropout"]
        tensors = safetensors.torch.load_file(weights)
        self.network = SalsaNext(Numbers, self.classes, dropout)
        self.moments = SalsaNext(Moments, self.classes, dropout)
        for network in (self.network, self.moments):
            network.load_state_dict(tensors)
            network.eval().to(self.device)

    @torch.no_grad()
    def probabilities(self, image: np.ndarray) -> np.ndarray:
        """Return the softmax (C, H, W) of an image (5, H, W)."""
        softmax = self.network(as_input(image, self.sensor, self.device)).softmax(1)
        return self.cropped(softmax, image).cpu().numpy()

    @torch.no_grad()
    def aleatoric(self, image: np.ndarray) -> tuple[Tensor, Tensor]:
        """Return mean and variance (C, H, W) of the softmax by the sensor's noise."""
        mean = as_input(image, self.sensor, self.device)
        variance = input_variance(image, self.sensor, self.device)
        moments = softmax_moments(self.moments((mean, variance)))
        mean, variance = (self.cropped(part, image) for part in moments)
        return mean, variance

    def uncertainty(self, image: np.ndarray, passes: int = 30) -> tuple[np.ndarray, ...]:
        """Return prediction (C, H, W), epistemic and aleatoric uncertainty (H, W) of an image."""
        drop(self.moments)
        drawn = [self.aleatoric(image) for _ in range(passes)]
        self.moments.eval()
        means = torch.stack([mean for mean, _ in drawn])
        epistemic = means.var(0, correction=0).mean(0)
        aleatoric = torch.stack([variance for _, variance in drawn]).mean((0, 1))
        return tuple(part.cpu().numpy() for part in (means.mean(0), epistemic, aleatoric))

    def refine(
        self, image: np.ndarray, labels: np.ndarray, pixel: np.ndarray, depth: np.ndarray
    ) -> np.ndarray:
        """Return the labels (N,) of points from those of pixels (H, W)."""
        return vote(image[0], labels, pixel, depth, self.classes, self.device)

    def label(self, path: Path, out: Path) -> None:
        """Label the points of a scan: a `.bin` file to a `.label` file."""
        points = read_points(path)
        kept = seen(points, self.sensor)
        image, pixel, depth = project(points[kept], self.sensor)
        labels = np.zeros(len(points), np.uint8)
        found = self.probabilities(image).argmax(0)
        labels[kept] = self.refine(image, found, pixel, depth)
        self.raw_ids[labels].tofile(out)

    @staticmethod
    def cropped(result: Tensor, image: np.ndarray) -> Tensor:
        return result[0, :, : image.shape[1], : image.shape[2]]


def prepare(part: str, path: Path, task: Mapping[str, Any]) -> Callable[[], Any]:
    """Compute the input of a part for one scan, and return the function that is timed."""
    method = Baseline(Path(task["weights"]), task["device"], task["sensor"])
    points = read_points(path)
    points = points[seen(points, method.sensor)]
    image, pixel, depth = project(points, method.sensor)
    work = {
        "projection": lambda: project(points, method.sensor),
        "network": lambda: method.probabilities(image),
        "predict": lambda: method.label(path, path.with_suffix(".label")),
        "uncertainty": lambda: method.uncertainty(image, task["passes"]),
    }
    if part in work:
        return work[part]
    pixel_labels = method.probabilities(image).argmax(0).astype(np.uint8)
    if part == "knn":
        return lambda: method.refine(image, pixel_labels, pixel, depth)
    labels = method.refine(image, pixel_labels, pixel, depth)
    return lambda: confusion(labels, pixel_labels.ravel()[pixel], method.classes)


def main(words: Sequence[str] | None = None) -> None:
    """Label a scan by the words of a command line, by default those of this process."""
    parser = argparse.ArgumentParser(description="Label a scan, plainly.")
    parser.add_argument("scan", type=Path, help="of float32 x, y, z, intensity")
    parser.add_argument("out", type=Path, help="uint32 raw ids, one per point")
    parser.add_argument("--weights", type=Path, help="a weights file of salsanext")
    parser.add_argument("--sensor", type=Path, help="another sensor, all keys, .toml")
    parser.add_argument("--device", default="cpu")
    options = parser.parse_args(words)
    sensor = tomllib.loads(options.sensor.read_text("utf-8")) if options.sensor else None
    baseline = Baseline(options.weights or DEFAULT_WEIGHTS, options.device, sensor)
    baseline.label(options.scan, options.out)


if __name__ == "__main__":
    main()
