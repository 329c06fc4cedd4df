# SPDX-License-Identifier: MIT
"""A server that answers while a test asks."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import HTTPServer

POLL_S = 0.01  # Time after which a server sees that the test has ended


@contextmanager
def served(server: HTTPServer) -> Iterator[None]:
    """Answer requests in a thread until the body ends, however it does."""
    thread = threading.Thread(target=server.serve_forever, args=(POLL_S,), daemon=True)
    thread.start()
    try:
        yield
    finally:
        server.shutdown()
        thread.join()
