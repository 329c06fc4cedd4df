# SPDX-License-Identifier: MIT
"""Labels that people made with other programs, and the records of them in a data set."""
