# SPDX-License-Identifier: MIT
"""Compilation of kernels for the CPU, their cache and threads."""
