# SPDX-License-Identifier: MIT
"""Training and tuning of networks."""
