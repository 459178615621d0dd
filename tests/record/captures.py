"""Cases of captures: packets of every maker, what decodes from them, ground truth, and recordings of real sensors."""

import json
import os
from functools import cache
from pathlib import Path

import numpy as np

from tests.record import package
from tests.record.answers import INPUTS, Answers, case, named
from tests.record.world import scene

VELODYNE = "strongest", "last", "dual"
ROBOSENSE = "strongest", "last", "first", "dual"
HESAI = "strongest", "last", "first", "dual", "first-last", "first-strongest"
OUSTER = "strongest", "dual"
MODES = {  # that packets have, by model
    **dict.fromkeys(("hdl-32e", "hdl-64e-s2", "hdl-64e-s3", "puck-hi-res", "puck-lite", "vlp-16", "vlp-32c"), VELODYNE),
    **dict.fromkeys(("vls-128", "vls-128-2020"), VELODYNE),
    **dict.fromkeys(("helios-16p", "helios-32"), ROBOSENSE),
    **dict.fromkeys(("pandar-xt16", "pandar-xt32", "xt32m2x"), HESAI),
    "qt128": (*HESAI, "two-strongest"),
    **dict.fromkeys(("os0-32", "os0-64", "os0-128", "os1-32", "os1-64", "os1-128", "os2-128"), OUSTER),
}
VARIANTS = {  # of models, by keys of their mounts
    "vlp-16": (
        {"rpm": 1200, "phase_deg": 77, "azimuth_fov_deg": [300, 40], "velodyne": {"pps": "absent", "fix_rate_hz": 5}},
        {"rpm": 300, "velodyne": {"pps": "synchronising", "fix_rate_hz": 20}},
    ),
    "vls-128": ({"rpm": 300, "azimuth_fov_deg": [10, 200], "phase_deg": 12.5},),
    "hdl-64e-s3": ({"rpm": 900, "velodyne": {"pps": "absent"}},),
    "pandar-xt32": ({"hesai": {"turns_while_firing": True}}, {"destination": "239.0.0.1", "vlan_id": 9}),
    "qt128": ({"rpm": 1200, "azimuth_fov_deg": [350, 30]}, {"rpm": 1200, "phase_deg": 200}),
    "helios-16p": ({"rpm": 1200, "azimuth_fov_deg": [90, 180]}, {"rpm": 300, "phase_deg": 45}),
    "os0-32": (
        {"ouster": {"profile": "LEGACY", "columns": 512}, "rpm": 1200},
        {"ouster": {"profile": "RNG15_RFL8_NIR8", "columns": 2048, "firmware": "3.2", "fragments": False}},
        {"ouster": {"firmware": "3.2", "imu_profile": "ACCEL32_GYRO32_NMEA"}, "azimuth_fov_deg": [340, 90]},
        {"ouster": {"profile": "RNG15_RFL8_NIR8_DUAL", "firmware": "3.2"}, "return_mode": "dual"},
        {"ouster": {"profile": "FUSA_RNG15_RFL8_NIR8_DUAL", "firmware": "3.2"}, "return_mode": "dual", "phase_deg": 30},
        {"ouster": {"imu": False, "firmware": "3.2"}, "return_mode": "dual"},
    ),
}
WITHOUT_PACKETS = "fan-16", "jt128", "ot128", "pandar40p", "pandar64"
RECORDINGS = {  # the frozen model of each, where it must be said
    "jerry_vlp16.pcap": "vlp-16",
    "mrpt_vlp16_gps.pcap": "vlp-16",
    "nebula_vlp16.pcap": "vlp-16",
    "nebula_vlp32.pcap": "vlp-32c",
    "nebula_vls128.pcap": "vls-128",
    "veloview_hdl32e_monterey.pcap": "hdl-32e",
    "hesai/nebula_qt128.pcap": "qt128",
    "hesai/nebula_xt16.pcap": "pandar-xt16",
    "hesai/nebula_xt32.pcap": "pandar-xt32",
    "robosense/nebula_helios16p.pcap": "helios-16p",
    "ouster/OS-0-32-U1_v2.2.0_1024x10.pcap": None,
    "ouster/OS-1-128_767798045_1024x10_20230712_120049.pcap": None,
    "ouster/OS-2-128-U1_v2.3.0_1024x10.pcap": None,
    "ouster/OS-2-32-U0_v2.0.0_1024x10.pcap": None,
    "ouster/crc_test.pcap": None,
    "ouster/same_ports_legacy.pcap": None,
}
RECORDING = "recording "  # before the names of the cases about them
CAPTURES = os.environ.get("LIDARCFG_CAPTURES")
AT = package.pose((1.0, -0.5, 0.0), (0.0, 0.0, 0.4))
SHORT_S = 0.012


def quiet(warning: str) -> None:
    """For warnings, which are no part of the record."""


def cloud_of(cloud) -> dict[str, object]:
    """The columns of a cloud."""
    keys = "xyz", "intensity", "ring", "time_ns", "sensor", "return_type"
    answers = {key: getattr(cloud, key) for key in keys}
    return answers if cloud.object is None else answers | {"object": cloud.object}


@cache
def sensor(model: str) -> str:
    """The file of a frozen sensor."""
    return str(INPUTS / "sensors" / f"{model}.yaml")


def exported(folder: Path, rig, surroundings, duration_s: float, **options: object) -> dict[str, object]:
    """The files of an export, and what decodes from its packets."""
    before = set(folder.iterdir())
    path = folder / "a.pcap"
    package.export(rig, surroundings, path, duration_s, on_warning=quiet, **options)
    answers = named("decoded", cloud_of(package.decode(path, rig, on_warning=quiet)))
    for one in sorted(set(folder.iterdir()) - before):
        if one.suffix == ".json" and "beam_intrinsics" in one.read_text():  # a sensor's metadata, whatever its layout
            answers[one.name] = json.dumps(json.loads(one.read_text()), sort_keys=True).encode()
        elif one.suffix in (".pcap", ".csv"):
            answers[one.name] = one.read_bytes()
        one.unlink()
    return answers


for each, modes in MODES.items():

    @case(f"packets of {each}")
    def _packets(folder: Path, model: str = each, modes: tuple[str, ...] = modes) -> Answers:
        answers: dict[str, object] = {}
        given = [{"return_mode": mode} for mode in modes]
        for number, keys in enumerate([*given, *VARIANTS.get(model, ())]):
            place = {"name": "a", "model": sensor(model), "position_m": [0.1, 0.2, 1.9], "rpy_deg": [2, -3, 20]}
            noisy = {"realism": {"range_noise_m": 0.01, "dropout_fraction": 0.02, "divergence": [3, 2], "seed": number}}
            rig = package.rig_of(folder, [place | keys | (noisy if number else {})])
            duration_s = 0.1 if "azimuth_fov_deg" in keys else SHORT_S
            answers |= named(f"{number}", exported(folder, rig, scene("block"), duration_s, at=AT))
        return answers


@case("packets of a mixed rig")
def _mixed(folder: Path) -> Answers:
    """Sensors of four makers on a car that turns: a revolution of each."""
    rig = package.load_rig(INPUTS / "rigs" / "mixed.yaml")
    answers = exported(folder, rig, scene("block"), 0.1, at=AT, trajectory=INPUTS / "trajectory.yaml")
    package.export(rig, scene("hills"), folder / "b.pcap", 0.05, on_warning=quiet, trajectory=INPUTS / "trajectory.tum")
    answers |= named("deskewed", cloud_of(package.decode(folder / "b.pcap", rig, on_warning=quiet, deskew=True)))
    for number, scan in enumerate(package.revolutions(folder / "b.pcap", quiet, rig)):
        answers |= named(f"scan {number}", cloud_of(scan))
    return answers


for each in ("block", "wet", "hills"):

    @case(f"echoes in {each}")
    def _echoes(folder: Path, name: str = each) -> Answers:
        """The truth of every return of sensors that are not perfect, and their packets."""
        rig = package.load_rig(INPUTS / "rigs" / "real.yaml")
        answers = {}
        for moving in (False, True):
            path = package.load_path(INPUTS / "trajectory.tum" if moving else None)
            at = package.Trajectory(AT, path, package.START_NS)
            truth = []
            streams = package.packets(rig, scene(name), at, 40_000_000, on_truth=truth.append)
            octets = b"".join(record for stream in streams for some in stream for record in some.records)
            rows = np.concatenate(truth)
            rows = rows[np.argsort(rows["sensor"], kind="stable")]
            columns = {f"truth {key}": rows[key] for key in rows.dtype.names}
            answers |= named("moving" if moving else "standing", columns | {"packets": octets})
        return answers


@case("points of simulated scans")
def _scans(folder: Path) -> Answers:
    """Points with their objects, not rounded as in packets; of sensors without packets, too."""
    answers: dict[str, object] = {}
    for name in ("mixed", "real"):
        rig = package.load_rig(INPUTS / "rigs" / f"{name}.yaml")
        package.export(
            rig, scene("block"), folder / "a.npz", 0.03, on_warning=quiet, trajectory=INPUTS / "trajectory.yaml"
        )
        answers |= named(name, cloud_of(package.load_cloud(folder / "a.npz", quiet)))
    sensors = [
        {"name": model, "model": sensor(model), "position_m": [0, 0, 1.5 + 0.2 * number], "range_m": [0.5, 80]}
        for number, model in enumerate(WITHOUT_PACKETS)
    ]
    package.export(package.rig_of(folder, sensors), scene("block"), folder / "b.npz", 0.03, at=AT, on_warning=quiet)
    return answers | named("without packets", cloud_of(package.load_cloud(folder / "b.npz", quiet)))


@case("where lasers fire")
def _patterns(folder: Path) -> Answers:
    """The pattern of a revolution of every model."""
    answers: dict[str, object] = {}
    for model in MODES:
        rig = package.rig_of(folder, [{"name": "a", "model": sensor(model), "position_m": [0, 0, 1]}])
        found = package.pattern(rig.mounts[0])
        answers |= named(
            model, {"laser": found.laser, "lag": found.lag_rad, "decides": found.gating_rad, "step": found.step_rad}
        )
    return answers


if CAPTURES:
    for each in RECORDINGS:

        @case(f"{RECORDING}{each}")
        def _recording(folder: Path, name: str = each) -> Answers:
            """The points and scans of a real sensor."""
            path = Path(CAPTURES or "") / name
            model = RECORDINGS[name] and sensor(RECORDINGS[name])
            clouds = list(package.decode_pcap(path, quiet, model=model))
            answers = cloud_of(package.concatenate(clouds))
            lengths = [len(scan.xyz) for scan in package.revolutions(path, quiet, model=model)]
            return answers | {"scans": np.array(lengths)}
