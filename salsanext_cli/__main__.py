# SPDX-License-Identifier: MIT
"""Entry point of ``python -m salsanext_cli``: the command line, as ``salsanext`` runs it."""

from salsanext_cli.cli.app import main

if __name__ == "__main__":
    main()
