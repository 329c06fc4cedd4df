# SPDX-License-Identifier: MIT
"""What stages do with one scan."""
