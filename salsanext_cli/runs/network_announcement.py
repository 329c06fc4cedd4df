# SPDX-License-Identifier: MIT
"""Announcement of the network of a run in the log."""

import logging
from typing import TYPE_CHECKING

from salsanext_cli.core.notices import NOTICE

if TYPE_CHECKING:
    from salsanext_cli.core.engines.network import Network

log = logging.getLogger(__name__)


def announce_network(network: "Network", weights: object) -> None:
    """Log weights, device, engine and precision, and parts fitted to other weights.

    Parameters
    ----------
    network : Network
        Network that will compute.
    weights : object
        Title or path of its weights.
    """
    merged = f", merged into the classes of {network.space.name}" if network.merging else ""
    backend = network.backend
    computing = f"on {backend.device} by {backend.library} in {backend.precision}"
    log.log(NOTICE, "%s %s%s", weights, computing, merged)
    inherited = network.card.inherited()
    if inherited:
        hint = ": run `salsanext tune error`" if inherited.startswith("error") else ""
        log.log(NOTICE, "%s; not fitted to these weights%s", inherited, hint)
    other_width = network.card.parts_of_default_width()
    if other_width:
        width = network.sensor.width
        log.log(NOTICE, "%s; not fitted to images of %d columns", other_width, width)
