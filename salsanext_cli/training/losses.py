# SPDX-License-Identifier: MIT
"""Loss of a training: class-weighted cross-entropy plus Lovász-Softmax.

Both use only pixels whose true class is scored; a batch without such pixels has loss 0 and
gradient 0.
"""

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from salsanext_cli.core.engines.device_copies import device_numbers
from salsanext_cli.training.data.targets import ClassSets
from salsanext_cli.training.distributed import SINGLE_PROCESS, ProcessGroup


def weighted_cross_entropy(
    log_probabilities: Tensor, truth: Tensor, weights: Tensor, total_weight: Tensor | None = None
) -> Tensor:
    """Return the mean of -log p(truth), weighted by the true class of each pixel.

    Parameters
    ----------
    log_probabilities : (P, T) float
        Of P pixels and T targets.
    truth : (P,) int64
        True target of each pixel.
    weights : (T,) float
        Weights of the targets.
    total_weight : 0-d Tensor, optional
        Weight to divide by if the pixels are a part of a batch: that of the whole batch.

    Returns
    -------
    0-d Tensor
    """
    # torch adds up the losses of all pixels in a single block of a GPU.
    loss = F.nll_loss(log_probabilities, truth, weights, reduction="none").sum()
    total = weights[truth].sum() if total_weight is None else total_weight
    return loss / total.clamp_min(torch.finfo(total.dtype).tiny)


@torch.no_grad()
def jaccard_gradient(errors: Tensor, foreground: Tensor) -> Tensor:
    """Return the gradient of the Lovász extension of the Jaccard loss by pixel.

    With pixels sorted by falling error, the weight of pixel i is the growth of the Jaccard loss
    when it joins the mispredicted set {1 … i-1} (Berman et al. 2018, eq. 9 and algorithm 1).

    Parameters
    ----------
    errors : (K, P) float
        Error of each pixel for K classes.
    foreground : (K, P) bool
        Pixels of each class.

    Returns
    -------
    (K, P) float
        0 for a class without pixels.
    """
    order = errors.argsort(dim=1, descending=True)
    belongs = foreground.gather(1, order)
    hits = belongs.cumsum(1, dtype=torch.int32)
    size = hits[:, -1:]
    rank = torch.arange(1, errors.shape[1] + 1, dtype=torch.int32, device=errors.device)
    union = size + rank - hits
    # The growth in closed form, since differences of losses close to 1 would cancel. A miss reduces
    # the intersection by one, a false alarm increases the union by one.
    shrinks = (size - hits).to(errors.dtype)
    union = union.to(errors.dtype)
    gradient = torch.where(belongs, 1, shrinks / (union - 1).clamp_min(1)) / union
    return torch.empty_like(gradient).scatter_(1, order, gradient)


def lovasz_softmax(
    probabilities: Tensor,
    truth: Tensor,
    group: ProcessGroup = SINGLE_PROCESS,
    pixels_of_workers: Sequence[int] | None = None,
) -> Tensor:
    """Return a worker's share of the Lovász-Softmax loss, a mean over the classes of the truth.

    Parameters
    ----------
    probabilities : (P, C) float
        Softmax of the pixels of the worker.
    truth : (P,) int64
        True classes; pixels of C and above do not count.
    group : ProcessGroup
        The workers.
    pixels_of_workers : sequence of int, optional
        P of each worker; by default they exchange it, and each waits for its device.

    Returns
    -------
    0-d Tensor
    """
    classes = sorted_classes(truth, probabilities.shape[1], group)
    is_counted = truth < probabilities.shape[1]
    foreground = truth == classes[:, None]
    columns = probabilities.t()
    # On a GPU a selection adds its gradient with atomic operations.
    is_all = len(classes) == len(columns)
    predicted = columns.contiguous() if is_all else columns.index_select(0, classes)
    errors = torch.where(foreground, 1 - predicted, predicted).masked_fill(~is_counted, 0)
    # Pixels that do not count come last, where their order and their ranks change nothing.
    keys = errors.detach().masked_fill(~is_counted, -1)
    # The pixels of all workers are sorted together.
    keys_of_workers = group.gather(keys, pixels_of_workers)
    foregrounds = group.gather(foreground.byte(), pixels_of_workers)
    gathered_foreground = torch.cat(foregrounds, 1).bool()
    gradients = jaccard_gradient(torch.cat(keys_of_workers, 1), gathered_foreground)
    pixel_counts = [keys_of_worker.shape[1] for keys_of_worker in keys_of_workers]
    gradients_of_workers = torch.split(gradients, pixel_counts, 1)
    present_count = gathered_foreground.any(1).sum()
    return (errors * gradients_of_workers[group.rank]).sum() / present_count.clamp_min(1)


def sorted_classes(truth: Tensor, class_count: int, group: ProcessGroup) -> Tensor:
    """Return the classes whose pixels are sorted: those of the truth of all workers.

    On a GPU they are all classes, since the host would wait for the truth.
    """
    if truth.device.type != "cpu":
        return torch.arange(class_count, device=truth.device)
    counts = truth.bincount(minlength=class_count)[:class_count]
    return group.sum(counts).nonzero()[:, 0]


class SegmentationLoss(nn.Module):
    """Weighted cross-entropy plus Lovász-Softmax on logits (paper eq. 3).

    A target is a class, or a set of classes: target C + k is the k-th set. Its probability is the
    sum over the set, and its weight is the least positive one of the set. Lovász-Softmax ignores
    such targets.

    Parameters
    ----------
    weights : (C,) float
        Weights of the classes; both terms ignore classes with weight 0.
    lovasz : float
        Factor of Lovász-Softmax.
    sets : tuple of tuple of int
        Classes of each set.
    """

    weights: Tensor  # (T,) float
    is_scored: Tensor  # (T,) bool

    def __init__(self, weights: Tensor, lovasz: float = 1.0, sets: ClassSets = ()) -> None:
        super().__init__()
        positive = weights.masked_fill(weights <= 0, math.inf)
        smallest = [positive[list(classes)].min().nan_to_num(posinf=0.0) for classes in sets]
        weights_of_sets = [weight[None] for weight in smallest]
        self.register_buffer("weights", torch.cat([weights, *weights_of_sets]))
        self.register_buffer("is_scored", self.weights > 0)
        self.class_count = len(weights)
        self.lovasz = lovasz
        self.sets = sets

    def forward(
        self,
        logits: Tensor,
        truth: Tensor,
        total_weight: Tensor | None = None,
        parts: int = 1,
        group: ProcessGroup = SINGLE_PROCESS,
        images_of_workers: Sequence[int] | None = None,
    ) -> Tensor:
        """Return the loss of a batch, or the share of a part of it.

        Parameters
        ----------
        logits : (B, C, H, W) float
            Logits of the network.
        truth : (B, H, W) integers
            Targets, on the device of the logits.
        total_weight : 0-d Tensor, optional
            Weight of the pixels of all parts, by which the cross-entropy of a part is divided.
        parts : int
            Number of parts of the batch, by which Lovász-Softmax is divided.
        group : ProcessGroup
            The workers.
        images_of_workers : sequence of int, optional
            B of each worker; by default they exchange the numbers of their pixels.

        Returns
        -------
        0-d Tensor
        """
        targets = truth.flatten().long()
        pixels = logits.movedim(1, -1).reshape(-1, logits.shape[1])
        if logits.device.type == "cpu":
            # Fewer pixels to sort. The host of a GPU would wait for their number.
            scored = self.is_scored[targets].nonzero()[:, 0]
            return self.pixel_loss(pixels[scored], targets[scored], total_weight, parts, group)
        pixels_of_workers = None
        if images_of_workers is not None:
            pixels_of_image = logits.shape[2] * logits.shape[3]
            pixels_of_workers = [count * pixels_of_image for count in images_of_workers]
        return self.pixel_loss(pixels, targets, total_weight, parts, group, pixels_of_workers)

    def pixel_loss(
        self,
        pixels: Tensor,
        targets: Tensor,
        total_weight: Tensor | None = None,
        parts: int = 1,
        group: ProcessGroup = SINGLE_PROCESS,
        pixels_of_workers: Sequence[int] | None = None,
    ) -> Tensor:
        """Return the loss of the logits of pixels, (P, C) float, with targets (P,) int64.

        Pixels that are not scored change nothing. The other parameters are as in `forward`, and P
        of each worker.
        """
        precise = torch.promote_types(pixels.dtype, torch.float32)
        log_probabilities = F.log_softmax(pixels, 1, dtype=precise)
        columns = self._of_targets(log_probabilities)
        loss = weighted_cross_entropy(columns, targets, self.weights.to(precise), total_weight)
        if not self.lovasz:
            return loss
        # The classes that are not scored do not count either, as targets of sets.
        classes = targets.masked_fill(~self.is_scored[targets], self.class_count)
        lovasz = lovasz_softmax(log_probabilities.exp(), classes, group, pixels_of_workers)
        return loss + self.lovasz / parts * lovasz

    def _of_targets(self, log_probabilities: Tensor) -> Tensor:
        """Return the logarithms of the probabilities (P, T) of targets from those of classes."""
        device = log_probabilities.device
        sets = [device_numbers(classes, device, torch.int64) for classes in self.sets]
        sums = [
            log_probabilities.index_select(1, classes).logsumexp(1, keepdim=True)
            for classes in sets
        ]
        return torch.cat([log_probabilities, *sums], 1) if sums else log_probabilities
