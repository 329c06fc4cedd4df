# SPDX-License-Identifier: MIT
"""Networks on a device: range images in, logits out."""
