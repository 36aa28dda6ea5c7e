"""What `mkdocs` does beside building docs/: README, CHANGELOG, wire format and client in C become pages where they lie.

Each is written once, in the place where people look for it in the repository. Here its links are turned into links
between pages; files that are no pages but are linked to come along.
"""

import posixpath
import re
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

REPOSITORY = Path(__file__).parent.parent.parent
PAGES = {
    "README.md": "index.md",
    "CHANGELOG.md": "changelog.md",
    "protocol/README.md": "wire.md",
    "clients/c/README.md": "c.md",
}
LINK = re.compile(r"(\]\()([^)#\s]+)((?:#[^)\s]*)?\))")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages from outside docs/, and what they and the others link to."""
    for source, page in PAGES.items():
        files.append(File.generated(config, page, content=(REPOSITORY / source).read_text()))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn links into the repository into links between pages."""
    source = next((source for source, name in PAGES.items() if name == page.file.src_uri), f"docs/{page.file.src_uri}")

    def turned(match: re.Match[str]) -> str:
        before, link, after = match.groups()
        if "://" in link or link.startswith("mailto:"):
            return match[0]
        return (
            before
            + _page_of(posixpath.normpath(posixpath.join(posixpath.dirname(source), link)), config, files)
            + after
        )

    return LINK.sub(turned, markdown)


def _page_of(path: str, config: Any, files: Files) -> str:
    """Where on the site a file of the repository is; a file from outside docs/ is taken along."""
    if path in PAGES:
        return PAGES[path]
    if path.startswith("docs/"):
        return path.removeprefix("docs/")
    name = f"files/{path}"
    if files.get_file_from_path(name) is None and (REPOSITORY / path).is_file():
        files.append(File.generated(config, name, abs_src_path=str(REPOSITORY / path)))
    return name
