"""A view of files and of what Python holds, in one call: a page in a notebook, a file, a picture."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

import numpy as np
from markupsafe import escape

from lidarcfg.capture.manifest import DriveInputs
from lidarcfg.clouds.cloud import PointCloud, concatenate
from lidarcfg.errors import LidarcfgError, a_thing
from lidarcfg.files import checked_path, system_errors
from lidarcfg.sensors.rig import Rig
from lidarcfg.study.study import Study
from lidarcfg.viewer.camera import Camera
from lidarcfg.viewer.colours import By
from lidarcfg.viewer.contents import Contents, complete_inputs, load_contents
from lidarcfg.viewer.page import html, page_of, save_html
from lidarcfg.viewer.still import SIZE, save_still
from lidarcfg.world.scene import Scene
from lidarcfg.world.vehicle import rig_vehicle

HEIGHT = 600  # pixels, in a notebook


@dataclass(frozen=True)
class View:
    """Points, rigs, a study and scenes, as the page shows them; a notebook shows the page."""

    contents: Contents
    by: By  # what colours mean

    def __repr__(self) -> str:
        shown = self.contents
        parts = [f"{len(shown.cloud.xyz):,} points", *map(repr, (*shown.rigs, *shown.scenes))]
        return f"<View: {', '.join([*parts, *([repr(shown.study)] if shown.study else [])])}>"

    def save(
        self,
        path: str | Path,
        size: tuple[int, int] = SIZE,
        camera: Sequence[float] | None = None,
        worst: int | None = None,
    ) -> None:
        """Write a page that needs no server (.html), or a still picture (.png) of a size in pixels.

        `camera` is the eye and the target in metres, in the vehicle frame, and the field of view in degrees if it is
        not 60: six numbers, or seven. So many of the `worst` subspaces are shown. Raises LidarcfgError.
        """
        path = checked_path(path, "path")
        suffix = path.suffix.lower()
        if suffix not in (".html", ".png"):
            raise LidarcfgError(f"{path}: is no page and no picture; allowed: .html, .png")
        seen_from = None if camera is None else _camera(camera)
        with system_errors(path):
            if suffix == ".png":
                save_still(self.contents, path, size, seen_from, self.by, worst)
            else:
                save_html(page_of(self.contents, self.by, seen_from, worst), path)

    def _repr_html_(self) -> str:
        page = escape(html(page_of(self.contents, self.by)))
        return f'<iframe srcdoc="{page}" style="width: 100%; height: {HEIGHT}px; border: 0"></iframe>'


def view(
    *shown: str | Path | PointCloud | Rig | Study | Scene,
    by: By = "sensor",
    on_warning: Callable[[str], None] = print,
    rig: str | Path | None = None,
) -> View:
    """Show files, as `lidarcfg view` does, and what was loaded or found, side by side in the vehicle frame.

    Points are coloured `by` sensor, intensity, ring, height, time or object. `rig` is the file of the rig that recorded
    the captures, by default that of their manifest. Raises LidarcfgError for what cannot be shown, and without anything
    to show.
    """
    for one in shown:
        if not isinstance(one, str | Path | PointCloud | Rig | Study | Scene):
            allowed = "a file, a PointCloud, a Rig, a Study, a Scene"
            raise LidarcfgError(f"{a_thing(one)} is not shown; allowed: {allowed}")
    if not shown:
        raise LidarcfgError("there is nothing to show; give files, a cloud, a rig, a study or a scene")
    if by not in get_args(By):
        raise LidarcfgError(f"by is {by!r}; allowed: {', '.join(get_args(By))}")
    paths = [Path(one) for one in shown if isinstance(one, str | Path)]
    given = DriveInputs(rig=None if rig is None else checked_path(rig, "rig"))
    files, known = complete_inputs(paths, given, on_warning)
    found = load_contents(files, known.rig, None, known.motion(), on_warning, vehicle=known.vehicle)
    study = next((one for one in shown if isinstance(one, Study)), found.study)
    rigs = (*found.rigs, *(one for one in shown if isinstance(one, Rig)))
    if study and not rigs:
        rigs = (study.rig(study.space.midpoint),)
    return View(
        replace(
            found,
            cloud=concatenate([found.cloud, *(one for one in shown if isinstance(one, PointCloud))]),
            rigs=rigs,
            study=study,
            scenes=(*found.scenes, *(one for one in shown if isinstance(one, Scene))),
            body=found.body or (rig_vehicle(rigs[0]) if rigs else None),
        ),
        by,
    )


def _camera(numbers: Sequence[float]) -> Camera:
    """The camera of six numbers or seven. Raises ConfigError."""
    values = np.asarray(numbers, np.float64).ravel().tolist()
    if len(values) not in (6, 7):
        raise LidarcfgError(f"camera has {len(values)} numbers; allowed: eye and target, and the field of view")
    return Camera(np.array(values[:3]), np.array(values[3:6]), *values[6:])
