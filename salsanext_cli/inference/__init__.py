# SPDX-License-Identifier: MIT
"""A network ready to use: engines, precision, batches."""
