# SPDX-License-Identifier: MIT
"""Evidence of the layout of values without a header, from the values alone."""
