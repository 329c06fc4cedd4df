# SPDX-License-Identifier: MIT
"""Output folders: their owner while they are filled, their reader afterwards."""
