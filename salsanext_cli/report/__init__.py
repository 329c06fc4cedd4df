# SPDX-License-Identifier: MIT
"""Numbers to pictures."""
