# SPDX-License-Identifier: MIT
"""Server of a live page: the page, and the points of each scan when it asks for them."""

from __future__ import annotations

import errno
import json
import re
import secrets
import sys
from collections.abc import Mapping
from contextlib import suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from socket import SHUT_RDWR
from threading import Lock
from typing import Any
from urllib.parse import urlsplit

from salsanext_cli.errors import SalsanextError, UsageError

LOOPBACK = "127.0.0.1"
TIMEOUT_S = 10.0  # Longest wait for the next bytes of a request, or until some are taken
MAX_CONNECTIONS = 64  # Of a browser there are six
OWN_NAMES = (LOOPBACK, "localhost")
"""Hosts that a browser may ask for, so that no page of another name here can read the scans."""


class PageServer(ThreadingHTTPServer):
    """Server, on the loopback interface, of a page and of the clouds that a subclass gives."""

    page = b""
    request_queue_size = MAX_CONNECTIONS

    def __init__(self, port: int) -> None:
        # Part of the address of the clouds: the page of an earlier server gets none of this one's.
        self.token = secrets.token_urlsafe(12)
        self._open: dict[Any, None] = {}  # Connections, the oldest first
        self._lock = Lock()
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

    def cloud(self, place: int) -> Mapping[str, object] | None:
        """Return the cloud of a scan by its place, as plain data; None if there is no such scan."""
        raise NotImplementedError

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a thread of its own; end the oldest connection if there are too many."""
        with self._lock:
            self._open[request] = None
            oldest = next(iter(self._open)) if len(self._open) > MAX_CONNECTIONS else None
            if oldest:
                del self._open[oldest]
                # Its thread reads the end of the request, and closes it.
                with suppress(OSError):
                    oldest.shutdown(SHUT_RDWR)
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        """Close a connection."""
        with self._lock:
            self._open.pop(request, None)
        super().shutdown_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing of a browser that no longer waits for its answer."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    """Answers to GET requests for ``/`` and ``/cloud/TOKEN/3``."""

    server: PageServer
    timeout = TIMEOUT_S

    def do_GET(self) -> None:
        """Answer one request."""
        try:
            path = urlsplit(self.path).path
            host = urlsplit(f"//{self.headers.get('Host', '')}").hostname
        except ValueError:
            self.send_error(HTTPStatus.BAD_REQUEST)
            return
        if host not in OWN_NAMES:
            self.send_error(HTTPStatus.FORBIDDEN)
            return
        match path.split("/"):
            case ["", ""]:
                self._answer(HTTPStatus.OK, "text/html; charset=utf-8", self.server.page)
            case ["", "cloud", token, place] if re.fullmatch("[0-9]{1,9}", place):
                self._answer_cloud(token, int(place))
            case _:
                self.send_error(HTTPStatus.NOT_FOUND)

    def _answer_cloud(self, token: str, place: int) -> None:
        status = HTTPStatus.OK
        data: Mapping[str, object] | None
        if token != self.server.token:
            error = "this page is of an earlier salsanext view: reload it"
            status, data = HTTPStatus.GONE, {"error": error}
        else:
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
