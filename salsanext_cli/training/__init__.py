# SPDX-License-Identifier: MIT
"""What only `train` and `tune` need."""
