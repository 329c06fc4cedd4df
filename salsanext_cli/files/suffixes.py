# SPDX-License-Identifier: MIT
"""Suffixes of scans and recordings, upper or lower case."""

CLOUD_SUFFIXES = (
    *(".pcd.bin.gz", ".bin.gz", ".pcd.bin", ".bin", ".pcd", ".ply", ".las", ".laz", ".xyz"),
)
"""Suffixes of files that are scans wherever they lie; longer ones first: they decide the stem."""
TABLE_SUFFIXES = (".npy", ".npz", ".feather", ".csv", ".txt", ".asc", ".pts")
"""Suffixes of files that often are something else, in the order in which a folder is searched."""
SCAN_SUFFIXES = (*CLOUD_SUFFIXES, *TABLE_SUFFIXES)
BAG_SUFFIXES = (".bag", ".mcap", ".db3")
RECORDING_SUFFIXES = (*BAG_SUFFIXES, ".pcap", ".osf")
"""Suffixes of recordings that are files."""
