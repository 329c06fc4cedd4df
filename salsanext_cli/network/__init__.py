# SPDX-License-Identifier: MIT
"""Networks that map range images to logits, and their weights files."""
