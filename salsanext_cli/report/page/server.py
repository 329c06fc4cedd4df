# SPDX-License-Identifier: MIT
"""Server of a live page: the page, and the points of each scan when it asks for them."""

from __future__ import annotations

import errno
import json
from collections.abc import Callable, Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import urlsplit

from salsanext_cli.errors import SalsanextError, UsageError

LOOPBACK = "127.0.0.1"
OWN_NAMES = (LOOPBACK, "localhost")
"""Hosts that a browser may ask for: a page of another name that resolves to this machine may not
read the scans.
"""


class PageServer(ThreadingHTTPServer):
    """Server on the loopback interface.

    Parameters
    ----------
    port : int
        Port; 0 for any free one.
    page : str
        HTML of the page.
    cloud : callable
        Returns the cloud of a scan by its place, as plain data; None if there is no such scan.

    Raises
    ------
    UsageError
        If the port is taken or may not be used.
    """

    daemon_threads = True

    def __init__(
        self, port: int, page: str, cloud: Callable[[int], Mapping[str, Any] | None]
    ) -> None:
        self.page = page.encode()
        self.cloud = cloud
        try:
            super().__init__((LOOPBACK, port), _Handler)
        except OSError as error:
            if error.errno not in (errno.EADDRINUSE, errno.EACCES):
                raise
            reason = f"{port}: {error.strerror}"
            raise UsageError("--port", reason, "another port, or 0 for any free one") from None

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{LOOPBACK}:{self.server_port}/"


class _Handler(BaseHTTPRequestHandler):
    """Answers to GET requests for ``/`` and ``/cloud/3``."""

    server: PageServer

    def do_GET(self) -> None:
        """Answer one request."""
        path = urlsplit(self.path).path
        folder, _, place = path.removeprefix("/").partition("/")
        if urlsplit(f"//{self.headers.get('Host', '')}").hostname not in OWN_NAMES:
            self.send_error(HTTPStatus.FORBIDDEN)
        elif path == "/":
            self._answer(HTTPStatus.OK, "text/html; charset=utf-8", self.server.page)
        elif folder == "cloud" and place.isdecimal() and place.isascii():
            self._answer_cloud(int(place))
        else:
            self.send_error(HTTPStatus.NOT_FOUND)

    def _answer_cloud(self, place: int) -> None:
        status, data = HTTPStatus.OK, None
        try:
            data = self.server.cloud(place)
        except SalsanextError as error:
            status, data = HTTPStatus.INTERNAL_SERVER_ERROR, {"error": str(error)}
        if data is None:
            self.send_error(HTTPStatus.NOT_FOUND)
        else:
            text = json.dumps(data, allow_nan=False, separators=(",", ":"))
            self._answer(status, "application/json", text.encode())

    def _answer(self, status: HTTPStatus, kind: str, content: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *_: object) -> None:
        """Say nothing: each request is a scan that is looked at."""
