# SPDX-License-Identifier: MIT
"""Files of scans, labels, poses and weights: arrays from files, and files from arrays."""
