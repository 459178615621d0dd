"""What the site has beyond the pages of docs/: an API page for each package, and links into the repository."""

import ast
import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parent.parent


def faces() -> dict[str, list[str]]:
    """The names that the package and each of its packages export, each by its full name."""
    found = {}
    for stub in [ROOT / "lidarcfg/__init__.pyi", *sorted((ROOT / "lidarcfg").glob("*/__init__.pyi"))]:
        package = ".".join(stub.parent.relative_to(ROOT).parts)
        froms = [node for node in ast.parse(stub.read_text()).body if isinstance(node, ast.ImportFrom)]
        names = [f"{package}.{node.module}.{one.name}" for node in froms if node.level for one in node.names]
        if names:
            found[package] = names
    return found


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Put the API pages behind the others."""
    assert config.nav
    config.nav.append({"API reference": [f"api/{package}.md" for package in faces()]})
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the API pages."""
    for package, names in faces().items():
        text = "\n".join([f"# {package}\n", *(f"::: {name}\n" for name in sorted(names, key=str.lower))])
        files.append(File.generated(config, f"api/{package}.md", content=text))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Lead links that leave docs/ to the repository."""
    up = "../" * (page.file.src_uri.count("/") + 1)
    return re.sub(rf"\]\({re.escape(up)}(?!\.\./)([^)\s]+)\)", rf"]({config.repo_url}/blob/main/\1)", markdown)
