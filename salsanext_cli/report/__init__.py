# SPDX-License-Identifier: MIT
"""Numbers to tables, pictures and pages."""
