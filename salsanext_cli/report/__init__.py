# SPDX-License-Identifier: MIT
"""Tables and pictures of results."""
