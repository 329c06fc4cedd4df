# SPDX-License-Identifier: MIT
"""The way of a scan on a device: batches of scans in torch, with the CPU kernels as the oracle."""
