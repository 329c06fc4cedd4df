# SPDX-License-Identifier: MIT
"""Command line as ``python -m salsanext_cli``, the same as ``salsanext``."""

from salsanext_cli.cli.app import main

if __name__ == "__main__":
    main()
