# SPDX-License-Identifier: MIT
"""Label spaces, their YAML, and merging of classes."""
