"""Open3D's own window, for machines with a screen."""

import os
import sys
from typing import Any

import numpy as np

from lidarcfg.errors import CloudError
from lidarcfg.geometry import transform
from lidarcfg.viewer.bodies import region_bodies, score
from lidarcfg.viewer.colours import BACKGROUND, EXCLUDED, By, point_colours, rgb
from lidarcfg.viewer.contents import Contents
from lidarcfg.viewer.timeline import mesh_at


def has_screen() -> bool:
    """Whether windows can open here."""
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def show_window(contents: Contents, by: By) -> None:
    """Open Open3D's window. Raises CloudError where there is no screen."""
    import open3d as o3d

    if not has_screen():
        raise CloudError("there is no screen for a window; --png FILE draws a still without one")
    window = o3d.visualization.Visualizer()
    if not window.create_window("lidarcfg"):
        raise CloudError("Open3D could not open a window on this screen; --png FILE draws a still")
    for part in parts(contents, by):
        window.add_geometry(part)
    window.get_render_option().background_color = np.array(BACKGROUND) / 255.0
    window.get_render_option().point_size = 2.0
    window.get_render_option().mesh_show_back_face = True
    window.run()
    window.destroy_window()


def parts(contents: Contents, by: By) -> list[Any]:
    """Open3D's geometries; bodies are the edges of their faces, as the window draws nothing translucent."""
    import open3d as o3d

    found: list[Any] = [o3d.geometry.TriangleMesh.create_coordinate_frame(1.0)]
    if len(contents.cloud.xyz):
        points = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(contents.cloud.xyz))
        points.colors = o3d.utility.Vector3dVector(point_colours(contents, by) / 255.0)
        found.append(points)
    found += [
        o3d.geometry.TriangleMesh.create_coordinate_frame(0.5).transform(mount.T_vehicle_sensor)
        for rig in contents.rigs
        for mount in rig.mounts
    ]
    for scene in contents.scenes:
        vertices, triangles = mesh_at(scene, contents.first_ns - contents.zero_ns)
        mesh = o3d.geometry.TriangleMesh(
            o3d.utility.Vector3dVector(transform(contents.T_vehicle_world, vertices)),
            o3d.utility.Vector3iVector(triangles),
        )
        found.append(mesh.compute_vertex_normals().paint_uniform_color(rgb([EXCLUDED])[0] / 255.0))
    if contents.study:
        for quads, code in region_bodies(contents.study, score(contents.study, contents.rigs[0], 1)):
            corners = quads.reshape(-1, 3)
            first = 4 * np.arange(len(quads))[:, None]
            ends = (first[:, :, None] + np.array([[0, 1], [1, 2], [2, 3], [3, 0]])).reshape(-1, 2)
            lines = o3d.geometry.LineSet(o3d.utility.Vector3dVector(corners), o3d.utility.Vector2iVector(ends))
            found.append(lines.paint_uniform_color(rgb([code])[0] / 255.0))
    return found
