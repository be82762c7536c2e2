"""MkDocs hooks: pages that are made from the program, and formulas as MathML."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import api_reference
import command_reference
import formulas
import notebook_pages
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[2]


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Fill in what the program and its metadata say: reference and notebooks, version, address of the source."""
    with (ROOT / "pyproject.toml").open("rb") as file:
        project = tomllib.load(file)["project"]
    config.copyright = f"{project['name']} {project['version']}, {project['license']}"
    config.repo_url = config.repo_url or project.get("urls", {}).get("Repository")
    if config.repo_url:
        config.edit_uri = "edit/main/docs/"
    for entry in config.nav or []:
        if "Reference" in entry:
            entry["Reference"] = [{"Commands": "reference/commands.md"}, {"Python": api_reference.navigation()}]
        if "Notebooks" in entry:
            entry["Notebooks"] = [f"notebooks/{name}.md" for name in ("index", *notebook_pages.names())]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages."""
    pages = {
        "reference/commands.md": command_reference.page(),
        "changelog.md": _as_site_page((ROOT / "CHANGELOG.md").read_text(encoding="utf-8")),
        "contributing.md": _as_site_page((ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")),
        **api_reference.pages(),
        **notebook_pages.pages(),
    }
    for path, text in pages.items():
        files.append(File.generated(config, path, content=text))
    return files


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn formulas into MathML, which browsers show without scripts."""
    return formulas.to_mathml(html, page.file.src_uri)


def on_post_page(output: str, page: Page, config: MkDocsConfig) -> str:
    """Refuse a page that asks another computer for something, shows a formula as its source, or links to no page."""
    for wrong in ('<script src="http', '<link rel="stylesheet" href="http', 'class="arithmatex"'):
        if wrong in output:
            raise PluginError(f"{page.file.src_uri}: contains {wrong}")
    source = re.search(r'href="(?!https?:)([^"]*\.md(#[^"]*)?)"', output)
    if source:
        raise PluginError(f"{page.file.src_uri}: links to {source.group(1)}, which is no page of the site")
    return output


def _as_site_page(text: str) -> str:
    """Links of a file at the top of the checkout, as seen from a page of the site."""
    return text.replace("](docs/", "](")
