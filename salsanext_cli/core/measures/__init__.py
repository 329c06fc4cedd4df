# SPDX-License-Identifier: MIT
"""Labels and probabilities to numbers: count first, divide once."""
