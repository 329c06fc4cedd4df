# SPDX-License-Identifier: MIT
"""Loss of a training: class-weighted cross-entropy plus Lovász-Softmax.

Both use only pixels whose true class is scored; a batch without such pixels has loss 0 and
gradient 0.
"""

import math

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from salsanext_cli.training.data.targets import ClassSets
from salsanext_cli.training.distributed import SINGLE_PROCESS, ProcessGroup
from salsanext_cli.training.transfer import to_device


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
    loss = F.nll_loss(log_probabilities, truth, weights, reduction="sum")
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
        Pixels of each class, at least one.

    Returns
    -------
    (K, P) float
    """
    order = errors.argsort(dim=1, descending=True)
    belongs = foreground.gather(1, order)
    hits = belongs.cumsum(1)
    size = hits[:, -1:]
    union = size + torch.arange(1, errors.shape[1] + 1, device=errors.device) - hits
    # The growth in closed form, since differences of losses close to 1 would cancel. A miss reduces
    # the intersection by one, a false alarm increases the union by one.
    shrinks = (size - hits).to(errors.dtype)
    union = union.to(errors.dtype)
    gradient = torch.where(belongs, 1, shrinks / (union - 1).clamp_min(1)) / union
    return torch.empty_like(gradient).scatter_(1, order, gradient)


def lovasz_softmax(
    probabilities: Tensor, truth: Tensor, group: ProcessGroup = SINGLE_PROCESS
) -> Tensor:
    """Return a worker's share of the Lovász-Softmax loss, a mean over the classes of the truth.

    Parameters
    ----------
    probabilities : (P, C) float
        Softmax of the pixels of the worker.
    truth : (P,) int64
        True classes, on the CPU.
    group : ProcessGroup
        The workers.

    Returns
    -------
    0-d Tensor
    """
    counts = truth.bincount(minlength=probabilities.shape[1])
    if group.size > 1:
        counts = group.sum(counts.to(probabilities.device)).cpu()
    present = counts.nonzero()[:, 0]
    if not len(present):
        return probabilities.sum()
    present = to_device(present, probabilities.device)
    foreground = to_device(truth, probabilities.device) == present[:, None]
    predicted = probabilities.t()[present]
    errors = torch.where(foreground, 1 - predicted, predicted)
    # The pixels of all workers are sorted together.
    gathered_errors = group.gather(errors.detach())
    gathered_foreground = torch.cat(group.gather(foreground.byte()), 1).bool()
    gradients = jaccard_gradient(torch.cat(gathered_errors, 1), gathered_foreground)
    pixels_of_workers = [errors_of_worker.shape[1] for errors_of_worker in gathered_errors]
    gradients_of_workers = torch.split(gradients, pixels_of_workers, 1)
    own_gradients = gradients_of_workers[group.rank]
    return (errors * own_gradients).sum() / len(present)


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

    weights: Tensor

    def __init__(self, weights: Tensor, lovasz: float = 1.0, sets: ClassSets = ()) -> None:
        super().__init__()
        positive = weights.masked_fill(weights <= 0, math.inf)
        smallest = [positive[list(classes)].min().nan_to_num(posinf=0.0) for classes in sets]
        weights_of_sets = [weight[None] for weight in smallest]
        self.register_buffer("weights", torch.cat([weights, *weights_of_sets]))
        self.is_scored = self.weights > 0  # (T,) bool; stays on the CPU
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
    ) -> Tensor:
        """Return the loss of a batch, or the share of a part of it.

        Parameters
        ----------
        logits : (B, C, H, W) float
            Logits of the network.
        truth : (B, H, W) integers
            Targets, on the CPU: it chooses the scored pixels, since reading them from a GPU would
            wait.
        total_weight : 0-d Tensor, optional
            Weight of the pixels of all parts, by which the cross-entropy of a part is divided.
        parts : int
            Number of parts of the batch, by which Lovász-Softmax is divided.
        group : ProcessGroup
            The workers.

        Returns
        -------
        0-d Tensor
        """
        truth = truth.flatten().long()
        scored = self.is_scored[truth].nonzero()[:, 0]
        truth = truth[scored]
        device = logits.device
        pixels = logits.movedim(1, -1).reshape(-1, logits.shape[1])[to_device(scored, device)]
        precise = torch.promote_types(logits.dtype, torch.float32)
        log_probabilities = F.log_softmax(pixels, 1, dtype=precise)
        sets = [to_device(torch.tensor(classes), device) for classes in self.sets]
        sums = [log_probabilities[:, classes].logsumexp(1, keepdim=True) for classes in sets]
        columns = torch.cat([log_probabilities, *sums], 1) if sums else log_probabilities
        weights = self.weights.to(precise)
        loss = weighted_cross_entropy(columns, to_device(truth, device), weights, total_weight)
        if self.lovasz:
            if sums:
                is_of_class = (truth < self.class_count).nonzero()[:, 0]
                log_probabilities = log_probabilities[to_device(is_of_class, device)]
                truth = truth[is_of_class]
            lovasz = lovasz_softmax(log_probabilities.exp(), truth, group)
            loss = loss + self.lovasz / parts * lovasz
        return loss
