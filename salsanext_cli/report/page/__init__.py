# SPDX-License-Identifier: MIT
"""Page of a run: one HTML file that fetches nothing."""
