# SPDX-License-Identifier: MIT
"""Points to pixels and back: pure functions, compiled for the CPU and on torch devices."""
