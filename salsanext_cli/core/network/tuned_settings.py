# SPDX-License-Identifier: MIT
"""Keys of the settings that a threshold of risk depends on, as weights files contain them."""

KEY_OF = {
    "min_range": "--min-range",
    "ego": "--ego",
    "intensity": "--intensity",
    "precision": "--precision",
    "width": "--width",
    "sensor": "--sensor",
}
"""Key in a weights file, by argument.

The first version wrote the options of the command line, and every later one reads its files.
"""
