# SPDX-License-Identifier: MIT
"""Label spaces and merging of classes."""
