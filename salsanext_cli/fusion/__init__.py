# SPDX-License-Identifier: MIT
"""Several views of one place: poses of a drive, and votes of its scans for each other's labels."""
