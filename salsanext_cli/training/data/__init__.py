# SPDX-License-Identifier: MIT
"""Data to train on: labelled scans of one or several data sets, what is drawn from them and how."""
