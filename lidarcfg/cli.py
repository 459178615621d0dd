"""The commands: each reads its inputs, makes one library call and prints one table."""

import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import lidarcfg
from lidarcfg.errors import LidarcfgError

if TYPE_CHECKING:
    from lidarcfg.capture.source import SourceStats
    from lidarcfg.capture.trajectory import Trajectory
    from lidarcfg.geometry import Array
    from lidarcfg.placement.optimize import Cycle, Log
    from lidarcfg.placement.study import Solver
    from lidarcfg.rig import Rig

FILE = click.Path(path_type=Path)
SECOND_NS = 10**9
SAVE_EVERY_S = 5.0
START_HELP = "ISO 8601, UTC unless it says.  [default: 2026-01-01T00:00:00]"


class Seconds(click.FloatRange):
    """A number above zero, of seconds if nothing else is said; click's own range lets NaN pass."""

    name = "seconds"

    def __init__(self, most: float) -> None:
        super().__init__(0, most, min_open=True)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The number, or click's error."""
        number = float(super().convert(value, param, ctx))
        if number != number:
            self.fail(f"{value} is not a number", param, ctx)
        return number


class Share(Seconds):
    """A relative error: above zero, at most one."""

    name = "share"


quiet_option = click.option("--quiet", is_flag=True, help="Print nothing but errors.")
THREADS = click.IntRange(1, 1024)


def main() -> None:
    """Entry point: 0 when done, 2 with one line for the user's mistake, 130 after Ctrl-C, 1 for a bug."""
    for name in ("SIGTERM", "SIGHUP"):  # as Ctrl-C: what was reached is kept, nothing half-written stays
        number = getattr(signal, name, None)
        if number and signal.getsignal(number) != signal.SIG_IGN:  # nohup's wish stands
            signal.signal(number, signal.default_int_handler)
    if hasattr(signal, "SIGPIPE"):
        signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # who read our output has gone: end quietly, as other tools do
    sys.stdout, sys.stderr = sys.stdout or open(os.devnull, "w"), sys.stderr or open(os.devnull, "w")  # noqa: SIM115
    try:
        code = cli.main(standalone_mode=False)
    except click.ClickException as error:
        message = " ".join(error.format_message().split())
        _fail(f"{message} (see {_command_path(error)} --help)")
    except LidarcfgError as error:
        _fail(str(error))
    except OSError as error:
        _fail(f"{error.filename}: {(error.strerror or str(error)).lower()}" if error.filename else str(error))
    except MemoryError:
        _fail("out of memory; a coarser grid, fewer samples or a shorter capture need less")
    except ImportError as error:
        if ".so" not in str(error):
            raise
        _fail(f"a system library is missing: {error} (Debian: apt-get install libegl1 libgl1 libusb-1.0-0)")
    except (click.Abort, KeyboardInterrupt):
        click.echo("interrupted", err=True)
        sys.exit(130)
    sys.exit(code or 0)


def _command_path(error: click.ClickException) -> str:
    context = getattr(error, "ctx", None)
    return context.command_path if context else "lidarcfg"


def _fail(message: str) -> None:
    click.echo(f"lidarcfg: {_one_line(message)}", err=True)
    sys.exit(2)


def _one_line(text: str) -> str:
    """With control characters written out, as a name may hold them."""
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


@click.group(
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(lidarcfg.__version__, prog_name="lidarcfg")
@click.pass_context
def cli(context: click.Context) -> None:
    """Where should the LiDARs sit on this vehicle, and what will they hear?

    \b
    lidarcfg optimize data/studies/liu2018-2x16.yaml -o out/two        place two LiDARs
    lidarcfg evaluate data/studies/liu2018-2x16.yaml out/two/rig.yaml  how well do they see?
    lidarcfg export out/two/rig.yaml --scene data/scenes/street.yaml \\
        --at=-30,-10,0 --duration 1 -o out/two.pcap                    what do they send?
    lidarcfg decode out/two.pcap --rig out/two/rig.yaml -o out/two.ply merged points
    lidarcfg view out/two.ply --png out/two.png                        a picture
    """
    if context.invoked_subcommand is None:
        click.echo(context.get_help())


@cli.command()
@click.argument("study", type=FILE)
@click.option("-o", "--output", type=FILE, help="Folder for the results.  [default: out/STUDY]")
@click.option("--seed", type=click.IntRange(0, 2**63 - 1), help="Seed of the search.  [default: the study's]")
@click.option("--threads", type=THREADS, help="Threads; the result is the same on any number.  [default: all]")
@click.option(
    "--solver", type=click.Choice(["auto", "abc", "cmaes", "de"]), help="How to search.  [default: the study's]"
)
@click.option("--cycles", type=click.IntRange(1), help="Budget: cycles of the swarm.")
@click.option("--evaluations", type=click.IntRange(1), help="Budget: trials.")
@click.option("--seconds", type=Seconds(1e9), help="Budget: seconds.")
@click.option("--resume", type=FILE, metavar="DIR", help="Go on with the search whose results are in DIR.")
@quiet_option
def optimize(
    study: Path,
    output: Path | None,
    seed: int | None,
    threads: int | None,
    solver: str | None,
    cycles: int | None,
    evaluations: int | None,
    seconds: float | None,
    resume: Path | None,
    quiet: bool,
) -> None:
    """Place the sensors of STUDY so that the largest subspace they cannot see is smallest.

    A budget given here replaces the study's. Ctrl-C ends the search and keeps the best so far; every few seconds
    rig.yaml and search.npz are brought up to date, so that even a killed search can go on with --resume.

    \b
    Example:
      lidarcfg optimize data/studies/liu2018-4x16.yaml -o out/four --seed 3 --seconds 60
    """
    import time

    from lidarcfg import report
    from lidarcfg.placement.optimize import optimize as search
    from lidarcfg.placement.study import load_study, with_solver

    loaded = with_solver(
        load_study(study),
        seed=seed,
        method=solver,
        cycles=cycles,
        evaluations=evaluations,
        seconds=seconds,
    )
    folder = output or resume or Path("out") / loaded.name
    log = report.load_log(loaded, resume) if resume else None
    report.check_writable(folder)
    saved = time.monotonic()
    with _progress(quiet) as on_share:

        def on_cycle(cycle: "Cycle", rig: "Rig", log: "Log") -> None:
            nonlocal saved
            on_share(*_search_line(loaded.solver, cycle))
            if time.monotonic() - saved > SAVE_EVERY_S:
                report.save_progress(loaded, rig, log, folder)
                saved = time.monotonic()

        found = search(loaded, threads, on_cycle, log)
    report.save_placement(loaded, found, folder)
    if not quiet:
        report.print_placement(found)
        click.echo(f"written to {folder}/: rig.yaml result.json history.csv convergence.png rig.png search.npz")
    if found.interrupted:
        click.echo("interrupted; the best so far is kept", err=True)
        sys.exit(130)


def _search_line(solver: "Solver", cycle: "Cycle") -> tuple[float, str]:
    """How much of the budget is spent, and how the search stands."""
    budgets = (
        (cycle.cycle, solver.cycles),
        (cycle.evaluations, solver.evaluations),
        (cycle.seconds, solver.seconds),
    )
    rate = cycle.evaluations / cycle.seconds
    stand = f"cycle {cycle.cycle}  best {cycle.best:.4f}  mean {cycle.mean:.4f}"
    return max(spent / budget for spent, budget in budgets if budget), f"{stand}  {rate:,.0f} evaluations/s"


@cli.command()
@click.argument("study", type=FILE)
@click.argument("rig", type=FILE)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document and nothing else.")
@click.option("-o", "--output", type=FILE, help="Folder for result.json and rig.png.")
@click.option("--tolerance", type=Share(1), help="Also the analytic max VSR, to this relative error.")
@quiet_option
def evaluate(study: Path, rig: Path, as_json: bool, output: Path | None, tolerance: float | None, quiet: bool) -> None:
    """How well RIG sees in the region of STUDY: max VSR, the worst subspaces, detection rates.

    The beams are the rig's; region and objects are the study's, whose bounds are not enforced. With --tolerance
    the cuboids are halved until the max VSR of the subspaces themselves, which the cuboids' faces overrate the
    surface of, is known to it.

    \b
    Example:
      lidarcfg evaluate data/studies/sedan.yaml data/rigs/roof.yaml --json
    """
    from lidarcfg import report
    from lidarcfg.placement.study import evaluate as judge
    from lidarcfg.placement.study import load_study
    from lidarcfg.rig import load_rig

    loaded, mounted = load_study(study), load_rig(rig)
    found = judge(loaded, mounted, tolerance)
    if output:
        report.save_evaluation(loaded, mounted, found, output)
    if as_json:
        click.echo(report.to_json(report.evaluation_dict(loaded, mounted, found)))
    elif not quiet:
        report.print_evaluation(mounted, found)


@cli.group(invoke_without_command=True)
@click.pass_context
def sensors(context: click.Context) -> None:
    """The catalogue of sensor models.

    \b
    Example:
      lidarcfg sensors show vlp-16
    """
    if context.invoked_subcommand is None:
        context.invoke(list_sensors)


@sensors.command("list")
@quiet_option
def list_sensors(quiet: bool = False) -> None:
    """List the models: name, beams, elevations, and what is known of them."""
    from lidarcfg import report
    from lidarcfg.sensor import catalogue, load_sensor

    if not quiet:
        report.print_sensors([load_sensor(name) for name in catalogue()])


@sensors.command("show")
@click.argument("name")
@quiet_option
def show_sensor(name: str, quiet: bool) -> None:
    """Show the model NAME: its beam table, timing and packet facts with their sources.

    \b
    Example:
      lidarcfg sensors show vlp-16
    """
    from lidarcfg import report
    from lidarcfg.sensor import load_sensor

    sensor = load_sensor(name)
    if not quiet:
        report.print_sensor(sensor)


@cli.command()
@click.argument("rig", type=FILE)
@click.option("--scene", type=FILE, required=True, help="The scene's YAML.")
@click.option("--duration", type=Seconds(86_400), required=True, help="Seconds.")
@click.option("-o", "--output", type=FILE, required=True, help="The .pcap to write.")
@click.option("--split", is_flag=True, help="One file a sensor instead, FILE-NAME.pcap.")
@click.option("--at", default="0,0,0", metavar="X,Y,YAW_DEG", help="Where the vehicle stands in the scene.")
@click.option("--start", metavar="TIME", help=START_HELP)
@click.option("--trajectory", type=FILE, help="How the vehicle moves from there: .yaml, or timed poses as .tum.")
@click.option("--truth", type=FILE, help="Write object, exact range and noise of each return to this .npz.")
@click.option("--no-skip", is_flag=True, help="Cast every beam, also those that cannot meet anything.")
@click.option("--stats", is_flag=True, help="Say how many beams were fired and how many were cast.")
@quiet_option
def export(
    rig: Path,
    scene: Path,
    duration: float,
    output: Path,
    split: bool,
    at: str,
    start: str | None,
    trajectory: Path | None,
    truth: Path | None,
    no_skip: bool,
    stats: bool,
    quiet: bool,
) -> None:
    """Write what the sensors of RIG send while the vehicle stands or moves in a scene, as UDP in a pcap.

    The same input gives the same bytes.

    \b
    Example:
      lidarcfg export out/two/rig.yaml --scene data/scenes/street.yaml \\
          --at=-30,-10,0 --duration 1 -o out/two.pcap
    """
    import time
    from contextlib import ExitStack

    from lidarcfg.capture import export as capture
    from lidarcfg.capture.pcap import write_pcap
    from lidarcfg.capture.scene import load_scene
    from lidarcfg.capture.truth import TruthFile
    from lidarcfg.rig import load_rig

    for path, suffix, option in ((output, ".pcap", "-o"), (truth, ".npz", "--truth")):
        if path and path.suffix != suffix:
            raise click.BadParameter(f"{str(path)!r} does not end in {suffix}", param_hint=option)
    mounted, stage = load_rig(rig), load_scene(scene)
    duration_ns, began = round(duration * SECOND_NS), time.monotonic()
    counted = [0, 0]

    def on_rays(rays: int, cast: int) -> None:
        counted[:] = counted[0] + rays, counted[1] + cast

    with _progress(quiet) as on_share, ExitStack() as stack:

        def on_progress(done_ns: int) -> None:
            rate = done_ns / SECOND_NS / max(time.monotonic() - began, 1e-9)
            on_share(done_ns / duration_ns, f"{done_ns / SECOND_NS:.1f} s simulated, {rate:.1f}× real time")

        names = [mount.name for mount in mounted.mounts]
        beside = stack.enter_context(TruthFile(truth, names, stage.names)) if truth else None
        start_ns = _nanoseconds(start) if start else capture.START_NS
        streams = capture.export(
            mounted,
            stage,
            _way(trajectory, at, start_ns),
            duration_ns,
            start_ns,
            on_progress,
            on_truth=beside.add if beside else None,
            on_rays=on_rays,
            skip=not no_skip,
        )
        if split:
            paths = [output.with_name(f"{output.stem}-{name}.pcap") for name in names]
            counts = [write_pcap(path, stream) for path, stream in zip(paths, streams, strict=True)]
        else:
            paths, counts = [output], [write_pcap(output, capture.in_time_order(streams))]
        records = beside.save() if beside else 0
    if not quiet:
        for path, count in zip(paths, counts, strict=True):
            click.echo(f"{path}: {count:,} packets, {duration:g} s")
        if truth:
            click.echo(f"{truth}: {records:,} returns")
    if stats:
        rays, cast = counted
        click.echo(f"{rays:,} rays, {cast:,} cast; {rays - cast:,} ({1 - cast / rays:.1%}) could meet nothing in range")


@cli.command()
@click.argument("pcap", type=FILE)
@click.option("--rig", type=FILE, help="Merge by this rig's poses; without it each source keeps its own frame.")
@click.option("--model", help="What the sensor is, whatever its packets say.")
@click.option("--trajectory", type=FILE, help="How the vehicle moved: takes the motion out; points are in the world.")
@click.option("--at", metavar="X,Y,YAW_DEG", help="Where the trajectory starts.  [default: 0,0,0]")
@click.option("--start", metavar="TIME", help="When the trajectory starts; " + START_HELP)
@click.option("-o", "--output", type=FILE, required=True, help="The .ply, .pcd or .npz to write.")
@click.option("--stats", is_flag=True, help="Say of each source: model, return mode, rpm, lost packets.")
@quiet_option
def decode(
    pcap: Path,
    rig: Path | None,
    model: str | None,
    trajectory: Path | None,
    at: str | None,
    start: str | None,
    output: Path,
    stats: bool,
    quiet: bool,
) -> None:
    """Read the LiDAR packets in PCAP, ours or a real recording, into a point cloud.

    Each sensor's points are where it saw them from as it was then; with --trajectory they are in one frame, the world.

    \b
    Example:
      lidarcfg decode out/two.pcap --rig out/two/rig.yaml -o out/two.ply
    """
    from dataclasses import replace

    from lidarcfg.capture.decode import decode_pcap
    from lidarcfg.capture.export import START_NS
    from lidarcfg.cloud import save_clouds
    from lidarcfg.rig import load_rig

    if trajectory and not rig:
        raise click.UsageError("--trajectory needs --rig, which says where the sensors are on the vehicle")
    if (at or start) and not trajectory:
        raise click.UsageError("--at and --start say where and when a --trajectory starts")
    seen: list[SourceStats] = []
    clouds = decode_pcap(pcap, _note, load_rig(rig) if rig else None, model, on_stats=seen.append if stats else None)
    if trajectory:
        way = _way(trajectory, at or "0,0,0", _nanoseconds(start) if start else START_NS)
        clouds = (replace(cloud, xyz=way.world(cloud.xyz, cloud.time_ns)) for cloud in clouds)
    count = save_clouds(output, clouds)
    if not quiet:
        click.echo(f"{output}: {count:,} points")
    for source in seen:
        click.echo(
            f"{source.name}: {' or '.join(source.models)}, {' and '.join(source.return_modes)}, {source.rpm:.1f} rpm, "
            f"{source.packets:,} packets, {source.lost:,} lost, {source.duplicates:,} doubled, "
            f"{source.reordered:,} out of order"
        )


@cli.command()
@click.argument("pcap", type=FILE)
@click.option("--to", "target", metavar="HOST[:PORT]", required=True, help="Without a port each keeps its own.")
@click.option("--speed", type=Seconds(1e6), default=1.0, show_default=True, help="Times real time.")
@quiet_option
def replay(pcap: Path, target: str, speed: float, quiet: bool) -> None:
    """Send the UDP datagrams in PCAP to a host at their own pace, so that a driver can be tested live.

    \b
    Example:
      lidarcfg replay out/two.pcap --to 127.0.0.1:2368
    """
    from lidarcfg.capture.pcap import read_datagrams
    from lidarcfg.capture.replay import replay as send

    host, _, port = target.partition(":")
    if ":" in target and not (port.isascii() and port.isdigit() and 1 <= int(port) <= 65535):
        raise click.BadParameter(f"{port!r} is not a port, 1 to 65535", param_hint="--to")
    sent = send(read_datagrams(pcap, _note), host, int(port) if port else None, speed)
    if not quiet:
        late = f"the latest {sent.latest_s * 1000:.1f} ms after its time"
        click.echo(f"{sent.packets:,} datagrams to {target} in {sent.seconds:.2f} s, {late}")


@cli.command()
@click.argument("files", type=FILE, nargs=-1, required=True)
@click.option("--rig", type=FILE, help="The rig: merges a pcap by its poses and marks its sensors.")
@click.option("--model", help="What a pcap's sensors are, whatever their packets say.")
@click.option("--png", type=FILE, help="Draw a still; needs no screen.")
@click.option("--window", is_flag=True, help="Open Open3D's window.  [default, without --png]")
@quiet_option
def view(
    files: tuple[Path, ...], rig: Path | None, model: str | None, png: Path | None, window: bool, quiet: bool
) -> None:
    """Look at the merged points of captures (.pcap) and clouds (.ply, .pcd, .npz).

    \b
    Example:
      lidarcfg view out/two.pcap --rig out/two/rig.yaml --png out/two.png
    """
    from lidarcfg import view as viewer
    from lidarcfg.capture.decode import decode_pcap
    from lidarcfg.cloud import SUFFIXES, concatenate, load_cloud
    from lidarcfg.rig import load_rig

    mounted = load_rig(rig) if rig else None
    clouds = []
    for path in files:
        if path.suffix.lower() in SUFFIXES:
            clouds.append(load_cloud(path))
        else:
            clouds.extend(decode_pcap(path, _note, mounted, model))
    merged = concatenate(clouds)
    if png:
        viewer.save_still(merged, png, mounted)
        if not quiet:
            click.echo(f"{png}: {len(merged.xyz):,} points")
    if window or not png:
        viewer.show_window(merged)


def _note(message: str) -> None:
    click.echo(f"lidarcfg: {_one_line(message)}", err=True)


def _way(trajectory: Path | None, at: str, start_ns: int) -> "Trajectory":
    """How the vehicle moves from X,Y,YAW_DEG on; without a file it stands there."""
    from lidarcfg.capture.trajectory import STANDING, Trajectory, load_motion, prepared

    return Trajectory(_vehicle_pose(at), prepared(load_motion(trajectory) if trajectory else STANDING), start_ns)


def _vehicle_pose(at: str) -> "Array":
    """T_world_vehicle (4, 4) from X,Y,YAW_DEG."""
    import math

    from lidarcfg.geometry import pose

    try:
        x, y, yaw_deg = map(float, at.split(","))
        if not all(map(math.isfinite, (x, y, yaw_deg))):
            raise ValueError
    except ValueError:
        raise click.BadParameter(f"{at!r} is not three numbers X,Y,YAW_DEG", param_hint="--at") from None
    return pose((x, y, 0.0), (0.0, 0.0, math.radians(yaw_deg)))


def _nanoseconds(start: str) -> int:
    """Since 1970 in UTC."""
    from datetime import UTC, datetime

    try:
        time = datetime.fromisoformat(start)
    except ValueError:
        what = f"{start!r} is not a time such as 2026-01-01T00:00:00"
        raise click.BadParameter(what, param_hint="--start") from None
    if time.tzinfo is None:
        time = time.replace(tzinfo=UTC)
    since = time - datetime(1970, 1, 1, tzinfo=UTC)
    if not 0 <= since.total_seconds() < 2**32:
        raise click.BadParameter(f"{start!r} is outside a pcap's 1970 to 2106", param_hint="--start")
    return (since.days * 86_400 + since.seconds) * SECOND_NS + since.microseconds * 1000


@contextmanager
def _progress(quiet: bool) -> Iterator[Callable[[float, str], None]]:
    """A bar on stderr that is told the share that is done and a text; it shows from the first share on."""
    if quiet:
        yield lambda share, text: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (BarColumn(30), TextColumn("{task.description}"), TimeRemainingColumn())
    progress = Progress(*columns, console=Console(stderr=True))
    task = progress.add_task("", total=1.0)

    def on_share(share: float, text: str) -> None:
        progress.start()
        progress.update(task, completed=share, description=text)

    try:
        yield on_share
    finally:
        if progress.live.is_started:
            progress.stop()
