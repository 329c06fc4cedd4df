# SPDX-License-Identifier: MIT
"""Ground plan of a street, and what is placed on it."""
