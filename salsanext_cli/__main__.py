# SPDX-License-Identifier: MIT
"""What ``python -m salsanext_cli`` runs: the command line, as ``salsanext`` does."""

from salsanext_cli.cli.app import main

if __name__ == "__main__":
    main()
