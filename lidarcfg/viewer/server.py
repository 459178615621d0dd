"""The page's server, for this machine only: the page's own routes, and evaluations of the rig as it is moved."""

import json
import re
import secrets
import sys
import threading
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import numpy as np

from lidarcfg.config.models import COORDINATE_MAX_M
from lidarcfg.errors import ConfigError, LidarcfgError, reason
from lidarcfg.geometry import Array
from lidarcfg.inputs import out_of_memory
from lidarcfg.requirements.verify import Verifier
from lidarcfg.sensors.rig import Rig, rig_text
from lidarcfg.study.evaluation import WORST
from lidarcfg.viewer.contents import Contents
from lidarcfg.viewer.evaluation import evaluation, rates, verdict, with_poses
from lidarcfg.viewer.missed import MissCounter
from lidarcfg.viewer.mounting import slide
from lidarcfg.viewer.page import ASSETS, MODULES, Page, html

HERE = "127.0.0.1"
HOSTS = (HERE, "localhost")  # any other name could be a page from elsewhere
HOST = re.compile(rf"({'|'.join(map(re.escape, HOSTS))})(:[0-9]{{1,5}})?")
TARGET = re.compile(r"(?:http://[\w.:-]*)?(/[\w./-]*)(?:[?#].*)?", re.ASCII)  # of a request: its path alone matters
REQUEST_MAX = 1 << 20  # bytes
TOKEN = "X-Lidarcfg-Token"  # a header that a page from elsewhere can neither know nor send
IDLE_S = 30.0  # after which a silent connection is closed


class Server(ThreadingHTTPServer):
    """Serves one page until it is shut down. Port 0 is any free one. Raises ConfigError if the port is taken."""

    daemon_threads = True
    request_queue_size = 256  # connections that wait to be accepted

    def __init__(self, contents: Contents, page: Page, port: int = 0) -> None:
        self.contents = contents
        self.page = page
        self.source = contents.source
        self.token = secrets.token_urlsafe()
        self.evaluating = threading.Lock()
        self.counting = threading.Lock()
        self.saving = threading.Lock()
        self.verifying = threading.Lock()
        self.missing = threading.Lock()
        required = contents.study and contents.study.requirements
        self.verifier = Verifier(required) if required else None  # keeps what is known of sensors that do not move
        missed = contents.study and contents.study.misses
        self.counter = MissCounter(missed) if missed else None
        about = page.about | {"live": True, "token": self.token, "file": contents.source and str(contents.source.path)}
        self.texts = {
            "/": ("text/html; charset=utf-8", html(None).encode()),
            "/about.json": ("application/json", json.dumps(about, allow_nan=False).encode()),
        }
        try:
            super().__init__((HERE, port), _Handler)
        except OSError as error:
            raise ConfigError(f"port {port}: {reason(error)}") from None

    @property
    def url(self) -> str:
        """The page's address."""
        return f"http://{HERE}:{self.server_address[1]}/"

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A browser that closes the connection early is no error."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    server: Server
    protocol_version = "HTTP/1.1"
    timeout = IDLE_S

    def do_GET(self) -> None:
        if not self._is_local():
            return
        target = TARGET.fullmatch(self.path)
        if not target:
            self._refuse(HTTPStatus.BAD_REQUEST, f"{self.path}: is no address of a page")
            return
        path = target[1]
        name = path.rpartition("/")[2]
        if path in self.server.texts:
            self._send(*self.server.texts[path])
        elif path.startswith("/page/") and path.removeprefix("/page/") in MODULES.values():
            self._send("text/javascript", (ASSETS / path.removeprefix("/page/")).read_bytes())
        elif path == f"/array/{name}" and name in self.server.page.arrays:
            self._send("application/octet-stream", self.server.page.arrays[name].data.cast("B"))
        else:
            self._refuse(HTTPStatus.NOT_FOUND, f"{path}: no such page")

    def do_POST(self) -> None:
        if not self._is_local():
            return
        try:
            request = self._request()
            poses = _poses(request, self.server.contents.rigs)
            kind, answer = self._answer(request, poses)
            if kind:
                self._send(kind, answer)
            else:
                self._refuse(HTTPStatus.NOT_FOUND, f"{self.path}: no such page")
        except OSError as error:
            if isinstance(error, ConnectionError):
                raise
            self._refuse(HTTPStatus.BAD_REQUEST, f"{error.filename}: {reason(error)}")
        except LidarcfgError as error:
            self._refuse(HTTPStatus.BAD_REQUEST, str(error))
        except MemoryError as error:
            self._refuse(HTTPStatus.BAD_REQUEST, str(out_of_memory(error, "evaluating the rig")))

    def _answer(self, request: dict[str, Any], poses: Array) -> tuple[str, bytes]:
        """The kind and the body of an answer; both empty if there is none. Raises ConfigError, OSError."""
        server = self.server
        study = server.contents.study
        rig = with_poses(server.contents.rigs[0], poses)
        if self.path == "/rig.yaml":
            return "application/yaml", rig_text(rig).encode()
        if self.path == "/save" and server.source:
            if not secrets.compare_digest(self.headers.get(TOKEN, "").encode(), server.token.encode()):
                raise ConfigError("the request does not come from the page as it is served now; reload it")
            with server.saving:
                server.source = server.source.save(poses)
            return _json({"file": str(server.source.path)})
        if self.path == "/place" and study:
            return _json({"poses": slide(study, poses, *_move(request, server.page.about["on_surface"])).tolist()})
        if self.path == "/evaluate" and study:
            with server.evaluating:
                return _json(evaluation(study, rig, _count(request), _flag(request, "transparent")))
        if self.path == "/rates" and study:
            with server.counting:
                return _json(rates(study, rig, _flag(request, "transparent")))
        if self.path == "/misses" and server.counter:
            with server.missing:
                return _json(server.counter.count(rig))
        if self.path == "/verify" and server.verifier:
            with server.verifying:
                return _json(verdict(server.verifier, rig))
        return "", b""

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing."""

    def _is_local(self) -> bool:
        """Whether the request names this machine; if not, it is refused."""
        names = [self.headers.get("Host", ""), self.headers.get("Origin", f"http://{HERE}").partition("://")[2]]
        if all(map(HOST.fullmatch, names)):
            return True
        self.close_connection = True
        self._refuse(HTTPStatus.FORBIDDEN, f"this page answers to {' and '.join(HOSTS)} only")
        return False

    def _request(self) -> dict[str, Any]:
        """The request's JSON. Raises ConfigError."""
        length = self.headers.get("Content-Length", "")
        if not (re.fullmatch("[0-9]{1,9}", length) and int(length) <= REQUEST_MAX):
            self.close_connection = True
            raise ConfigError(f"Content-Length {length!r}; allowed: 0 to {REQUEST_MAX}")
        try:
            request = json.loads(self.rfile.read(int(length)))
        except TimeoutError:
            self.close_connection = True  # what comes later is no request
            raise ConfigError(f"the request is not whole after {self.timeout:g} s") from None
        except (ValueError, RecursionError):
            raise ConfigError("the request is not JSON") from None
        if not isinstance(request, dict):
            raise ConfigError("the request is not a map of keys")
        return request

    def _send(self, kind: str, body: bytes | memoryview, status: HTTPStatus = HTTPStatus.OK) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.end_headers()
        self.wfile.write(body)

    def _refuse(self, status: HTTPStatus, what: str) -> None:
        self._send("text/plain; charset=utf-8", f"{what}\n".encode(errors="backslashreplace"), status)


def _json(values: Any) -> tuple[str, bytes]:
    return "application/json", json.dumps(values, allow_nan=False).encode()


def _poses(request: dict[str, Any], rigs: tuple[Rig, ...]) -> Array:
    """(mounts, 6) of the first rig. Raises ConfigError."""
    if not rigs:
        raise ConfigError("there is no rig to move")
    return _numbers(request, "poses", (len(rigs[0].mounts), 6))


def _numbers(request: dict[str, Any], key: str, shape: tuple[int, ...]) -> Array:
    """One pose, or several. Raises ConfigError."""
    given: Any = request.get(key)
    try:
        plain = all(type(number) in (int, float) for pose in (given if len(shape) > 1 else [given]) for number in pose)
        poses = np.array(given if plain else None, np.float64)  # "1" and true are no numbers
    except (TypeError, ValueError, OverflowError):
        poses = np.empty(0)
    if poses.shape != shape or not (abs(poses) <= COORDINATE_MAX_M).all():
        what = f"{shape[0]} of x, y, z" if len(shape) > 1 else "x, y, z"
        raise ConfigError(f"{key}: allowed are {what}, roll, pitch, yaw in metres and radians")
    return poses


def _move(request: dict[str, Any], surface_mounts: list[int]) -> tuple[int, Array, bool]:
    """Which sensor on a surface is moved where to, and whether its image follows. Raises ConfigError."""
    number = request.get("mount")
    if isinstance(number, bool) or number not in surface_mounts:
        raise ConfigError(
            f"mount: allowed is one that sits on a surface: {', '.join(map(str, surface_mounts)) or 'there is none'}"
        )
    return int(number), _numbers(request, "pose", (6,)), _flag(request, "mirrors")


def _flag(request: dict[str, Any], key: str) -> bool:
    """True or false; false unless said. Raises ConfigError."""
    flag = request.get(key, False)
    if not isinstance(flag, bool):
        raise ConfigError(f"{key}: allowed is true or false")
    return flag


def _count(request: dict[str, Any]) -> int:
    """How many of the worst subspaces are wanted. Raises ConfigError."""
    worst = request.get("worst", WORST)
    if type(worst) is not int or not 0 <= worst <= WORST:
        raise ConfigError(f"worst: allowed is 0 to {WORST}")
    return worst
