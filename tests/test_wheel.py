"""The wheel and the source distribution hold what commands need outside a checkout."""

from __future__ import annotations

import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import yaml

BUILD = "from setuptools import build_meta as b; import sys; to = sys.argv[1]; b.build_wheel(to); b.build_sdist(to)"
WANTED = (
    "py.typed", "params.yaml", "data/whtc.csv", "data/channel_names.yaml", "codegen/c/driver.c",
    "codegen/fmi/fmi2Functions.h", "codegen/fmi/fmi3Functions.h",
)  # fmt: skip


def test_what_is_built(project_root: Path, tmp_path: Path):
    parts = ["dieseltwin", "README.md", "pyproject.toml", "MANIFEST.in", "LICENSE", "params.yaml"]
    command = ["git", "ls-files", "-co", "--exclude-standard", "-z", *parts]
    listed = subprocess.run(command, cwd=project_root, capture_output=True, text=True, check=True).stdout
    tree = tmp_path / "tree"
    for name in filter(None, listed.split("\0")):
        source, target = project_root / name, tree / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if source.is_symlink():
            target.symlink_to(source.readlink())
        elif source.is_file():
            target.write_bytes(source.read_bytes())
    subprocess.run([sys.executable, "-c", BUILD, str(tmp_path)], cwd=tree, check=True, capture_output=True)
    (wheel,), (sdist,) = tmp_path.glob("*.whl"), tmp_path.glob("*.tar.gz")
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        assert {f"dieseltwin/{name}" for name in WANTED} <= names
        settings = archive.read("dieseltwin/params.yaml")
    assert settings == (project_root / "params.yaml").read_bytes() and "identify" in yaml.safe_load(settings)
    written = {path.relative_to(project_root).as_posix() for path in (project_root / "dieseltwin").rglob("*.py")}
    assert written <= names
    with tarfile.open(sdist) as archive:
        packed = archive.extractfile(f"{sdist.name.removesuffix('.tar.gz')}/dieseltwin/params.yaml")
        assert packed is not None and packed.read() == settings
