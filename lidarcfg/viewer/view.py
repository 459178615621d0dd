"""A view of files and of what Python holds, in one call: a page in a notebook, a file, a picture."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from markupsafe import escape

from lidarcfg.capture.manifest import DriveInputs
from lidarcfg.clouds.cloud import PointCloud, concatenate
from lidarcfg.errors import LidarcfgError
from lidarcfg.sensors.rig import Rig
from lidarcfg.study.study import Study
from lidarcfg.viewer.colours import By
from lidarcfg.viewer.contents import Contents, complete_inputs, load_contents
from lidarcfg.viewer.page import html, page_of, save_html
from lidarcfg.viewer.still import save_still
from lidarcfg.world.scene import Scene
from lidarcfg.world.vehicle import rig_vehicle

HEIGHT = 600  # pixels, in a notebook


@dataclass(frozen=True)
class View:
    """Points, rigs, a study and scenes, as the page shows them; a notebook shows the page."""

    contents: Contents
    by: By  # what colours mean

    def save(self, path: str | Path) -> None:
        """Write a page that needs no server (.html), or a still picture (.png). Raises LidarcfgError."""
        suffix = Path(path).suffix.lower()
        if suffix not in (".html", ".png"):
            raise LidarcfgError(f"{path}: is no page and no picture; allowed: .html, .png")
        if suffix == ".png":
            save_still(self.contents, path, by=self.by)
        else:
            save_html(page_of(self.contents, self.by), path)

    def _repr_html_(self) -> str:
        page = escape(html(page_of(self.contents, self.by)))
        return f'<iframe srcdoc="{page}" style="width: 100%; height: {HEIGHT}px; border: 0"></iframe>'


def view(
    *shown: str | Path | PointCloud | Rig | Study | Scene,
    by: By = "sensor",
    on_warning: Callable[[str], None] = print,
) -> View:
    """Show files, as `lidarcfg view` does, and what was loaded or found, side by side in the vehicle frame.

    Points are coloured by `by`. Raises LidarcfgError for what cannot be shown, and without anything to show.
    """
    paths = [Path(one) for one in shown if isinstance(one, str | Path)]
    files, known = complete_inputs(paths, DriveInputs(), on_warning)
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
