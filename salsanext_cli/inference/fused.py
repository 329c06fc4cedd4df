# SPDX-License-Identifier: MIT
"""The same network for one purpose, predicting on a CPU in float32: each unit is one step.

3×3 kernels, and 2×2 ones of dilation 2, which are 3×3 ones with zeros between them, are computed by
`winograd`.
"""

from __future__ import annotations

import copy

import numpy as np
import torch
from torch import Tensor, nn

from salsanext_cli.inference.lanes import LANES
from salsanext_cli.inference.steps import (
    Convolution1x1,
    Convolution3x3,
    Epilogue,
    OneThread,
    Stack,
)
from salsanext_cli.network.blocks import DilatedStack
from salsanext_cli.network.segmentation import SegmentationNetwork


def fuse(module: SegmentationNetwork) -> SegmentationNetwork:
    """Return a network that computes the same as `module` does in evaluation mode, faster.

    It is for inference on a CPU in float32. Weights are copied where they are changed and shared
    elsewhere. Layers that are no units stay as they are.
    """
    shared = {id(tensor): tensor for tensor in module.state_dict(keep_vars=True).values()}
    fused = copy.deepcopy(module, shared)
    _fuse_children(fused)
    fused.manages_threads = True
    return fused.eval()


@torch.no_grad()
def _fuse_children(parent: nn.Module) -> None:
    for name, child in parent.named_children():
        unit = _unit(list(child) if isinstance(child, nn.Sequential) else [child])
        if unit is not None:
            setattr(parent, name, unit)
        elif isinstance(child, nn.Conv2d | nn.ConvTranspose2d):
            setattr(parent, name, OneThread(child))
        else:
            _fuse_children(child)
            if isinstance(child, DilatedStack) and (stack := _stack(child)):
                setattr(parent, name, stack)


def _stack(fused: DilatedStack) -> Stack | None:
    """Return a stack as one step, None unless all of its units are."""
    match [*fused.children()]:
        case [Convolution3x3() as a, Convolution3x3() as b, Convolution3x3() as c, last]:
            return Stack(a, b, c, last) if isinstance(last, Convolution1x1) else None
    return None


def _unit(layers: list[nn.Module]) -> nn.Module | None:
    """Return layers as one step, None if they are not of a kind that can be."""
    if not layers:
        return None
    convolution, *others = layers
    if not isinstance(convolution, nn.Conv2d) or not _keeps_size(convolution):
        return None
    kernels = convolution.weight.double()
    bias = (
        kernels.new_zeros(len(kernels)) if convolution.bias is None else convolution.bias.double()
    )
    scale, shift, slope = torch.ones_like(bias), torch.zeros_like(bias), 1.0
    match others:
        case []:
            pass
        case [nn.LeakyReLU() as bend]:
            slope = bend.negative_slope
        case [nn.LeakyReLU() as bend, nn.BatchNorm2d() as norm]:
            slope, (scale, shift) = bend.negative_slope, _affine(norm)
        case [nn.BatchNorm2d() as norm, nn.LeakyReLU() as bend]:
            factor, term = _affine(norm)
            kernels, bias = kernels * factor[:, None, None, None], bias * factor + term
            slope = bend.negative_slope
        case _:
            return None
    bias_, scale_, shift_ = (t.float().numpy() for t in (bias, scale, shift))
    ending = Epilogue(bias_, scale_, shift_, np.float32(slope))
    return _step(convolution, kernels, ending)


def _step(layer: nn.Conv2d, kernels: Tensor, ending: Epilogue) -> nn.Module | None:
    outputs, inputs, *size = kernels.shape
    if size == [1, 1]:
        fits = outputs % LANES == 0 or ending.is_bias
        return Convolution1x1(kernels.float(), ending) if fits else None
    if inputs % LANES or outputs % LANES:
        return None
    if size == [2, 2]:
        spread = kernels.new_zeros(outputs, inputs, 3, 3)
        spread[:, :, ::2, ::2] = kernels
        return Convolution3x3(spread, 1, ending)
    return Convolution3x3(kernels, layer.dilation[0], ending)


def _keeps_size(layer: nn.Conv2d) -> bool:
    """Say whether a convolution is one of SalsaNext's kinds."""
    geometry = layer.kernel_size, layer.dilation, layer.padding
    return (
        geometry in (((1, 1), (1, 1), (0, 0)), ((2, 2), (2, 2), (1, 1)))
        or (geometry[0] == (3, 3) and layer.dilation == layer.padding in ((1, 1), (2, 2)))
    ) and (layer.stride, layer.groups, layer.padding_mode) == ((1, 1), 1, "zeros")


def _affine(norm: nn.BatchNorm2d) -> tuple[Tensor, Tensor]:
    """Return factor and term of a batch norm in evaluation mode, float64."""
    mean, variance = norm.running_mean, norm.running_var
    assert mean is not None
    assert variance is not None
    factor = norm.weight.double() / (variance.double() + norm.eps).sqrt()
    return factor, norm.bias.double() - mean.double() * factor
