# SPDX-License-Identifier: MIT
"""What records of stages contain: settings, and digests of scans in files of their own."""
