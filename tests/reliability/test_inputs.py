"""Input files damaged, endless, of another kind or odd: one line and exit 2, or an answer, in 10 s and 1 GB."""

import os
import random
import shutil

import numpy as np
import pytest

from tests.reliability.commands import MARKS, ROOT, run

pytestmark = pytest.mark.slow

FIRST = MARKS[0]
READS = {  # by suffix, the commands that read such a file
    "-rig.yaml": ("view {0} --png o.png", f"evaluate {FIRST}.yaml {{0}}", "convert {0} -o o.urdf"),
    ".yaml": ("validate {0}", "optimize {0} --evaluations 10 -o o"),
    ".pcap": ("decode {0} -o o.ply", "convert {0} -o o.mcap", "replay {0} 127.0.0.1:9 --speed 1000000"),
    ".ply": ("view {0} --png o.png", "convert {0} -o o.las"),
    ".npz": ("view {0} --png o.png",),
    ".tum": (f"export {FIRST}-rig.yaml --scene scene.yaml --duration 0.1 -o o.pcap --trajectory {{0}}",),
    ".stl": (f"export {FIRST}-rig.yaml --scene scene.yaml --duration 0.1 -o o.pcap --vehicle {{0}}",),
}
DIGITS = "0x" + "f" * 5000, "9" * 5000, "1e" + "9" * 5000
ODD = {
    "0-d": np.float64(3),
    "text": np.array(["a", "b"]),
    "empty": np.empty(0),
    "not finite": np.array([np.nan, np.inf]),
    "large integers": np.array([2**63 - 1, -(2**63)], np.int64),
}


@pytest.fixture(scope="module")
def sources(folder):
    """A good file of each kind."""
    assert run(["decode", f"{FIRST}.pcap", "-o", f"{FIRST}.npz", "--quiet"], folder).code == 0
    (folder / f"{FIRST}.tum").write_text("0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n")
    shutil.copy(ROOT / "data/vehicles/sedan.ply", folder / "body.ply")
    return {suffix: folder / f"{FIRST}{suffix}" for suffix in READS if suffix != ".stl"}


def check(done, may_work=True):
    """It is refused, or it works within the bounds."""
    assert done.refused or (may_work and done.code == 0 and done.in_bounds), done


def clean(folder):
    """Remove what commands made; nothing unfinished is left."""
    assert not list(folder.glob(".*.part"))
    for path in folder.glob("o*"):
        shutil.rmtree(path) if path.is_dir() else path.unlink()


@pytest.mark.parametrize("suffix", [suffix for suffix in READS if suffix != ".stl"])
def test_damaged_files(folder, sources, suffix, times):
    """Cut off, with a byte changed, with a part doubled, empty."""
    draw = random.Random(suffix)
    whole = sources[suffix].read_bytes()
    path = folder / f"damaged{suffix}"
    for number in range(4 * times):
        at = draw.randrange(len(whole))
        data = bytearray(whole)
        if number % 4 == 0:
            data = data[:at]
        elif number % 4 == 1:
            data[at] ^= 1 << draw.randrange(8)
        elif number % 4 == 2:
            data[at:at] = data[max(at - 100, 0) : at]
        else:
            data = bytearray()
        path.write_bytes(data)
        for words in READS[suffix][: None if times > 2 else 1]:
            check(run([*words.format(path.name).split(), "--quiet"], folder))
            clean(folder)


def _sparse(path):
    with open(path, "wb") as file:
        file.truncate(10**10)


@pytest.mark.parametrize("suffix", READS)
@pytest.mark.parametrize(
    "make", [os.mkfifo, lambda path: path.symlink_to("/dev/zero"), _sparse], ids=["pipe", "device", "sparse"]
)
def test_files_without_an_end(folder, suffix, make):
    make(path := folder / f"endless{suffix}")
    try:
        check(run([*READS[suffix][0].format(path.name).split(), "--quiet"], folder), may_work=False)
    finally:
        path.unlink()
    clean(folder)


def test_the_content_of_one_kind_under_the_suffix_of_another(folder, sources):
    for source in sources.values():
        for suffix, commands in READS.items():
            if not source.name.endswith(suffix):
                shutil.copy(source, folder / f"other{suffix}")
                check(run([*commands[0].format(f"other{suffix}").split(), "--quiet"], folder))
                clean(folder)


@pytest.mark.parametrize("digits", DIGITS, ids=lambda digits: digits[:3])
def test_numbers_of_thousands_of_digits(folder, digits):
    (folder / "long.yaml").write_text(f"name: r\nsensors: [{{name: a, model: vlp-16, position_m: [0, 0, {digits}]}}]\n")
    check(run(["validate", "long.yaml"], folder), may_work=False)


def test_a_search_whose_arrays_are_odd(folder, times):
    """Each array of search.npz of another shape or kind, or omitted: it is not resumed."""
    study = f"{FIRST}.yaml"
    assert run(["optimize", study, "--evaluations", "40", "-o", "s", "--quiet"], folder).code == 0
    path = folder / "s/search.npz"
    with np.load(path) as archive:
        good = dict(archive)
    for key in list(good)[:: 1 if times > 2 else 4]:
        for odd in ODD.values():
            np.savez(path, **good | {key: odd})
            alike = (odd.dtype.kind, odd.ndim) == (good[key].dtype.kind, good[key].ndim)
            check(run(["optimize", study, "--resume", "s", "-o", "o", "--quiet"], folder), may_work=alike)
        np.savez(path, **{name: array for name, array in good.items() if name != key})
        check(run(["optimize", study, "--resume", "s", "-o", "o", "--quiet"], folder), may_work=False)
    clean(folder)
