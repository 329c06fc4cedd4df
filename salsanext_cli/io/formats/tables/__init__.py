# SPDX-License-Identifier: MIT
"""Tables of points as other programs write them: text, Feather and Parquet."""
