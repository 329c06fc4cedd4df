# SPDX-License-Identifier: MIT
"""Output: messages, progress, summaries and help."""
