# SPDX-License-Identifier: MIT
"""Server of a live page, and of the points of every scan on request."""

from __future__ import annotations

import errno
import json
import re
import secrets
import sys
from collections.abc import Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import urlsplit

from salsanext_cli.core.errors import SalsanextError, UsageError
from salsanext_cli.core.wording import argument

LOOPBACK = "127.0.0.1"
TIMEOUT_S = 10.0  # Longest wait for a client to send or take bytes
LOCAL_NAMES = (LOOPBACK, "localhost")
"""Host names in accepted requests: a web site whose name points here cannot read the scans."""


class PageServer(ThreadingHTTPServer):
    """Server, on the loopback interface, of a page and of the clouds of a subclass."""

    page = b""
    request_queue_size = 64

    def __init__(self, port: int) -> None:
        # Part of the address of the clouds: pages of earlier servers cannot load them.
        self.token = secrets.token_urlsafe(12)
        try:
            super().__init__((LOOPBACK, port), _Handler)
        except OSError as error:
            if error.errno not in (errno.EADDRINUSE, errno.EACCES):
                raise
            problem = f"{port}: {(error.strerror or '').lower()}"
            hint = "name another port, or 0 for any free port"
            raise UsageError(argument("port"), problem, hint=hint) from None

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{LOOPBACK}:{self.server_port}/"

    def cloud(self, index: int) -> Mapping[str, object] | None:
        """Return the cloud of a scan by its index, as plain data; None if there is no such scan."""
        raise NotImplementedError

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Print no error of a browser that closed the connection."""
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
        if host not in LOCAL_NAMES:
            self.send_error(HTTPStatus.FORBIDDEN)
            return
        match path.split("/"):
            case ["", ""]:
                self._answer(HTTPStatus.OK, "text/html; charset=utf-8", self.server.page)
            case ["", "cloud", token, index] if re.fullmatch("[0-9]{1,9}", index):
                self._answer_cloud(token, int(index))
            case _:
                self.send_error(HTTPStatus.NOT_FOUND)

    def _answer_cloud(self, token: str, index: int) -> None:
        status = HTTPStatus.OK
        data: Mapping[str, object] | None
        if token != self.server.token:
            problem = "this page belongs to an earlier salsanext view: reload it"
            status = HTTPStatus.GONE
            data = {"error": problem}
        else:
            try:
                data = self.server.cloud(index)
            except SalsanextError as error:
                status = HTTPStatus.INTERNAL_SERVER_ERROR
                data = {"error": str(error)}
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
        """Log no requests."""
