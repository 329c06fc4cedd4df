# SPDX-License-Identifier: MIT
"""Weights on a device: range images in, logits out."""
