"""Attacks on the server of `view`: foreign pages, oversized and slow requests, many connections."""

import http.client
import json
import socket
import threading
import time
from collections.abc import Iterator

from attack_run import ROOT, Row

CONNECTIONS = 200
FOREIGN = (
    {"Host": "evil.example"},
    {"Host": "127.0.0.1.evil.example"},
    {"Host": "localhost.evil.example:80"},
    {"Host": ""},
    {"Host": "127.0.0.1", "Origin": "http://evil.example"},
    {"Host": "127.0.0.1", "Origin": "null"},
    {"Host": "127.0.0.1", "Origin": "http://127.0.0.1.evil.example"},
    {"Host": "127.0.0.1", "Origin": "file://"},
    {"Host": "127.0.0.1", "Origin": "http://localhost:80@evil.example"},
    {"Host": "localhost:80@evil.example"},
)
BODIES = (
    b"",
    b"[",
    b"[" * 100_000,
    b"null",
    b"{}",
    b'{"poses": [[NaN, 0, 0, 0, 0, 0]]}',
    b'{"poses": [[1e999, 0, 0, 0, 0, 0]]}',
    b'{"poses": "x"}',
    b'{"poses": [[1, 2, 3]]}',
    b'{"poses": [[1, 2, 3, 0, 0, 0]], "worst": -1}',
    b'{"poses": [["1", "2", "3", "0", "0", "0"]]}',
    b'{"poses": [[true, false, true, false, true, false]], "mount": 0, "pose": [1, 2, 3, 0, 0, 0]}',
    b'{"poses": [[1, 2, 3, 0, 0, 0]], "mount": [0], "pose": {"x": 1}}',
    b'{"poses": [[1, 2, 3, 0, 0, 0]], "worst": true, "transparent": 3}',
    b"\xff\xfe",
    b"9" * 5000,
)
PATHS = ("/..%2f..%2fetc/passwd", "/page/../server.py", "/page/%2e%2e/server.py", "/array/../../x", "//evil/", "/%00")


def ask(port: int, method: str, path: str, body: bytes | None, headers: dict[str, str]) -> tuple[int, bytes]:
    """A status and a body; 0 and what went wrong without an answer."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=30)
    try:
        connection.putrequest(method, path, skip_host="Host" in headers)
        for key, value in headers.items():
            connection.putheader(key, value)
        if body is not None and "Content-Length" not in headers:
            connection.putheader("Content-Length", str(len(body)))
        connection.endheaders(body)
        answer = connection.getresponse()
        return answer.status, answer.read()
    except (OSError, http.client.HTTPException) as error:
        return 0, repr(error).encode()
    finally:
        connection.close()


def attacks(quick: bool) -> Iterator[Row]:
    """All of them on one server, which must answer in the end as in the beginning."""
    import numpy as np

    from lidarcfg.view.page import page_of
    from lidarcfg.view.server import Server
    from lidarcfg.view.stage import load_stage

    files = [ROOT / "data/studies/liu2018-2x16.yaml"]
    stage = load_stage(files, None, None, np.eye(4), lambda warning: None)
    with Server(stage, page_of(stage)) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        port = server.server_address[1]
        first = ask(port, "GET", "/about.json", None, {})
        for one in (foreign, nonsense, slow, many):
            row = one(port)
            row.add("" if ask(port, "GET", "/about.json", None, {}) == first else "the page is another one after")
            yield row
        server.shutdown()


def valid(port: int) -> bytes:
    """A request that the server answers."""
    said = json.loads(ask(port, "GET", "/about.json", None, {})[1])
    count = len(said["rigs"][0]["mounts"]) if "rigs" in said else 2
    return json.dumps({"worst": 1, "poses": [[0, 0, 2, 0, 0, 0]] * count}).encode()


def foreign(port: int) -> Row:
    """Pages from elsewhere."""
    row = Row("the page's server: a foreign Host or Origin")
    for headers in FOREIGN:
        for method, path, body in (("GET", "/", None), ("GET", "/about.json", None), ("POST", "/rig.yaml", b"{}")):
            status, said = ask(port, method, path, body, headers)
            row.add("" if status == 403 and len(said) < 200 else f"{headers} {method} {path}: {status}")
    return row


def nonsense(port: int) -> Row:
    """Bodies that are none, sizes that are not so, paths that lead elsewhere."""
    row = Row("the page's server: oversized and odd bodies, paths, methods")
    for body in BODIES:
        for path in ("/evaluate", "/rig.yaml", "/rates", "/place", "/save", "/none"):
            status, _ = ask(port, "POST", path, body, {})
            row.add("" if status in (400, 404) else f"{body[:40]!r} to {path}: {status}")
    status, _ = ask(port, "POST", "/evaluate", valid(port).ljust(2**20 + 1), {})
    row.add("" if status in (0, 400) else f"a body above 1 MiB: {status}")  # it need not be read to its end
    for size in ("-1", "1e3", str(2**20 + 1), "9" * 400, "", "x", "\u0663".encode().decode("latin-1")):
        status, _ = ask(port, "POST", "/evaluate", b"", {"Content-Length": size})
        row.add("" if status == 400 else f"Content-Length {size[:20]!r}: {status}")
    for path in PATHS:
        status, _ = ask(port, "GET", path, None, {})
        row.add("" if status in (400, 404) else f"{path}: {status}")
    for method in ("PUT", "DELETE", "OPTIONS", "TRACE", "PATCH", "X" * 1000):
        status, _ = ask(port, method, "/", None, {})
        row.add("" if status in (400, 405, 501) else f"{method[:10]}: {status}")
    return row


def slow(port: int) -> Row:
    """Clients that send a byte a while, or nothing: others are answered meanwhile."""
    row = Row("the page's server: slow clients")
    clients = [socket.create_connection(("127.0.0.1", port)) for _ in range(20)]
    clients[0].sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX: ")
    clients[1].sendall(b"POST /evaluate HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 1000\r\n\r\n{")
    for i in range(20):
        clients[i % 2].sendall(b" ")
        row.add("" if _answers(port) else "another client waits")
        time.sleep(0.02)
    for client in clients:
        client.close()
    return row


def _answers(port: int) -> bool:
    began = time.monotonic()
    return ask(port, "GET", "/about.json", None, {})[0] == 200 and time.monotonic() - began < 5


def many(port: int) -> Row:
    """Connections at once, that ask and evaluate."""
    row, body = Row(f"the page's server: {CONNECTIONS} connections at once"), valid(port)
    found: list[str] = []

    def one(i: int) -> None:
        what = ("POST", "/evaluate", body) if i % 10 == 0 else ("GET", "/about.json", None)
        status, said = ask(port, *what, {})
        found.append("" if status == 200 else f"{what[1]}: {status} {said[:100]!r}")

    threads = [threading.Thread(target=one, args=(i,)) for i in range(CONNECTIONS)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for wrong in found:
        row.add(wrong)
    return row
