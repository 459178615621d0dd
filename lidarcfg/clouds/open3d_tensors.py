"""Clouds from and to Open3D's tensors, with all attributes."""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lidarcfg.clouds.ply_pcd import Column, Names, columns_of
from lidarcfg.errors import CloudError
from lidarcfg.geometry import Array

if TYPE_CHECKING:
    import open3d

SOURCE = "the Open3D cloud"  # in messages


def tensors(xyz: Array, columns: Mapping[str, NDArray[Any]]) -> "open3d.t.geometry.PointCloud":
    """Open3D's cloud of copies of points (N, 3) and of columns (N,), which become attributes (N, 1)."""
    import open3d as o3d

    out = o3d.t.geometry.PointCloud(o3d.core.Tensor.from_numpy(np.array(xyz, order="C")))
    for key, column in columns.items():
        out.point[key] = o3d.core.Tensor.from_numpy(np.array(column[:, None], order="C"))
    return out


def read_tensors(
    cloud: "open3d.t.geometry.PointCloud | open3d.geometry.PointCloud",
    sensor_names: Sequence[str],
    object_names: Sequence[str],
    on_warning: Callable[[str], None],
) -> tuple[dict[str, Any], dict[str, Column]]:
    """The columns of a cloud, and attributes of one value a point that no column holds. Raises CloudError."""
    import open3d as o3d

    if isinstance(cloud, o3d.geometry.PointCloud):
        attributes = {"positions": np.array(cloud.points, np.float64)}
        ignored = [name for name in ("colors", "normals") if getattr(cloud, f"has_{name}")()]
    elif isinstance(cloud, o3d.t.geometry.PointCloud):
        attributes = {name: tensor.cpu().numpy().copy() for name, tensor in cloud.point.items()}
        ignored = [name for name, column in attributes.items() if name != "positions" and column[0:1].size > 1]
    else:
        allowed = "open3d.t.geometry.PointCloud or open3d.geometry.PointCloud"
        raise CloudError(f"a {type(cloud).__name__} is no cloud of Open3D; allowed: {allowed}")
    xyz = np.asarray(attributes.pop("positions", np.empty((0, 3))), np.float64)
    fields = {name: column.reshape(-1) for name, column in attributes.items() if name not in ignored}
    objects: list[str] | None = None
    if "object" in fields:
        objects = list(object_names or map(str, range(int(fields["object"].max(initial=-1)) + 1)))
    columns, others, remarks = columns_of(SOURCE, xyz, fields, Names(list(sensor_names) or None, objects, "cloud"))
    remarks += [f"{', '.join(ignored)} ignored"] * bool(ignored)
    if remarks:
        on_warning(f"{SOURCE} {'; '.join(remarks)}")
    return columns, others
