# SPDX-License-Identifier: MIT
"""Words to stage calls."""
