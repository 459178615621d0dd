"""The ground truth of a capture's returns: object, exact range and noise, one record per return."""

import tempfile
import zipfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import IO

import numpy as np
from numpy.typing import NDArray

from lidarcfg.files import check_replaceable, make_parent, replacing
from lidarcfg.geometry import Bytes, Flags, Times
from lidarcfg.sensors.firing import Firings
from lidarcfg.simulate.echoes import Echoes

RECORD = np.dtype(
    [
        ("sensor", "<u2"),  # index into sensor_names
        ("time_ns", "<i8"),  # of the firing, exact
        ("laser", "u1"),
        ("return_type", "u1"),  # 0 strongest, 1 last, 3 first; of a pair 0 and 1, of an Ouster's 0 and 2; alike: 0
        ("object", "<i4"),  # index into object_names; -1: rain or fog
        ("range_m", "<f8"),  # exact, along the beam
        ("noise_m", "<f8"),  # added to the range before it is rounded
    ]
)

RECORDS = 1 << 16  # at a time


def records(
    sensor_index: int, types: Bytes, fired: Firings, fired_ns: Times, found: Echoes, sent: Flags
) -> NDArray[np.void]:
    """The records of N firings: echoes, their types, when they were fired, and which of them were sent, are (N, R)."""
    firing, which = np.nonzero(sent)
    out = np.empty(len(firing), RECORD)
    out["sensor"] = sensor_index
    out["time_ns"] = fired_ns[firing, which]
    out["laser"] = fired.laser[firing]
    out["return_type"] = types[firing, which]
    for key in ("object", "range_m", "noise_m"):
        out[key] = getattr(found, key)[firing, which]
    return out


class TruthFile:
    """Collects the records of all sensors; `save` writes them sensor by sensor to a .npz. Memory stays constant."""

    def __init__(self, path: str | Path, sensor_names: Sequence[str], object_names: Sequence[str]) -> None:
        path = Path(path)
        check_replaceable(path)
        make_parent(path)
        self._path = path
        self._names = {"sensor_names": sensor_names, "object_names": object_names}
        self._bodies: list[IO[bytes]] = [tempfile.TemporaryFile(dir=path.parent) for _ in sensor_names]  # noqa: SIM115

    def __enter__(self) -> "TruthFile":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        for body in self._bodies:
            with suppress(OSError):  # of a full disk: `add` has raised it
                body.close()

    def add(self, found: NDArray[np.void]) -> None:
        """Append records of one sensor. Raises OSError with the name of the .npz."""
        if len(found):
            try:
                self._bodies[found["sensor"][0]].write(found.tobytes())
            except OSError as error:
                raise OSError(error.errno, error.strerror, str(self._path)) from None

    def save(self) -> int:
        """Write the file, whole or not at all, and return the number of records."""
        counts = [body.tell() // RECORD.itemsize for body in self._bodies]
        with replacing(self._path, "wb") as file, zipfile.ZipFile(file, "w") as archive:
            for key, names in self._names.items():
                with archive.open(f"{key}.npy", "w") as out:
                    np.lib.format.write_array(out, np.array(names, np.str_))
            for key in RECORD.names or ():
                with archive.open(f"{key}.npy", "w", force_zip64=True) as out:
                    head = {"descr": RECORD[key].str, "fortran_order": False, "shape": (sum(counts),)}
                    np.lib.format.write_array_header_1_0(out, head)
                    for body in self._bodies:
                        body.seek(0)
                        while piece := body.read(RECORDS * RECORD.itemsize):
                            out.write(np.frombuffer(piece, RECORD)[key].tobytes())
        return sum(counts)
