"""The built wheel is complete; a failed build writes nothing."""

import os
import runpy
import shutil
import subprocess
import sys
import tarfile
from pathlib import Path
from zipfile import ZipFile

import pytest

import avrgym
from avrgym.vr.server.web_server import STATIC_FOLDER
from helpers.system.paths import ROOT

PACKAGE = Path(avrgym.__file__).parent
NEEDED = ("pyproject.toml", "hatch_build.py", "README.md", "LICENSE")


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a clone holds after ``make client``."""
    assert (STATIC_FOLDER / "index.html").is_file(), "the client must be built"
    folder = tmp_path_factory.mktemp("source")
    for name in NEEDED:
        shutil.copy(ROOT / name, folder)
    shutil.copytree(PACKAGE, folder / "src" / "avrgym", ignore=shutil.ignore_patterns("__pycache__"))
    (folder / ".gitignore").write_text("/src/avrgym/vr/static/\n")
    return folder


def build(source: Path, kind: str, out: Path) -> subprocess.CompletedProcess[str]:
    """Build as ``pip`` does, without the network."""
    call = f"import hatchling.build; hatchling.build.build_{kind}({str(out)!r})"
    return subprocess.run([sys.executable, "-c", call], cwd=source, capture_output=True, text=True)


@pytest.fixture(scope="module")
def wheel(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("wheel")
    built = build(source, "wheel", out)
    assert built.returncode == 0, built.stderr
    (path,) = out.glob("*.whl")
    return path


def files_of_the_package() -> set[str]:
    return {
        path.relative_to(PACKAGE.parent).as_posix()
        for path in PACKAGE.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }


def test_a_wheel_contains_the_whole_package(wheel: Path) -> None:
    with ZipFile(wheel) as archive:
        held = set(archive.namelist())
    assert files_of_the_package() <= held
    assert {f"avrgym/vr/static/{page}.html" for page in ("index", "dashboard", "replay")} <= held
    assert (
        sum(name.startswith("avrgym/assets/policies/") and name.endswith(".safetensors") for name in held)
        >= 16
    )
    assert any(name.startswith("avrgym/assets/human/") for name in held)


@pytest.mark.slow
def test_a_source_distribution_holds_the_client(source: Path, tmp_path: Path) -> None:
    assert build(source, "sdist", tmp_path).returncode == 0
    (path,) = tmp_path.glob("*.tar.gz")
    with tarfile.open(path) as archive:
        held = {name.partition("/")[2] for name in archive.getnames()}
    assert {f"src/{name}" for name in files_of_the_package()} <= held
    assert "hatch_build.py" in held


@pytest.mark.fast_cases(3)
@pytest.mark.parametrize("kind", ["wheel", "sdist"])
@pytest.mark.parametrize(
    "lost", ["vr/static", "assets/policies/DrinkingPR2-revised.safetensors", "assets/human/woman.npz"]
)
def test_a_wheel_requires_pages_policies_and_bodies(
    source: Path, tmp_path: Path, kind: str, lost: str
) -> None:
    clone = Path(shutil.copytree(source, tmp_path / "clone"))
    place = clone / "src" / "avrgym" / lost
    shutil.rmtree(place) if place.is_dir() else place.unlink()
    built = build(clone, kind, tmp_path / "out")
    assert built.returncode != 0
    assert f"missing in {clone / 'src' / 'avrgym'}: {lost}" in built.stderr
    assert "`make client` builds the pages" in built.stderr
    assert "Traceback" not in built.stderr
    assert not list(tmp_path.glob("out/*"))


def test_the_build_checks_all_required_files() -> None:
    needed = runpy.run_path(str(ROOT / "hatch_build.py"))["ASSETS"]
    folder = PACKAGE / "assets"
    assert sorted(needed) == sorted(
        path.relative_to(PACKAGE).as_posix()
        for path in folder.rglob("*")
        if path.is_file() and path.suffix != ".md"
    )


@pytest.mark.slow
def test_a_missing_client_is_reported_with_a_fix(wheel: Path, tmp_path: Path) -> None:
    with ZipFile(wheel) as archive:
        archive.extractall(tmp_path)
    shutil.rmtree(tmp_path / "avrgym" / "vr" / "static")
    served = subprocess.run(
        [sys.executable, "-c", "from avrgym.cli.main import app; app()", "serve", "--port", "0"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
    )
    assert served.returncode == 1
    (line,) = served.stderr.splitlines()
    assert line.startswith(
        "avrgym: the browser client is missing; run `pip install --force-reinstall avrgym`"
    )
