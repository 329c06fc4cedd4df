# SPDX-License-Identifier: MIT
"""Plain training loop, written as published ones are.

Everything happens in the loop, one thing after the other: reading, augmenting, projecting with
NumPy, a network in float32, a loss that goes from class to class, and the step's confusion matrix.
"""

from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor, nn

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.training.recipe import Recipe


def augment(
    points: np.ndarray, labels: np.ndarray, recipe: Recipe, random: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Drop, flip, turn and shift points (N, 4), each with its probability."""
    if random.random() < recipe.drop:
        count = int(len(points) * random.uniform(0, 0.5))
        dropped = random.choice(len(points), count, replace=False)
        points, labels = np.delete(points, dropped, axis=0), np.delete(labels, dropped)
    if random.random() < recipe.flip:
        points[:, 1] = -points[:, 1]
    if random.random() < recipe.rotate:
        angle = random.uniform(-np.pi, np.pi)
        cosine, sine = np.cos(angle), np.sin(angle)
        turn = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
        points[:, :3] = points[:, :3] @ turn.T
    if random.random() < recipe.shift:
        points[:, :3] += random.uniform((-5, -3, -1), (5, 3, 0))
    return points, labels


def project(
    points: np.ndarray, labels: np.ndarray, sensor: Sensor
) -> tuple[np.ndarray, np.ndarray]:
    """Project points (N, 4); return channels (5, H, W) and labels (H, W), 0 where it is empty."""
    up, down = np.radians(sensor.fov_up), np.radians(sensor.fov_down)
    depth = np.linalg.norm(points[:, :3], axis=1)
    yaw = np.arctan2(points[:, 1], points[:, 0])
    pitch = np.arcsin(points[:, 2] / depth)
    u = 0.5 * (1 - yaw / np.pi) * sensor.width
    v = (1 - (pitch - down) / (up - down)) * sensor.height
    u = np.clip(np.floor(u), 0, sensor.width - 1).astype(np.int32)
    v = np.clip(np.floor(v), 0, sensor.height - 1).astype(np.int32)
    # The nearest is written last, and stays.
    order = np.argsort(depth)[::-1]
    u, v = u[order], v[order]
    image = np.zeros((sensor.height, sensor.width, 5), np.float32)
    image[v, u] = np.column_stack((depth, points))[order]
    truth = np.zeros((sensor.height, sensor.width), np.int64)
    truth[v, u] = labels[order]
    return image.transpose(2, 0, 1), truth


def lovasz_softmax(probabilities: Tensor, truth: Tensor) -> Tensor:
    """Return Lovász-Softmax of (B, C, H, W) for (B, H, W), class after class, 0 left out."""
    flat = probabilities.permute(0, 2, 3, 1).reshape(-1, probabilities.shape[1])
    truth = truth.view(-1)
    flat, truth = flat[truth != 0], truth[truth != 0]
    losses: list[Tensor] = []
    for c in truth.unique():
        members = (truth == c).float()
        errors, order = torch.sort((members - flat[:, c]).abs(), descending=True)
        members = members[order]
        intersection = members.sum() - members.cumsum(0)
        union = members.sum() + (1 - members).cumsum(0)
        jaccard = 1 - intersection / union
        jaccard[1:] = jaccard[1:] - jaccard[:-1]
        losses.append(torch.dot(errors, jaccard))
    return torch.stack(losses).sum() / len(losses)


class PlainTraining:
    """Training loop of a network, step by step.

    Parameters
    ----------
    module : Module
        (B, 5, H, W) to logits (B, C, H, W).
    files : sequence of ScanFile
        To learn from, in float32 of four columns.
    space, sensor, recipe
        Label space, projection, and settings of augmentation and optimiser.
    weights : (C,) float32
        Of the classes.
    lap : callable
        Called with the name of each part of a step when it is over.
    """

    def __init__(
        self,
        module: nn.Module,
        files: Sequence[ScanFile],
        space: LabelSpace,
        sensor: Sensor,
        recipe: Recipe,
        weights: Tensor,
        lap: Callable[[str], object],
    ) -> None:
        self.module, self.files, self.sensor, self.recipe = module.train(), files, sensor, recipe
        self.space, self.lap = space, lap
        self.entropy = nn.NLLLoss(weight=weights)
        self.random = np.random.default_rng(recipe.seed)
        self.optimiser = torch.optim.SGD(
            module.parameters(),
            lr=recipe.learning_rate,
            momentum=recipe.momentum,
            weight_decay=recipe.weight_decay,
        )
        self.confusion = np.zeros((space.class_count, space.class_count), np.int64)
        self.losses: list[float] = []

    def sample(self, file: ScanFile) -> tuple[Tensor, Tensor]:
        """Read, augment, project, normalise and crop a scan."""
        points = np.fromfile(file.path, np.float32).reshape(-1, 4)
        raw = np.fromfile(file.label_path, np.uint32) & np.uint32(0xFFFF)
        labels = self.space.to_train(raw, source=file.label_path)
        points, labels = augment(points, labels, self.recipe, self.random)
        image, truth = project(points, labels, self.sensor)
        empty = image[0] == 0
        image = image - np.array(self.sensor.means, np.float32)[:, None, None]
        image = image / np.array(self.sensor.stds, np.float32)[:, None, None]
        image[:, empty] = 0
        if self.recipe.crop_width:
            start = self.random.integers(self.sensor.width)
            image = np.roll(image, -start, axis=2)[:, :, : self.recipe.crop_width]
            truth = np.roll(truth, -start, axis=1)[:, : self.recipe.crop_width]
        return torch.from_numpy(image.copy()), torch.from_numpy(truth.copy())

    def batch(self) -> tuple[Tensor, Tensor]:
        """Draw a batch of scans."""
        chosen = self.random.integers(len(self.files), size=self.recipe.batch)
        images, truths = zip(*(self.sample(self.files[i]) for i in chosen), strict=True)
        return torch.stack(images), torch.stack(truths)

    def loss(self, probabilities: Tensor, truth: Tensor) -> Tensor:
        """Return weighted cross-entropy plus Lovász-Softmax."""
        entropy = self.entropy(torch.log(probabilities.clamp(min=1e-8)), truth)
        return entropy + lovasz_softmax(probabilities, truth)

    def step(self) -> None:
        """Learn from one batch."""
        images, truth = self.batch()
        self.lap("data")
        probabilities = self.module(images).softmax(1)
        self.lap("forward")
        loss = self.loss(probabilities, truth)
        self.lap("loss")
        self.optimiser.zero_grad()
        loss.backward()
        self.lap("backward")
        self.optimiser.step()
        self.lap("update")
        predicted = probabilities.argmax(1).numpy()
        np.add.at(self.confusion, (predicted.ravel(), truth.numpy().ravel()), 1)
        self.losses.append(loss.item())
        self.lap("book-keeping")
