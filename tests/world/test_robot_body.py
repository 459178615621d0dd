"""Bodies of robots: places by urdf_parser_py's tree and SciPy's rotations, shapes by trimesh's or by hand."""

import math
import os
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation
from urdf_parser_py.urdf import URDF, Box, Cylinder, Mesh, Sphere

from lidarcfg.errors import ConfigError, SceneError
from lidarcfg.world.robot_body import robot_body
from lidarcfg.world.vehicle import load_vehicle

ROOT = Path(__file__).parents[2]
ROBOT = ROOT / "data/vehicles/delivery-robot.urdf"
CHORD = 0.0011  # metres: facets are within a millimetre of what is round

LINK = '<link name="{}"><visual>{}<geometry>{}</geometry></visual></link>'


def written(folder, geometry, origin="", name="base_link", more=""):
    path = folder / "robot.urdf"
    path.write_text(f'<robot name="r">{LINK.format(name, origin, geometry)}{more}</robot>')
    return path


def moved(origin):
    T = np.eye(4)
    if origin:
        T[:3, :3] = Rotation.from_euler("xyz", origin.rpy or (0, 0, 0)).as_matrix()
        T[:3, 3] = origin.xyz or (0, 0, 0)
    return T


def chained(robot, name):
    """T_base_link: below base_link, or above."""
    T = np.eye(4)
    if name == "base_footprint":
        return np.linalg.inv(moved(robot.joints[0].origin))
    while name != "base_link":
        joint = next(one for one in robot.joints if one.child == name)
        T = moved(joint.origin) @ T
        name = joint.parent
    return T


def shape_of(geometry, folder):
    """A shape of trimesh's, with many more facets than ours."""
    if isinstance(geometry, Box):
        return trimesh.creation.box(geometry.size)
    if isinstance(geometry, Cylinder):
        return trimesh.creation.cylinder(geometry.radius, geometry.length, sections=720)
    if isinstance(geometry, Sphere):
        return trimesh.creation.icosphere(5, geometry.radius)
    assert isinstance(geometry, Mesh)
    return trimesh.load_mesh(folder / geometry.filename).apply_scale(geometry.scale or (1, 1, 1))


def test_the_delivery_robot_is_where_another_parser_puts_it():
    robot = URDF.from_xml_string(ROBOT.read_text().split("?>", 1)[1])
    body = robot_body(ROBOT)
    links = {link.name: link for link in robot.links}
    assert body.without == ("vlp16", "mid360_front")
    assert set(body.links) == {name for name, link in links.items() if link.visuals or link.collisions} - {
        *body.without
    }
    for name in body.links:
        theirs = []
        for shape in links[name].visuals or links[name].collisions:
            placed = shape_of(shape.geometry, ROBOT.parent)
            theirs.append(placed.apply_transform(chained(robot, name) @ moved(shape.origin)))
        ours = trimesh.Trimesh(*robot_body(ROBOT, without=links.keys() - {name}).mesh)
        bounds = np.array([one.bounds for one in theirs])
        np.testing.assert_allclose(ours.bounds, (bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)), atol=CHORD)
        volume = sum(one.volume for one in theirs)
        assert 0.97 * volume < ours.volume < 1.00001 * volume  # outward; facets are inside of what is round
    assert load_vehicle(ROBOT).closed.keys() == {"body"}
    whole = body.mesh[0]
    np.testing.assert_allclose(
        (whole.min(axis=0), whole.max(axis=0)), ((-0.34, -0.28, -0.1), (0.34, 0.28, 0.54)), atol=CHORD
    )


@pytest.mark.parametrize(
    ("geometry", "origin", "low", "high", "volume"),
    [
        ('<box size="1 2 3"/>', '<origin xyz="10 0 0"/>', (9.5, -1, -1.5), (10.5, 1, 1.5), 6),
        ('<box size="1 2 3"/>', f'<origin xyz="0 0 1" rpy="0 0 {math.pi / 2}"/>', (-1, -0.5, -0.5), (1, 0.5, 2.5), 6),
        ('<box size="1 2 3"/>', f'<origin rpy="{math.pi / 2} 0 {math.pi / 2}"/>', (-1.5, -0.5, -1), (1.5, 0.5, 1), 6),
        ('<cylinder radius="0.5" length="2"/>', "", (-0.5, -0.5, -1), (0.5, 0.5, 1), math.pi / 2),
        ('<cylinder radius="0.5" length="2"/>', f'<origin rpy="0 {math.pi / 2} 0"/>', (-1, -0.5, -0.5), (1, 0.5, 0.5), math.pi / 2),
        ('<sphere radius="2"/>', '<origin xyz="1 1 1"/>', (-1, -1, -1), (3, 3, 3), 4 / 3 * math.pi * 8),
    ],
)  # fmt: skip
def test_shapes_by_hand(tmp_path, geometry, origin, low, high, volume):
    """rpy is about the fixed axes x, then y, then z: y of the third box ends along z, then that stays; x ends along y."""
    vertices, triangles = robot_body(written(tmp_path, geometry, origin)).mesh
    np.testing.assert_allclose((vertices.min(axis=0), vertices.max(axis=0)), (low, high), atol=CHORD)
    assert 0.995 * volume < trimesh.Trimesh(vertices, triangles).volume < volume * 1.000001


@pytest.mark.parametrize("suffix", ["stl", "obj", "ply", "glb", "off"])
def test_meshes_of_any_format_are_scaled_and_mirrored(tmp_path, suffix):
    """A tetrahedron of the volume 1/6, at (1, 0, 0); a mirror leaves it outward."""
    tetra = trimesh.Trimesh([(1, 0, 0), (2, 0, 0), (1, 1, 0), (1, 0, 1)], [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)])
    tetra.export(tmp_path / f"part.{suffix}")
    vertices, triangles = robot_body(
        written(tmp_path, f'<mesh filename="part.{suffix}" scale="2 -3 0.5"/>', '<origin xyz="0 0 7"/>')
    ).mesh
    np.testing.assert_allclose((vertices.min(axis=0), vertices.max(axis=0)), ((2, -3, 7), (4, 0, 7.5)), atol=1e-7)
    assert trimesh.Trimesh(vertices, triangles).volume == pytest.approx(2 * 3 * 0.5 / 6)


DAE = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit meter="0.01" name="centimeter"/><up_axis>Z_UP</up_axis></asset>
<library_geometries><geometry id="g"><mesh><source id="p">
<float_array id="pa" count="12">0 0 0 1 0 0 0 1 0 0 0 1</float_array><technique_common>
<accessor source="#pa" count="4" stride="3"><param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/></accessor>
</technique_common></source><vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="4"><input semantic="VERTEX" source="#v" offset="0"/><p>0 2 1 0 1 3 0 3 2 1 2 3</p></triangles></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s"><node id="n"><translate>10 0 0</translate><scale>2 3 4</scale>
<instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>
"""


def test_a_collada_mesh_is_in_metres_and_its_nodes_in_their_places(tmp_path):
    """A tetrahedron in centimetres, twice, three and four times as large, moved by 10; then mirrored; by hand."""
    pytest.importorskip("collada")
    (tmp_path / "part.dae").write_text(DAE)
    vertices, triangles = robot_body(written(tmp_path, '<mesh filename="part.dae" scale="1 -1 1"/>')).mesh
    np.testing.assert_allclose(
        (vertices.min(axis=0), vertices.max(axis=0)), ((0.1, -0.03, 0), (0.12, 0, 0.04)), atol=1e-9
    )
    assert trimesh.Trimesh(vertices, triangles).volume == pytest.approx(2 * 3 * 4 / 6 * 1e-6)
    for wrong in (DAE[:900], "<COLLADA/>", DAE.replace("0 2 1 0 1 3", "0 2 9 0 1 3"), DAE.replace("#g", "#h"), ""):
        (tmp_path / "part.dae").write_text(wrong)
        with pytest.raises(
            SceneError, match=r"robot.urdf: link 'base_link': .*part.dae: (not a whole Collada file|no tri)"
        ):
            robot_body(tmp_path / "robot.urdf")


@pytest.mark.parametrize(
    ("urdf", "mesh", "filename", "variable"),
    [
        ("src/my_bot/urdf", "src/my_bot/meshes", "package://my_bot/meshes/a.stl", None),
        ("src/bringup/urdf", "src/my_bot/meshes", "package://my_bot/meshes/a.stl", None),
        ("here", "ros/my_bot/meshes", "package://my_bot/meshes/a.stl", ("ROS_PACKAGE_PATH", "ros")),
        ("here", "ros/my_bot/meshes", "model://my_bot/meshes/a.stl", ("ROS_PACKAGE_PATH", "ros/my_bot")),
        ("here", "install/share/my_bot", "package://my_bot/a.stl", ("AMENT_PREFIX_PATH", "install")),
        ("here", "here/sub dir", "sub dir/a.stl", None),
        ("here", "there", "../there/a.stl", None),
        ("here", "else where", "file://TMP/else%20where/a.stl", None),
    ],
)
def test_meshes_are_found(tmp_path, monkeypatch, urdf, mesh, filename, variable):
    for folder in (urdf, mesh):
        (tmp_path / folder).mkdir(parents=True, exist_ok=True)
    trimesh.creation.box((1, 2, 3)).export(tmp_path / mesh / "a.stl")
    if variable:
        monkeypatch.setenv(variable[0], os.pathsep.join(["/nowhere", str(tmp_path / variable[1])]))
    path = written(tmp_path / urdf, f'<mesh filename="{filename.replace("TMP", str(tmp_path))}"/>')
    body = robot_body(path)
    assert np.ptp(body.mesh[0], axis=0).tolist() == [1, 2, 3]
    assert [file.resolve() for file in body.files] == [tmp_path / mesh / "a.stl"]


JOINT = '<joint name="{0}" type="fixed"><parent link="{1}"/><child link="{0}"/><origin xyz="{2}"/></joint>'
BOX = '<box size="0.1 0.1 0.1"/>'


@pytest.mark.parametrize(
    ("name", "left_out"),
    [
        ("front_lidar_link", True),
        ("velodyne_base_link", True),
        ("os_sensor", True),
        ("lidar_mount", True),  # the lowest that is called so: what else could be the LiDAR?
        ("imu_laser", False),
        ("chassis", False),
    ],
)
def test_links_called_as_lidars_are_left_out(tmp_path, name, left_out):
    more = LINK.format(name, "", BOX) + JOINT.format(name, "base_link", "0 0 2")
    body = robot_body(written(tmp_path, BOX, more=more))
    assert (body.without == (name,)) == left_out
    assert body.mesh[0][:, 2].max() == pytest.approx(0.05 if left_out else 2.05)


def test_what_holds_a_lidar_stays(tmp_path):
    more = LINK.format("lidar_mount", "", BOX) + JOINT.format("lidar_mount", "base_link", "0 0 2")
    more += LINK.format("lidar", "", BOX) + JOINT.format("lidar", "lidar_mount", "0 0 1")
    path = written(tmp_path, BOX, more=more)
    assert (robot_body(path).links, robot_body(path).without) == (("base_link", "lidar_mount"), ("lidar",))
    assert robot_body(path, []).links == ("base_link", "lidar_mount", "lidar")
    assert robot_body(path, ["lidar", "base_link"]).links == ("lidar_mount",)


def test_the_vehicle_frame_is_base_link_and_what_collides_counts_where_nothing_is_seen(tmp_path):
    """By hand: base_footprint is 0.3 m below; its plate of collision is 0.1 m high."""
    path = tmp_path / "r.urdf"
    plate = '<collision><geometry><box size="1 1 0.1"/></geometry></collision>'
    path.write_text(
        f'<robot name="r"><link name="base_footprint">{plate}</link>{LINK.format("base_link", "", BOX)}'
        '<joint name="j" type="fixed"><parent link="base_footprint"/><child link="base_link"/><origin xyz="0 0 0.3"/>'
        "</joint></robot>"
    )
    body = robot_body(path)
    assert body.base == "base_link"
    np.testing.assert_allclose(body.mesh[0].min(axis=0), (-0.5, -0.5, -0.35), atol=1e-12)
    assert "its lowest point is at z = -0.350 m" in load_vehicle(path).warnings[0]


HUGE = '<mesh filename="huge.stl"/>'


@pytest.mark.parametrize(
    ("geometry", "message"),
    [
        ('<mesh filename="gone.stl"/>', "link 'base_link': mesh '{tmp}/gone.stl': no such file"),
        ('<mesh filename="package://gone/a.stl"/>', "link 'base_link': package 'gone' is not found; looked for a folder"),
        ('<mesh filename="http://x/a.stl"/>', "link 'base_link': mesh 'http://x/a.stl' is not fetched; allowed: package"),
        ("<mesh/>", "link 'base_link': mesh: has no filename"),
        ('<mesh filename="robot.urdf"/>', "robot.urdf: a robot; a vehicle or a scene names it under meshes"),
        (HUGE, "huge.stl: larger than the 500 million bytes"),
        ('<box size="1 -2 3"/>', "link 'base_link': box: size '1 -2 3' is not allowed; allowed: above 0"),
        ('<box size="1 2"/>', "link 'base_link': size '1 2' is not three numbers"),
        ('<sphere radius="0"/>', "link 'base_link': sphere: radius '0' is not allowed; allowed: above 0"),
        ('<cylinder radius="1"/>', "link 'base_link': cylinder: length '' is not allowed; allowed: above 0"),
        ('<cylinder radius="wide" length="1"/>', "cylinder: radius 'wide' is not allowed"),
        ("<cone/>", "link 'base_link': its geometry is <cone>; allowed: one of box, cylinder, sphere, mesh"),
        ("", "link 'base_link': its geometry is nothing; allowed: one of"),
        ('<box size="1 1 1"/><link', "robot.urdf:1:"),
    ],
)  # fmt: skip
def test_mistakes_have_one_line(tmp_path, geometry, message):
    path = written(tmp_path, geometry)
    if geometry == HUGE:
        with (tmp_path / "huge.stl").open("wb") as file:
            file.truncate(500_000_001)
    with pytest.raises(SceneError) as error:
        robot_body(path)
    assert message.format(tmp=tmp_path) in str(error.value)
    with pytest.raises(ConfigError) as error:
        load_vehicle(path)
    assert message.format(tmp=tmp_path) in str(error.value)
    assert "\n" not in str(error.value)


def test_mistakes_of_trees_have_one_line(tmp_path):
    path = tmp_path / "r.urdf"
    two = LINK.format("a", "", BOX) + LINK.format("b", "", BOX)
    for text, message in (
        (two + JOINT.format("a", "b", "0 0 0") + JOINT.format("b", "a", "0 0 0"), "is above itself"),
        (two, "has 2 roots: a, b"),
        ('<link name="a"/>', "has no shapes"),
        ("", "has no link"),
        (LINK.format("a", "", '<mesh filename="a.stl" scale="1 0 1"/>'), "scale '1 0 1' is flat"),
        (LINK.format("a", '<origin xyz="1e9 0 0"/>', BOX), "link 'a': reaches beyond"),
    ):
        path.write_text(f'<robot name="r">{text}</robot>')
        trimesh.creation.box().export(tmp_path / "a.stl")
        with pytest.raises(SceneError) as error:
            robot_body(path)
        assert message in str(error.value)
    path.write_text(f'<robot name="r">{LINK.format("a", "", BOX)}</robot>')
    with pytest.raises(SceneError, match=r"has no link 'lid'; its links: a"):
        robot_body(path, ["lid"])
