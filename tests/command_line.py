"""The command line as a user types it, in this process: `main` with its errors, exit codes and output."""

import contextlib
import io
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from lidarcfg.cli.main import main

SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGPIPE") if hasattr(signal, name)]


def lidarcfg(*words, code=0, cwd="."):
    """What `lidarcfg words` prints in a folder, after it ended with `code`; a bug is raised."""
    out = io.StringIO()
    errors = io.StringIO()
    handlers = {number: signal.getsignal(number) for number in SIGNALS}
    try:
        with (
            pytest.MonkeyPatch.context() as patch,
            contextlib.chdir(Path(cwd)),
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(errors),
            pytest.raises(SystemExit) as ended,
        ):
            patch.setattr(sys, "argv", ["lidarcfg", *map(str, words)])
            main()
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    assert ended.value.code == code, errors.getvalue()
    return SimpleNamespace(stdout=out.getvalue(), stderr=errors.getvalue(), returncode=code)


@contextlib.contextmanager
def without_drawing():
    """Figures are made and written, but blank: to draw them takes half of a command's time."""
    from matplotlib.figure import Figure

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "draw", lambda self, renderer: None)
        yield


def started(words):
    """A process that heeds Ctrl-C even where these tests run in the background, which ignores it."""
    return subprocess.Popen(
        words,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
