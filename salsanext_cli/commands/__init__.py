# SPDX-License-Identifier: MIT
"""Commands: stages, their options, and what they print."""
