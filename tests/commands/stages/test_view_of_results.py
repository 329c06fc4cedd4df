# SPDX-License-Identifier: MIT
import json
import os
import signal
import socket
import struct
import subprocess
import sys
from dataclasses import replace
from http.client import HTTPConnection

import pytest
from background_server import served
from evaluation_runs import CAR, ROAD, SPACE, World
from scans import SMALL, refused

from salsanext_cli.commands.stages.report import report, view
from salsanext_cli.core.errors import UsageError
from salsanext_cli.runs.results.manifest import Manifest, StageRecord
from salsanext_cli.runs.results.query import ResultQuery


@pytest.fixture
def world(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    world = World(tmp_path)
    for number in range(7):
        world.add(f"{number:06}", [CAR, ROAD, ROAD], [CAR, CAR, ROAD])
    return world


def asker(server):
    """Return a function that asks a server; it returns the status and the answer."""

    def ask(path, host=None, method="GET"):
        connection = HTTPConnection("127.0.0.1", server.server_port, timeout=20)
        path = path.replace("TOKEN", server.token)
        connection.request(method, path, headers={"Host": host} if host else {})
        answer = connection.getresponse()
        return answer.status, answer.read().decode()

    return ask


@pytest.fixture
def ask(world):
    with view(world.out, query=ResultQuery(world.dataset)) as server, served(server):
        yield asker(server)


def test_every_scan_is_the_same_as_in_a_report(world, ask):
    names = [f"08/{number:06}" for number in range(7)]
    page = report(world.out, query=ResultQuery(world.dataset), scans=names).page.read_text()
    for place, name in enumerate(names):
        status, text = ask(f"/cloud/TOKEN/{place}")
        cloud = json.loads(text)
        _, _, after = page.partition(f'id="cloud-{place}">')
        assert status == 200
        assert set(cloud.pop("scales")) == {"range", "intensity"}
        assert cloud == json.loads(after.partition("</script>")[0]) | {"reason": ""}
        assert cloud["name"] == name


def test_only_the_page_and_its_scans_are_served_to_local_names(ask):
    assert ask("/")[0] == 200
    assert ask("/?from=a-link")[0] == 200
    for place in ("7", "-1", "x", "", "../cloud/TOKEN/1", "9" * 5000):
        assert ask(f"/cloud/TOKEN/{place}")[0] == 404, place
    for path in ("/x", "/cloud", "/cloud/1"):
        assert ask(path)[0] == 404, path
    assert ask("/", method="POST")[0] == 501
    assert ask("/", host="[")[0] == 400
    assert ask("/cloud/token-of-an-earlier-server/1")[0] == 410
    for host, status in (("localhost:9000", 200), ("127.0.0.1.evil.example", 403)):
        assert ask("/cloud/TOKEN/0", host)[0] == status, host


def test_results_that_changed_since_the_start_are_refused(world):
    record = StageRecord(
        stage="predict", settings={"label_space": SPACE.to_dict(), "sensor": SMALL.to_dict()}
    )
    Manifest(world.out).write(record)
    with view(world.out, query=ResultQuery(world.dataset)) as server, served(server):
        ask = asker(server)
        assert ask("/cloud/TOKEN/1")[0] == 200
        Manifest(world.out).write(replace(record, writes=("predictions",)))
        status, text = ask("/cloud/TOKEN/1")
    assert status == 500
    assert json.loads(text)["error"].startswith(str(world.out))


def test_a_browser_that_leaves_is_no_error(ask, world, capfd):
    with view(world.out, query=ResultQuery(world.dataset)) as server, served(server):
        connection = socket.create_connection(("127.0.0.1", server.server_port))
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        connection.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")
        connection.close()
        assert asker(server)("/")[0] == 200
    assert "Traceback" not in capfd.readouterr().err


def test_half_a_request_ends_after_the_timeout(world):
    with view(world.out, query=ResultQuery(world.dataset)) as server:
        handler = server.RequestHandlerClass
        assert handler.timeout < 60
        server.RequestHandlerClass = type("Impatient", (handler,), {"timeout": 0.1})
        with (
            served(server),
            socket.create_connection(("127.0.0.1", server.server_port), timeout=20) as connection,
        ):
            connection.sendall(b"GET / HTTP/1.1\r\nHo")
            assert connection.recv(1) == b""
            assert asker(server)("/")[0] == 200


def test_a_missing_scan_does_not_end_the_server(world, ask):
    (world.dataset / "sequences/08/velodyne/000003.bin").unlink()
    status, text = ask("/cloud/TOKEN/3")
    assert status == 500
    assert "000003" in json.loads(text)["error"]
    assert ask("/cloud/TOKEN/4")[0] == 200


def test_a_taken_port_is_refused(world):
    first = view(world.out, query=ResultQuery(world.dataset))
    with first, refused(UsageError, "port") as caught:
        view(world.out, port=first.server_port, query=ResultQuery(world.dataset))
    assert str(first.server_port) in caught.value.problem


def test_a_signal_ends_view(world):
    (world.dataset / "sequences/08/velodyne/000000.bin").write_bytes(b"damaged")
    command = [sys.executable, "-m", "salsanext_cli", "view", str(world.out), "--port", "0"]
    command += ["--dataset", str(world.dataset), "--json"]
    ssh = {"SSH_CONNECTION": "10.0.0.1 5000 10.0.0.2 22"}
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ | ssh
    ) as run:
        try:
            assert run.stdout
            server = json.loads(run.stdout.readline())
            assert server["scans"] == 7
            assert server["url"].startswith("http://127.0.0.1:")
            run.send_signal(signal.SIGTERM)
            output, errors = run.communicate(timeout=60)
        finally:
            run.kill()
    assert run.returncode == 1
    assert output == ""
    assert "Traceback" not in errors
    assert "ssh -N -L" in errors


def test_unreadable_and_missing_scans_are_reported(world, caplog):
    scans = world.dataset / "sequences/08/velodyne"
    (scans / "000000.bin").write_bytes(b"damaged")
    (scans / "000004.bin").unlink()
    (scans / "000005.bin").unlink()
    server = view(world.out, query=ResultQuery(world.dataset))
    server.server_close()
    assert server.scans == 5
    assert [failure.scan.stem for failure in server.failures] == ["000000"]
    assert "08/000004, 08/000005" in caplog.text
