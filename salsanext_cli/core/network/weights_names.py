# SPDX-License-Identifier: MIT
"""Names of weights: what stands for a file, and what a wrong name probably means."""

DEFAULT_NAME = "default"  # Weights of the package; a file of that name needs an absolute path
PAPER_NETWORKS = ("rangenet53", "salsanet", "salsanext-v1")
"""First letters of the networks in `examples/paper_networks`, which earlier versions had."""
PAPER_NETWORKS_HINT = (
    "run `pip install examples/paper_networks` in a clone, and train its networks: "
    "`salsanext train DATASET RUN --set architecture=NAME`"
)
