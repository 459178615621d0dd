"""Attacks on the page's `/save`, which writes the rig's file: foreign pages, odd requests, kills, full disks."""

import http.client
import json
import os
import random
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from attack_run import Row, small_files
from attack_server import BODIES, FOREIGN, ask

RIG = """# measured by hand
name: r
sensors:
  - {name: left, model: vlp-16, position_m: [0, 1, 1.9]}   # stays
  - {name: right, model: vlp-16, position_m: [0, -1, 1.9], rpy_deg: [0, 0, 5]}
"""
LONG = "# " + "x" * 2000 + "\n"
TOKEN = "X-Lidarcfg-Token"
SAVES_S = 0.2  # in which some savers save a few times
WRONG = (
    b'{"poses": [["1", "2", "3", "0", "0", "0"], [1, 2, 3, 0, 0, 0]]}',
    b'{"poses": [[true, 2, 3, 0, 0, 0], [1, 2, 3, 0, 0, 0]]}',
    b'{"poses": [[null, 2, 3, 0, 0, 0], [1, 2, 3, 0, 0, 0]]}',
    b'{"poses": [[[1], 2, 3, 0, 0, 0], [1, 2, 3, 0, 0, 0]]}',
    b'{"poses": [[NaN, 2, 3, 0, 0, 0], [1, 2, 3, 0, 0, 0]]}',
    b'{"poses": [[-Infinity, 2, 3, 0, 0, 0], [1, 2, 3, 0, 0, 0]]}',
    b'{"poses": [[1e308, 2, 3, 0, 0, 0], [1, 2, 3, 0, 0, 0]]}',
    b'{"poses": [[1' + b"0" * 400 + b", 2, 3, 0, 0, 0], [1, 2, 3, 0, 0, 0]]}",
    b'{"poses": [[1, 2, 3, 0, 0, 0]]}',
    b'{"poses": [[1, 2, 3, 0, 0, 0], [1, 2, 3, 0, 0, 0], [1, 2, 3, 0, 0, 0]]}',
    b'{"poses": {"0": [1, 2, 3, 0, 0, 0]}}',
    b'{"poses": [[], []]}',
    b'{"pose": []}',
)
PLACES = (
    "/save/",
    "/save/../save",
    "/save%00",
    "/save?file=/etc/passwd",
    "/SAVE",
    "/save/x.yaml",
    "/../save",
    "save",
)
SIZES = ("-1", "1e3", str(2**20 + 1), "9" * 400, "", "x", "0x10", "+5")


def body(z_m: float) -> bytes:
    """A request for two sensors at a height."""
    return json.dumps({"poses": [[0, 1, z_m, 0, 0, 0], [0, -1, z_m, 0, 0, 0.1]]}).encode()


@dataclass(frozen=True)
class Page:
    """A page of one rig, served by a process of its own."""

    path: Path
    pid: int
    port: int
    token: str

    def save(self, said: bytes, path: str = "/save", **headers: str) -> tuple[int, bytes]:
        """What the server answers."""
        return ask(self.port, "POST", path, said, {TOKEN: self.token} | headers)

    def heights_m(self) -> set[float]:
        """The heights of the file's sensors: one if it is whole. Raises LidarcfgError."""
        from lidarcfg.rig import load_rig

        return {mount.position_m[2] for mount in load_rig(self.path).mounts}


@contextmanager
def served(path: Path, limit: Callable[[], None] = lambda: None) -> Iterator[Page]:
    """The page of the rig's file, until the end."""
    reader, writer = os.pipe()
    pid = os.fork()
    if not pid:
        try:  # the child
            from lidarcfg.view.page import page_of
            from lidarcfg.view.server import Server
            from lidarcfg.view.stage import load_stage

            stage = load_stage([path], None, None, np.eye(4), lambda warning: None)
            with Server(stage, page_of(stage)) as server:
                os.write(writer, json.dumps([server.server_address[1], server.token]).encode())
                os.close(writer)
                limit()
                server.serve_forever()
        finally:  # nothing of the parent is to be ended here
            os._exit(1)
    os.close(writer)
    with os.fdopen(reader) as file:
        port, token = json.load(file)
    try:
        yield Page(path, pid, port, token)
    finally:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)


def attacks(folder: Path, times: int, rng: random.Random) -> Iterator[Row]:
    """All of them; the file is there whole after each."""
    (path := folder / "rig.yaml").write_text(RIG)
    for one in (foreign, nonsense, slow, savers):
        with served(path) as page:
            row = one(page)
            row.add("" if page.save(body(1.5))[0] == 200 and page.heights_m() == {1.5} else "it does not save after")
        row.add(leftovers(folder))
        path.write_text(RIG)
        yield row
    for another in (changed, partial(pages, times=min(times, 20)), full_disk):
        row = another(path)
        path.write_text(RIG)
        yield row
    yield kills(path, times, rng)


def leftovers(folder: Path) -> str:
    """What is there besides the rig."""
    return ", ".join(sorted(one.name for one in folder.iterdir() if one.name != "rig.yaml"))


def refused(page: Page, answer: tuple[int, bytes], what: str, allowed: tuple[int, ...] = (400,)) -> str:
    """Empty if it was refused in one line and the file is as it was."""
    status, said = answer
    fits = status in allowed and len(said) < 500 and said.count(b"\n") == 1
    return "" if fits and page.path.read_text() == RIG else f"{what}: {status} {said[:200]!r}"


def foreign(page: Page) -> Row:
    """Pages from elsewhere, with the token or without; this machine's without it."""
    row = Row("saving: a foreign Host or Origin, no token or another")
    for headers in FOREIGN:
        row.add(refused(page, page.save(body(1.0), **headers), str(headers), (403,)))
        row.add(refused(page, ask(page.port, "POST", "/save", body(1.0), headers), str(headers), (403,)))
    for token in ("", "x", page.token[:-1], page.token + "x", page.token.swapcase(), "\xfc", "x" * 60_000):
        row.add(refused(page, page.save(body(1.0), **{TOKEN: token}), f"token {token[:9]!r}"))
    row.add(refused(page, ask(page.port, "POST", "/save", body(1.0), {}), "no token"))
    for method in ("GET", "PUT", "DELETE", "PATCH", "OPTIONS"):
        status = ask(page.port, method, "/save", None, {TOKEN: page.token})[0]
        row.add("" if status in (404, 501) and page.path.read_text() == RIG else f"{method}: {status}")
    return row


def nonsense(page: Page) -> Row:
    """Bodies that are none, of other types, not finite; sizes that are not so; paths that lead elsewhere."""
    row = Row("saving: oversized, malformed and odd requests, NaN, paths")
    for said in (*BODIES, *WRONG, b" " * (2**20)):
        row.add(refused(page, page.save(said), repr(said[:60])))
    for size in SIZES:
        row.add(refused(page, page.save(b"", **{"Content-Length": size}), f"Content-Length {size[:20]!r}"))
    for path in PLACES:
        row.add(refused(page, page.save(body(1.0), path), path, (404, 400)))
    more = json.loads(body(1.75)) | {"file": "../other.yaml", "path": "/etc/passwd", "output": "x"}
    status, said = page.save(json.dumps(more).encode())
    kept = json.loads(said) == {"file": str(page.path)} and page.heights_m() == {1.75}
    row.add("" if status == 200 and kept and not leftovers(page.path.parent) else f"names of files: {status} {said!r}")
    return row


def slow(page: Page) -> Row:
    """Clients that begin to save and say no more, or leave: others save meanwhile."""
    row = Row("saving: slow clients, and those that leave")
    head = f"POST /save HTTP/1.1\r\nHost: 127.0.0.1\r\n{TOKEN}: {page.token}\r\nContent-Length: 1000\r\n\r\n"
    clients = [socket.create_connection(("127.0.0.1", page.port)) for _ in range(20)]
    for number, client in enumerate(clients):
        client.sendall((head + '{"poses": [[')[: len(head) + number - 8].encode())
        if number % 2:
            client.close()
        began = time.monotonic()
        saved = page.save(body(1 + number / 64))[0] == 200 and time.monotonic() - began < 5
        row.add("" if saved and page.heights_m() == {1 + number / 64} else "another client waits")
    for client in clients:
        client.close()
    return row


def savers(page: Page) -> Row:
    """Many at once on one page: each is done, and the file is one of theirs at any time."""
    row, heights, stop = (
        Row("saving: eight savers at once on one page"),
        [1 + i / 64 for i in range(8)],
        threading.Event(),
    )
    found: list[str] = []

    def one(z_m: float) -> None:
        while not stop.is_set():
            status, said = page.save(body(z_m))
            found.append("" if status == 200 else f"{status} {said!r}")

    threads = [threading.Thread(target=one, args=(z_m,)) for z_m in heights]
    for thread in threads:
        thread.start()
    until = time.monotonic() + 5 * SAVES_S
    while time.monotonic() < until:
        seen = page.heights_m()
        found.append("" if seen <= {1.9, *heights} and len(seen) == 1 else f"the file has {seen}")
    stop.set()
    for thread in threads:
        thread.join()
    for wrong in found:
        row.add(wrong)
    return row


def changed(path: Path) -> Row:
    """A file that is another by now, and no file: it is not written, and not waited for."""
    row, other = Row("saving: a file that has changed, or is none any more"), path.with_name("other.yaml")

    def swap(make: Callable[[], object]) -> Callable[[], object]:
        return lambda: (path.unlink(), make())

    def sparse() -> None:
        with open(path, "wb") as file:
            file.truncate(10**10)

    tricks: dict[str, Callable[[], object]] = {
        "edited": lambda: path.write_text(RIG + "# mine\n"),
        "of the same size": lambda: path.write_text(RIG.replace("hand", "HAND")),
        "gone": path.unlink,
        "a folder": swap(path.mkdir),
        "a pipe": swap(lambda: os.mkfifo(path)),
        "a device": swap(lambda: path.symlink_to("/dev/zero")),
        "links in a circle": swap(lambda: path.symlink_to(path.name)),
        "a link to another": swap(lambda: (other.write_text(RIG + "#\n"), path.symlink_to(other))),
        "ten gigabytes": swap(sparse),
    }
    for what, trick in tricks.items():
        path.write_text(RIG)
        with served(path) as page:
            trick()
            before, began = os.lstat(path) if os.path.lexists(path) else None, time.monotonic()
            status, said = page.save(body(1.0))
            after = os.lstat(path) if os.path.lexists(path) else None
            same = (before and (before.st_ino, before.st_mtime_ns)) == (after and (after.st_ino, after.st_mtime_ns))
            fits = status == 400 and said.count(b"\n") == 1 and same and time.monotonic() - began < 5
            row.add("" if fits else f"{what}: {status} {said[:200]!r}")
        path.rmdir() if path.is_dir() else path.unlink(missing_ok=True)
        other.unlink(missing_ok=True)
    path.write_text(RIG)
    path.chmod(0o444)
    with served(path) as page:
        row.add(refused(page, page.save(body(1.0)), "read-only"))
    path.chmod(0o644)
    path.rename(other)
    path.symlink_to(other)
    with served(path) as page:
        kept = page.save(body(1.25))[0] == 200 and path.is_symlink() and page.heights_m() == {1.25}
        row.add("" if kept else "a link does not stay one")
    path.unlink()
    other.unlink()
    return row


def pages(path: Path, times: int) -> Row:
    """Two pages of one file that save at once: one saves, the other is told that the file has changed."""
    row = Row("saving: two pages of one file at once")
    for number in range(times):
        path.write_text(RIG)
        with served(path) as one, served(path) as other:
            answers: dict[float, int] = {}

            def save(page: Page, z_m: float, answers: dict[float, int] = answers) -> None:
                answers[z_m] = page.save(body(z_m))[0]

            both = [threading.Thread(target=save, args=(page, z_m)) for page, z_m in ((one, 1.25), (other, 1.75))]
            for thread in both:
                thread.start()
                time.sleep(0.0005 * (number % 4))
            for thread in both:
                thread.join()
            saved = {z_m for z_m, status in answers.items() if status == 200}
            row.add(
                "" if len(saved) == 1 and one.heights_m() == saved else f"{answers}: the file has {one.heights_m()}"
            )
    row.add(leftovers(path.parent))
    return row


def full_disk(path: Path) -> Row:
    """A file that cannot become as large as it has to be: one line, the old file whole, and the page goes on."""
    row = Row("saving: a full disk")
    for most in (0, 1, 100, len(LONG), len(LONG + RIG) - 10):
        path.write_text(LONG + RIG)
        with served(path, small_files(most)) as page:
            for _ in range(2):
                status, said = page.save(body(1.123456789))
                whole = path.read_text() == LONG + RIG and not leftovers(path.parent)
                fits = status == 400 and said.count(b"\n") == 1 and b"too large" in said
                row.add("" if fits and whole else f"{most} bytes: {status} {said!r} {leftovers(path.parent)}")
    return row


def kills(path: Path, times: int, rng: random.Random) -> Row:
    """Kill -9 while four savers save: the file is whole, one of theirs; the next page's save removes what is left."""
    row, begun = Row("kill -9: the page while it saves"), 0
    path.write_text(RIG)
    for _ in range(times):
        heights = [round(rng.uniform(1, 3), 6) for _ in range(4)]
        with served(path) as page:
            before = page.heights_m()

            def save(z_m: float, page: Page = page) -> None:
                with suppress(OSError, http.client.HTTPException):
                    while page.save(body(z_m))[0] == 200:
                        pass

            threads = [threading.Thread(target=save, args=(z_m,)) for z_m in heights]
            for thread in threads:
                thread.start()
            time.sleep(rng.uniform(0, SAVES_S))
            os.kill(page.pid, signal.SIGKILL)
            for thread in threads:
                thread.join()
        begun += bool(leftovers(path.parent))
        seen = page.heights_m()
        odd = "" if len(seen) == 1 and seen <= before | set(heights) else f"the file has {seen}"
        with served(path) as page:
            saved = page.save(body(1.5))[0] == 200 and page.heights_m() == {1.5}
        row.add(odd or ("" if saved else "the next page does not save") or leftovers(path.parent))
    row.seen = f"{begun} had begun a file"
    return row
