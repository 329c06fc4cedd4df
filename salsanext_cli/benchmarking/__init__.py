# SPDX-License-Identifier: MIT
"""What `salsanext benchmark` measures, and how."""
