"""Values of options as people write them, and names of options as other programs have them."""

import math

import click
import pytest

from lidarcfg.cli.options import Seconds
from tests.command_line import lidarcfg


@pytest.mark.parametrize(
    ("text", "seconds"),
    [("1", 1), ("1s", 1), ("500 ms", 0.5), ("500ms", 0.5), ("2 min", 120), ("1.5H", 5400), (" 3 sec ", 3), ("1e3us", 1e-3), ("7µs", 7e-6), ("20ns", 2e-8)],
)  # fmt: skip
def test_seconds_with_units(text, seconds):
    assert Seconds().convert(text, None, None) == pytest.approx(seconds, rel=1e-15)


@pytest.mark.parametrize(
    "text", ["", "s", "1 day", "one", "1,5 s", "1 s s", "nan", "nan s", "0", "-1 s", "2 days", "inf"]
)
def test_what_is_not_a_time(text):
    with pytest.raises(click.BadParameter, match="allowed: "):
        Seconds(100).convert(text, None, None)


def test_selections_may_be_open():
    kind = Seconds(signed=True)
    assert (kind.convert("0", None, None), kind.convert("-5 ms", None, None)) == (0, -0.005)
    assert kind.convert("inf", None, None) == kind.convert(math.inf, None, None) == math.inf


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (("optimize", "x", "--time", "30"), "No such option '--time'. Did you mean --seconds?"),
        (("export", "x", "--time", "30"), "No such option '--time'. Did you mean --duration?"),
        (("optimize", "x", "--budget", "30"), "No such option '--budget'. Did you mean --seconds or --evaluations?"),
        (("optimize", "x", "--second", "30"), "--seconds"),
    ],
)
def test_options_that_other_programs_have(words, meant):
    done = lidarcfg(*words, code=2)
    assert meant in done.stderr
    assert "--quiet" not in done.stderr
