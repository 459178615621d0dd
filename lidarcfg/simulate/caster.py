"""Casts the rays of a drive in one of our own scenes, on threads, as any simulator may in its own."""

import os
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from lidarcfg.config.models import Given
from lidarcfg.errors import LidarcfgError
from lidarcfg.files import loaded
from lidarcfg.geometry import Array, Bytes
from lidarcfg.sensors.firing import RETURN_TYPES
from lidarcfg.simulate.drive import Drive, FiredPackets, RayBatch
from lidarcfg.simulate.simulator import CLEAR, Simulator
from lidarcfg.units import SECOND_NS
from lidarcfg.world.scene import Scene, load_scene
from lidarcfg.world.tracer import Tracer
from lidarcfg.world.vehicle import Vehicle, check_outside, resolve_vehicle

AHEAD = 1  # batches that are cast while the caller has one
PIECE_RAYS = 8192  # cast at a time, at least
PIECES = 4  # of a batch for each thread: sensors take longer or shorter


@dataclass(frozen=True)
class CastBatch:
    """A batch that is being cast."""

    rays: RayBatch
    range_m: Array  # (N, R)
    intensity: Bytes  # (N, R)
    jobs: list[Future[None]]

    def result(self) -> tuple[RayBatch, Array, Bytes]:
        """The batch, when all of it is cast."""
        for job in self.jobs:
            job.result()
        return self.rays, self.range_m, self.intensity


class Caster:
    """A scene, or its file, and the vehicle of the drive's rig, or of a file, in which a drive's rays are cast.

    Rays are the beam's axis, in the scene's weather; divergence and `range_10_percent_m` are for `export`.
    Raises LidarcfgError.
    """

    def __init__(
        self, drive: Drive, scene: Scene | Given, vehicle: Vehicle | Given | None = None, threads: int | None = None
    ) -> None:
        self._drive = drive
        scene = loaded(scene, load_scene, Scene)
        begin_ns = drive.start_ns + round(max(drive.span_s[0], 0) * SECOND_NS)
        tracer = Tracer(scene, drive.trajectory.pose(begin_ns)[:3, 3], drive.start_ns)
        carrier = resolve_vehicle(drive.rig, vehicle)
        if carrier:
            check_outside(carrier, drive.rig.mounts)
        bodies = Tracer(carrier.scene, np.zeros(3)) if carrier else None
        mounts = [replace(sensor.mount, realism=None) for sensor in drive.sensors]
        self._simulators = [Simulator(i, one, tracer, drive.trajectory, bodies) for i, one in enumerate(mounts)]
        clear = scene.file.weather == CLEAR  # and then all returns of a ray are the same
        self._columns = 1 if clear else max(len(RETURN_TYPES[one.return_mode]) for one in mounts)
        self._threads = threads or os.cpu_count() or 1

    def cast(self, batches: Iterable[RayBatch]) -> Iterator[tuple[RayBatch, Array, Bytes]]:
        """Each batch with ranges (N, R), inf where nothing is hit, and intensities (N, R), as `Writer.write` has them.

        A batch ahead is cast meanwhile. Rays are in the world. Raises LidarcfgError.
        """
        waiting: deque[CastBatch] = deque()
        with ThreadPoolExecutor(self._threads) as pool:
            for rays in batches:
                waiting.append(self._begun(pool, rays))
                if len(waiting) > AHEAD:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()

    def _begun(self, pool: ThreadPoolExecutor, rays: RayBatch) -> CastBatch:
        """A batch, piece by piece handed to the threads."""
        if any(one.sensor is not own for one, own in zip(rays.packets, self._drive.sensors, strict=False)):
            raise LidarcfgError("the rays are of another drive")
        if rays.trajectory is None:
            raise LidarcfgError('rays are in the frame of the vehicle; allowed: frame="world"')
        shape = len(rays), self._columns
        made = CastBatch(rays, np.full(shape, np.inf), np.zeros(shape, np.uint8), [])
        most = max(len(rays) // (PIECES * self._threads), PIECE_RAYS)
        row = 0
        for one in rays.packets:
            count = len(one.batch.firings.time_ns)
            for first in range(0, count, most):
                piece = slice(first, min(first + most, count))
                made.jobs.append(pool.submit(self._cast, one, piece, made, row))
            row += count
        return made

    def _cast(self, fired: FiredPackets, piece: slice, made: CastBatch, row: int) -> None:
        """Cast some firings of a sensor, whose rows begin at `row`."""
        found, _ = self._simulators[fired.sensor.index].echoes(fired.batch.firings[piece], fired.first + piece.start)
        rows = slice(row + piece.start, row + piece.stop)
        columns = min(found.range_m.shape[1], self._columns)
        made.range_m[rows, :columns] = found.range_m[:, :columns]
        made.intensity[rows, :columns] = found.reflectivity[:, :columns]
