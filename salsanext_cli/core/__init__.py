# SPDX-License-Identifier: MIT
"""Arrays in, arrays out: nothing here knows a file of results or a command line."""
