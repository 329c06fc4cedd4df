# SPDX-License-Identifier: MIT
"""Points to pixels and back: pure functions, the same bits on a CPU and in torch."""
