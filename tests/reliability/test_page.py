"""The server of `view`: odd requests, slow clients, and kills while it saves the rig's file."""

import http.client
import json
import multiprocessing
import random
import socket
import threading
import time
from contextlib import contextmanager, suppress

import numpy as np
import pytest

from lidarcfg.sensors.rig import load_rig

pytestmark = pytest.mark.slow

RIG = "name: r\nsensors:\n" + "".join(
    f"  - {{name: {name}, model: vlp-16, position_m: [0, {y}, 1.9]}}\n" for name, y in (("left", 1), ("right", -1))
)
BODIES = (
    b"",
    b"[" * 100_000,
    b"{}",
    b'{"poses": [[NaN, 2, 3, 0, 0, 0], [1, 2, 3, 0, 0, 0]]}',
    b'{"poses": [[1e999, 2, 3, 0, 0, 0], [1, 2, 3, 0, 0, 0]]}',
    b'{"poses": [["1", "2", "3", "0", "0", "0"], [1, 2, 3, 0, 0, 0]]}',
    b'{"poses": [[true, 2, 3, 0, 0, 0], [1, 2, 3, 0, 0, 0]]}',
    b'{"poses": [[1, 2, 3, 0, 0, 0]]}',
    b"\xff\xfe",
    b"9" * 5000,
)
SIZES = "-1", "1e3", str(2**20 + 1), "9" * 400, "", "x", "+5"


def _serve(path, sender):
    from lidarcfg.viewer.contents import load_contents
    from lidarcfg.viewer.page import page_of
    from lidarcfg.viewer.server import Server

    contents = load_contents([path], None, None, np.eye(4), lambda warning: None)
    with Server(contents, page_of(contents)) as server:
        sender.send((server.server_address[1], server.token))
        server.serve_forever()


@contextmanager
def served(path):
    """The page of a rig, served by a process of its own: what asks it, what saves, and the process."""
    context = multiprocessing.get_context("forkserver")
    receiver, sender = context.Pipe(False)
    process = context.Process(target=_serve, args=(path, sender))
    process.start()
    port, token = receiver.recv()

    def ask(method, path, body=None, **headers):
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=30)
        try:
            connection.request(method, path, body, {"X-Lidarcfg-Token": token} | headers)
            answer = connection.getresponse()
            return answer.status, answer.read()
        finally:
            connection.close()

    try:
        yield ask, port, process
    finally:
        process.kill()
        process.join()


@pytest.fixture
def path(tmp_path):
    (tmp_path / "rig.yaml").write_text(RIG)
    return tmp_path / "rig.yaml"


def poses(z_m):
    return json.dumps({"poses": [[0, 1, z_m, 0, 0, 0], [0, -1, z_m, 0, 0, 0.1]]}).encode()


def heights_m(path):
    """One height if the file is whole and of one save."""
    return {mount.position_m[2] for mount in load_rig(path).mounts}


def test_odd_requests_change_nothing(path):
    with served(path) as (ask, _, _):
        before = ask("GET", "/about.json")
        for body in BODIES:
            for where in ("/save", "/evaluate", "/none"):
                status, said = ask("POST", where, body)
                assert status in (400, 404), (body[:40], where)
                assert len(said) < 500
        for size in SIZES:
            assert ask("POST", "/save", b"", **{"Content-Length": size})[0] == 400, size
        assert ask("GET", "/about.json") == before
        assert path.read_text() == RIG
        assert ask("POST", "/save", poses(1.5))[0] == 200
    assert heights_m(path) == {1.5}


def test_slow_clients_hold_up_nobody(path):
    with served(path) as (ask, port, _):
        clients = [socket.create_connection(("127.0.0.1", port)) for _ in range(20)]
        for number, client in enumerate(clients):
            client.sendall(b"POST /save HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 1000\r\n\r\n{"[: 20 + number])
            began = time.monotonic()
            assert ask("POST", "/save", poses(1 + number / 64))[0] == 200
            assert time.monotonic() - began < 5
        for client in clients:
            client.close()
    assert [one.name for one in path.parent.iterdir()] == ["rig.yaml"]


def test_a_kill_while_it_saves_leaves_a_whole_file(path, times):
    draw = random.Random(1)
    for _ in range(times):
        heights = [round(draw.uniform(1, 3), 6) for _ in range(4)]
        before = heights_m(path)
        with served(path) as (ask, _, process):

            def save(z_m, ask=ask):
                with suppress(OSError, http.client.HTTPException):
                    while ask("POST", "/save", poses(z_m))[0] == 200:
                        pass

            threads = [threading.Thread(target=save, args=(z_m,)) for z_m in heights]
            for thread in threads:
                thread.start()
            time.sleep(draw.uniform(0, 0.2))
            process.kill()
            for thread in threads:
                thread.join()
        found = heights_m(path)
        assert len(found) == 1
        assert found <= before | set(heights)
        with served(path) as (ask, _, _):
            assert ask("POST", "/save", poses(1.5))[0] == 200
        assert [one.name for one in path.parent.iterdir() if not one.name.startswith(".")] == ["rig.yaml"]
