# SPDX-License-Identifier: MIT
"""Networks that map range images to logits, their weights files and their costs."""
