# SPDX-License-Identifier: MIT
"""Networks that map range images to logits, and the card that describes their weights."""
