# SPDX-License-Identifier: MIT
"""Epistemic and aleatoric uncertainty of a prediction."""
