# SPDX-License-Identifier: MIT
"""Files of surveys, LAS, LAZ and E57, and the local frame of their map coordinates."""
