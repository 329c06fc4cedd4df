# SPDX-License-Identifier: MIT
"""Files of one scan each: a reader, and an encoder where one is written, per format."""
