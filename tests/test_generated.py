"""Pages, drawings and stubs that are made of the code."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["make_architecture", "make_keys", "make_stubs"])
def test_what_is_made_is_up_to_date(name):
    tool = ROOT / f"tools/{name}.py"
    done = subprocess.run([sys.executable, tool, "--check"], check=False)
    assert done.returncode == 0, f"run {tool.relative_to(ROOT)}"


def test_the_site_has_each_page():
    """By what is in the folder."""
    nav = (ROOT / "tools/mkdocs.yml").read_text().partition("nav:")[2].partition("theme:")[0]
    pages = sorted(path.relative_to(ROOT / "docs").as_posix() for path in (ROOT / "docs").rglob("*.md"))
    assert sorted(re.findall(r"[\w/-]+\.md", nav)) == pages


def test_the_site_builds(tmp_path):
    """By MkDocs itself, which finds links that lead nowhere; with an API page for each package that exports names."""
    pytest.importorskip("mkdocs", reason="the extra `docs` is not installed")
    build = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--config-file", ROOT / "tools/mkdocs.yml"]
    subprocess.run([*build, "--site-dir", tmp_path], check=True)
    stubs = [path.parent.name for path in (ROOT / "lidarcfg").glob("*/__init__.pyi") if "from ." in path.read_text()]
    there = {path.name for path in (tmp_path / "api").iterdir()}
    assert there == {"lidarcfg", *(f"lidarcfg.{name}" for name in stubs)}
