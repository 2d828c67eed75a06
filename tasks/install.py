"""Install the locked packages into this Python: ``python tasks/install.py requirements.lock`` (`make setup`).

uv does it in a fifth of pip's time. What pip is told where packages come from (its files, its variables) is told to uv
as well; where uv can't be had or can't find all of them, pip installs. Imports nothing that isn't Python's own: nothing
else is there yet.
"""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

PIP = (sys.executable, "-m", "pip")
SETTINGS = {
    "index-url": "UV_DEFAULT_INDEX",
    "extra-index-url": "UV_INDEX",
    "find-links": "UV_FIND_LINKS",
    "no-index": "UV_NO_INDEX",
    "cert": "SSL_CERT_FILE",
    "trusted-host": "UV_INSECURE_HOST",
    "default-timeout": "UV_HTTP_TIMEOUT",
    "timeout": "UV_HTTP_TIMEOUT",
}
"""What pip calls a setting -> the variable that uv reads it from."""
COMMAS = "UV_FIND_LINKS"  # its places are told apart by commas, those of the others by spaces


def uv_settings(configuration: str) -> dict[str, str]:
    """What `pip config list` prints, as variables for uv; a later line of a setting holds, as for pip."""
    found = {}
    for line in configuration.splitlines():
        key, equals, quoted = line.partition("=")
        name = key.removeprefix(":env:").rpartition(".")[2]
        if not equals or name not in SETTINGS:
            continue
        separator = "," if SETTINGS[name] == COMMAS else " "
        found[SETTINGS[name]] = separator.join(str(ast.literal_eval(quoted)).split())
    return found


def install(lock: Path) -> None:
    """Install exactly what a lock names.

    Raises:
        CalledProcessError: pip failed.
    """
    if not _by_uv(lock):
        subprocess.run([*PIP, "install", "-qq", "--no-compile", "-r", str(lock)], check=True)


def _by_uv(lock: Path) -> bool:
    version = next((line for line in lock.read_text(encoding="utf-8").splitlines() if line.startswith("uv==")), "uv")
    if subprocess.run([*PIP, "install", "-qq", version], check=False, capture_output=True).returncode:
        return False
    told = subprocess.run([*PIP, "config", "list"], check=False, capture_output=True, text=True).stdout
    environment: Mapping[str, str] = {
        # All places count alike, as for pip: the lock names versions.
        **uv_settings(told), "UV_INDEX_STRATEGY": "unsafe-best-match", **os.environ,
    }  # fmt: skip
    command = [sys.executable, "-m", "uv", "pip", "install", "-q", "--no-deps", "--python", sys.executable]
    ended = subprocess.run([*command, "-r", str(lock)], env=environment, check=False, capture_output=True, text=True)
    if ended.returncode:
        print(f"uv: {ended.stderr.strip()}\npip installs instead", file=sys.stderr)
    return not ended.returncode


if __name__ == "__main__":
    try:
        install(Path(sys.argv[1]))
    except subprocess.CalledProcessError as error:
        sys.exit(error.returncode)
