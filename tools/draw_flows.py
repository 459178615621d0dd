"""Flow charts of the documentation: files, what is between them, and arrows. Drawn by tools/draw_concepts.py."""

from pathlib import Path

import numpy as np
from matplotlib.patches import FancyBboxPatch

from lidarcfg.report.plots import new_figure, save_figure

Boxes = dict[str, tuple[float, float, str, str]]  # by name: place, kind, text
Arrows = tuple[tuple[str, str], ...]
BOXES: Boxes = {
    "study": (0.2, 5.0, "file", "study.yaml\nregion, sensors with bounds,\nobjects, vehicle"),
    "optimize": (3.5, 5.0, "command", "optimize\nevaluate, compare, sweep"),
    "rig": (6.6, 5.0, "file", "rig.yaml\nmodels, poses, network,\nvehicle"),
    "report": (6.6, 6.7, "file", "report.html, result.json\nmax VSR, detection,\nblind spots"),
    "sensors": (0.2, 6.7, "file", "sensors/*.yaml\nbeams, firing, range"),
    "scene": (3.5, 3.3, "file", "scene.yaml\nground, objects, weather;\ntrajectory"),
    "export": (6.6, 3.3, "command", "export\nrays, echoes, packets"),
    "pcap": (6.6, 1.6, "file", "capture.pcap\npackets as the sensors\nsend them"),
    "truth": (9.7, 3.3, "file", "truth.npz\nwhat each return hit"),
    "decode": (3.5, 1.6, "command", "decode\nmerge, deskew"),
    "replay": (9.7, 1.6, "command", "replay\nto your driver, by UDP"),
    "cloud": (0.2, 1.6, "file", "cloud.ply .pcd .npz\none point a return"),
    "convert": (6.6, -0.1, "command", "convert\nROS 2, MCAP, LAS, KITTI …"),
    "view": (0.2, -0.1, "command", "view\npage, still, window"),
    "urdf": (9.7, 5.0, "command", "convert\nURDF, launch, CARLA …"),
}
ARROWS: Arrows = (
    *(("sensors", "optimize"), ("study", "optimize"), ("optimize", "rig"), ("optimize", "report"), ("rig", "export")),
    *(("scene", "export"), ("export", "truth"), ("export", "pcap"), ("pcap", "decode"), ("pcap", "replay")),
    *(("decode", "cloud"), ("cloud", "view"), ("pcap", "convert"), ("rig", "urdf")),
)
FILLS = {"file": "#eaf2fa", "command": "#fbeccb", "type": "#dcefe6"}
WIDE, HIGH = 2.6, 1.1
INSIDE: Boxes = {
    "mount": (0.2, 3.3, "file", "rig, sensor\nbeams, rpm, mode"),
    "schedule": (3.3, 3.3, "command", "schedule (codec)\nwhich laser fires when,\nat what encoder angle"),
    "simulator": (6.4, 3.3, "command", "simulator\nrays, echoes, noise"),
    "encode": (9.5, 3.3, "command", "encode (codec)\nthe maker's payloads"),
    "scene": (6.4, 5.0, "file", "scene, trajectory\nwhat rays can hit, and when"),
    "pcap": (9.5, 1.6, "file", "pcap\nEthernet, IP, UDP"),
    "stream": (6.4, 1.6, "command", "stream\nin order, losses counted"),
    "decode": (3.3, 1.6, "command", "decode (codec)\nangles, times, ranges"),
    "cloud": (0.2, 1.6, "file", "cloud\nin the vehicle frame,\nor the world's"),
}
FLOW: Arrows = (
    *(("mount", "schedule"), ("schedule", "simulator"), ("scene", "simulator"), ("simulator", "encode")),
    *(("encode", "pcap"), ("pcap", "stream"), ("stream", "decode"), ("decode", "cloud")),
)

SWEEP: Boxes = {
    "plan": (0.2, 3.3, "file", "plan.yaml\na study, the keys that\nvary, their values"),
    "sweep": (3.5, 3.3, "command", "lidarcfg sweep\na run per combination;\nit alone writes files"),
    "scheduler": (6.6, 3.3, "command", "dask scheduler\nhands out runs,\ngives lost ones again"),
    "worker": (9.7, 5.0, "command", "dask worker\none run at a time,\none thread"),
    "other": (9.7, 3.3, "command", "dask worker\non any machine,\nno shared disk"),
    "last": (9.7, 1.6, "command", "dask worker\nmay come and go"),
    "runs": (3.5, 1.6, "file", "runs/NAME/\nresult.json, rig.yaml,\nwritten when a run ends"),
    "table": (0.2, 1.6, "file", "table.csv, .parquet\na row a run;\nsweep.png"),
}
SWEPT: Arrows = (
    *(("plan", "sweep"), ("sweep", "scheduler"), ("scheduler", "sweep"), ("sweep", "runs"), ("runs", "table")),
    *(
        (one, other)
        for name in ("worker", "other", "last")
        for one, other in (("scheduler", name), (name, "scheduler"))
    ),
)
PYTHON: Boxes = {
    "study": (0.2, 6.7, "command", "load_study\nstudy.yaml"),
    "Study": (3.4, 6.7, "type", "Study\nregion, sensors with\nbounds, objective"),
    "optimize": (6.6, 6.7, "command", "optimize\nsearches"),
    "Placement": (9.7, 6.7, "type", "Placement\nrig, objective, history"),
    "rig": (0.2, 5.0, "command", "load_rig\nrig.yaml"),
    "Rig": (3.4, 5.0, "type", "Rig\nmounts: sensor and pose"),
    "evaluate": (6.6, 5.0, "command", "evaluate\none rig in a study"),
    "Evaluation": (9.7, 5.0, "type", "Evaluation\nmax_vsr_m, subspaces,\ndetection"),
    "capture": (0.2, 3.3, "file", "capture.pcap\nof export, or recorded"),
    "decode": (3.4, 3.3, "command", "decode\npackets to points,\nmerged by the rig"),
    "cloud": (6.6, 3.3, "type", "PointCloud\nxyz, intensity, ring,\ntime_ns, sensor"),
    "scene": (0.2, 1.6, "command", "load_scene\nscene.yaml"),
    "Scene": (3.4, 1.6, "type", "Scene\nstatic and dynamic\nobjects, weather"),
    "export": (6.6, 1.6, "command", "export\nrays, echoes, packets"),
    "files": (9.7, 1.6, "file", "capture.pcap\nor points with\nground truth"),
}
CALLS: Arrows = (
    *(("study", "Study"), ("Study", "optimize"), ("optimize", "Placement"), ("Study", "evaluate"), ("rig", "Rig")),
    *(("Rig", "evaluate"), ("evaluate", "Evaluation"), ("Rig", "decode"), ("capture", "decode"), ("decode", "cloud")),
    *(("Rig", "export"), ("scene", "Scene"), ("Scene", "export"), ("export", "files")),
)
PARTS: Boxes = {
    "commands": (4.95, 6.7, "command", "commands/\nthe command line"),
    "report": (1.2, 5.0, "type", "report/\nHTML, JSON, tables"),
    "view": (4.95, 5.0, "type", "view/\npage, still, window"),
    "formats": (8.7, 5.0, "type", "formats/\nother tools' files"),
    "placement": (1.2, 3.3, "type", "placement/\nregion, subspaces,\nsolvers"),
    "simulate": (8.7, 3.3, "type", "simulate/\nrays, echoes, noise"),
    "capture": (8.7, 1.6, "type", "capture/\npcap, stream, decode"),
    "packets": (8.7, -0.1, "type", "packets/\na codec per family"),
    "world": (4.95, -0.1, "type", "world/\nscene, motion, tracer"),
    "rig": (1.2, -0.1, "file", "rig.py, sensor.py\nmounts, models"),
}
IMPORTS: Arrows = (
    *(("commands", "report"), ("commands", "view"), ("commands", "formats"), ("report", "placement")),
    *(("view", "placement"), ("view", "simulate"), ("formats", "simulate"), ("simulate", "capture")),
    *(("capture", "packets"), ("packets", "world"), ("placement", "world"), ("world", "rig")),
)


def data(path: Path) -> None:
    """The files (blue) and the commands (yellow) between them."""
    _flow(path, BOXES, ARROWS, (10.5, 6.4))


def packets(path: Path) -> None:
    """From a rig to packets and back: what of it is the codec's."""
    _flow(path, INSIDE, FLOW, (10.5, 4.0))


def sweep(path: Path) -> None:
    """A sweep on a cluster: what is a file, what a process, and who speaks with whom."""
    _flow(path, SWEEP, SWEPT, (10.5, 4.0))


def python(path: Path) -> None:
    """The functions of the package (yellow), and the types that they take and give (green)."""
    _flow(path, PYTHON, CALLS, (10.5, 5.4))


def parts(path: Path) -> None:
    """The package's folders; an arrow points at what a folder may import, with all that follows it."""
    _flow(path, PARTS, IMPORTS, (10.5, 6.4))


def _flow(path: Path, boxes: Boxes, arrows: Arrows, size_in: tuple[float, float]) -> None:
    """Boxes with text, and arrows between them: level ones, or else upright ones."""
    figure = new_figure(*size_in)
    axis = figure.subplots()
    for x, y, kind, text in boxes.values():
        style = "round,pad=0.02,rounding_size=0.1" if kind == "file" else "round,pad=0.02,rounding_size=0.5"
        axis.add_patch(FancyBboxPatch((x, y), WIDE, HIGH, boxstyle=style, facecolor=FILLS[kind], edgecolor="0.4"))
        first, _, rest = text.partition("\n")
        axis.text(x + WIDE / 2, y + HIGH - 0.25, first, ha="center", va="center", fontweight="bold", fontsize=10)
        axis.text(x + WIDE / 2, y + 0.38, rest, ha="center", va="center", fontsize=8.5)
    for one, other in arrows:
        (ax, ay), (bx, by) = (np.add(boxes[name][:2], (WIDE / 2, HIGH / 2)) for name in (one, other))
        level = abs(bx - ax) > 1
        side, up = np.sign(bx - ax) * WIDE / 2 * level, np.sign(by - ay) * HIGH / 2 * (not level)
        start, end = (ax + side, ay + up), (bx - side, by - up)
        axis.annotate("", end, start, arrowprops={"arrowstyle": "-|>", "color": "0.25", "linewidth": 1.4})
    ys = [box[1] for box in boxes.values()]
    axis.set(xlim=(0, 12.5), ylim=(min(ys) - 0.2, max(ys) + HIGH + 0.2), aspect="equal")
    axis.axis("off")
    save_figure(figure, path)
