"""What an export notes beside the capture, and decoding by it."""

import hashlib

import numpy as np
import pytest
import yaml

from lidarcfg.capture.manifest import load_manifest
from lidarcfg.clouds.cloud import load_cloud
from lidarcfg.errors import ConfigError
from lidarcfg.sensors.sensor import catalogue
from tests.command_line import lidarcfg


@pytest.fixture(scope="module")
def here(tmp_path_factory):
    """A VLS-128, which fires before its first packet's time, on timed poses that begin at 0."""
    folder = tmp_path_factory.mktemp("manifest")
    (folder / "drive.yaml").write_text("name: v\nsensors: [{name: a, model: vls-128, position_m: [0, 0, 2]}]\n")
    (folder / "motion.yaml").write_text(
        "poses:\n- {time_s: 0, position_m: [0, 0, 0]}\n- {time_s: 0.03, position_m: [0.3, 0, 0]}\n"
    )
    words = ("--trajectory", "motion.yaml", "--at", "1,2,5", "--start", "2026-03-01T12:00:00+01:00")
    lidarcfg(
        "export", "drive.yaml", "--scene", "data/scenes/street.yaml", *words, "--duration", 0.02, "-o", "drive.pcap",
        "--return-mode", "last", cwd=folder,
    )  # fmt: skip
    lidarcfg("decode", "drive.pcap", "--rig", "drive.yaml", *words, "-o", "said.npz", cwd=folder)
    return folder


def test_nothing_is_said_twice(here):
    """Deskewed by the manifest as by the options of the export, bit for bit."""
    lidarcfg("decode", "drive.pcap", "--deskew", "-o", "noted.npz", "--stats", cwd=here)
    noted, said = (load_cloud(here / f"{name}.npz", pytest.fail) for name in ("noted", "said"))
    assert len(noted.xyz) > 10_000
    for key in ("xyz", "time_ns", "ring", "sensor"):
        assert np.array_equal(getattr(noted, key), getattr(said, key))
    values = yaml.safe_load((here / "drive.pcap.yaml").read_text())
    assert values["rig"] == {
        "file": "drive.yaml",
        "sha256": hashlib.sha256((here / "drive.yaml").read_bytes()).hexdigest(),
    }
    assert (here / values["scene"]["file"]).resolve().name == "street.yaml"
    assert (values["return_mode"], values["duration_s"], values["at"]) == ("last", 0.02, "1,2,5")
    assert "capture manifest: 0.02 s" in lidarcfg("validate", "drive.pcap.yaml", cwd=here).stdout


@pytest.mark.parametrize(
    ("vehicle", "said"),
    [
        ("{file: a.yaml, sha256: '0', c: 1}", "vehicle.c: unknown key; allowed: file, sha256, files"),
        ("{file: a.yaml}", "vehicle.sha256: missing"),
        ("5", "vehicle: 5 is not a map of keys"),
        ("body", "vehicle: 'body' is not allowed; allowed: none, or file and sha256"),
    ],
)
def test_a_vehicle_that_is_none(here, vehicle, said):
    """Errors name keys as the file has them."""
    text = (here / "drive.pcap.yaml").read_text()
    (here / "odd.yaml").write_text(f"{text}vehicle: {vehicle}\n")
    assert said in lidarcfg("validate", "odd.yaml", code=2, cwd=here).stderr


def test_what_has_changed_is_not_taken(here):
    motion = (here / "motion.yaml").read_text()
    try:
        (here / "motion.yaml").write_text(motion + "# another\n")
        done = lidarcfg("decode", "drive.pcap", "--deskew", "-o", "no.npz", code=2, cwd=here)
        assert "drive.pcap.yaml:24:3: trajectory.file: motion.yaml has changed since the export" in done.stderr
        lidarcfg("decode", "drive.pcap", "--deskew", "--trajectory", "motion.yaml", "-o", "yes.npz", cwd=here)
        (here / "motion.yaml").unlink()
        done = lidarcfg("decode", "drive.pcap", "--deskew", "-o", "no.npz", code=2, cwd=here)
        assert "trajectory.file: motion.yaml: no such file" in done.stderr
    finally:
        (here / "motion.yaml").write_text(motion)
    done = lidarcfg("decode", "other.pcap", "--deskew", "-o", "no.npz", code=2, cwd=here)
    assert "other.pcap.yaml: the capture has no manifest; give --rig and --trajectory" in done.stderr
    assert not (here / "no.npz").exists()


def test_dual_of_thin_beams_is_said(here):
    words = ("export", "drive.yaml", "--scene", "data/scenes/street.yaml", "--duration", 0.01, "--return-mode", "dual")
    done = lidarcfg(*words, "-o", "dual.pcap", cwd=here)
    assert "warning: a: beams without divergence have one echo, so that both returns are the same" in done.stderr
    stats = lidarcfg("decode", "dual.pcap", "--stats", "-o", "dual.npz", cwd=here).stdout
    assert "vls-128, dual" in stats


def write_files(folder):
    """A rig with a sensor of its own on a vehicle of a mesh, in a scene of every kind of file."""
    import trimesh

    box = trimesh.creation.box((1.0, 1.0, 1.0))
    for name in ("wall.ply", "body.ply"):
        box.export(folder / name)
    trimesh.Scene({"crate": box}).export(str(folder / "crates.gltf"))
    np.save(folder / "hill.npy", np.zeros((3, 3)))
    trimesh.PointCloud([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0.1, 0.1, 0]]).export(folder / "map.ply")
    (folder / "scene.yaml").write_text(
        """name: s
ground: {reflectivity: 10}
meshes: [{name: wall, file: wall.ply, position_m: [9, 0, 0], reflectivity: 50}]
height_fields: [{name: hill, file: hill.npy, cell_m: 1, position_m: [30, 0, 0], reflectivity: 9}]
models: [{name: crates, file: crates.gltf, position_m: [5, 5, 0], reflectivity: 9}]
surfels: [{name: map, file: map.ply, radius_m: 0.1, position_m: [4, 4, 0], reflectivity: 9}]
"""
    )
    (folder / "own.yaml").write_bytes(catalogue()["vlp-16"].read_bytes().replace(b"name: vlp-16", b"name: own"))
    (folder / "rig.yaml").write_text(
        """name: r
sensors:
- {name: a, model: own.yaml, position_m: [0, 0, 3]}
- {name: b, model: vlp-16, position_m: [0, 1, 3]}
vehicle: {meshes: [{name: body, file: body.ply}]}
"""
    )


def test_a_change_in_what_inputs_name_is_noticed(tmp_path):
    """Meshes, height fields, buffers of glTF, maps of points, the vehicle's mesh, the sensors: hashed by hand."""
    write_files(tmp_path)
    words = ("export", "rig.yaml", "--scene", "scene.yaml", "--duration", 0.002)
    lidarcfg(*words, "-o", "a.pcap", cwd=tmp_path)
    values = yaml.safe_load((tmp_path / "a.pcap.yaml").read_text())
    noted = {key: {one["file"]: one["sha256"] for one in values[key]["files"]} for key in ("rig", "scene")}
    buffers = {path.name for path in tmp_path.glob("*.bin")}
    assert set(noted["rig"]) == {"own.yaml", "body.ply"}
    assert set(noted["scene"]) == {"wall.ply", "hill.npy", "crates.gltf", "map.ply"} | buffers
    assert buffers
    for name, digest in (noted["rig"] | noted["scene"]).items():
        assert hashlib.sha256((tmp_path / name).read_bytes()).hexdigest() == digest
    assert values["models"] == {"vlp-16": hashlib.sha256(catalogue()["vlp-16"].read_bytes()).hexdigest()}
    manifest = load_manifest(tmp_path / "a.pcap")
    for key, names in noted.items():
        for i, name in enumerate(names):
            content = (tmp_path / name).read_bytes()
            (tmp_path / name).write_bytes(content + b"\n")
            with pytest.raises(ConfigError, match=rf"{key}.files\[{i}\].file: .*{name} has changed since the export"):
                manifest.input_path(key)
            (tmp_path / name).write_bytes(content)
        assert manifest.input_path(key) == tmp_path / f"{key}.yaml"
    other = manifest.model_copy(update={"models": {"vlp-16": "0" * 64}})
    with pytest.raises(
        ConfigError, match=r"models.vlp-16: vlp-16 differs between this catalogue and that of the export"
    ):
        other.input_path("rig")
    lidarcfg(*words, "--vehicle", "none", "-o", "b.pcap", cwd=tmp_path)
    values = yaml.safe_load((tmp_path / "b.pcap.yaml").read_text())
    assert values["vehicle"] == "none"
    assert [one["file"] for one in values["rig"]["files"]] == ["own.yaml"]
    lidarcfg(*words, "--vehicle", "body.ply", "-o", "c.pcap", cwd=tmp_path)
    values = yaml.safe_load((tmp_path / "c.pcap.yaml").read_text())
    assert set(values["vehicle"]) == {"file", "sha256"}
