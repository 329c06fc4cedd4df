# SPDX-License-Identifier: MIT
"""Values of options, from the text that was typed."""
