# SPDX-License-Identifier: MIT
"""Files on disk: reading, atomic writing, locks, records and plug-ins."""
