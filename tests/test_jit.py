"""numba as it is started here: without scipy.linalg, which others' kernels can use all the same."""

import subprocess
import sys

CODE = """
import sys
import numpy as np
from lidarcfg.jit import njit
from numba.np.linalg import ensure_blas

@njit
def doubled(x):
    return x * 2

@njit
def product(a, b):
    return np.dot(a, b)

assert doubled(np.ones(3)).tolist() == [2, 2, 2]
assert "scipy.linalg" not in sys.modules
assert ensure_blas.__module__ == "numba.np.linalg" and ensure_blas.__name__ == "ensure_blas"
assert product(np.eye(3) * 2, np.arange(9.0).reshape(3, 3)).tolist() == [[0, 2, 4], [6, 8, 10], [12, 14, 16]]
print("scipy.linalg" in sys.modules)
"""


def test_scipy_is_loaded_when_matrices_are_multiplied():
    done = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, check=False)
    assert done.stderr == ""
    assert done.stdout == "True\n"
