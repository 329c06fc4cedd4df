# SPDX-License-Identifier: MIT
"""Only what `train` needs."""
