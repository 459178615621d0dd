"""Help as a page, and what TAB completes: asked of click, and of a real bash."""

import contextlib
import io
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import click
import pytest
from click.shell_completion import ShellComplete

from lidarcfg.cli.main import cli
from lidarcfg.sensors.sensor import catalogue

ROOT = Path(__file__).parents[2]
BIN = Path(sys.executable).parent
COMMANDS = {
    name: command
    for group, prefix in ((cli, ""), (cli.commands["sensors"], "sensors "))
    for name, command in ((prefix + name, command) for name, command in group.commands.items())
}


def page(words="", columns=80):
    """What --help prints on a terminal so wide."""
    said = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(said):
        patch.setenv("COLUMNS", str(columns))
        cli.main([*words.split(), "--help"], prog_name="lidarcfg", standalone_mode=False)
    return said.getvalue()


def test_the_first_page_has_every_command_once_by_task_and_in_order():
    text = page()
    listed = [
        line.split()[0] for line in text.splitlines() if line[:2] == "  " and line[2:3].isalpha() and "  " in line[3:]
    ]
    sections = cli.list_sections(click.Context(cli))
    assert [name for name in listed if name in cli.commands] == [name for s in sections for name in s.commands]
    assert sorted(name for s in sections for name in s.commands) == sorted(cli.commands)
    for section in sections:
        assert f"\n{section.title}:\n" in text
    assert "..." not in text.partition("Options:")[2]  # a sentence cut short
    assert "docs/" in text


@pytest.mark.parametrize("columns", [52, 80, 200])
def test_help_fits_the_terminal(columns):
    """Examples and tables fit 80 columns; they are not broken, so that a narrower terminal can wrap what it copies."""
    for words in ("", *COMMANDS):
        text, *examples = re.split(r"^(?:Examples?|From a study to a picture):$", page(words, columns), flags=re.M)
        for line in text.splitlines():
            is_table = words == "convert" and line.startswith("  ") and "   " in line.strip()
            assert len(line) <= max(79 if is_table else 0, min(columns, 100)), (words, line)
        for line in re.findall(r"^ .*", "\n".join(examples), re.M):
            assert len(line) < 80, (words, line)


@pytest.mark.parametrize("columns", [52, 80])
def test_a_broken_example_is_one_command_to_a_shell(columns):
    example = page("export", columns).split("Example:\n")[1]
    assert example.count("\\\n") == 1
    said = subprocess.run(
        ["bash", "-c", example.replace("lidarcfg", "echo", 1)], capture_output=True, text=True, check=True
    )
    assert said.stdout == (
        "export out/sedan/rig.yaml --scene data/scenes/street.yaml --at=0,-1.8,0 --duration 1 -o out/sedan.pcap\n"
    )


def test_every_command_has_an_example_and_one_sentence():
    for name, command in COMMANDS.items():
        if name.split()[-1] != "list":
            assert f"lidarcfg {name}" in command.epilog.split("Example")[1], name
        assert command.get_short_help_str(limit=200).endswith("."), name


def completed(*words):
    """What click offers for the last of these words."""
    *before, incomplete = words
    return {item.value for item in ShellComplete(cli, {}, "lidarcfg", "_X").get_completions(before, incomplete)}


def test_what_completes():
    assert {"export", "evaluate"} <= completed("e") <= set(cli.commands)
    assert completed("optimize", "--solver", "") == {"auto", "abc", "annealing"}
    assert completed("sensors", "show", "") == set(catalogue())
    assert completed("sensors", "show", "hdl") == {name for name in catalogue() if name.startswith("hdl")}
    for command in ("decode", "view", "convert"):
        assert completed(command, "--model", "vlp-1") == {"vlp-16"}
    roof = str(ROOT / "data/rigs/roof.yaml")
    assert completed("decode", "x.pcap", "--rig", roof, "--sensor", "") == {"left", "right"}
    assert completed("decode", "x.pcap", "--rig", roof, "--sensor", "r") == {"right"}
    assert completed("decode", "x.pcap", "--rig", "none.yaml", "--sensor", "") == set()
    assert completed("decode", "x.pcap", "--sensor", "") == set()
    assert completed("completion", "z") == {"zsh"}
    assert {"--scene", "--duration"} <= completed("export", "--")


def test_every_path_completes_files():
    for name, command in COMMANDS.items():
        for param in command.params:
            if isinstance(param.type, click.Path):
                (item,) = param.shell_complete(click.Context(command), "da")
                assert item.type in ("file", "dir"), (name, param.name)


def tab(words, cwd):
    """What a real bash has in COMPREPLY after TAB, with the script sourced."""
    script = f"""
source <(lidarcfg completion bash)
compopt() {{ printf "compopt %s\\n" "$2"; }}
COMP_WORDS=({words}); COMP_CWORD=$(( ${{#COMP_WORDS[@]}} - 1 ))
_lidarcfg_completion lidarcfg
printf '%s\\n' "${{COMPREPLY[@]}}"
"""
    environment = os.environ | {"PATH": f"{BIN}:{os.environ['PATH']}"}
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, cwd=cwd, env=environment, check=True)
    assert done.stderr == ""
    return done.stdout.split("\n")[:-1]


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("bash"), reason="there is no bash")
def test_a_real_bash(tmp_path):
    assert tab("lidarcfg opt", tmp_path) == ["optimize"]
    assert tab("lidarcfg sensors show puck", tmp_path) == ["puck-hi-res", "puck-lite"]
    assert tab("lidarcfg optimize --solver an", tmp_path) == ["annealing"]
    assert tab("lidarcfg evaluate data/stu", tmp_path) == ["compopt default", ""]  # bash's own files
    assert tab("lidarcfg decode x.pcap --model ./my", tmp_path) == ["compopt default", ""]


@pytest.mark.skipif(not shutil.which("fish"), reason="there is no fish")
def test_a_real_fish():
    script = 'lidarcfg completion fish | source; complete -C "lidarcfg sensors show puck"'
    environment = os.environ | {"PATH": f"{BIN}:{os.environ['PATH']}"}
    done = subprocess.run(
        ["fish", "--no-config", "-c", script], capture_output=True, text=True, env=environment, check=True
    )
    assert done.stdout.splitlines() == ["puck-hi-res", "puck-lite"]


@pytest.mark.slow
@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_scripts(shell, tmp_path):
    done = subprocess.run(
        [BIN / "lidarcfg", "completion"],
        capture_output=True,
        text=True,
        env=os.environ | {"SHELL": f"/usr/bin/{shell}"},
        check=True,
    )
    named = subprocess.run([BIN / "lidarcfg", "completion", shell], capture_output=True, text=True, check=True)
    assert done.stdout == named.stdout
    assert f"_LIDARCFG_COMPLETE={shell}_complete" in done.stdout
    if shutil.which(shell):
        (tmp_path / "script").write_text(done.stdout)
        subprocess.run([shell, "-n", tmp_path / "script"], check=True)


@pytest.mark.parametrize("shell", ["/bin/tcsh", ""])
def test_a_shell_that_is_not_known(shell):
    environment = os.environ | {"SHELL": shell}
    done = subprocess.run(
        [BIN / "lidarcfg", "completion"], capture_output=True, text=True, env=environment, check=False
    )
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert f"'{Path(shell).name}' is not one of 'bash', 'zsh', 'fish'" in done.stderr
