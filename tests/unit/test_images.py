"""The container images: the lock files satisfy pyproject.toml, every line has a hash, and the base
image can be pinned."""

import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from tests.paths import ROOT

PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PROJECT = PYPROJECT["project"]
BASE = PROJECT["dependencies"]
EXTRAS = PROJECT["optional-dependencies"]
LINE = re.compile(
    r"^(?P<name>[\w.-]+)==(?P<version>[\w.]+)(?: ; [^\\]*)? \\\n(?P<hashes>(?: .*\n)+)",
    re.MULTILINE,
)


def needed(*extras: str) -> list[str]:
    """The requirements with extras, and with those that they name."""
    found = [text for extra in extras for text in EXTRAS[extra]]
    named = [each for text in found for each in Requirement(text).extras if "kollsman" in text]
    return [text for text in found if "kollsman" not in text] + (needed(*named) if named else BASE)


def locked(*names: str) -> dict[str, set[str]]:
    """Versions by package name."""
    found: dict[str, set[str]] = {}
    for name in names:
        text = (ROOT / "docker" / f"{name}.lock").read_text(encoding="utf-8")
        matches = list(LINE.finditer(text))
        assert sum("==" in line for line in text.splitlines()) == len(matches)
        for match in matches:
            assert "--hash=sha256:" in match["hashes"]
            found.setdefault(match["name"].lower(), set()).add(match["version"])
    return found


@pytest.mark.parametrize(
    ("wanted", "files"),
    [(BASE, ["companion"]), (needed("sim"), ["sim", "jsbsim"]), (["hatchling>=1.25"], ["build"])],
    ids=["companion", "sim", "build"],
)
def test_the_lock_files_satisfy_the_project(wanted: list[str], files: list[str]) -> None:
    versions = locked(*files)
    for text in wanted:
        requirement = Requirement(text)
        held = versions.get(requirement.name.lower(), set())
        assert held, f"{requirement.name} is missing: make lock"
        assert any(requirement.specifier.contains(each) for each in held), f"{text}: make lock"


def test_both_images_have_the_same_versions() -> None:
    base, sim = locked("companion"), locked("sim")
    assert {name: sim.get(name) for name in base} == base


def bases(folder: Path) -> set[str]:
    """The base images that the Dockerfiles name."""
    pattern = re.compile(r"^ARG BASE=(.+)$", re.MULTILINE)
    files = sorted(folder.glob("*.Dockerfile"))
    assert len(files) == 2
    return {base for path in files for base in pattern.findall(path.read_text(encoding="utf-8"))}


def test_both_images_have_the_same_base() -> None:
    assert len(bases(ROOT / "docker")) == 1


def test_the_base_is_pinned_by_a_digest(tmp_path: Path) -> None:
    """The script asks skopeo, here a double of it, and takes no answer that is no digest."""
    folder, tools = tmp_path / "docker", tmp_path / "bin"
    folder.mkdir()
    tools.mkdir()
    for path in [*(ROOT / "docker").glob("*.Dockerfile"), ROOT / "docker" / "pin-base.sh"]:
        shutil.copy(path, folder)
    (name,) = {base.split("@")[0] for base in bases(folder)}
    digest = "sha256:" + 16 * "0af5"
    skopeo = tools / "skopeo"
    for answer, code in ((digest, 0), (digest[:-1] + "5", 0), ("no such image", 1)):
        skopeo.write_text(f"#!/bin/sh\necho '{answer}'\n", encoding="ascii")
        skopeo.chmod(0o755)
        search = f"{tools}:/usr/bin:/bin"
        command = ["bash", str(folder / "pin-base.sh")]
        done = subprocess.run(command, env={"PATH": search}, capture_output=True, check=False)
        assert done.returncode == code, done.stderr
        if code == 0:
            assert bases(folder) == {f"{name}@{answer}"}


def test_the_images_see_all_that_the_wheel_is_made_of() -> None:
    lines = (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines()
    seen = {line.removeprefix("!") for line in lines if line.startswith("!")}
    wheel = PYPROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]
    needed_paths = [*wheel["packages"], *wheel["force-include"], PROJECT["readme"]]
    needed_paths += PROJECT["license-files"]
    for path in needed_paths:
        assert path in seen or path.split("/")[0] in seen, path
