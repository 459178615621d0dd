"""The container's file, line by line, the page on installing, and what GitHub reads: what they name is there."""

import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml
from click.testing import CliRunner

from lidarcfg.cli.main import cli

ROOT = Path(__file__).parents[1]
DOCKERFILE = ROOT / "tools/Dockerfile"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
INSTRUCTIONS = {"FROM", "COPY", "RUN", "WORKDIR", "ENTRYPOINT", "CMD"}


def instructions():
    """Instruction and arguments of each line, as Docker reads a file without continued lines."""
    lines = [line for line in DOCKERFILE.read_text().splitlines() if line and not line.startswith("#")]
    return [(line.split(" ", 1)[0], line.split(" ", 1)[1]) for line in lines]


def test_each_line_is_an_instruction_and_what_it_copies_is_there():
    stages = set()
    for name, text in instructions():
        assert name in INSTRUCTIONS
        words = text.split()
        if name == "FROM":
            assert re.fullmatch(r"python:3\.1[1-4]-slim( AS \w+)?", text)
            stages |= set(words[2:])
        if name == "COPY":
            sources = words[:-1]
            if sources[0].startswith("--from="):
                assert sources[0].removeprefix("--from=") in stages
                continue
            assert all((ROOT / source).exists() for source in sources), text
            assert len(sources) == 1 or words[-1].endswith("/")


def test_the_image_gets_all_that_a_build_reads():
    """What pyproject.toml names, and the build's own backend; by the package's own list and not by Docker."""
    copied = {word for name, text in instructions() if name == "COPY" for word in text.split()[:-1]}
    needed = [*PROJECT["project"]["license-files"], PROJECT["tool"]["scikit-build"]["cmake"]["source-dir"]]
    needed += PROJECT["tool"]["scikit-build"]["wheel"]["force-include"]
    needed += [f"{path}/build_backend.py" for path in PROJECT["build-system"]["backend-path"]]
    needed += [one["path"] for one in PROJECT["tool"]["hatch"]["metadata"]["hooks"]["fancy-pypi-readme"]["fragments"]]
    needed += [one["input"] for one in PROJECT["tool"]["dynamic-metadata"] if "input" in one]
    for path in ("pyproject.toml", *needed):
        assert any(path == one or path.startswith(f"{one}/") for one in copied), path


@pytest.mark.slow
def test_its_commands_are_understood():
    """pip's and ours, asked for help with the options given; the extras are the package's."""
    commands = [shlex.split(part) for name, text in instructions() if name == "RUN" for part in text.split(" && ")]
    assert {words[0] for words in commands} == {"pip", "apt-get", "rm", "lidarcfg"}
    for words in commands:
        if words[0] == "pip":
            options = [word for word in words[2:] if word.startswith("--")]
            said = subprocess.run(
                [sys.executable, "-m", "pip", words[1], "--help"], capture_output=True, text=True, check=True
            ).stdout
            assert all(re.search(rf"{option}\b", said) for option in options), words
            for extras in re.findall(r"\[([\w,]+)\]", words[-1]):
                assert set(extras.split(",")) <= PROJECT["project"]["optional-dependencies"].keys()
        if words[0] == "lidarcfg":
            assert CliRunner().invoke(cli, words[1:]).exit_code == 0
    (entry,) = (text for name, text in instructions() if name == "ENTRYPOINT")
    (default,) = (text for name, text in instructions() if name == "CMD")
    assert re.findall(r'"([^"]+)"', entry) == [*PROJECT["project"]["scripts"]]
    assert CliRunner().invoke(cli, re.findall(r'"([^"]+)"', default)).exit_code == 0


def test_system_libraries_are_the_same_everywhere():
    """In the container's file, on the page, and in what the demo installs."""
    installed = (ROOT / "tools/environment.sh").read_text()
    page = (ROOT / "docs/installation.md").read_text()
    for one in ("libegl1", "libgl1", "libgomp1", "libusb-1.0-0"):
        assert f'"{one}"' in installed
        assert one in page
        assert one in DOCKERFILE.read_text()


def test_the_page_names_what_is_there():
    page = (ROOT / "docs/installation.md").read_text()
    for extra in re.findall(r"pip install '\.\[(\w+)\]'", page):
        assert extra in PROJECT["project"]["optional-dependencies"]
    for command in re.findall(r"lidarcfg (?!lidarcfg)([a-z]+) ", " ".join(re.findall(r"^docker run .*$", page, re.M))):
        assert command in cli.commands
    low, high = re.search(r"Python (3\.\d+) to (3\.\d+)", page).groups()
    versions = [one.split(" :: ")[-1] for one in PROJECT["project"]["classifiers"] if "Python :: 3." in one]
    assert (low, high) == (versions[0], versions[-1])
    assert PROJECT["project"]["requires-python"] == f">={low}"


def test_the_demo_has_the_extra_that_its_next_commands_need():
    """The README converts what the demo wrote to MCAP."""
    assert re.search(r'environment\.sh"? "?convert', (ROOT / "tools/demo").read_text())


@pytest.mark.parametrize(
    ("schema", "files"),
    [
        ("github-workflows", ".github/workflows/*.yml"),
        ("github-issue-forms", ".github/ISSUE_TEMPLATE/[!c]*.yml"),
        ("github-issue-config", ".github/ISSUE_TEMPLATE/config.yml"),
        ("dependabot", ".github/dependabot.yml"),
        ("citation-file-format", "CITATION.cff"),
    ],
)
def test_what_github_reads_keeps_its_schema(schema, files):
    found = sorted(map(str, ROOT.glob(files)))
    assert found
    checked("check-jsonschema", "--builtin-schema", f"vendor.{schema}", *found)


@pytest.mark.parametrize(
    "words",
    [("zizmor", "--offline", "--no-progress", ".github"), ("hadolint", "--ignore", "DL3008", "tools/Dockerfile")],
)
def test_linters_find_nothing(words):
    """DL3008: Debian removes the versions that it would have pinned."""
    checked(*words)


def checked(program, *words):
    path = Path(sys.executable).with_name(program)
    if not path.exists():
        pytest.skip(f"no wheel of {program} for this Python and system")
    done = subprocess.run([path, *words], cwd=ROOT, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_workflows_run_what_is_there_on_pythons_that_are_supported():
    workflows = {path.stem: yaml.safe_load(path.read_text()) for path in ROOT.glob(".github/workflows/*.yml")}
    supported = {line.rsplit(" ")[-1] for line in PROJECT["project"]["classifiers"] if "Python :: 3." in line}
    assert len(set(workflows["tests"]["jobs"]["tests"]["strategy"]["matrix"]["python"]) & supported) == 3
    steps = [step for one in workflows.values() for job in one["jobs"].values() for step in job.get("steps", ())]
    scripts = {step["run"] for step in steps if "run" in step} & {".ci/run", "tools/site"}
    assert scripts == {".ci/run", "tools/site"}
    assert all((ROOT / script).exists() for script in scripts)


def test_versions_agree():
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    released = re.search(r"## ([\d.]+) \((\d{4}-\d\d-\d\d)\)", (ROOT / "CHANGELOG.md").read_text())
    assert (cited["version"], str(cited["date-released"])) == released.groups()
