"""docs/security.md's commands and files, as they stand there, with this machine's endpoint and paths."""

import re
import subprocess
from pathlib import Path

from tests.helpers import REPOSITORY
from tests.servers import free_endpoint

PAGE = (REPOSITORY / "docs" / "security.md").read_text()
HOST = "192.0.2.10"


def make_certificates(folder: Path, names: tuple[str, ...] = ()) -> None:
    """Run the page's commands there; and for further ``names`` what the page does for alpha."""
    commands = re.search(r"```sh\n(.*?)```", PAGE, re.DOTALL)
    assert commands is not None
    of_alpha = "".join(line for line in commands[1].splitlines(keepends=True) if "alpha" in line)
    script = commands[1] + "".join(of_alpha.replace("alpha", name) for name in names)
    subprocess.run(["sh", "-e", "-c", script.replace(HOST, "127.0.0.1")], cwd=folder, check=True, capture_output=True)


class Files:
    """The page's json5 files."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.where = free_endpoint().removeprefix("tcp/")

    def file(self, name: str, **changes: str) -> Path:
        """The file of that name, with words changed."""
        found = re.search(rf"```json5\n// {name}\n(.*?)```", PAGE, re.DOTALL)
        assert found is not None, name
        text = found[1].replace(f"{HOST}:7447", self.where)
        for word, instead in changes.items():
            assert word in text
            text = text.replace(word, instead)
        text = re.sub(r'"([\w/]+\.(?:pem|key|txt))"', rf'"{self.folder}/\1"', text)
        out = self.folder / f"{len(list(self.folder.iterdir()))}-{name}"
        out.write_text(text)
        return out
