# SPDX-License-Identifier: MIT
"""One function over many scans: workers, chunks, shards, devices."""
