# SPDX-License-Identifier: MIT
"""Points to pixels and back: pure functions."""
