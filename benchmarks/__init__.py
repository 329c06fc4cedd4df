# SPDX-License-Identifier: MIT
"""Scripts that measure, and those that build the default weights; README.md lists them."""
