"""Shortcuts through numba: by numba's own values of flags, and by the machine code that it makes without them."""

import subprocess
import sys

import numba
from hypothesis import given
from hypothesis import strategies as st
from numba import types
from numba.core.compiler import Flags

from lidarcfg.jit import njit

CODE = """
import re, sys
import lidarcfg.shortcuts
if sys.argv[1] == "without":
    lidarcfg.shortcuts.take = lambda: None
from lidarcfg.jit import inner, njit
import numpy as np

__name__ = "lidarcfg.made"

@inner()
def squares(x):
    return max(x * x, 0.5)

@njit(fastmath=True, error_model="numpy")
def roots(xs):
    out = np.empty(len(xs))
    for n in range(len(xs)):
        value, left = xs[n], 9
        while value > 1e9 and left:
            for _ in range(left):
                value /= 2.0 if value > left else 3.0
            left -= 1
        out[n] = min(squares(xs[n]), 3.0) / np.sqrt(value)
    return out

assert roots(np.array([4.0, 0.25])).tolist() == [1.5, 1.0]
asm = roots.inspect_asm(roots.signatures[0])
name = roots.overloads[roots.signatures[0]].fndesc.mangled_name
body = asm[asm.index(f"\\n{name}:") :]
print(len(re.findall("cfunc[.]", asm)) > 0)
print(body[: body.index(".Lfunc_end")])
"""
OPTIONS = {
    "nrt": st.booleans(), "no_cpython_wrapper": st.booleans(), "error_model": st.sampled_from(["python", "numpy"]),
    "fastmath": st.sampled_from([False, True, {"nnan"}]),
}  # fmt: skip


@st.composite
def flags(draw):
    """Some options set, to their defaults or else."""
    out = Flags()
    for name in draw(st.sets(st.sampled_from(sorted(OPTIONS)))):
        setattr(out, name, draw(OPTIONS[name]))
    return out


@given(flags(), flags())
def test_flags_are_alike_where_all_their_values_are(one, other):
    assert (one == other) == (one.values() == other.values())
    assert one != other or hash(one) == hash(other)
    assert one != 1


def test_machine_code_is_the_same_without_them():
    """But for how Python enters it, and for the second way in, for C, that numba makes otherwise."""
    (c, *body), (no_c, *same) = (
        subprocess.run(
            [sys.executable, "-c", CODE, how], capture_output=True, text=True, check=True
        ).stdout.splitlines()
        for how in ("without", "with")
    )
    assert (c, no_c) == ("True", "False")
    assert len(body) > 20
    assert same == body


def test_functions_of_others_can_be_passed_to_compiled_ones():
    """That is what the second way in is for."""

    @numba.njit(types.float64(types.float64))
    def twice(x):
        return 2 * x

    @numba.njit(types.float64(types.FunctionType(types.float64(types.float64)), types.float64))
    def applied(function, x):
        return function(x) + 1

    @njit()
    def thrice(x):
        return 3 * x

    assert applied(twice, 3.0) == 7.0
    assert thrice(3.0) == 9.0
