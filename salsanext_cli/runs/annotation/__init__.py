# SPDX-License-Identifier: MIT
"""Scans picked to be labelled, and labels taken back."""
