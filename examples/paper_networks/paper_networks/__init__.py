# SPDX-License-Identifier: MIT
"""Networks of the ablations of the SalsaNext paper, and RangeNet53."""
