# SPDX-License-Identifier: MIT
"""Labelling tools: what each gets from a data set, and what it gives back."""
