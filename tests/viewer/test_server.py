"""The page's server and requests that no browser makes: an answer as RFC 9112 asks for, and no traceback."""

import socket
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest

from lidarcfg.viewer.contents import load_contents
from tests.viewer.driver import serving

ROOT = Path(__file__).parents[2]
BAD = "400 "
LINES = {
    "GET //[ HTTP/1.1": BAD,
    "GET http://[ HTTP/1.1": BAD,
    "GET http://[1.2.3]/ HTTP/1.1": BAD,
    "GET http://a]b/ HTTP/1.1": BAD,
    "GET /[x HTTP/1.1": BAD,
    "GET * HTTP/1.1": BAD,
    "GET \xff\xfe HTTP/1.1": BAD,
    "GET / / HTTP/1.1": BAD,
    "GET / HTTP/x": "Error code: 400",
    "GET / HTTP/1.\xb2": "Error code: 400",
    "GET": "Error code: 400",
    "\x00\x01\x02": "Error code: 400",
    "GET / HTTP/9.9": "Error code: 505",
    "G[T / HTTP/1.1": "501 ",
    f"GET /{'a' * 70_000} HTTP/1.1": "414 ",
    f"POST / HTTP/1.1\r\nContent-Length: {'9' * 5000}": BAD,
    "GET /nothing HTTP/1.1": "404 ",
    "GET http://localhost/?a=[ HTTP/1.1": "200 ",
}


@pytest.fixture(scope="module")
def address():
    """Of a page with a rig."""
    contents = load_contents([ROOT / "data/rigs/roof.yaml"], None, None, np.eye(4), print)
    with serving(contents) as url:
        where = urlsplit(url)
        yield where.hostname, where.port


def answered(address, line):
    """The first bytes of the answer to a request with this line; HTTP/0.9 has no status line."""
    with socket.create_connection(address, timeout=20) as connection:
        connection.sendall(f"{line}\r\nHost: localhost\r\nConnection: close\r\n\r\n".encode("latin-1"))
        return connection.recv(1000).decode("latin-1")


@pytest.mark.parametrize(("line", "status"), LINES.items(), ids=[line[:20] for line in LINES])
def test_a_malformed_request_is_refused_quietly(line, status, address, capfd):
    assert status in answered(address, line)
    assert "200 " in answered(address, "GET / HTTP/1.1")
    assert capfd.readouterr() == ("", "")
