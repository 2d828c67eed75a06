"""What the documentation's site needs beside the pages: the README and the changelog as pages, links that fit it."""

from __future__ import annotations

import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[1]
PAGES = {"README": "readme", "CHANGELOG": "changes"}
OF_THE_TOP = {f"{name}.md": f"{page}.md" for name, page in PAGES.items()}
"""Files at the top of the repository -> pages."""

OF_ANOTHER_HOST = "https://unpkg.com/iframe-worker/shim"
OUR_OWN = "assets/iframe-worker.js"

_LINK = re.compile(r"\[([^\]\[]*)\]\(([^)#\s]+)(#[^)\s]*)?\)")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that stand at the top of the repository."""
    for name, page in OF_THE_TOP.items():
        files.append(File.generated(config, page, content=(ROOT / name).read_text(encoding="utf-8")))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn links that are right in the repository into links of the site; to files that it doesn't hold: into text."""
    at_the_top = page.file.src_uri in OF_THE_TOP.values()

    def fitted(link: re.Match[str]) -> str:
        words, target, anchor = link[1], link[2], link[3] or ""
        found = ((ROOT if at_the_top else ROOT / "docs") / target).resolve()
        if ":" in target or not found.exists():
            return link[0]
        if found.parent == ROOT and found.name in OF_THE_TOP:
            return f"[{words}]({OF_THE_TOP[found.name]}{anchor})"
        if found.is_relative_to(ROOT / "docs"):
            return f"[{words}]({found.relative_to(ROOT / 'docs').as_posix()}{anchor})"
        return words

    return _LINK.sub(fitted, markdown)


def on_post_page(output: str, page: Page, config: MkDocsConfig) -> str:
    """Take the one script that the theme would fetch from another host from the site itself."""
    return output.replace(OF_ANOTHER_HOST, OUR_OWN)


def on_post_template(output_content: str, template_name: str, config: MkDocsConfig) -> str:
    """The same in pages that aren't written by anybody, such as the one for what isn't found."""
    return output_content.replace(OF_ANOTHER_HOST, OUR_OWN)
