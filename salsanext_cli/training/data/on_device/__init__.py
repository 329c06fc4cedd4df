# SPDX-License-Identifier: MIT
"""Samples made on the device of a training, a whole batch at a time."""
